"""A sliding window: the last frames, their landmarks and their joint covariance, as one value.

Its world is the first camera of the recording. That first pose is held by a prior, so that the
information of the frames that left the window is a proper prior of those that remain, and the
covariances of poses are absolute: they grow along the path.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from probevo.arrays import BoolArray, FloatArray, IntArray, rows_of
from probevo.errors import InputError
from probevo.estimation.window.calibration_effect import CalibrationEffect
from probevo.estimation.window.equations import (
    JITTER,
    POSE,
    RIG,
    WindowLandmarks,
    WindowObservations,
)
from probevo.estimation.window.inertial import Inertial
from probevo.geometry import se3
from probevo.measurements.base import Measurement
from probevo.measurements.variables import Values, pose_of

RIGID_SIGMA_RAD = 1e-9
"""Standard deviation of the jitter of a rig that is said to be flawless, rad."""
ORIGIN_SIGMA = 1e-7
"""Standard deviation of the first pose, m and rad: it is the origin, but for rounding."""


@dataclass(frozen=True)
class MarginalPrior:
    """What all that was marginalised says of K poses and the rig: the cost ½ xᵀ Λ x − ηᵀ x.

    x, [6K + 4], holds the poses' offsets Log(T T̄⁻¹) from their linearisation points, and the rig's
    errors. The prior of the latter is not part of it (``WindowAdjustment``)."""

    information: FloatArray
    """Λ, [6K + 4, 6K + 4]."""
    vector: FloatArray
    """η, [6K + 4]."""


class SmoothedPose(NamedTuple):
    """A pose as it leaves the window, with all that later frames of the window say of it."""

    frame: int
    """Index of its frame."""
    T_world_cam: FloatArray
    """[4, 4], m."""
    cov: FloatArray
    """Covariance of the left perturbation of T_cam_world, [6, 6], m and rad."""


@dataclass(frozen=True)
class Window:
    """K frames, L landmarks, and M observations of these."""

    frames: IntArray
    """Index of each frame, [K], ascending."""
    T_cam_world: FloatArray
    """Poses, [K, 4, 4], m."""
    T_linear: FloatArray
    """Linearisation points T̄ of the poses, [K, 4, 4]; that of a pose is fixed once the prior
    contains it."""
    rig_errors: FloatArray
    """Disparity errors (b₀, b₁, b₂) of the rig in px, and the distortion k₁ of its lenses, [4]."""
    is_blind: BoolArray
    """Which frames no feature connects with others, so that their poses are dead-reckoned, [K]."""
    jitter: FloatArray
    """Jitter ω of each frame, [K, 3], rad (``camera.rig_jitter``)."""
    jitter_cov: FloatArray
    """Its prior covariance S, [3, 3], rad²."""
    prior: MarginalPrior
    ids: IntArray
    """Identity of each landmark, [L]."""
    landmarks: WindowLandmarks
    observations: WindowObservations
    cov: FloatArray
    """Joint covariance of the poses' left perturbations and the rig, [6K + 4, 6K + 4]."""
    cov_of_motions: FloatArray
    """The same for motions between the poses (``PoseCovariance.motion_cov``)."""
    calibration_effect: CalibrationEffect
    """How errors of the calibration that the window does not estimate move its poses
    (Schmidt's consider term). ``cov`` is without it."""
    dead_reckoning: tuple[Measurement, ...] = ()
    """Measurements that stand in for features, of which each is linearised anew until a frame of it
    leaves the window: what is dead-reckoned may be off by tens of degrees, and turn once an IMU is
    used. They are not in the prior."""
    marginalized: tuple[SmoothedPose, ...] = ()
    """The poses that have left the window in the last step."""
    inertial: Inertial = field(default_factory=Inertial.none)
    """Its IMU, with velocities, biases and gravity; ``Inertial.none`` without one."""

    @staticmethod
    def at_first_frame(frame: int) -> Window:
        """Return the window of the first frame, which has no landmark yet."""
        # The joint vector is (pose, rig); the rig's prior is the estimator's, so that its block is
        # zero.
        information = np.zeros((POSE + RIG, POSE + RIG))
        information[:POSE, :POSE] = np.eye(POSE) / ORIGIN_SIGMA**2
        cov = np.zeros((POSE + RIG, POSE + RIG))
        cov[:POSE, :POSE] = np.eye(POSE) * ORIGIN_SIGMA**2
        return Window(
            frames=np.array([frame]),
            T_cam_world=np.eye(4)[None],
            T_linear=np.eye(4)[None],
            is_blind=np.zeros(1, np.bool_),
            rig_errors=np.zeros(RIG),
            jitter=np.zeros((1, JITTER)),
            jitter_cov=RIGID_SIGMA_RAD**2 * np.eye(JITTER),
            prior=MarginalPrior(information, np.zeros(POSE + RIG)),
            ids=np.zeros(0, np.int64),
            landmarks=WindowLandmarks(
                state=np.zeros((0, 4)),
                error_information=np.zeros(0),
                static_weight=np.zeros(0),
                bias=np.zeros((0, 4)),
            ),
            observations=WindowObservations(
                start=np.zeros(1, np.int64),
                slot=np.zeros(0, np.int64),
                pixels=np.zeros((0, 4)),
                root=np.zeros((0, 4, 4)),
                loss_parameter=np.zeros(0),
            ),
            cov=cov,
            cov_of_motions=cov,
            calibration_effect=CalibrationEffect.none(),
        )

    def restarted(self) -> Window:
        """Return a window of the last frame alone, with its pose and covariance; all others leave
        it, and what it has learned of the rig is lost."""
        is_last = np.arange(len(self)) == len(self) - 1
        left = replace(self, marginalized=()).without_frames(~is_last)
        begun = Window.at_first_frame(int(self.frames[-1]))
        # The pose is known as well as before, but to no more than double precision tells.
        variances, axes = np.linalg.eigh(self.cov_given_calibration(-1))
        variances = np.maximum(variances, max(ORIGIN_SIGMA**2, 1e-12 * variances[-1]))
        information = begun.prior.information.copy()
        information[:POSE, :POSE] = axes / variances @ axes.T
        cov = begun.cov.copy()
        cov[:POSE, :POSE] = axes * variances @ axes.T
        return replace(
            begun,
            T_cam_world=left.T_cam_world,
            T_linear=left.T_cam_world,
            jitter_cov=self.jitter_cov,
            prior=replace(begun.prior, information=information),
            cov=cov,
            cov_of_motions=cov,
            calibration_effect=left.calibration_effect,
            marginalized=left.marginalized,
            inertial=left.inertial,
        )

    def __len__(self) -> int:
        """Return the number of frames, K."""
        return len(self.frames)

    def pose_slice(self, slot: int) -> slice:
        """Return where the pose at a slot of the window lies in the joint vector."""
        return slice(POSE * slot, POSE * (slot + 1))

    def values(self) -> Values:
        """Return the poses by their variables."""
        return dict(zip(map(pose_of, self.frames.tolist()), self.T_cam_world, strict=True))

    def slot(self, frame: int) -> int:
        """Return the slot of a frame in the window.

        Raises:
            InputError: the frame is not in the window.
        """
        found = np.flatnonzero(self.frames == frame)
        if not len(found):
            raise InputError(
                f"frame {frame}",
                "it is not in the window.",
                f"That has the frames {', '.join(str(index) for index in self.frames)}.",
            )
        return int(found[0])

    @property
    def num_seen(self) -> IntArray:
        """In how many frames of the window each landmark was seen, [L]."""
        return np.diff(self.observations.start)

    @property
    def age(self) -> IntArray:
        """How many frames after its landmark's first one each observation is, [M]."""
        first = self.observations.slot[self.observations.start[:-1]]
        age: IntArray = self.observations.slot - np.repeat(first, self.num_seen)
        return age

    @property
    def landmark_rows(self) -> IntArray:
        """The landmark of each observation, [M]."""
        return np.repeat(np.arange(len(self.ids)), self.num_seen)

    @property
    def last_seen(self) -> IntArray:
        """Place in the window of the last frame that saw each landmark, [L]."""
        return self.observations.slot[self.observations.start[1:] - 1]

    def rows_seen_last(self, ids: IntArray, slot: int) -> IntArray:
        """Return the landmark of each identity, [N], among those that a frame was the last to see;
        −1 for none."""
        alive = np.flatnonzero(self.last_seen == slot)
        rows = rows_of(ids, self.ids[alive])
        is_known = rows >= 0
        rows[is_known] = alive[rows[is_known]]
        return rows

    def num_common_landmarks(self, frame: int, other: int) -> int:
        """Return how many landmarks two frames see, by their indices; 0 if one is not in the
        window."""
        landmarks_of_frame, landmarks_of_other = (
            self.landmark_rows[
                np.isin(self.observations.slot, np.flatnonzero(self.frames == index))
            ]
            for index in (frame, other)
        )
        return len(np.intersect1d(landmarks_of_frame, landmarks_of_other))

    def has_common_landmarks(self, slot: int) -> bool:
        """Return whether a landmark is seen both from the frame in this slot and from the one
        before it."""
        slots = self.observations.slot
        rows = self.landmark_rows
        is_pair = (rows[1:] == rows[:-1]) & (slots[1:] == slot) & (slots[:-1] == slot - 1)
        return bool(is_pair.any())

    def relative(self, slot: int, other: int) -> tuple[FloatArray, FloatArray]:
        """Return the motion T_slot_other between two frames of the window, and its covariance.

        Args:
            slot: slot of the frame to which it leads.
            other: slot of the frame that it starts from.

        Returns:
            T_slot_other, [4, 4], m, and the covariance of its left perturbation, [6, 6].
        """
        T = self.T_cam_world[slot] @ se3.inverse(self.T_cam_world[other])
        # Both poses are perturbed on the left, so that of T = T_slot T_other⁻¹ the perturbation is
        # ξ = ξ_slot − Ad(T) ξ_other, to first order. Sums, since both may be the same frame.
        jacobian = np.zeros((POSE, len(self.cov)))
        jacobian[:, self.pose_slice(slot)] += np.eye(POSE)
        jacobian[:, self.pose_slice(other)] -= se3.adjoint(T)
        between = self.calibration_effect.between(slot, other, se3.adjoint(T))
        return T, jacobian @ self.cov_of_motions @ jacobian.T + between

    def pose(self, slot: int) -> SmoothedPose:
        """Return the pose in a slot of the window, with its covariance; −1 is the last."""
        return SmoothedPose(
            frame=int(self.frames[slot]),
            T_world_cam=se3.inverse(self.T_cam_world[slot]),
            cov=self.cov_given_calibration(slot) + self.calibration_effect.pose_cov(slot),
        )

    def cov_given_calibration(self, slot: int) -> FloatArray:
        """Return the covariance of a pose, [6, 6], for a calibration that is known exactly."""
        at = self.pose_slice(slot % len(self))
        return self.cov[at, at].copy()  # a view would keep the whole window's alive

    def without_frames(self, leaving: BoolArray) -> Window:
        """Return the window without the poses of some frames, [K], which it lists as marginalised.

        Prior, dead reckoning, landmarks, observations and the states of the IMU stay as they are:
        whoever calls this marginalises them.
        """
        stays = ~leaving
        kept = ~is_of_poses(leaving)
        return replace(
            self,
            frames=self.frames[stays],
            T_cam_world=self.T_cam_world[stays],
            T_linear=self.T_linear[stays],
            is_blind=self.is_blind[stays],
            calibration_effect=self.calibration_effect.subset(stays),
            jitter=self.jitter[stays],
            cov=self.cov[np.ix_(kept, kept)],
            cov_of_motions=self.cov_of_motions[np.ix_(kept, kept)],
            inertial=self.inertial.kept(stays),
            marginalized=(
                *self.marginalized,
                *(self.pose(int(slot)) for slot in np.flatnonzero(leaving)),
            ),
        )

    def offsets(self) -> FloatArray:
        """Return x of the prior: offsets of the poses, and the rig, [6K + 4]."""
        x = np.empty(POSE * len(self) + RIG)
        x[:-RIG] = se3.log(self.T_cam_world @ se3.inverse(self.T_linear)).ravel()
        x[-RIG:] = self.rig_errors
        return x


def is_of_poses(frames: BoolArray) -> BoolArray:
    """Mark the poses of some frames, [K], in the joint vector, [6K + 4]."""
    return np.concatenate([np.repeat(frames, POSE), np.zeros(RIG, np.bool_)])


def selected(observations: WindowObservations, keep: BoolArray) -> WindowObservations:
    """Return some of the M observations, given by a mask [M]; landmarks left without any go."""
    num_landmarks = len(observations.start) - 1
    rows = np.repeat(np.arange(num_landmarks), np.diff(observations.start))
    counts = np.bincount(rows[keep], minlength=num_landmarks)
    return WindowObservations(
        start=_starts(counts[counts > 0]),
        slot=observations.slot[keep],
        pixels=observations.pixels[keep],
        root=observations.root[keep],
        loss_parameter=observations.loss_parameter[keep],
    )


def merged(
    before: WindowObservations, new: WindowObservations, rows: IntArray
) -> WindowObservations:
    """Return all observations, sorted by landmark.

    Args:
        before: observations of L landmarks.
        new: N more, later than all of these; ``start`` of them is ignored.
        rows: the landmark of each of these, [N]; those from L on are new.
    """
    num_landmarks = len(before.start) - 1
    rows_before = np.repeat(np.arange(num_landmarks), np.diff(before.start))
    all_rows = np.concatenate([rows_before, rows])
    # Stable, so that the observations of a landmark stay in the order of their frames.
    order = np.argsort(all_rows, kind="stable")
    return WindowObservations(
        start=_starts(np.bincount(all_rows, minlength=num_landmarks)),
        slot=np.concatenate([before.slot, new.slot])[order],
        pixels=np.concatenate([before.pixels, new.pixels])[order],
        root=np.concatenate([before.root, new.root])[order],
        loss_parameter=np.concatenate([before.loss_parameter, new.loss_parameter])[order],
    )


def _starts(counts: IntArray) -> IntArray:
    starts = np.zeros(len(counts) + 1, np.int64)
    np.cumsum(counts, out=starts[1:])
    return starts

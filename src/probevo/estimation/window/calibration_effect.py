"""What errors of lenses, focal length and shutter do to the poses of a window.

The window is handed tracks that are corrected by the field, and does not estimate it. The field of
the lenses is c; that of step k was corrected by ĉ_k, so that its motion is off by G_k (c − ĉ_k),
with the gain G_k = ∂ξ/∂c of its solve. Along the path these errors add up,

    S_k = Ad_k S_{k−1} + G_k,    s_k = Ad_k s_{k−1} + G_k ĉ_k,

and the pose is off by S_k c − s_k. With the newest estimate, c ~ N(ĉ, Σ), its second moment is

    S_k Σ S_kᵀ + (S_k ĉ − s_k)(S_k ĉ − s_k)ᵀ.

So what is learned of the lenses later makes earlier poses more certain, or less, if it is other
than what they were corrected by. Not all of the field is that of the lenses
(``window.field_variation``).

The focal length is not corrected. An error ε of its logarithm moves each motion by the gain ∂ξ/∂ε,
which adds up to F_k as G_k does to S_k, and moves the estimate of c by ∂c/∂ε, so that the second
moment has the term E[ε²] (F_k + S_k ∂c/∂ε)(…)ᵀ besides.

The readout time τ of a rolling shutter (``camera.rolling_shutter``) is corrected from the frame on
in which it is noticeable. Like c, it has a gain, which adds up to R_k, and corrections, which are
part of s_k: poses before that frame are known to be off by R_k τ̂. What a step has left unknown of
the velocity at its two frames (``estimation.velocity_change``) is new in each frame, and moves its
pose only: each frame has half of the covariance that this adds to the motion of the step. For a
global shutter, all of this is zero.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from probevo.arrays import BoolArray, FloatArray
from probevo.camera.distortion_field import NUM_COEFFICIENTS
from probevo.camera.image_errors import ImageErrors
from probevo.estimation.rig_update import CommonMode
from probevo.estimation.window.equations import POSE
from probevo.estimation.window.field_variation import FieldVariation
from probevo.geometry import se3


class PathSensitivity(NamedTuple):
    """How errors of the calibration have moved the poses of K frames; or one pose, or motion."""

    field: FloatArray
    """S_k of the distortion field, [K, 6, NUM_COEFFICIENTS], m/px and rad/px."""
    focal: FloatArray
    """F_k of the focal length, [K, 6], m and rad."""
    readout: FloatArray
    """R_k of the readout time, [K, 6], m/s and rad/s."""
    corrected: FloatArray
    """s_k, by which corrections have moved the poses, [K, 6], m and rad."""

    @staticmethod
    def none() -> PathSensitivity:
        """Return that of the first frame, which nothing has moved."""
        return PathSensitivity(
            field=np.zeros((1, POSE, NUM_COEFFICIENTS)),
            focal=np.zeros((1, POSE)),
            readout=np.zeros((1, POSE)),
            corrected=np.zeros((1, POSE)),
        )

    def subset(self, frames: BoolArray | slice | int) -> PathSensitivity:
        """Select some frames, or one."""
        return PathSensitivity._make(part[frames] for part in self)

    def with_new_frame(self, prev: int, adjoint: FloatArray) -> PathSensitivity:
        """Append a frame that has what another has, in its own axes."""
        return PathSensitivity._make(
            np.concatenate([part, (adjoint @ part[prev])[None]]) for part in self
        )

    def between(self, slot: int, other: int, adjoint: FloatArray) -> PathSensitivity:
        """Return what was added from one frame to another, given the adjoint of that motion."""
        return PathSensitivity._make(part[slot] - adjoint @ part[other] for part in self)

    def with_step(self, motion: CommonMode, used: ImageErrors) -> PathSensitivity:
        """Add the last step to the newest frame.

        Args:
            motion: how errors of the calibration move the step.
            used: the estimate by which its tracks were corrected.
        """
        added = PathSensitivity(
            field=motion.distortion_gain,
            focal=motion.focal_gain,
            readout=motion.readout_gain,
            corrected=(
                motion.distortion_gain @ used.distortion + motion.readout_gain * used.readout_s
            ),
        )
        return PathSensitivity._make(
            _added_to_last(part, more) for part, more in zip(self, added, strict=True)
        )


@dataclass(frozen=True)
class CalibrationEffect:
    """How errors of the calibration move the poses of K frames."""

    path: PathSensitivity
    errors: ImageErrors
    """The newest estimate of these errors."""
    variation: FieldVariation
    """The part of the field that changes from place to place."""
    velocity_cov: FloatArray
    """What is unknown of the velocity at each frame adds this to the covariance of its pose,
    [K, 6, 6]."""

    @staticmethod
    def none() -> CalibrationEffect:
        """Return the effect on the first frame, which is none."""
        return CalibrationEffect(
            path=PathSensitivity.none(),
            errors=ImageErrors.initial(),
            variation=FieldVariation.none(),
            velocity_cov=np.zeros((1, POSE, POSE)),
        )

    def subset(self, frames: BoolArray | slice) -> CalibrationEffect:
        """Return the effect on some of the frames."""
        return replace(
            self,
            path=self.path.subset(frames),
            variation=self.variation.subset(frames),
            velocity_cov=self.velocity_cov[frames],
        )

    def with_new_frame(self, prev: int, T_curr_prev: FloatArray) -> CalibrationEffect:
        """Return the effect with one more frame, whose motion from another, [4, 4], adds none."""
        return replace(
            self,
            path=self.path.with_new_frame(prev, se3.adjoint(T_curr_prev)),
            variation=self.variation.with_new_frame(prev, T_curr_prev),
            velocity_cov=np.concatenate([self.velocity_cov, np.zeros((1, POSE, POSE))]),
        )

    def with_step(
        self,
        motion: CommonMode,
        *,
        used: ImageErrors,
        errors: ImageErrors,
        velocity_cov: FloatArray,
    ) -> CalibrationEffect:
        """Return the effect with that of the last step added, and with the newest estimate.

        Args:
            motion: how errors of the calibration move the step.
            used: the estimate by which its tracks were corrected.
            errors: the estimate after the step.
            velocity_cov: what the velocity within the step, as far as it is unknown, adds to the
                covariance of its motion, [6, 6].
        """
        return CalibrationEffect(
            path=self.path.with_step(motion, used),
            errors=errors,
            variation=self.variation.with_step(motion.distortion_gain),
            velocity_cov=_added_to_last(self.velocity_cov, 0.5 * velocity_cov),
        )

    def pose_cov(self, slot: int) -> FloatArray:
        """Return the second moment of the error of a pose, [6, 6]."""
        lens_moment = self._second_moment(self.path.subset(slot))
        field_moment = lens_moment + self.variation.pose_cov(slot, self.errors.distortion_sigma_px)
        moment: FloatArray = field_moment + self.velocity_cov[slot]
        return moment

    def between(self, slot: int, other: int, adjoint: FloatArray) -> FloatArray:
        """Return the second moment of the error of the motion between two frames, [6, 6].

        Args:
            slot: of the frame at the end of the motion.
            other: of the frame at its start.
            adjoint: of the motion, [6, 6].
        """
        lens_moment = self._second_moment(self.path.between(slot, other, adjoint))
        if slot == other:
            return lens_moment
        other_velocity_cov = adjoint @ self.velocity_cov[other] @ adjoint.T
        moment: FloatArray = lens_moment + self.velocity_cov[slot] + other_velocity_cov
        return moment

    def _second_moment(self, moved: PathSensitivity) -> FloatArray:
        """Return the second moment of S c + F ε + R τ − s for a pose or a motion, [6, 6]."""
        errors = self.errors
        S = moved.field
        left = S @ errors.distortion - moved.corrected + moved.readout * errors.readout_s
        focal_shift = errors.focal_rms * (moved.focal + S @ errors.distortion_shift_by_focal)
        readout_shift = errors.readout_sigma_s * (
            moved.readout + S @ errors.distortion_shift_by_readout
        )
        moment: FloatArray = (
            S @ errors.distortion_cov @ S.T
            + np.outer(left, left)
            + np.outer(focal_shift, focal_shift)
            + np.outer(readout_shift, readout_shift)
        )
        return moment


def _added_to_last(frames: FloatArray, more: FloatArray) -> FloatArray:
    """Return values of K frames with something added to the last one's."""
    added = frames.copy()
    added[-1] += more
    return added

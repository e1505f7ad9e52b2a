"""The IMU of a window: from the first samples, via the test against the images, to its states.

An IMU never makes the path worse than the images alone: it is tested before it is used, each of
its factors is gated by the motion that two frames show by themselves, and one that contradicts the
images time and again is left out for good.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum, auto

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.estimation.window.equations import POSE, WindowEquations
from probevo.estimation.window.further_measurements import with_measurements
from probevo.estimation.window.inertial_noise import (
    Innovation,
    estimated_noise_factor,
    innovation_of,
    median_excess,
)
from probevo.estimation.window.inertial_start import (
    fit_inertial_states,
    with_gravity_of_known_length,
)
from probevo.estimation.window.inertial_states import (
    InertialPrediction,
    InertialStates,
    InertialSystem,
    Intervals,
    inertial_system,
    moved,
    predicted,
    walk_variances,
    with_covariance,
    with_frame,
    without_first_frame,
)
from probevo.estimation.window.window import MarginalPrior, Window
from probevo.geometry import se3
from probevo.geometry.uncertainty import MOTIONS_DIFFER_FROM
from probevo.measurements.base import pose_of
from probevo.measurements.preintegration import (
    NO_ACCELEROMETER,
    NoPreintegration,
    Preintegration,
    preintegrate,
)
from probevo.measurements.relative_pose import RelativePose
from probevo.sequences.frame import Frame
from probevo.sequences.imu_calibration import ImuCalibration

FRAMES_AT_START = 6
"""Number of frames of which the states are estimated at first; all frames of a shorter window."""
FEWEST_AT_START = 4
"""Least number of them. Of the accelerometer, K frames have 6 (K − 1) velocities and displacements,
and the prior of its bias, against 3K velocities, gravity, and the bias: 3K − 9 degrees of freedom.
Three frames fit any forces, and would test nothing but the length of gravity."""
LARGEST_EXCESS = 4.0
"""Largest χ² over its degrees of freedom, at the start and later: what factors and images together
may be noisier than they say."""
LARGEST_NOISE_FACTOR = 16.0
"""Largest factor of the samples' variances: four times the standard deviation of the data sheet."""
NUM_TESTED = 20
"""Last factors over which the noise is estimated, and those beyond the gate are counted."""
FEWEST_INNOVATIONS = 8
"""Least number of them that says how large the noise is."""
MOST_GATED = 6
"""So many of them beyond the gate, and the IMU is left out."""
MOST_ATTEMPTS = 30
"""Frames at which the IMU may contradict the images before it has ever been used."""
NO_SOLUTION = "is left out for good: with it, the window has no solution"
"""Why an IMU is left out where the normal equations with its states are singular."""
SHORT_WINDOW = "is left out: with fewer than 3 window.frames, it cannot be tested"
"""Why an IMU is left out of a window that never has ``FEWEST_AT_START`` frames."""
UNTESTABLE = "cannot be tested: the covariance of the poses is too large to be accurate"
"""Why an IMU is not used where its factors are lost in rounding."""


class ImuStatus(Enum):
    """How far an IMU has come, from its first samples to its use."""

    UNUSABLE = auto()
    """None of its samples could be preintegrated, neither within the window nor after it."""
    WAITING = auto()
    """Not tested yet, and without a preintegration to the next frame."""
    TESTING = auto()
    """Not tested yet, with a preintegration to the next frame."""
    USED = auto()
    """The poses of the window depend on it."""
    EXCLUDED = auto()
    """It has failed a test, or the window is too short for one: it is left out for good."""


@dataclass(frozen=True)
class Inertial:
    """The IMU of a window with K frames."""

    calibration: ImuCalibration
    factors: tuple[Preintegration | None, ...] = ()
    """Between successive frames, [K − 1]; None where there is none."""
    stamps_ns: Mapping[int, int] = field(default_factory=dict)
    """Time of each frame of the window, and of the next one, by its index: biases walk with or
    without samples."""
    pending: Preintegration | None = None
    """From the last frame to the next one."""
    prediction: InertialPrediction | None = None
    """The motion to the next frame; None before the states are known, or without samples."""
    states: InertialStates | None = None
    """None before the IMU has passed its test."""
    innovations: tuple[Innovation, ...] = ()
    """How far the last predictions that were tested were off."""
    was_gated: tuple[bool, ...] = ()
    """Which of these were beyond the gate."""
    noise_factor: float = 1.0
    """What the variances of the samples by the data sheet are multiplied by: by the test at the
    start, and then by the last innovations."""
    attempts: int = 0
    """Frames at which the test at the start was failed."""
    note: str = ""
    """Why the IMU says nothing of the last step, as the end of "the IMU …"; empty if it does."""
    is_excluded: bool = False
    """Whether it has been left out for good."""
    has_measured: bool = False
    """Whether its samples have covered any interval so far."""

    @property
    def status(self) -> ImuStatus:
        """How far it has come."""
        if self.is_excluded:
            return ImuStatus.EXCLUDED
        if self.states is not None:
            return ImuStatus.USED
        if self.pending is not None:
            return ImuStatus.TESTING
        return ImuStatus.WAITING if self.has_factors else ImuStatus.UNUSABLE

    @property
    def is_used(self) -> bool:
        """Whether the window's poses depend on it."""
        return self.status is ImuStatus.USED

    @property
    def has_factors(self) -> bool:
        """Whether its samples cover an interval between frames of the window."""
        return any(factor is not None for factor in self.factors)

    @property
    def first_covered(self) -> int:
        """Place of the first frame from which on its samples cover all intervals, 0 … K − 1."""
        missing = [at for at, factor in enumerate(self.factors) if factor is None]
        return missing[-1] + 1 if missing else 0

    @property
    def excess(self) -> float:
        """By how much the covariances of the last innovations, with ``noise_factor``, are still too
        small in the median; 1 if they are right."""
        if len(self.innovations) < FEWEST_INNOVATIONS:
            return 1.0
        return median_excess(self.innovations, self.noise_factor)

    @property
    def mean_excess(self) -> float:
        """By how much the covariances by the data sheet are too small in the mean, with innovations
        beyond the gate.

        A step that no image has tested may be as wrong as any of these. An IMU that lies errs the
        same way in each step, so that its errors add up: the factor is used on top of
        ``noise_factor``, with which the covariances describe errors that are independent.
        """
        distances = [innovation.squared_distance(1.0) for innovation in self.innovations]
        known = [squared for squared in distances if np.isfinite(squared)]
        if not known:
            return self.noise_factor
        # The mean of χ² of six degrees of freedom is six.
        return max(1.0, float(np.mean(known)) / POSE)

    def intervals(self, frames: IntArray) -> Intervals:
        """Return what lies between the frames of the window, given their indices, [K]."""
        stamps_ns = np.array([self.stamps_ns[frame] for frame in frames.tolist()])
        durations_s = 1e-9 * np.diff(stamps_ns)
        return Intervals(self.factors, walk_variances(self.calibration, durations_s))

    def tested(self, innovation: Innovation, *, is_gated: bool) -> Inertial:
        """Return the IMU with one more innovation, and the noise that the last of them show."""
        innovations = (*self.innovations[1 - NUM_TESTED :], innovation)
        noise_factor = self.noise_factor
        if len(innovations) >= FEWEST_INNOVATIONS:
            noise_factor = estimated_noise_factor(innovations, largest=LARGEST_NOISE_FACTOR)
        return replace(
            self,
            innovations=innovations,
            was_gated=(*self.was_gated[1 - NUM_TESTED :], is_gated),
            noise_factor=noise_factor,
        )

    def without_states(self, note: str, *, is_excluded: bool) -> Inertial:
        """Return the IMU as before its start, for a reason."""
        return replace(
            self,
            states=None,
            prediction=None,
            pending=None,
            note=note,
            is_excluded=is_excluded,
            innovations=(),
            was_gated=(),
            noise_factor=1.0,
            factors=(None,) * len(self.factors) if is_excluded else self.factors,
        )


def with_samples(window: Window, prev: Frame, frame: Frame) -> Window:
    """Return the window with what the IMU measured after its last frame.

    Args:
        window: K frames.
        prev: the last of them.
        frame: the next one, with the samples between the two.
    """
    if window.inertial is None or window.inertial.is_excluded:
        return window
    # Restart where no factor of the window is left, as after a long time without samples.
    inertial = window.inertial
    if inertial.is_used and not inertial.has_factors:
        # For as long as the window lasts: what is left of the states would only be in the way.
        window = without_inertial(window, inertial.note, is_excluded=False)
        inertial = inertial.without_states(inertial.note, is_excluded=False)
    # Preintegrate with the latest estimate of the biases, about which the factor is linearised.
    states = inertial.states
    inertial = replace(inertial, stamps_ns=_stamps_of(window, prev, frame))
    factor = preintegrate(
        frame.imu,
        prev.stamp_ns,
        frame.stamp_ns,
        calibration=inertial.calibration,
        bias=states.bias[-1] if states is not None else np.zeros(6),
    )
    if isinstance(factor, NoPreintegration):
        # A gyro alone predicts motions, as with two frames; nobody expects more of it.
        is_gyro = factor.reason == NO_ACCELEROMETER and not inertial.has_measured
        note = "" if is_gyro else factor.reason
        return replace(window, inertial=replace(inertial, pending=None, prediction=None, note=note))
    factor = replace(factor, cov=inertial.noise_factor * factor.cov)
    # Predict the next motion, once velocity, biases and gravity are known.
    prediction = None
    if states is not None:
        prediction = predicted(window, states, factor)
        if not np.isfinite(prediction.cov).all():
            prediction = None
    inertial = replace(inertial, pending=factor, prediction=prediction, note="", has_measured=True)
    return replace(window, inertial=inertial)


def _stamps_of(window: Window, prev: Frame, frame: Frame) -> dict[int, int]:
    """Return the time of each frame of the window and of the next one, by its index, ns."""
    known = {} if window.inertial is None else window.inertial.stamps_ns
    of_window = {index: known[index] for index in window.frames.tolist() if index in known}
    return {**of_window, prev.index: prev.stamp_ns, frame.index: frame.stamp_ns}


def trusts_gyro(window: Window | None) -> bool:
    """Return whether the gyro may predict the motion to the next frame.

    While the IMU can still be tested against the window but has not passed, it may not. A gyro that
    can never be tested there, since it has too few samples or no accelerometer, may.
    """
    if window is None or window.inertial is None:
        return True
    return window.inertial.status in (ImuStatus.UNUSABLE, ImuStatus.USED)


def may_bridge(window: Window) -> bool:
    """Return whether a window has an IMU that knows the motion through frames without features, or
    may yet come to know it.

    One whose samples have covered no interval of the window may not: too few of them, or none of
    an accelerometer.
    """
    if window.inertial is None:
        return False
    return window.inertial.status not in (ImuStatus.UNUSABLE, ImuStatus.EXCLUDED)


def knows_next_motion(window: Window) -> bool:
    """Return whether the IMU of a window predicts the motion to the next frame, so that no other
    dead reckoning is needed."""
    return window.inertial is not None and window.inertial.prediction is not None


def has_measured(window: Window) -> bool:
    """Return whether a window has an IMU whose samples have covered any interval so far."""
    return window.inertial is not None and window.inertial.has_measured


def uses_imu(window: Window | None) -> bool:
    """Return whether the poses of a window depend on its IMU."""
    return window is not None and window.inertial is not None and window.inertial.is_used


def with_inflated_factor_if_refuted(window: Window, seen: RelativePose) -> Window:
    """Return the window with a pending factor that counts for little, if the motion that the images
    show refutes it.

    Its covariance grows by as much as explains by itself how far it is off. Without any factor, the
    velocity would not be known after this frame, nor the motion through a blackout that begins
    there.

    Args:
        window: K frames, with what the IMU measured since.
        seen: the motion to the next frame, from two frames by themselves: their images, and
            sensors of the motion; corrected if there is a correction.
    """
    inertial = window.inertial
    if inertial is None or inertial.prediction is None:
        return window
    # ν = Log(T_seen T_predicted⁻¹), along the axes of the next frame. The prediction has the
    # noise of the samples times the factor so far; what is remembered has that of the data sheet.
    prediction = inertial.prediction
    noise_factor = inertial.noise_factor
    difference = se3.log(seen.T_curr_prev @ se3.inverse(prediction.T_curr_prev))
    innovation = innovation_of(
        difference,
        seen.covariance + prediction.cov_of_states,
        prediction.cov_of_samples / noise_factor,
    )
    squared = innovation.squared_distance(noise_factor)
    is_gated = squared > MOTIONS_DIFFER_FROM
    inertial = inertial.tested(innovation, is_gated=is_gated)
    # Gated once: the factor counts for little. Too often, or too noisy in the median: for good.
    if is_gated:
        note = f"contradicts the images in this step (χ² {squared:.0f} of 6 degrees of freedom)"
        pending = None
        if inertial.pending is not None and np.isfinite(squared):
            pending = _as_noisy_as(inertial.pending, difference)
        inertial = replace(inertial, pending=pending, prediction=None, note=note)
    num_gated = sum(inertial.was_gated)
    if num_gated >= MOST_GATED or inertial.excess > LARGEST_EXCESS:
        note = (
            f"is left out for good: it contradicted the images in {num_gated} of the last"
            f" {len(inertial.innovations)} steps, by {inertial.excess:.1f} times their variances in"
            " the median"
        )
        return without_inertial(replace(window, inertial=inertial), note)
    return replace(window, inertial=inertial)


def _as_noisy_as(factor: Preintegration, error: FloatArray) -> Preintegration:
    """Return a factor whose covariance explains by itself why its motion is off by so much, [6]."""
    # The factor is ordered (δφ, δv, δp), the error [ρ; φ].
    rotation = np.diagonal(factor.cov)[:3].mean()
    position = np.diagonal(factor.cov)[6:].mean()
    too_large = max(error[:3] @ error[:3] / position, error[3:] @ error[3:] / rotation)
    return replace(factor, cov=max(1.0, too_large) * factor.cov)


def without_factor_if_worse(window: Window, motion: RelativePose) -> Window:
    """Return the window without the pending factor, if that knows less of the next motion.

    So it is while the velocity is unknown, as after a step without samples.

    Args:
        window: K frames, with what the IMU measured since.
        motion: to the next frame, by other means.
    """
    inertial = window.inertial
    if inertial is None or not inertial.is_used or inertial.pending is None:
        return window
    if inertial.prediction is not None:
        variance = np.trace(inertial.prediction.cov[:3, :3])
        if variance < np.trace(motion.covariance[:3, :3]):
            return window
    note = "does not know its velocity in this step"
    unused = replace(inertial, pending=None, prediction=None, note=note)
    return replace(window, inertial=unused)


def predicted_motion(window: Window, frame: int) -> RelativePose | None:
    """Return the motion from the last frame to the next one, of this index, that the IMU predicts,
    if it does."""
    if window.inertial is None or window.inertial.prediction is None:
        return None
    prediction = window.inertial.prediction
    last = pose_of(int(window.frames[-1]))
    return RelativePose(prediction.T_curr_prev, prediction.cov, curr=pose_of(frame), prev=last)


def reason_unused_in_step(window: Window | None) -> str:
    """Return why the IMU was not used in the last step, if there is a reason."""
    return "" if window is None or window.inertial is None else window.inertial.note


def noise_factor_of(window: Window | None) -> float | None:
    """Return by how much the samples' variances exceed those of the calibration; None if a window
    uses no IMU."""
    if window is None or window.inertial is None or not window.inertial.is_used:
        return None
    return window.inertial.noise_factor


def without_inertial(window: Window, note: str, *, is_excluded: bool = True) -> Window:
    """Return the window with its inertial states marginalised.

    Frames that nothing but the IMU connects keep the motion between them, with a covariance that is
    inflated by what the tests of the IMU have shown; without it, their poses would be unknown.

    Args:
        window: K frames with their covariance.
        note: why, as the end of "the IMU …".
        is_excluded: whether the IMU is left out for good, or starts again.
    """
    inertial = window.inertial
    if inertial is None:
        return window
    left_out = inertial.without_states(note, is_excluded=is_excluded)
    if inertial.states is None:
        return replace(window, inertial=left_out)
    # Their joint prior with the poses stays, reduced to the poses by the Schur complement; the
    # factors go, since without pairs the system is that prior alone. As everywhere,
    # the gradient at the present offsets is turned into the vector of the prior.
    intervals = inertial.intervals(window.frames)
    system = inertial_system(window, inertial.states, intervals, num_pairs=0)
    hessian, gradient = system.reduced()
    information = window.prior.information + hessian
    vector = window.prior.vector + gradient + hessian @ window.offsets()
    prior = replace(window.prior, information=information, vector=vector)
    return with_measurements(
        replace(window, prior=prior, inertial=left_out),
        _motions_by_imu_only(window, inertial.mean_excess),
    )


def _motions_by_imu_only(window: Window, inflation: float) -> list[RelativePose]:
    """Return the motions between successive frames that nothing but the IMU connects.

    Args:
        window: K frames with their covariance.
        inflation: of the covariance of each motion.
    """
    motions = []
    for slot in range(1, len(window)):
        here = window.pose_slice(slot)
        before = window.pose_slice(slot - 1)
        # Landmarks in common, or an off-diagonal block of the prior, connect the two already.
        if window.has_common_landmarks(slot) or window.prior.information[here, before].any():
            continue
        T_curr_prev, cov = window.relative(slot, slot - 1)
        motions.append(
            RelativePose(
                T_curr_prev,
                inflation * cov,
                curr=pose_of(int(window.frames[slot])),
                prev=pose_of(int(window.frames[slot - 1])),
            )
        )
    return motions


def with_new_frame(window: Window) -> Window:
    """Return the window whose last frame is new with the pending factor, and states of its own."""
    inertial = window.inertial
    if inertial is None:
        return window
    states = inertial.states
    if states is not None:
        velocity = states.velocity[-1]
        if inertial.prediction is not None:
            velocity = inertial.prediction.velocity
        states = with_frame(states, velocity)
    factors = (*inertial.factors, inertial.pending)
    return replace(
        window,
        inertial=replace(inertial, factors=factors, states=states, pending=None, prediction=None),
    )


def bridges_newest(window: Window) -> bool:
    """Return whether the IMU connects the last frame with the one before."""
    inertial = window.inertial
    return inertial is not None and inertial.is_used and inertial.factors[-1] is not None


def without_imu_if_untestable(window: Window, most_frames: int) -> Window:
    """Return the window without its IMU, for good, if it is too short to test it.

    Args:
        window: K frames.
        most_frames: of the window at any time, the new one included.
    """
    inertial = window.inertial
    if inertial is None or inertial.is_excluded or most_frames >= FEWEST_AT_START:
        return window
    return without_inertial(window, SHORT_WINDOW)


def with_states_if_consistent(window: Window, most_frames: int = FRAMES_AT_START) -> Window:
    """Return the window with inertial states, if the IMU agrees with its poses.

    Args:
        window: K frames, adjusted without any inertial states.
        most_frames: of the window at any time, the new one included.
    """
    inertial = window.inertial
    if inertial is None or inertial.status in (ImuStatus.USED, ImuStatus.EXCLUDED):
        return window
    # The factors up to the last frame; where one is missing, as after lost samples, those before
    # it do not count.
    first = inertial.first_covered
    if len(window) - first < min(FRAMES_AT_START, most_frames):
        return window
    factors = [factor for factor in inertial.factors[first:] if factor is not None]
    # The test against the images.
    try:
        fit = fit_inertial_states(window, factors, inertial.calibration, first=first)
    except np.linalg.LinAlgError:
        # Far from the origin, rounding of the poses' covariance exceeds what a factor measures.
        return replace(window, inertial=replace(inertial, note=UNTESTABLE))
    reason = fit.reason_against(LARGEST_EXCESS)
    if not reason:
        states = with_gravity_of_known_length(fit.states)
        # The factors that were tested have the noise that the test has shown, as later ones have.
        excess = max(1.0, fit.excess)
        noisier = tuple(
            None if factor is None else replace(factor, cov=excess * factor.cov)
            for factor in inertial.factors
        )
        used = replace(inertial, states=states, factors=noisier, noise_factor=excess, note="")
        return replace(window, inertial=used)
    # Failed: try again in the next frame, up to ``MOST_ATTEMPTS``.
    attempts = inertial.attempts + 1
    is_excluded = attempts >= MOST_ATTEMPTS
    note = f"is left out for good: it {reason}" if is_excluded else reason
    tried = replace(inertial, attempts=attempts, note=note, is_excluded=is_excluded)
    return replace(window, inertial=tried)


def system_of(window: Window) -> InertialSystem | None:
    """Return the normal equations of the inertial states and their factors, if there are any."""
    inertial = window.inertial
    if inertial is None or inertial.states is None:
        return None
    return inertial_system(window, inertial.states, inertial.intervals(window.frames))


def after_increment(
    window: Window, system: InertialSystem | None, increment: FloatArray
) -> Inertial | None:
    """Return the IMU after an increment of poses and rig, [6K + 4]; its states follow."""
    inertial = window.inertial
    if inertial is None or inertial.states is None or system is None:
        return inertial
    return replace(inertial, states=moved(inertial.states, system.increment(increment)))


def with_state_covariance(
    window: Window, system: InertialSystem | None, cov: FloatArray
) -> Inertial | None:
    """Return the IMU with the covariance of its states, given that of poses and rig."""
    inertial = window.inertial
    if inertial is None or inertial.states is None or system is None:
        return inertial
    return replace(inertial, states=with_covariance(inertial.states, system, cov))


def marginalize_first_frame(
    window: Window, others: WindowEquations
) -> tuple[MarginalPrior, Inertial | None] | None:
    """Marginalise the first frame's pose and inertial states; None if there are no such states.

    Args:
        window: K frames.
        others: equations of poses and rig from all but the inertial states, at the current values.
    """
    inertial = window.inertial
    if inertial is None or inertial.states is None:
        return None
    # Only what involves the first frame: its factor to the second, and the prior.
    intervals = inertial.intervals(window.frames)
    system = inertial_system(window, inertial.states, intervals, num_pairs=1)
    x = np.concatenate([window.offsets(), inertial.states.joint()])
    remaining, states = without_first_frame(inertial.states, others, system, x=x)
    return remaining, replace(inertial, states=states, factors=inertial.factors[1:])

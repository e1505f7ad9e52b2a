"""What each step does with the IMU of a window: start, step, tests and exclusion.

An IMU never makes the path worse than the images alone: it is tested before it is used, each of
its factors is gated by the motion that two frames show by themselves, and one that contradicts the
images time and again is left out for good.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from probevo.arrays import FloatArray
from probevo.estimation.window.equations import WindowEquations
from probevo.estimation.window.further_measurements import with_measurements
from probevo.estimation.window.inertial import (
    MAX_EXCESS,
    USUAL_NOISE_FACTOR,
    ImuStatus,
    Inertial,
)
from probevo.estimation.window.inertial_equations import (
    InertialSystem,
    Intervals,
    inertial_system,
    walk_variances,
    without_first_frame,
)
from probevo.estimation.window.inertial_noise import innovation_of
from probevo.estimation.window.inertial_prediction import predicted
from probevo.estimation.window.inertial_start import (
    fit_inertial_states,
    with_gravity_of_known_length,
)
from probevo.estimation.window.inertial_states import InertialStates
from probevo.estimation.window.window import MarginalPrior, Window
from probevo.geometry import se3
from probevo.geometry.uncertainty import MOTIONS_DIFFER_FROM
from probevo.measurements.imu_reason import ImuFault, ImuReason
from probevo.measurements.preintegration import (
    NoPreintegration,
    Preintegration,
    preintegrate,
)
from probevo.measurements.relative_pose import RelativePose
from probevo.measurements.variables import pose_of
from probevo.sequences.frame import Frame

FRAMES_AT_START = 6
"""Number of frames of which the states are estimated at first; all frames of a shorter window."""
MIN_AT_START = 4
"""Minimum number of them. Of the accelerometer, K frames have 6 (K − 1) velocities and
displacements, and the prior of its bias, against 3K velocities, gravity, and the bias: 3K − 9
degrees of freedom. Three frames fit any forces, and would test nothing but the length of
gravity."""
MAX_GRAVITY_SIGMA_M_S2 = 3.0
"""Largest standard deviation of gravity at the start, where its length is free. Its direction is
then known to 17°, and may be linearised about: it stays where it is once the first frame leaves."""
MAX_GATED = 6
"""So many of the last ``NUM_TESTED`` factors beyond the gate, and the IMU is left out."""
MAX_ATTEMPTS = 30
"""Frames at which the IMU may contradict the images before it has ever been used."""
NO_SOLUTION = ImuReason(
    ImuFault.NO_SOLUTION, "is left out for good: with it, the window has no solution"
)
"""Why an IMU is left out where the normal equations with its states are singular."""
SHORT_WINDOW = ImuReason(
    ImuFault.SHORT_WINDOW, "is left out: with fewer than 3 window.frames, it cannot be tested"
)
"""Why an IMU is left out of a window that never has ``MIN_AT_START`` frames."""
UNTESTABLE = ImuReason(
    ImuFault.UNTESTABLE,
    "cannot be tested: the covariance of the poses is too large to be accurate",
)
"""Why an IMU is not used where its factors are lost in rounding."""
UNKNOWN_GRAVITY = ImuReason(
    ImuFault.TESTING, "is being tested: gravity is not yet known well enough"
)
"""Why an IMU is not used whose test any direction of gravity would pass."""
UNTESTED_STEP = ImuReason(
    ImuFault.TESTING, "is being tested, which takes a step that the images show"
)
"""Why an IMU is not tested in a step that is dead-reckoned, or a part of it."""
UNKNOWN_VELOCITY = ImuReason(ImuFault.UNKNOWN_VELOCITY, "does not know its velocity in this step")
"""Why an IMU is not used where the motion is known better by other means."""


def exclude_if_untestable(window: Window, most_frames: int) -> Window:
    """Return the window without its IMU, for good, if it is too short to test it.

    Args:
        window: K frames.
        most_frames: of the window at any time, the new one included.
    """
    inertial = window.inertial
    if inertial.status in (ImuStatus.ABSENT, ImuStatus.EXCLUDED) or most_frames >= MIN_AT_START:
        return window
    return without_imu(window, SHORT_WINDOW)


def initialize_states(window: Window, most_frames: int = FRAMES_AT_START) -> Window:
    """Return the window with inertial states, if the IMU agrees with its poses.

    Args:
        window: K frames, adjusted without any inertial states.
        most_frames: of the window at any time, the new one included.
    """
    inertial = window.inertial
    calibration = inertial.calibration
    if calibration is None or inertial.is_used or inertial.is_excluded:
        return window
    # The factors up to the last frame; where one is missing, as after lost samples, those before
    # it do not count.
    first = inertial.first_covered
    if len(window) - first < min(FRAMES_AT_START, most_frames):
        return window
    factors = [factor for factor in inertial.factors[first:] if factor is not None]
    # The test against the images.
    try:
        fit = fit_inertial_states(window, factors, calibration, first=first)
    except np.linalg.LinAlgError:
        # Far from the origin, rounding of the poses' covariance exceeds what a factor measures.
        return replace(window, inertial=replace(inertial, reason=UNTESTABLE))
    if fit.gravity_sigma_m_s2 > MAX_GRAVITY_SIGMA_M_S2:
        # It fits any direction of gravity: wait for more frames.
        return replace(window, inertial=replace(inertial, reason=UNKNOWN_GRAVITY))
    reason = fit.reason_against(MAX_EXCESS)
    if reason is None:
        states = with_gravity_of_known_length(fit.states)
        # The factors that were tested have the noise that the test has shown, as later ones have.
        excess = max(1.0, fit.excess)
        noisier = tuple(
            None if factor is None else replace(factor, cov=excess * factor.cov)
            for factor in inertial.factors
        )
        used = replace(inertial, states=states, factors=noisier, noise_factor=excess, reason=None)
        return replace(window, inertial=used)
    # Failed: try again in the next frame, up to ``MAX_ATTEMPTS``.
    attempts = inertial.attempts + 1
    if attempts >= MAX_ATTEMPTS:
        return without_imu(window, reason.for_good())
    return replace(window, inertial=replace(inertial, attempts=attempts, reason=reason))


def with_reason_to_wait(window: Window, most_frames: int) -> Window:
    """Return the window whose IMU says why it is still being tested, if nothing was wrong with it
    in the last step.

    Args:
        window: K frames.
        most_frames: of the window at any time, the new one included.
    """
    inertial = window.inertial
    if inertial.is_used or inertial.reason is not None:
        return window
    if not inertial.factors or inertial.factors[-1] is None:
        return window  # there is no IMU, or a gyro alone, of which nobody expects more
    reason = UNTESTED_STEP
    covered = len(window) - inertial.first_covered
    needed = min(FRAMES_AT_START, most_frames)
    if covered < needed:
        text = f"is being tested: its samples connect {covered} of the {needed} frames it takes"
        reason = ImuReason(ImuFault.TESTING, text)
    return replace(window, inertial=replace(inertial, reason=reason))


def preintegrate_samples(window: Window, prev: Frame, frame: Frame) -> Window:
    """Return the window with what the IMU measured after its last frame.

    Args:
        window: K frames.
        prev: the last of them.
        frame: the next one, with the samples between the two.
    """
    inertial = window.inertial
    calibration = inertial.calibration
    if calibration is None or inertial.is_excluded:
        return window
    # Restart where no factor of the window is left, as after a long time without samples: what is
    # left of the states would only be in the way.
    if inertial.is_used and not inertial.has_factors:
        window = _without_states(window, inertial.restarted())
        inertial = window.inertial
    # Preintegrate with the latest estimate of the biases, about which the factor is linearised.
    states = inertial.states
    inertial = replace(inertial, stamps_ns=_stamps_of(window, prev, frame))
    factor = preintegrate(
        frame.imu,
        prev.stamp_ns,
        frame.stamp_ns,
        calibration=calibration,
        bias=states.bias[-1] if states is not None else np.zeros(6),
    )
    if isinstance(factor, NoPreintegration):
        # A gyro alone predicts motions, as with two frames; nobody expects more of it.
        is_gyro = factor.reason.fault is ImuFault.NO_ACCELEROMETER and not inertial.has_measured
        return replace(
            window, inertial=inertial.without_measurement(None if is_gyro else factor.reason)
        )
    factor = replace(factor, cov=inertial.noise_factor * factor.cov)
    # Predict the next motion, once velocity, biases and gravity are known.
    prediction = None
    if states is not None:
        prediction = predicted(window, states, factor)
        if not np.isfinite(prediction.cov).all():
            prediction = None
    measured = replace(
        inertial, pending=factor, prediction=prediction, reason=None, has_measured=True
    )
    return replace(window, inertial=measured)


def _stamps_of(window: Window, prev: Frame, frame: Frame) -> dict[int, int]:
    """Return the time of each frame of the window and of the next one, by its index, ns."""
    known = window.inertial.stamps_ns
    window_stamps = {index: known[index] for index in window.frames.tolist() if index in known}
    return {**window_stamps, prev.index: prev.stamp_ns, frame.index: frame.stamp_ns}


def predicted_motion(window: Window, frame: int) -> RelativePose | None:
    """Return the motion from the last frame to the next one, of this index, that the IMU predicts,
    if it does."""
    prediction = window.inertial.prediction
    if prediction is None:
        return None
    last = pose_of(int(window.frames[-1]))
    return RelativePose(prediction.T_curr_prev, prediction.cov, curr=pose_of(frame), prev=last)


def system_of(window: Window, num_pairs: int | None = None) -> InertialSystem | None:
    """Return the normal equations of the inertial states and their factors, if there are any.

    Args:
        window: K frames.
        num_pairs: how many of the intervals between them count, from the first on; all, by default.
    """
    inertial = window.inertial
    if inertial.states is None or inertial.calibration is None:
        return None
    variances = walk_variances(inertial.calibration, inertial.durations_s(window.frames))
    intervals = Intervals(inertial.factors, variances)
    return inertial_system(window, inertial.states, intervals, num_pairs=num_pairs)


def marginalize_first_frame(
    window: Window, others: WindowEquations
) -> tuple[MarginalPrior, InertialStates] | None:
    """Marginalise the first frame's pose and inertial states; None if there are no such states.

    Args:
        window: K frames.
        others: equations of poses and rig from all but the inertial states, at the current values.

    Returns:
        The prior of the poses that remain and the rig, and the states that remain.
    """
    inertial = window.inertial
    # Only what involves the first frame: its factor to the second, and the prior.
    system = system_of(window, num_pairs=1)
    if inertial.states is None or system is None:
        return None
    x = np.concatenate([window.offsets(), inertial.states.joint()])
    return without_first_frame(inertial.states, others, system, x=x)


def gate_prediction(window: Window, seen: RelativePose) -> Window:
    """Test the motion that the IMU predicts against the one that the images show.

    The innovation is recorded, and the noise of the samples estimated anew from all of them. Beyond
    the gate, the pending factor counts for little: its covariance grows by as much as explains by
    itself how far it is off. (Without any factor, the velocity would not be known after this frame,
    nor the motion through a blackout that begins there.) If the gate has failed ``MAX_GATED``
    times, or the median innovation is too large, the IMU is left out for good.

    Args:
        window: K frames, with what the IMU measured since.
        seen: the motion to the next frame, from two frames by themselves: their images, and
            sensors of the motion; corrected if there is a correction.
    """
    inertial = window.inertial
    prediction = inertial.prediction
    if prediction is None:
        return window
    # ν = Log(T_seen T_predicted⁻¹), along the axes of the next frame. The prediction has the
    # noise of the samples times the factor so far; what is remembered has that of the data sheet.
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
        text = f"contradicts the images in this step (χ² {squared:.0f} of 6 degrees of freedom)"
        reason = ImuReason(ImuFault.GATED, text)
        pending = None
        if inertial.pending is not None and np.isfinite(squared):
            pending = _as_noisy_as(inertial.pending, difference)
        inertial = replace(inertial, pending=pending, prediction=None, reason=reason)
    num_gated = sum(inertial.was_gated)
    if num_gated >= MAX_GATED or inertial.excess > MAX_EXCESS:
        text = (
            f"contradicted the images in {num_gated} of the last {len(inertial.innovations)} steps"
        )
        if inertial.excess > MAX_EXCESS:
            text = (
                f"differs from the images by {inertial.excess:.1f} times what"
                f" {USUAL_NOISE_FACTOR:.0f} times the variances of its samples explain, in the"
                f" median of the last {len(inertial.innovations)} steps"
            )
        reason = ImuReason(ImuFault.GATED_OFTEN, text).for_good()
        return without_imu(replace(window, inertial=inertial), reason)
    return replace(window, inertial=inertial)


def _as_noisy_as(factor: Preintegration, error: FloatArray) -> Preintegration:
    """Return a factor whose covariance explains by itself why its motion is off by so much, [6]."""
    # The factor is ordered (δφ, δv, δp), the error [ρ; φ].
    rotation = np.diagonal(factor.cov)[:3].mean()
    position = np.diagonal(factor.cov)[6:].mean()
    too_large = max(error[:3] @ error[:3] / position, error[3:] @ error[3:] / rotation)
    return replace(factor, cov=max(1.0, too_large) * factor.cov)


def drop_weaker_factor(window: Window, motion: RelativePose) -> Window:
    """Return the window without the pending factor, if that knows less of the next motion.

    So it is while the velocity is unknown, as after a step without samples.

    Args:
        window: K frames, with what the IMU measured since.
        motion: to the next frame, by other means.
    """
    inertial = window.inertial
    if not inertial.is_used or inertial.pending is None:
        return window
    if inertial.prediction is not None:
        variance = np.trace(inertial.prediction.cov[:3, :3])
        if variance < np.trace(motion.covariance[:3, :3]):
            return window
    return replace(window, inertial=inertial.without_measurement(UNKNOWN_VELOCITY))


def without_imu(window: Window, reason: ImuReason) -> Window:
    """Return the window without its IMU, for good.

    Args:
        window: K frames with their covariance.
        reason: why.
    """
    return _without_states(window, window.inertial.excluded(reason))


def _without_states(window: Window, left_out: Inertial) -> Window:
    """Return the window with its inertial states marginalised.

    Frames that nothing but the IMU connects keep the motion between them, with a covariance that is
    inflated by what the tests of the IMU have shown; without it, their poses would be unknown.

    Args:
        window: K frames with their covariance.
        left_out: its IMU without states.
    """
    # The joint prior of states and poses stays, reduced to the poses by the Schur complement; the
    # factors go, since without pairs the system is that prior alone. As everywhere, the gradient at
    # the present offsets is turned into the vector of the prior.
    system = system_of(window, num_pairs=0)
    if system is None:
        return replace(window, inertial=left_out)
    hessian, gradient = system.reduced()
    information = window.prior.information + hessian
    vector = window.prior.vector + gradient + hessian @ window.offsets()
    prior = replace(window.prior, information=information, vector=vector)
    return with_measurements(
        replace(window, prior=prior, inertial=left_out),
        _motions_by_imu_only(window, window.inertial.mean_excess),
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
        # Landmarks in common, an off-diagonal block of the prior, or dead reckoning connect the two
        # already.
        if window.has_common_landmarks(slot) or window.prior.information[here, before].any():
            continue
        if _is_dead_reckoned(window, slot):
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


def _is_dead_reckoned(window: Window, slot: int) -> bool:
    """Return whether dead reckoning connects the frame in a slot with the one before it."""
    pair = {pose_of(int(window.frames[slot])), pose_of(int(window.frames[slot - 1]))}
    return any(pair <= set(measurement.variables) for measurement in window.dead_reckoning)

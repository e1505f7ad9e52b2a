"""Gyro and accelerometer between two frames, preintegrated on the manifold of rotations.

Forster, Carlone, Dellaert, Scaramuzza, "On-manifold preintegration for real-time visual-inertial
odometry", T-RO 2017. Everything is in the axes of the camera: rates and forces are turned by
C_cam_imu first, so that the "body" is the IMU's place with the camera's axes, and ``lever_m`` away
from the camera's centre.

Biases walk within the interval, too. Given their values at both ends, which are states, what
remains of the walk is a Brownian bridge: it counts as noise, so that preintegration and walk
together are one joint factor of both frames, as long as the interval may be.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.geometry import so3
from probevo.measurements.gyro import means_between
from probevo.measurements.imu_reason import ImuFault, ImuReason
from probevo.measurements.preintegration_numba import (
    MeanSamples,
    NoiseDensities,
    PreintegrationSums,
    preintegrate_samples,
)
from probevo.sequences.frame import ImuSamples
from probevo.sequences.imu import HELD_NS
from probevo.sequences.imu_calibration import ImuCalibration
from probevo.sequences.validation import MAX_FORCE_M_S2, MAX_RATE_RAD_S, are_within

MIN_SAMPLES = 5
"""Number of samples that cover any interval. Fewer, as an inertial navigation system gives at
the rate of the frames, do not show how the acceleration changes between them, unless they follow
one another closely."""
CLOSE_NS = 1_000_000_000 // 55
"""Samples that are not farther apart than this in the mean cover any interval, even if there are
only two. Linear interpolation over h loses (2πfh)²/12 of a swing at f: with samples of 60 Hz, 9 %
at 10 Hz, faster than a hand or a vehicle moves of its own. The limit is halfway to 50 Hz, and the
mean averages the jitter of stamps, so that an IMU of either rate is used always or never. An
interval of 1/18 s or more has ``MIN_SAMPLES`` then, so that this counts for faster cameras
only."""
LONGEST_HOLE = 3.0
"""Longest time without a sample, in usual distances of samples."""
MIN_GYRO_NOISE_RAD_S_SQRT_HZ = 1e-7
MIN_ACCEL_NOISE_M_S2_SQRT_HZ = 1e-6
"""Least noise densities, less than the best sensors have: a simulated IMU may have none at all, and
the covariance of a preintegration must have an inverse."""
NO_BIAS = np.zeros(6)
NUM_ERRORS = 6
"""Errors of the calibration that act on the samples. If ω̂(t) and f̂(t) are the rates and forces
that are summed up, the true ones are (1 + s_g) Exp(θ) ω̂(t + τ) and (1 + s_f) Exp(θ) f̂(t + τ). In
the order of columns: the mounting θ, rad; the delay τ of the stamps, s; and the errors of scale s_g
of the gyro and s_f of the accelerometer."""


@dataclass(frozen=True)
class Preintegration:
    """The preintegrated samples of an IMU from frame i to frame j, for one assumed bias.

    With R the attitude of the camera's axes in the world, v and p the velocity and position of the
    IMU in it, and g gravity,

        ΔR = R_iᵀ R_j,    Δv = R_iᵀ (v_j − v_i − g T),    Δp = R_iᵀ (p_j − p_i − v_i T − ½ g T²).
    """

    duration_s: float
    """T."""
    rotation: FloatArray
    """ΔR, [3, 3]."""
    velocity: FloatArray
    """Δv, [3], m/s."""
    position: FloatArray
    """Δp, [3], m."""
    cov: FloatArray
    """Covariance of (δφ, δv, δp), [9, 9], given the biases at both ends: from white noise, and from
    the random walk of the biases between the ends; the true rotation is ΔR Exp(δφ)."""
    bias_jacobian: FloatArray
    """Derivative of (δφ, δv, δp) with respect to ``bias``, [9, 6]."""
    bias_change_jacobian: FloatArray
    """Derivative with respect to the change of the bias from the start to the end, [9, 6]: between
    two known values, a random walk is a straight line in the mean."""
    error_jacobian: FloatArray
    """Derivative with respect to the errors of the calibration, ``NUM_ERRORS``, [9, 6]."""
    bias: FloatArray
    """Biases of gyro, rad/s, and accelerometer, m/s², along the camera's axes, that were taken off,
    [6]."""
    lever_m: FloatArray
    """Position of the IMU in the camera's frame, [3], m."""


@dataclass(frozen=True)
class NoPreintegration:
    """An interval without a preintegration."""

    reason: ImuReason
    """Why there is none."""


def preintegrate(
    imu: ImuSamples | None,
    start_ns: int,
    end_ns: int,
    calibration: ImuCalibration,
    bias: FloatArray = NO_BIAS,
) -> Preintegration | NoPreintegration:
    """Preintegrate the samples between two frames.

    Rates and forces are interpolated linearly between the samples, and at both ends.

    Args:
        imu: samples from the last one at or before the start to the first one at or after the end,
            on the clock of the images. Those without a finite, plausible rate and force are left
            out. None is an interval without samples.
        start_ns, end_ns: time of the previous and of the current frame, ns.
        calibration: of the IMU on the camera; its noise densities give the covariance.
        bias: of gyro, rad/s, and accelerometer, m/s², along the camera's axes, [6].

    Returns:
        The preintegration, or the reason why there is none.
    """
    # Refuse an interval that the usable samples do not cover.
    if imu is None or not len(imu.stamps_ns):
        return NoPreintegration(ImuReason(ImuFault.NO_SAMPLES, "has no samples"))
    if end_ns <= start_ns:
        text = "has samples of an interval of no length"
        return NoPreintegration(ImuReason(ImuFault.EMPTY_INTERVAL, text))
    if not np.isfinite(imu.accel_m_s2).any():
        return NoPreintegration(ImuReason(ImuFault.NO_ACCELEROMETER, "has no accelerometer"))
    is_usable = are_within(imu.gyro_rad_s, MAX_RATE_RAD_S)
    is_usable &= are_within(imu.accel_m_s2, MAX_FORCE_M_S2)
    stamps_ns = imu.stamps_ns[is_usable]
    reason = _reason_against(stamps_ns, start_ns, end_ns)
    if reason is not None:
        return NoPreintegration(reason)
    # Sub-intervals between knots: start, samples inside, end.
    is_inside = (stamps_ns > start_ns) & (stamps_ns < end_ns)
    # Count from the start of the interval: stamps since 1970 are not exact as floats.
    knots_ns = np.concatenate([[start_ns], stamps_ns[is_inside], [end_ns]]) - start_ns
    C_cam_imu = calibration.C_cam_imu
    steps_s = 1e-9 * np.diff(knots_ns)
    # Knots include all samples, so that both are linear from knot to knot.
    rates = means_between(knots_ns, stamps_ns - start_ns, imu.gyro_rad_s[is_usable] @ C_cam_imu.T)
    forces = means_between(knots_ns, stamps_ns - start_ns, imu.accel_m_s2[is_usable] @ C_cam_imu.T)
    # The sums, from the identity and zero on.
    bias = np.asarray(bias, np.float64)
    sums = PreintegrationSums(
        rotation=np.eye(3),
        velocity=np.zeros(3),
        position=np.zeros(3),
        cov=np.zeros((9, 9)),
        bias_jacobian=np.zeros((9, 6)),
        bias_change_jacobian=np.zeros((9, 6)),
        gyro_scale_jacobian=np.zeros(9),
    )
    densities = NoiseDensities(
        gyro=max(float(calibration.gyro_noise_rad_s_sqrt_hz), MIN_GYRO_NOISE_RAD_S_SQRT_HZ),
        accel=max(float(calibration.accel_noise_m_s2_sqrt_hz), MIN_ACCEL_NOISE_M_S2_SQRT_HZ),
        gyro_walk=float(calibration.gyro_bias_walk_rad_s2_sqrt_hz),
        accel_walk=float(calibration.accel_bias_walk_m_s3_sqrt_hz),
    )
    samples = MeanSamples(steps_s, rates - bias[:3], forces - bias[3:])
    preintegrate_samples(samples, densities, sums)
    if not all(np.isfinite(part).all() for part in sums):
        text = "has rates or forces whose integral is not finite"
        return NoPreintegration(ImuReason(ImuFault.INTEGRAL_NOT_FINITE, text))
    return Preintegration(
        duration_s=1e-9 * (end_ns - start_ns),
        rotation=sums.rotation,
        velocity=sums.velocity,
        position=sums.position,
        cov=0.5 * (sums.cov + sums.cov.T),
        bias_jacobian=sums.bias_jacobian,
        bias_change_jacobian=sums.bias_change_jacobian,
        error_jacobian=_error_jacobian(sums, samples),
        bias=bias,
        lever_m=calibration.T_cam_imu[:3, 3],
    )


def _error_jacobian(sums: PreintegrationSums, samples: MeanSamples) -> FloatArray:
    """Return the derivative of (δφ, δv, δp) with respect to the errors of the calibration, [9, 6].

    Args:
        sums: ΔR, Δv and Δp of the interval.
        samples: that they are made of.
    """
    jacobian = np.zeros((9, NUM_ERRORS))
    # Turned by θ, ΔR, Δv and Δp are Exp(θ) ΔR Exp(−θ), Exp(θ) Δv and Exp(θ) Δp.
    jacobian[:3, :3] = sums.rotation.T - np.eye(3)
    jacobian[3:6, :3] = -so3.wedge(sums.velocity)
    jacobian[6:, :3] = -so3.wedge(sums.position)
    # Later by τ, the interval loses what is at its start and gains what is at its end, and the axes
    # of its start turn by ω_i τ.
    rate_i, rate_j = samples.rates_rad_s[[0, -1]]
    force_i, force_j = samples.forces_m_s2[[0, -1]]
    jacobian[:3, 3] = rate_j - sums.rotation.T @ rate_i
    jacobian[3:6, 3] = sums.rotation @ force_j - force_i - np.cross(rate_i, sums.velocity)
    jacobian[6:, 3] = sums.velocity - samples.steps_s.sum() * force_i
    jacobian[6:, 3] -= np.cross(rate_i, sums.position)
    jacobian[:, 4] = sums.gyro_scale_jacobian
    jacobian[3:6, 5] = sums.velocity
    jacobian[6:, 5] = sums.position
    return jacobian


def _reason_against(stamps_ns: IntArray, start_ns: int, end_ns: int) -> ImuReason | None:
    """Return why samples with these stamps do not cover an interval; None if they do."""
    if len(stamps_ns) and (stamps_ns[-1] < start_ns or stamps_ns[0] > end_ns):
        where = f"end {1e-9 * (start_ns - int(stamps_ns[-1])):.3g} s before the previous frame"
        if stamps_ns[0] > end_ns:
            where = f"begin {1e-9 * (int(stamps_ns[0]) - end_ns):.3g} s after the current frame"
        text = f"has samples that {where} (are its stamps ns, on the clock of the images?)"
        return ImuReason(ImuFault.OUTSIDE_INTERVAL, text)
    # From the last sample at or before the start to the first one at or after the end.
    first = max(int(np.searchsorted(stamps_ns, start_ns, side="right")) - 1, 0)
    covering = stamps_ns[first : int(np.searchsorted(stamps_ns, end_ns, side="left")) + 1]
    between_ns = np.diff(covering)
    # A sample that is a mean over its interval may be given at both ends of it; it counts once.
    apart_ns = between_ns[np.abs(between_ns) > HELD_NS]
    num_samples = len(apart_ns) + min(len(covering), 1)
    if num_samples == 0:
        return ImuReason(ImuFault.NO_USABLE_SAMPLE, "has no usable sample between two frames")
    if num_samples == 1:
        return ImuReason(ImuFault.SINGLE_SAMPLE, "has a single usable sample between two frames")
    # The longest time without a sample, at either end of the interval as well.
    hole_ns = max(
        float(between_ns.max()), float(covering[0] - start_ns), float(end_ns - covering[-1])
    )
    # The ends of the interval count as samples' stamps where no sample reaches them.
    covered_ns = max(int(covering[-1]), end_ns) - min(int(covering[0]), start_ns)
    if num_samples < MIN_SAMPLES and covered_ns > CLOSE_NS * (num_samples - 1):
        text = (
            f"has {num_samples} usable samples between two frames, and none for"
            f" {1e-6 * hole_ns:.0f} ms, where the window needs {MIN_SAMPLES}, or one in each"
            f" {1e-6 * CLOSE_NS:.0f} ms in the mean"
        )
        return ImuReason(ImuFault.FEW_SAMPLES, text)
    if between_ns.min() <= 0:
        text = "has samples whose stamps do not ascend"
        return ImuReason(ImuFault.STAMPS_NOT_ASCENDING, text)
    if hole_ns > LONGEST_HOLE * float(np.median(apart_ns)):
        return ImuReason(ImuFault.HOLE, f"has no samples for {1e-6 * hole_ns:.0f} ms")
    return None

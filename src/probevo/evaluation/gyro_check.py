"""Check of the gyro's calibration against the rotations by images.

Let φ_k(τ) be the gyro's rotation over step k, integrated over the interval shifted by τ. The model
of the rotation by images is φ = s Exp(δ) φ_k(τ) + b Δt + noise, with an error δ of the mounting, s
of the unit, a bias b and a lag τ of the stamps. All are estimated jointly, by Gauss–Newton from
several starts, since the usual mistakes (degrees, an inverse mounting, a late clock) are far from
the given calibration.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.evaluation.clustered_regression import Regression, regress
from probevo.geometry import so3
from probevo.measurements.gyro import integrate_gyro
from probevo.sequences.imu import ImuStream
from probevo.sequences.imu_calibration import ImuCalibration

# Indices of δ, s − 1, b and τ among the eight unknowns
MOUNTING = slice(0, 3)
SCALE = 3
BIAS = slice(4, 7)
LAG = 7
MOUNTING_SIGMA_RAD = 1.0
"""Prior standard deviation of δ: nothing is known, since each start has its own mounting."""
SCALE_SIGMA = 100.0
"""Prior standard deviation of s: degrees instead of radians are a factor of 57."""
LAG_SIGMA_S = 0.1
"""Prior standard deviation of τ."""
LAGS_S = np.arange(-0.2, 0.2001, 0.02)
"""Candidates for the lag at the start."""
MIN_STEPS = 10
"""Steps that the samples must cover, for eight unknowns."""
_DIFFERENCE_S = 0.002
"""Half the step of the central difference by τ."""
_ITERATIONS = 10
_CONVERGED = 0.01
"""Change of an unknown, in standard deviations, below which the iteration ends."""
_SAME_RAD = 1e-9
"""Rotations below this have no direction."""


@dataclass(frozen=True)
class GyroCheck:
    """The gyro's calibration, estimated from images."""

    regression: Regression
    """Estimate of (δ, s − 1, b, τ): rad, 1, rad/s, s."""
    C_cam_imu: FloatArray
    """Rotation of the IMU to the camera that agrees with the images, [3, 3]."""
    attenuation: float
    """Bias of s by the gyro's noise (regression dilution): the variance of the noise over
    the variance of the rotations. It matters if the camera hardly turns."""


def integrated_rotations(
    between_ns: IntArray, stream: ImuStream, calibration: ImuCalibration, lag_s: float = 0.0
) -> FloatArray:
    """Integrate the gyro over K steps, without any bias.

    Args:
        between_ns: stamps of the two frames of each step, [K, 2].
        stream: the samples of the IMU.
        calibration: the calibration of the IMU.
        lag_s: time to be added to the stamps of the IMU.

    Returns:
        Rotation vectors Log(C_curr_prev), [K, 3], camera frame; NaN for steps that the samples do
        not cover.
    """
    rotation_rad = np.full((len(between_ns), 3), np.nan)
    shifted_ns = between_ns - round(1e9 * lag_s)
    for k, (start_ns, end_ns) in enumerate(shifted_ns.tolist()):
        samples = stream.between(start_ns, end_ns)
        if samples is not None:
            gyro = integrate_gyro(samples, start_ns, end_ns, calibration=calibration)
            rotation_rad[k] = so3.log(gyro.C_curr_prev)
    return rotation_rad


def check_gyro(
    between_ns: IntArray, rotation_rad: FloatArray, stream: ImuStream, calibration: ImuCalibration
) -> GyroCheck | None:
    """Estimate mounting, unit, bias and lag of the gyro.

    Args:
        between_ns: stamps of the two frames of K steps, [K, 2].
        rotation_rad: their rotations by the images, Log(C_curr_prev), [K, 3], camera frame.
        stream: the samples of the IMU, on the clock of the images.
        calibration: the calibration of the IMU.

    Returns:
        None if the samples cover fewer than ten steps.
    """
    # Starts, Gauss–Newton from each, and the solution of the least cost.
    problem = _Problem(between_ns, rotation_rad, stream, calibration)
    rotations_by_lag = {float(lag_s): problem.gyro_rotations(float(lag_s)) for lag_s in LAGS_S}
    if max(int(_covered(gyro_rad).sum()) for gyro_rad in rotations_by_lag.values()) < MIN_STEPS:
        return None
    solutions = [problem.solved(start) for start in problem.starts(rotations_by_lag)]
    converged = [solution for solution in solutions if solution is not None]
    if not converged:
        return None
    best = min(converged, key=lambda regression: regression.cost)
    turned = so3.exp(best.values[MOUNTING]) @ calibration.C_cam_imu
    gyro_rad = problem.gyro_rotations(float(np.clip(best.values[LAG], LAGS_S[0], LAGS_S[-1])))
    covered = _covered(gyro_rad)
    # Regression dilution: variance of the noise, three axes, over the variance of the rotations
    # without their median rate. Rotors and engines shake a gyro more than its data sheet says.
    swing = _without_median_rate(gyro_rad[covered], problem.duration_s[covered])
    per_second = max(3.0 * calibration.gyro_noise_rad_s_sqrt_hz**2, _white_noise_rad2_s(stream))
    noise = per_second * float(problem.duration_s[covered].sum())
    attenuation = noise / max(float(np.sum(swing**2)), _SAME_RAD**2)
    return GyroCheck(regression=best, C_cam_imu=turned, attenuation=min(attenuation, 1.0))


@dataclass(frozen=True)
class _Problem:
    """Rotations by images, and the gyro's samples."""

    between_ns: IntArray
    rotation_rad: FloatArray
    stream: ImuStream
    calibration: ImuCalibration

    @property
    def duration_s(self) -> FloatArray:
        """Duration of each step, [K, 1]."""
        return np.asarray(1e-9 * np.diff(self.between_ns, axis=1))

    def gyro_rotations(self, lag_s: float) -> FloatArray:
        """Integrate the gyro over the steps, [K, 3]; NaN where it does not cover them."""
        return integrated_rotations(self.between_ns, self.stream, self.calibration, lag_s)

    def starts(self, rotations_by_lag: dict[float, FloatArray]) -> list[FloatArray]:
        """Return values of the eight unknowns to start from.

        They are the given calibration; the same with the unit, of either sign, that makes the
        rotations as large as the images'; and with the best mounting (Kabsch), too. Each
        has its best lag.
        """
        starts = []
        for sign, with_mounting in ((0.0, False), (1.0, False), (-1.0, False), (1.0, True)):
            fits = []
            for lag_s, gyro_rad in rotations_by_lag.items():
                covered = _covered(gyro_rad)
                if covered.sum() < MIN_STEPS:
                    continue
                start = np.zeros(8)
                start[LAG] = lag_s
                # Without the median rate the bias, which is not known yet, drops out.
                gyro = _without_median_rate(gyro_rad[covered], self.duration_s[covered])
                image = _without_median_rate(self.rotation_rad[covered], self.duration_s[covered])
                if sign:
                    lengths = [np.median(np.linalg.norm(each, axis=1)) for each in (image, gyro)]
                    start[SCALE] = sign * lengths[0] / max(lengths[1], _SAME_RAD) - 1.0
                if with_mounting:
                    start[MOUNTING] = so3.log(so3.most_aligned(image.T @ gyro))
                turned = (1.0 + start[SCALE]) * gyro @ so3.exp(start[MOUNTING]).T
                fits.append((float(np.median(np.linalg.norm(image - turned, axis=1))), start))
            starts.append(min(fits, key=lambda fit: fit[0])[1])
        return starts

    def solved(self, start: FloatArray) -> Regression | None:
        """Solve by Gauss–Newton; None if the shifted gyro covers too few steps."""
        # Prior of (δ, s − 1, b, τ), each around zero.
        values = start
        regression = None
        prior_sigma = np.r_[
            np.full(3, MOUNTING_SIGMA_RAD),
            SCALE_SIGMA,
            np.full(3, max(self.calibration.gyro_bias_sigma_rad_s, 1e-6)),
            LAG_SIGMA_S,
        ]
        for _ in range(_ITERATIONS):
            lag_s = float(np.clip(values[LAG], LAGS_S[0], LAGS_S[-1]))
            before = self.gyro_rotations(lag_s - _DIFFERENCE_S)
            after = self.gyro_rotations(lag_s + _DIFFERENCE_S)
            covered = _covered(before) & _covered(after)
            if covered.sum() < MIN_STEPS:
                return None
            # Predicted rotations, and their speed of change by the lag, ∂φ_k/∂τ, rad/s
            gyro = 0.5 * (before + after)[covered]
            factor = 1.0 + values[SCALE]
            directed = gyro @ so3.exp(values[MOUNTING]).T
            turned = factor * directed
            speed = (after - before)[covered] / (2.0 * _DIFFERENCE_S)
            # Jacobian by (δ, s − 1, b, τ), [k, 3, 8]: Exp(δ + dδ) = Exp(J_l dδ) Exp(δ), and Exp(ε)
            # φ ≈ φ − φ^ ε.
            mounting_jacobian = -so3.wedge(turned) @ so3.left_jacobian(values[MOUNTING])
            design = np.concatenate(
                [
                    mounting_jacobian,
                    directed[:, :, None],
                    self.duration_s[covered][:, :, None] * np.eye(3),
                    factor * (speed @ so3.exp(values[MOUNTING]).T)[:, :, None],
                ],
                axis=2,
            )
            # Linearised about the values, with the lag as clipped. The target is such that the
            # regression gives the new values and not a step: its prior is around zero.
            about = values.copy()
            about[LAG] = lag_s
            predicted = turned + self.duration_s[covered] * values[BIAS]
            target = self.rotation_rad[covered] - predicted + design @ about
            regression = regress(
                design.reshape(-1, 8),
                target.ravel(),
                np.repeat(np.flatnonzero(covered), 3),
                prior_sigma=prior_sigma,
            )
            change = np.abs(regression.values - values) / regression.sigma
            values = regression.values
            if change.max() < _CONVERGED:
                break
        return regression


def _white_noise_rad2_s(stream: ImuStream) -> float:
    """Return by how much the variance of the integrated samples grows, all axes together, rad²/s.

    It follows from second differences of the samples: of white noise, they have six times its
    variance. Where samples are so rare that the motion itself bends between them, it is too large.
    """
    is_known = stream.recorded & np.isfinite(stream.gyro_rad_s).all(axis=1)
    rates = stream.gyro_rad_s[is_known]
    if len(rates) < MIN_STEPS:
        return 0.0
    variance = float(np.mean(np.sum(np.diff(rates, n=2, axis=0) ** 2, axis=1))) / 6.0
    period_s = 1e-9 * float(np.median(np.diff(stream.stamps_ns[is_known])))
    return variance * period_s


def _covered(rotation_rad: FloatArray) -> np.ndarray:
    """Tell which of the rotations, [K, 3], are known."""
    return np.asarray(np.isfinite(rotation_rad).all(axis=1))


def _without_median_rate(rotation_rad: FloatArray, duration_s: FloatArray) -> FloatArray:
    """Subtract the median rate, and with it the bias, from rotations, [K, 3]."""
    return np.asarray(rotation_rad - duration_s * np.median(rotation_rad / duration_s, axis=0))

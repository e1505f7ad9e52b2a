"""The rotation between two frames from the gyro (PROBE eqs. 3-4), and the estimate of its bias."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.geometry import so3
from probevo.sequences.frame import ImuSamples
from probevo.sequences.imu_calibration import ImuCalibration

MAX_UNSEEN = 0.25
"""Largest share of an interval without samples: before the first, after the last, and in gaps."""
HOLE = 3.0
"""A gap is longer than this many sample periods."""
PERIOD_MEMORY = 0.9
"""Weight of the usual sample period against the period in one interval, in the mean of logarithms.
At ten frames a second, no interval of a dropout of half a second is taken to be covered, and
samples at a tenth of the rate are after ten frames."""
_NO_BIAS = np.zeros(3)


@dataclass(frozen=True)
class GyroRotation:
    """Rotation of the camera over one interval as its gyro measured it, for one assumed bias."""

    C_curr_prev: FloatArray
    """p_curr = C_curr_prev p_prev in the camera's frames, [3, 3]."""
    cov: FloatArray
    """Covariance of its left perturbation from the gyro's white noise alone, [3, 3], rad²."""
    bias_jacobian: FloatArray
    """J_b, with C_curr_prev(b + δb) ≈ Exp(J_b δb) C_curr_prev(b), [3, 3], s; the bias is in the
    IMU's frame."""
    duration_s: float


def covers(
    imu: ImuSamples, start_ns: int, end_ns: int, usual_period_ns: float | None = None
) -> bool:
    """Return whether the samples cover the interval, which dropped frames may have left without.

    Args:
        imu: the samples.
        start_ns, end_ns: the interval, ns.
        usual_period_ns: sample period in the intervals before, ns (``period_after``); None if there
            were none. The few samples that a dropout has left do not show it.
    """
    if not len(imu.stamps_ns):
        return False
    ends_ns = max(int(imu.stamps_ns[0]) - start_ns, 0) + max(end_ns - int(imu.stamps_ns[-1]), 0)
    between_ns = np.diff(imu.stamps_ns)
    period_ns = np.median(between_ns) if len(between_ns) else 0.0
    if usual_period_ns is not None:
        period_ns = min(period_ns, usual_period_ns)
    holes_ns = between_ns[between_ns > HOLE * period_ns]
    return ends_ns + int(holes_ns.sum()) <= MAX_UNSEEN * (end_ns - start_ns)


def period_after(imu: ImuSamples | None, usual_period_ns: float | None) -> float | None:
    """Return the usual sample period, ns, after one more interval; None before the first samples.

    Args:
        imu: the samples of the interval, if it has any.
        usual_period_ns: the usual period before.
    """
    if imu is None or len(imu.stamps_ns) < 2:
        return usual_period_ns
    period_ns = float(np.median(np.diff(imu.stamps_ns)))
    if usual_period_ns is None:
        return period_ns
    return float(usual_period_ns**PERIOD_MEMORY * period_ns ** (1.0 - PERIOD_MEMORY))


def integrate_gyro(
    imu: ImuSamples,
    start_ns: int,
    end_ns: int,
    calibration: ImuCalibration,
    bias_rad_s: FloatArray = _NO_BIAS,
) -> GyroRotation:
    """C_curr_prev = C_cv Ψ_J ⋯ Ψ_1 C_cvᵀ with Ψ_j = Exp(−ψ_j) and ψ_j the turn in sub-interval j
    (PROBE eqs. 3-4).

    A rate ω propagates the attitude by Exp(ω Δt), from the right: C_prev_curr = Exp(ψ_1) ⋯
    Exp(ψ_J). PROBE's C_ba maps coordinates the other way, which transposes the product; hence the
    minus in Ψ_j and its reversed order.

    Rates are interpolated linearly between the samples, at both ends of the interval too, and each
    sub-interval turns at the mean of its two ends: the error falls with the square of the sample
    period.

    Args:
        imu: samples that cover the interval; beyond them, the outermost ones are held.
        start_ns, end_ns: time of the previous and of the current frame, ns.
        calibration: of the IMU on the camera.
        bias_rad_s: taken off every rate, [3], rad/s, in the IMU's frame.
    """
    steps_s, rates_rad_s = _mean_rates(imu, start_ns, end_ns)
    C_cam_imu = calibration.C_cam_imu
    # ψ_j, [J, 3], along the axes of the camera, and Ψ_j = Exp(−ψ_j).
    turns_rad = steps_s[:, None] * (rates_rad_s - bias_rad_s) @ C_cam_imu.T
    products = _products_from(so3.exp(-turns_rad))
    # Exp(−(ψ_j + δ)) = Exp(−J(−ψ_j) δ) Ψ_j, and the later Ψ's rotate that error into the frame at
    # the end of the interval.
    sensitivity = products[1:] @ so3.left_jacobian(-turns_rad)
    variance = calibration.gyro_noise_rad_s_sqrt_hz**2 * steps_s
    return GyroRotation(
        C_curr_prev=products[0],
        cov=np.einsum("j,jab,jcb->ac", variance, sensitivity, sensitivity),
        bias_jacobian=np.einsum("j,jab->ab", steps_s, sensitivity) @ C_cam_imu,
        duration_s=1e-9 * (end_ns - start_ns),
    )


def _mean_rates(imu: ImuSamples, start_ns: int, end_ns: int) -> tuple[FloatArray, FloatArray]:
    """Return each sub-interval's length, [J], s, and its mean rate, [J, 3], rad/s."""
    is_inside = (imu.stamps_ns > start_ns) & (imu.stamps_ns < end_ns)
    # Count from the start of the interval: stamps since 1970 are not exact as floats.
    knots_ns = np.concatenate([[start_ns], imu.stamps_ns[is_inside], [end_ns]]) - start_ns
    rates = means_between(knots_ns, imu.stamps_ns - start_ns, imu.gyro_rad_s)
    return 1e-9 * np.diff(knots_ns), rates


def means_between(knots_ns: IntArray, stamps_ns: IntArray, values: FloatArray) -> FloatArray:
    """Return the mean of values [J, 3] between successive knots, [K − 1, 3], interpolated
    linearly."""
    values_at_knots = np.stack([np.interp(knots_ns, stamps_ns, axis) for axis in values.T], axis=1)
    means: FloatArray = 0.5 * (values_at_knots[:-1] + values_at_knots[1:])
    return means


def _products_from(Psi: FloatArray) -> FloatArray:
    """Ψ_J ⋯ Ψ_{j+1} for j = 0 … J, the last of them 1: [J, 3, 3] to [J + 1, 3, 3]."""
    products = np.empty((len(Psi) + 1, 3, 3))
    products[-1] = np.eye(3)
    for j in reversed(range(len(Psi))):
        products[j] = products[j + 1] @ Psi[j]
    return products


@dataclass(frozen=True)
class GyroBias:
    """A Gaussian estimate of the gyro's bias, in the IMU's frame.

    One step is: ``predicted`` over the interval, ``integrate_gyro`` with ``mean``, a solve with
    ``rotation_cov`` as the covariance of the gyro's rotation, ``updated_by_joint_solve`` with
    the rotation that came out.
    """

    mean: FloatArray
    """[3], rad/s."""
    cov: FloatArray
    """[3, 3], rad²/s²."""

    @staticmethod
    def initial(calibration: ImuCalibration) -> GyroBias:
        """Return a bias of zero with the standard deviation of the calibration."""
        return GyroBias(np.zeros(3), calibration.gyro_bias_sigma_rad_s**2 * np.eye(3))

    def predicted(self, duration_s: float, calibration: ImuCalibration) -> GyroBias:
        """Propagate the bias by its random walk over an interval."""
        walked = calibration.gyro_bias_walk_rad_s2_sqrt_hz**2 * duration_s
        return GyroBias(self.mean, self.cov + walked * np.eye(3))

    def rotation_cov(self, gyro: GyroRotation) -> FloatArray:
        """Return Q + J P Jᵀ: the covariance of the gyro's rotation with its bias marginalised, [3,
        3], rad².

        Args:
            gyro: integrated with the bias ``mean``.
        """
        return gyro.cov + gyro.bias_jacobian @ self.cov @ gyro.bias_jacobian.T

    def sensitivity(self, gyro: GyroRotation) -> FloatArray:
        """Return J P^½, [3, 3]: ∂(left perturbation of the gyro's rotation)/∂(error of the bias in
        standard deviations).

        Args:
            gyro: integrated with the bias ``mean``.
        """
        # The symmetric root exists where P is singular, too, and its columns have the same meaning
        # in every step: the sensitivities of successive steps may be added up.
        variances, directions = np.linalg.eigh(self.cov)
        root: FloatArray = directions * np.sqrt(np.maximum(variances, 0.0)) @ directions.T
        return gyro.bias_jacobian @ root

    def updated_by_joint_solve(
        self, gyro: GyroRotation, C_curr_prev_solved: FloatArray, cov_rotation_posterior: FloatArray
    ) -> GyroBias:
        """Update the bias with a solve that had the gyro's rotation among its measurements.

        The true rotation is Exp(r) C_gyro with r = J δb + n, δb ~ N(0, P), n ~ N(0, Q). Given r,
        the other measurements have no information about the bias: δb | r ~ N(K r, (1 − K J) P),
        where K = P Jᵀ (Q + J P Jᵀ)⁻¹. Over the posterior r ~ N(r̂, Σ) of the solve, the laws of
        total expectation and variance give

            mean⁺ = mean + K r̂,    P⁺ = (1 − K J) P + K Σ Kᵀ = (1 − K J) P (1 − K J)ᵀ + K (Q + Σ)
            Kᵀ.

        So the gyro is counted only once, although the posterior contains it. A solve without other
        information, Σ = Q + J P Jᵀ and r̂ = 0, leaves the bias unchanged.

        Args:
            gyro: integrated with the bias ``mean``.
            C_curr_prev_solved: rotation of the solved motion, [3, 3].
            cov_rotation_posterior: Σ, covariance of its left perturbation, [3, 3], rad².
        """
        return self._corrected(gyro, C_curr_prev_solved, cov_rotation_posterior, independent=False)

    def updated_by_independent_solve(
        self, gyro: GyroRotation, C_curr_prev_solved: FloatArray, cov_rotation: FloatArray
    ) -> GyroBias:
        """Update the bias with a solve that did not use the gyro.

        It is a Kalman update with r ~ N(J δb, Q + Σ).

        It takes the arguments of ``updated_by_joint_solve``; Σ is now independent of the gyro.
        """
        return self._corrected(gyro, C_curr_prev_solved, cov_rotation, independent=True)

    def _corrected(
        self,
        gyro: GyroRotation,
        C_curr_prev_solved: FloatArray,
        cov_rotation: FloatArray,
        *,
        independent: bool,
    ) -> GyroBias:
        P = self.cov
        Q = gyro.cov
        J = gyro.bias_jacobian
        innovation_cov = (
            self.rotation_cov(gyro) + cov_rotation if independent else self.rotation_cov(gyro)
        )
        # K = P Jᵀ S⁻¹, with S the covariance of the innovation. By the pseudo-inverse, an interval
        # of zero length, or a gyro without noise and bias, has no information instead of raising.
        K = P @ J.T @ np.linalg.pinv(innovation_cov, hermitian=True)
        # The rotation from the gyro's to the solved one, in the frame of the current camera.
        r = so3.log(C_curr_prev_solved @ gyro.C_curr_prev.T)
        # Joseph's form stays positive semi-definite whatever the rounding.
        rest = np.eye(3) - K @ J
        return GyroBias(self.mean + K @ r, rest @ P @ rest.T + K @ (Q + cov_rotation) @ K.T)

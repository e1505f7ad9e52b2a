"""Velocities, biases and gravity from a window of poses alone, and whether the IMU agrees with it.

Given the poses, what an IMU measured is linear in velocities, accelerometer bias and gravity, and
nearly so in the gyro's bias. A stereo window has the scale, so that this starts from rest as from
any motion. What remains of the residuals, χ² distributed if the calibration holds, tests the
mounting, the clock, the units and the noise of the IMU against the images, before it is used.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from probevo.arrays import FloatArray
from probevo.estimation.motion_model import INNOVATION_GATE
from probevo.estimation.scaled_inverse import scaled_inverse
from probevo.estimation.window.equations import POSE, RIG
from probevo.estimation.window.inertial_equations import linearized
from probevo.estimation.window.inertial_states import STATE, InertialStates, at_start
from probevo.estimation.window.window import Window
from probevo.measurements.imu_reason import ImuFault, ImuReason
from probevo.measurements.preintegration import Preintegration
from probevo.sequences.imu_calibration import GRAVITY_M_S2, ImuCalibration

GRAVITY_TOLERANCE_M_S2 = 0.3
"""By how much gravity may differ from its length beyond 3σ: scale errors of 2 %, and a little."""
USUAL_FACTOR = 10.0
"""By how much the noise densities of a sensor on a vehicle may exceed those of its data sheet."""
MIN_BIAS_SIGMA = 1e-6
"""Smallest prior standard deviation of a bias, rad/s and m/s², where a calibration says zero: its
information stays finite."""
_PASSES = 3
"""Weights and the gyro's rotation depend on what is estimated, but little."""


@dataclass(frozen=True)
class InertialFit:
    """What poses and preintegrations of a window say of its inertial states."""

    states: InertialStates
    """With the prior of the first frame's biases."""
    chi2: float
    """χ² of the residuals that remain."""
    dof: int
    bias_chi2: float
    """The part of it that is due to the biases, by their prior of six degrees of freedom: among
    the others, a bias of several σ would go unnoticed."""
    gravity_m_s2: float
    """Length of gravity, where it is free."""
    gravity_sigma_m_s2: float
    """Its standard deviation."""

    @property
    def excess(self) -> float:
        """χ² over its degrees of freedom: 1 if calibration and noise are right."""
        return self.chi2 / self.dof

    def reason_against(self, largest_excess: float) -> ImuReason | None:
        """Return what contradicts the images; None if they agree."""
        if not np.isfinite(self.chi2):
            text = "fits the images with no finite residual"
            return ImuReason(ImuFault.NO_FINITE_RESIDUAL, text)
        if self.excess > largest_excess:
            text = (
                f"contradicts the images: χ² is {self.chi2:.0f} for {self.dof} degrees of"
                " freedom; check the mounting, the clock, the units and the noise of the IMU"
            )
            # At least, since the poses have a share in the covariance of the residuals, too.
            factor = np.sqrt(self.excess)
            if factor < USUAL_FACTOR:
                text += f" (noise densities at least {factor:.1f} times as large would explain it)"
            return ImuReason(ImuFault.CONTRADICTION, text)
        if self.bias_chi2 > INNOVATION_GATE:
            text = (
                f"shows biases beyond what its calibration says: χ² is {self.bias_chi2:.0f} for 6"
                " degrees of freedom; check gyro_bias_sigma_rad_s and accel_bias_sigma_m_s2"
            )
            return ImuReason(ImuFault.LARGE_BIAS, text)
        off_m_s2 = abs(self.gravity_m_s2 - GRAVITY_M_S2)
        if off_m_s2 > 3.0 * self.gravity_sigma_m_s2 + GRAVITY_TOLERANCE_M_S2:
            text = (
                f"measures gravity as {self.gravity_m_s2:.2f} ±"
                f" {self.gravity_sigma_m_s2:.2f} m/s²; check the unit of the accelerometer"
            )
            return ImuReason(ImuFault.WRONG_GRAVITY, text)
        return None


def fit_inertial_states(
    window: Window,
    factors: Sequence[Preintegration],
    calibration: ImuCalibration,
    *,
    first: int = 0,
) -> InertialFit:
    """Estimate the inertial states of a window whose poses are known with their covariance.

    Frames before the first factor take part neither in the fit nor in the test. Their velocities
    are taken to be that of the next frame, as a guess.

    Args:
        window: K poses, from images alone.
        factors: between all successive frames from place ``first`` on, [K − 1 − first].
        calibration: of the IMU; its bias sigmas are the prior.
        first: place of the first frame with a factor.

    Raises:
        numpy.linalg.LinAlgError: the covariance of the poses is indefinite, by rounding.
    """
    T_linear = window.T_linear[first:]
    covered = replace(window, T_cam_world=window.T_cam_world[first:], T_linear=T_linear)
    pose_cov = window.cov[POSE * first :, POSE * first :]
    count = len(T_linear)
    pairs = np.arange(count - 1)
    bias_sigma = bias_sigmas(calibration)
    # Unknowns: velocities, one bias of each kind, gravity. First guesses: at rest, without bias,
    # gravity along the first camera's y axis. Velocities and gravity enter linearly, so that these
    # need not be good.
    size = 3 * count + 9
    velocity = np.zeros((count, 3))
    bias = np.zeros(6)
    gravity = np.array([0.0, GRAVITY_M_S2, 0.0])
    prior = np.zeros((size, size))
    bias_columns = 3 * count + np.arange(6)
    prior[bias_columns, bias_columns] = 1.0 / bias_sigma**2
    cov = np.zeros((size, size))
    chi2 = np.inf
    bias_chi2 = np.inf
    for _ in range(_PASSES):
        # Stack the factors: residuals r, and their derivatives by the poses and by the unknowns.
        states = at_start(velocity, bias, gravity, bias_sigma)
        residual, jacobian = linearized(covered, states, factors, pairs)
        rows = len(residual) * 9
        pose_design = np.zeros((rows, POSE * count + RIG))
        design = np.zeros((rows, size))
        noise = np.zeros((rows, rows))
        for at, factor in enumerate(factors):
            here = slice(9 * at, 9 * at + 9)
            pose_design[here, POSE * at : POSE * (at + 2)] = jacobian[at, :, : 2 * POSE]
            state_jacobian = jacobian[at, :, 2 * POSE :]
            design[here, 3 * at : 3 * at + 3] = state_jacobian[:, :3]
            design[here, 3 * at + 3 : 3 * at + 6] = state_jacobian[:, STATE : STATE + 3]
            design[here, bias_columns] = state_jacobian[:, 3:STATE]
            design[here, bias_columns] += state_jacobian[:, STATE + 3 : 2 * STATE]
            # ∂δv/∂g = −T C_i and ∂δp/∂g = −½ T² C_i.
            # Gravity is free here, in its length, too, and not only across itself.
            C_i = T_linear[at, :3, :3]
            design[9 * at + 3 : 9 * at + 6, -3:] = -factor.duration_s * C_i
            design[9 * at + 6 : 9 * at + 9, -3:] = -0.5 * factor.duration_s**2 * C_i
            noise[here, here] = factor.cov
        # Whiten by the covariance of r, to which the poses contribute, scaled to a unit diagonal
        # since the units differ widely.
        residual_cov = noise + pose_design @ pose_cov @ pose_design.T
        variance = np.diagonal(residual_cov)
        if not (variance > 0.0).all():
            raise np.linalg.LinAlgError("the covariance of the poses is indefinite")
        scale = 1.0 / np.sqrt(variance)
        residual_root = np.linalg.cholesky(residual_cov * scale[:, None] * scale)
        white_design = np.linalg.solve(residual_root, design * scale[:, None])
        white_residual = np.linalg.solve(residual_root, residual.ravel() * scale)
        # One Gauss–Newton step under the prior Λ of the biases, with the white design D and
        # residual r: (Dᵀ D + Λ)⁻¹ (−Dᵀ r − Λ x). What then remains of r is χ² distributed, prior
        # included.
        cov = scaled_inverse(white_design.T @ white_design + prior)
        values = np.concatenate([velocity.ravel(), bias, gravity])
        step = -cov @ (white_design.T @ white_residual + prior @ values)
        remaining = white_residual + white_design @ step
        values = values + step
        bias_chi2 = float(values @ prior @ values)
        chi2 = float(remaining @ remaining) + bias_chi2
        velocity = values[: 3 * count].reshape(-1, 3)
        bias = values[bias_columns]
        gravity = values[-3:]
    length = float(np.linalg.norm(gravity))
    along = gravity / max(length, 1e-9)
    all_velocities = np.vstack([np.tile(velocity[0], (first, 1)), velocity])
    return InertialFit(
        states=at_start(all_velocities, bias, gravity, bias_sigma),
        chi2=chi2,
        dof=9 * (count - 1) - 3 * count - 3,  # the biases count as measured by their prior
        bias_chi2=bias_chi2,
        gravity_m_s2=length,
        gravity_sigma_m_s2=float(np.sqrt(along @ cov[-3:, -3:] @ along)),
    )


def bias_sigmas(calibration: ImuCalibration) -> FloatArray:
    """Return the prior standard deviations of gyro and accelerometer bias, [6]."""
    sigmas = [calibration.gyro_bias_sigma_rad_s, calibration.accel_bias_sigma_m_s2]
    floored: FloatArray = np.maximum(np.repeat(sigmas, 3), MIN_BIAS_SIGMA)
    return floored


def with_gravity_of_known_length(states: InertialStates) -> InertialStates:
    """Return the states with gravity's length as on earth."""
    length = np.linalg.norm(states.gravity_linear)
    return replace(states, gravity_linear=states.gravity_linear * (GRAVITY_M_S2 / length))

"""Velocities, biases and gravity of a window's frames, and the errors of the IMU's calibration, as
one value.

Like landmarks, these states are eliminated before the poses are solved for: given the poses and
the rig, nothing connects them with any feature. The joint prior of poses, rig and these states is
held in two parts. That of poses and rig alone is the window's own prior (``MarginalPrior``); the
rest of it is here.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from probevo.arrays import FloatArray
from probevo.estimation.motion_model import GYRO_DELAY_S, GYRO_MISALIGNMENT_RAD
from probevo.estimation.window.equations import POSE, RIG
from probevo.geometry import so3
from probevo.measurements.preintegration import NUM_ERRORS

GRAVITY = 2
"""Dimensions of the direction of gravity."""
LEVER = 3
"""Dimensions of the error of the IMU's position in the camera's frame."""
CALIBRATION = NUM_ERRORS + LEVER
"""Dimensions of the errors of the calibration."""
COMMON = GRAVITY + CALIBRATION
"""Dimensions of what all frames have in common."""
STATE = 9
"""Dimensions of velocity, gyro bias and accelerometer bias of a frame."""
SCALE_SIGMA = 0.02
"""Standard deviation of the error of the accelerometer's scale: MEMS sensors have up to 3 %. Of
gravity it is 0.2 m/s²; by where on the earth it is, it differs by 0.03."""
LEVER_SIGMA_M = 0.05
"""Standard deviation of the IMU's position in each direction, as measured by hand."""
CALIBRATION_SIGMAS = np.concatenate(
    [
        np.full(3, GYRO_MISALIGNMENT_RAD),
        [GYRO_DELAY_S, GYRO_MISALIGNMENT_RAD, SCALE_SIGMA],
        np.full(LEVER, LEVER_SIGMA_M),
    ]
)
"""Prior standard deviations of the errors of the calibration, [9]: the data sheet gives noise and
biases, but not how well mounting, clock, scales and position are known."""


@dataclass(frozen=True)
class InertialStates:
    """States of K frames, in the world of the window, and what the past says of them.

    The vector x, [11 + 9K], holds the offset of gravity, the errors of the calibration, and
    velocity and biases of each frame.
    """

    velocity: FloatArray
    """Velocity of the IMU, [K, 3], m/s."""
    velocity_linear: FloatArray
    """Linearisation points of the velocities, [K, 3]; fixed once the prior contains them."""
    bias: FloatArray
    """Biases of gyro, rad/s, and accelerometer, m/s², along the camera's axes, [K, 6]."""
    gravity_linear: FloatArray
    """Linearisation point of gravity in the world, [3], m/s²."""
    gravity_offset: FloatArray
    """δ, [2], rad: gravity is Exp(B δ) of its linearisation point, with B across it."""
    calibration_errors: FloatArray
    """Errors of the calibration, [9]: those of the samples, ``NUM_ERRORS``, and that of the IMU's
    position in the camera's frame, m."""
    coupling: FloatArray
    """Part Λ_ip of the joint prior between x and poses and rig, [11 + 9K, 6K + 4]."""
    information: FloatArray
    """Part Λ_ii of the joint prior, [11 + 9K, 11 + 9K]."""
    vector: FloatArray
    """Information vector η of x, [11 + 9K]."""
    cov: FloatArray
    """Covariance of x, [11 + 9K, 11 + 9K]."""
    cross_cov: FloatArray
    """Cross-covariance of x with poses and rig, [11 + 9K, 6K + 4]."""

    @property
    def gravity(self) -> FloatArray:
        """Gravity in the world, [3], m/s²."""
        turned: FloatArray = so3.exp(self.across @ self.gravity_offset) @ self.gravity_linear
        return turned

    @property
    def calibration_sigma(self) -> FloatArray:
        """Standard deviations of ``calibration_errors``, [9]."""
        return np.sqrt(np.maximum(np.diagonal(self.cov)[GRAVITY:COMMON], 0.0))

    @property
    def across(self) -> FloatArray:
        """B, [3, 2]: unit vectors across the linearisation point of gravity."""
        return across(self.gravity_linear)

    def joint(self) -> FloatArray:
        """Return x, [11 + 9K]."""
        frame_states = np.hstack([self.velocity, self.bias])
        return np.concatenate([self.gravity_offset, self.calibration_errors, frame_states.ravel()])


def across(vector: FloatArray) -> FloatArray:
    """Return two unit vectors across a vector, [3, 2]."""
    unit = vector / np.linalg.norm(vector)
    first = np.cross(unit, np.eye(3)[np.argmin(np.abs(unit))])
    first /= np.linalg.norm(first)
    return np.column_stack([first, np.cross(unit, first)])


def at_start(
    velocity: FloatArray, bias: FloatArray, gravity: FloatArray, bias_sigma: FloatArray
) -> InertialStates:
    """Return states whose prior is only that of the first frame's biases and of the calibration.

    Args:
        velocity: first guesses, [K, 3], m/s.
        bias: the same of both biases, [6].
        gravity: the same of gravity in the world, of any length, [3], m/s².
        bias_sigma: standard deviations of both biases about zero, [6].
    """
    count = len(velocity)
    size = COMMON + STATE * count
    # Behind what is in common, each frame has velocity [3] and biases [6]: those of the first frame
    # are at COMMON + 3 and after.
    information = np.zeros((size, size))
    calibration_indices = GRAVITY + np.arange(CALIBRATION)
    information[calibration_indices, calibration_indices] = 1.0 / CALIBRATION_SIGMAS**2
    bias_indices = COMMON + 3 + np.arange(6)
    information[bias_indices, bias_indices] = 1.0 / bias_sigma**2
    return InertialStates(
        velocity=velocity,
        velocity_linear=velocity,
        bias=np.tile(bias, (count, 1)),
        gravity_linear=gravity,
        gravity_offset=np.zeros(GRAVITY),
        calibration_errors=np.zeros(CALIBRATION),
        coupling=np.zeros((size, POSE * count + RIG)),
        information=information,
        vector=np.zeros(size),
        cov=np.zeros((size, size)),
        cross_cov=np.zeros((size, POSE * count + RIG)),
    )


def with_frame(states: InertialStates, velocity: FloatArray) -> InertialStates:
    """Return the states with one more frame, of which the prior says nothing.

    Args:
        states: of K frames.
        velocity: a guess of that at the new frame, [3], m/s.
    """
    q = len(states.vector)
    p = states.coupling.shape[1]
    # The rig stays last in the vector of poses and rig, and moves behind the new pose.
    poses = np.concatenate([np.arange(p - RIG), np.arange(p - RIG, p) + POSE])
    information = np.zeros((q + STATE, q + STATE))
    information[:q, :q] = states.information
    coupling = np.zeros((q + STATE, p + POSE))
    coupling[:q, poses] = states.coupling
    return replace(
        states,
        velocity=np.vstack([states.velocity, velocity]),
        velocity_linear=np.vstack([states.velocity_linear, velocity]),
        bias=np.vstack([states.bias, states.bias[-1]]),
        coupling=coupling,
        information=information,
        vector=np.concatenate([states.vector, np.zeros(STATE)]),
    )


def moved(states: InertialStates, step: FloatArray) -> InertialStates:
    """Return the states after a step of x, [11 + 9K]."""
    frame_states = step[COMMON:].reshape(-1, STATE)
    velocity = states.velocity + frame_states[:, :3]
    # First-estimates Jacobians: what the prior contains keeps its linearisation point.
    information = np.diagonal(states.information)
    is_fixed = information[COMMON::STATE] > 0.0
    changed = replace(
        states,
        velocity=velocity,
        velocity_linear=np.where(is_fixed[:, None], states.velocity_linear, velocity),
        bias=states.bias + frame_states[:, 3:],
        gravity_offset=states.gravity_offset + step[:GRAVITY],
        calibration_errors=states.calibration_errors + step[GRAVITY:COMMON],
    )
    # Gravity likewise: until the prior contains it, the linearisation point moves along, and δ is
    # zero.
    if information[0] > 0.0:
        return changed
    return replace(changed, gravity_linear=changed.gravity, gravity_offset=np.zeros(GRAVITY))

"""The motion to the next frame, as an IMU predicts it from velocity, biases and gravity."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from probevo.arrays import FloatArray
from probevo.estimation.window.equations import POSE
from probevo.estimation.window.inertial_equations import linearized, walk_variances
from probevo.estimation.window.inertial_states import COMMON, STATE, InertialStates
from probevo.estimation.window.window import Window
from probevo.geometry import se3, so3
from probevo.measurements.preintegration import NUM_ERRORS, Preintegration


class InertialPrediction(NamedTuple):
    """The motion that an IMU measured after the last frame of a window."""

    T_curr_prev: FloatArray
    """[4, 4], m."""
    cov_of_states: FloatArray
    """Covariance of its left perturbation from pose, velocity, biases and their walk, gravity, and
    the calibration, [6, 6]."""
    cov_of_samples: FloatArray
    """The same from the noise of the samples, [6, 6]."""
    velocity: FloatArray
    """Velocity of the IMU at the end of the motion, in the world, [3], m/s."""

    @property
    def cov(self) -> FloatArray:
        """Covariance of its left perturbation, [6, 6]."""
        return self.cov_of_states + self.cov_of_samples


def predicted(window: Window, states: InertialStates, factor: Preintegration) -> InertialPrediction:
    """Predict the motion after the last frame from its velocity, biases and gravity.

    Args:
        window: K poses with their covariance.
        states: of these K frames, with their covariance.
        factor: from the last frame on.
    """
    last = len(window) - 1
    dt = factor.duration_s
    C_i = window.T_cam_world[last, :3, :3]
    correction = factor.bias_jacobian @ (states.bias[last] - factor.bias)
    correction += factor.error_jacobian @ states.calibration_errors[:NUM_ERRORS]
    gravity = states.gravity
    # The state at the end, by the equations that ``linearized`` sets to zero.
    rotation = factor.rotation @ so3.exp(correction[:3])
    ballistic = C_i @ (dt * states.velocity[last] + 0.5 * dt**2 * gravity)
    displacement = factor.position + correction[6:] + ballistic
    change = C_i.T @ (factor.velocity + correction[3:6])
    velocity = states.velocity[last] + dt * gravity + change
    # The IMU is at l in both camera frames: p_prev = R_ij p_curr + s, and R_ij l + s is l plus the
    # displacement.
    lever_m = factor.lever_m + states.calibration_errors[NUM_ERRORS:]
    T_prev_curr = se3.from_parts(rotation, lever_m + displacement - rotation @ lever_m)
    T_curr_prev = se3.inverse(T_prev_curr)
    cov_of_states, cov_of_samples = _predicted_covariances(
        window, states, factor, T_curr_prev=T_curr_prev, velocity=velocity
    )
    return InertialPrediction(T_curr_prev, cov_of_states, cov_of_samples, velocity)


def _predicted_covariances(
    window: Window,
    states: InertialStates,
    factor: Preintegration,
    *,
    T_curr_prev: FloatArray,
    velocity: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return the covariance of a predicted motion from the states and from the samples, [6, 6].

    Args:
        window: K poses with their covariance.
        states: of these K frames, with their covariance.
        factor: from the last frame on.
        T_curr_prev: the motion, [4, 4].
        velocity: at its end, [3], m/s.
    """
    last = len(window) - 1
    # Linearise the factor at these two ends, as if they were a window of two frames.
    T_new = T_curr_prev @ window.T_cam_world[last]
    pair = replace(
        window,
        T_cam_world=np.stack([window.T_cam_world[last], T_new]),
        T_linear=np.stack([window.T_cam_world[last], T_new]),
    )
    velocities = np.stack([states.velocity[last], velocity])
    ends = replace(
        states,
        velocity=velocities,
        velocity_linear=velocities,
        bias=np.stack([states.bias[last], states.bias[last]]),
    )
    _, jacobians = linearized(pair, ends, [factor], np.array([0]))
    jacobian = jacobians[0]
    # Columns of the Jacobian: pose i, pose j, velocity and biases of i, those of j, and what
    # all frames have in common.
    at_state = COMMON + STATE * last
    # The bias at the end is that at the start and what it has walked meanwhile.
    bias_i = slice(2 * POSE + 3, 2 * POSE + STATE)
    bias_j = slice(2 * POSE + STATE + 3, 2 * POSE + 2 * STATE)
    jacobian[:, bias_i] += jacobian[:, bias_j]
    # New pose and velocity follow from the old states, the walk and the noise: from
    # J_u u + J_g g + J_w w = noise, u = −J_u⁻¹ J_g g − J_u⁻¹ J_w w + J_u⁻¹ noise. What is in
    # common has the last columns.
    unknown = np.r_[np.arange(POSE, 2 * POSE), 2 * POSE + STATE + np.arange(3)]
    given = np.r_[
        np.arange(POSE), 2 * POSE + np.arange(STATE), 2 * (POSE + STATE) + np.arange(COMMON)
    ]
    inverse = np.linalg.inv(jacobian[:, unknown])
    sensitivity = -inverse @ jacobian[:, given]
    at_pose = window.pose_slice(last)
    inertial = np.r_[np.arange(at_state, at_state + STATE), np.arange(COMMON)]  # that is first in x
    # Joint covariance of the last pose, its velocity and biases, and what is in common.
    cov = np.empty((POSE + STATE + COMMON, POSE + STATE + COMMON))
    cov[:POSE, :POSE] = window.cov[at_pose, at_pose]
    cov[POSE:, :POSE] = states.cross_cov[inertial, at_pose]
    cov[:POSE, POSE:] = cov[POSE:, :POSE].T
    cov[POSE:, POSE:] = states.cov[np.ix_(inertial, inertial)]
    # The motion is the new pose less the last one: ξ = ξ_new − Ad(T) ξ_last.
    relative = sensitivity[:POSE]
    relative[:, :POSE] -= se3.adjoint(T_curr_prev)
    cov_of_states = relative @ cov @ relative.T
    if window.inertial.calibration is not None:
        walk = walk_variances(window.inertial.calibration, np.array([factor.duration_s]))[0]
        by_walk = inverse[:POSE] @ jacobian[:, bias_j]
        cov_of_states += (by_walk * walk) @ by_walk.T
    noise_jacobian = inverse[:POSE]
    return _symmetric(cov_of_states), _symmetric(noise_jacobian @ factor.cov @ noise_jacobian.T)


def _symmetric(matrix: FloatArray) -> FloatArray:
    """Return a covariance without what rounding left of asymmetry."""
    return np.asarray(0.5 * (matrix + matrix.T), np.float64)

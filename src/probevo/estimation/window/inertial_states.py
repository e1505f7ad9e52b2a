"""Velocities, biases and gravity of a window's frames, as one value.

Like landmarks, these states are eliminated before the poses are solved for: given the poses and
the rig, nothing connects them with any feature. The joint prior of poses, rig and these states is
held in two parts. That of poses and rig alone is the window's own prior (``MarginalPrior``); the
rest of it is here.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from probevo.arrays import FloatArray
from probevo.estimation.window.equations import POSE, RIG
from probevo.geometry import so3

GRAVITY = 2
"""Dimensions of the direction of gravity."""
STATE = 9
"""Dimensions of velocity, gyro bias and accelerometer bias of a frame."""


@dataclass(frozen=True)
class InertialStates:
    """States of K frames, in the world of the window, and what the past says of them.

    The vector x, [2 + 9K], holds the offset of gravity, and velocity and biases of each frame.
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
    coupling: FloatArray
    """Part Λ_ip of the joint prior between x and poses and rig, [2 + 9K, 6K + 4]."""
    information: FloatArray
    """Part Λ_ii of the joint prior, [2 + 9K, 2 + 9K]."""
    vector: FloatArray
    """Information vector η of x, [2 + 9K]."""
    cov: FloatArray
    """Covariance of x, [2 + 9K, 2 + 9K]."""
    cross_cov: FloatArray
    """Cross-covariance of x with poses and rig, [2 + 9K, 6K + 4]."""

    @property
    def gravity(self) -> FloatArray:
        """Gravity in the world, [3], m/s²."""
        turned: FloatArray = so3.exp(self.across @ self.gravity_offset) @ self.gravity_linear
        return turned

    @property
    def across(self) -> FloatArray:
        """B, [3, 2]: unit vectors across the linearisation point of gravity."""
        return across(self.gravity_linear)

    def joint(self) -> FloatArray:
        """Return x, [2 + 9K]."""
        frame_states = np.hstack([self.velocity, self.bias])
        return np.concatenate([self.gravity_offset, frame_states.ravel()])


def across(vector: FloatArray) -> FloatArray:
    """Return two unit vectors across a vector, [3, 2]."""
    unit = vector / np.linalg.norm(vector)
    first = np.cross(unit, np.eye(3)[np.argmin(np.abs(unit))])
    first /= np.linalg.norm(first)
    return np.column_stack([first, np.cross(unit, first)])


def at_start(
    velocity: FloatArray, bias: FloatArray, gravity: FloatArray, bias_sigma: FloatArray
) -> InertialStates:
    """Return states whose prior is only that of the first frame's biases.

    Args:
        velocity: first guesses, [K, 3], m/s.
        bias: the same of both biases, [6].
        gravity: the same of gravity in the world, of any length, [3], m/s².
        bias_sigma: standard deviations of both biases about zero, [6].
    """
    count = len(velocity)
    size = GRAVITY + STATE * count
    # Behind gravity, each frame has velocity [3] and biases [6]: those of the first frame are
    # at GRAVITY + 3 and after.
    information = np.zeros((size, size))
    bias_indices = GRAVITY + 3 + np.arange(6)
    information[bias_indices, bias_indices] = 1.0 / bias_sigma**2
    return InertialStates(
        velocity=velocity,
        velocity_linear=velocity,
        bias=np.tile(bias, (count, 1)),
        gravity_linear=gravity,
        gravity_offset=np.zeros(GRAVITY),
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
    """Return the states after a step of x, [2 + 9K]."""
    frame_states = step[GRAVITY:].reshape(-1, STATE)
    velocity = states.velocity + frame_states[:, :3]
    # First-estimates Jacobians: what the prior contains keeps its linearisation point.
    information = np.diagonal(states.information)
    is_fixed = information[GRAVITY::STATE] > 0.0
    changed = replace(
        states,
        velocity=velocity,
        velocity_linear=np.where(is_fixed[:, None], states.velocity_linear, velocity),
        bias=states.bias + frame_states[:, 3:],
        gravity_offset=states.gravity_offset + step[:GRAVITY],
    )
    # Gravity likewise: until the prior contains it, the linearisation point moves along, and δ is
    # zero.
    if information[0] > 0.0:
        return changed
    return replace(changed, gravity_linear=changed.gravity, gravity_offset=np.zeros(GRAVITY))

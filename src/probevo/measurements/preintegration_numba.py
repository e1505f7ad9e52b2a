"""Compiled preintegration of gyro and accelerometer over the samples of one interval."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from probevo.arrays import FloatArray
from probevo.compiled import compiled, copy_into
from probevo.geometry.so3_numba import exp_coefficients


class MeanSamples(NamedTuple):
    """Mean rate and specific force in each of J sub-intervals, biases taken off."""

    steps_s: FloatArray
    """Length of each, [J], s."""
    rates_rad_s: FloatArray
    """[J, 3]."""
    forces_m_s2: FloatArray
    """[J, 3]."""


class PreintegrationSums(NamedTuple):
    """Where ``preintegrate_samples`` adds up; all zero at the start, but for rotation = 1."""

    rotation: FloatArray
    """ΔR, [3, 3]."""
    velocity: FloatArray
    """Δv, [3]."""
    position: FloatArray
    """Δp, [3]."""
    cov: FloatArray
    """Covariance of the errors (δφ, δv, δp), [9, 9], given the biases at start and end."""
    bias_jacobian: FloatArray
    """Derivative of (δφ, δv, δp) with respect to the biases of gyro and accelerometer, [9, 6]."""
    bias_change_jacobian: FloatArray
    """The same with respect to their change from start to end, [9, 6]."""
    gyro_scale_jacobian: FloatArray
    """The same with respect to the logarithm of the gyro's scale, [9]."""


class NoiseDensities(NamedTuple):
    """How noisy gyro and accelerometer are."""

    gyro: float
    """White noise, rad/s/√Hz."""
    accel: float
    """White noise, m/s²/√Hz."""
    gyro_walk: float
    """Random walk of the bias, rad/s²/√Hz."""
    accel_walk: float
    """Random walk of the bias, m/s³/√Hz."""


@compiled
def fill_exp(x: float, y: float, z: float, C: FloatArray, J: FloatArray) -> None:
    """Fill C with Exp(φ) and J with the right Jacobian J_r(φ), both [3, 3], for φ = (x, y, z)."""
    squared = x * x + y * y + z * z
    a, b, c = exp_coefficients(squared)
    wedge = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    for i in range(3):
        for j in range(3):
            wedge_2 = 0.0
            for k in range(3):
                wedge_2 += wedge[i, k] * wedge[k, j]
            unit = 1.0 if i == j else 0.0
            C[i, j] = unit + a * wedge[i, j] + b * wedge_2
            J[i, j] = unit - b * wedge[i, j] + c * wedge_2


@compiled
def preintegrate_samples(
    samples: MeanSamples, densities: NoiseDensities, sums: PreintegrationSums
) -> None:
    """Integrate rates and forces in the axes of the start, with covariance and bias Jacobians.

    In each sub-interval the rate is constant, and the force acts along the axes of its middle. The
    errors δ = (δφ, δv, δp), with ΔR Exp(δφ), follow Forster et al. 2017, eqs. (59) to (63): over a
    sub-interval, δ ← A δ − B n, with n the errors, bias or noise, of its mean rate and force.

    The biases walk meanwhile. Let w(t) be a walk of unit density. Its mean over a sub-interval from
    t to t + dt has the variance t + ⅓ dt, and the covariance t + ½ dt with w at the end. So the
    cross-covariance M of δ and w follows M ← A M − B (t + ½ dt). At the end T of the interval, the
    change w(T) of the bias moves the mean of δ by M/T w(T), and if it is known, the covariance of δ
    is smaller by M Mᵀ/T: what is left is that of a Brownian bridge.

    Args:
        samples: of the sub-intervals, in the order of time.
        densities: of noise and walks.
        sums: receives the result.
    """
    whole = np.empty((3, 3))
    half = np.empty((3, 3))
    jacobian = np.empty((3, 3))
    half_jacobian = np.empty((3, 3))
    A = np.zeros((9, 9))
    B = np.zeros((9, 6))
    noisy = np.empty((9, 6))
    walk_sums = np.zeros((9, 6))
    walk_cov = np.empty((9, 6))
    elapsed = 0.0
    rotation = sums.rotation
    for index in range(len(samples.steps_s)):
        dt = samples.steps_s[index]
        rate = samples.rates_rad_s[index]
        force = samples.forces_m_s2[index]
        # The turn over the sub-interval, Exp(ω dt), and over its first half, with their right
        # Jacobians.
        fill_exp(rate[0] * dt, rate[1] * dt, rate[2] * dt, whole, jacobian)
        h = 0.5 * dt
        fill_exp(rate[0] * h, rate[1] * h, rate[2] * h, half, half_jacobian)
        middle = np.dot(rotation, half)
        # ΔR Exp(δφ) Exp((ω − n) h) = ΔR_m Exp(δ) with δ = Exp(ω h)ᵀ δφ − J_r(ω h) h n: such a
        # rotation error δ of the middle's axes moves the force by −ΔR_m f^ δ.
        wedge = np.array(
            [
                [0.0, -force[2], force[1]],
                [force[2], 0.0, -force[0]],
                [-force[1], force[0], 0.0],
            ]
        )
        turned_by_force = -np.dot(middle, wedge)
        by_rotation = np.dot(turned_by_force, half.T)
        by_rate = np.dot(turned_by_force, half_jacobian)
        # A has the order (δφ, δv, δp) in rows and columns, B has (rate, force) in its columns. The
        # rate of the first half turns the middle's axes, hence h in its effect on velocity. The
        # force moves the velocity by dt and the position by ½ dt².
        for i in range(3):
            for j in range(3):
                unit = 1.0 if i == j else 0.0
                A[i, j] = whole[j, i]
                A[3 + i, j] = by_rotation[i, j] * dt
                A[3 + i, 3 + j] = unit
                A[6 + i, j] = by_rotation[i, j] * 0.5 * dt * dt
                A[6 + i, 3 + j] = unit * dt
                A[6 + i, 6 + j] = unit
                B[i, j] = jacobian[i, j] * dt
                B[3 + i, j] = by_rate[i, j] * h * dt
                B[6 + i, j] = by_rate[i, j] * h * 0.5 * dt * dt
                B[3 + i, 3 + j] = middle[i, j] * dt
                B[6 + i, 3 + j] = middle[i, j] * 0.5 * dt * dt
        copy_into(sums.bias_jacobian, np.dot(A, sums.bias_jacobian) - B)
        scaled = np.dot(A, sums.gyro_scale_jacobian)
        for i in range(9):
            for j in range(3):
                scaled[i] += B[i, j] * rate[j]
            sums.gyro_scale_jacobian[i] = scaled[i]
        # Σ ← A Σ Aᵀ + B N Bᵀ − A M Bᵀ − B Mᵀ Aᵀ, the last two for the walk. White noise of density
        # σ has the variance σ²/dt in the mean over a sub-interval.
        gyro_walk = densities.gyro_walk * densities.gyro_walk
        accel_walk = densities.accel_walk * densities.accel_walk
        mean_walk = elapsed + dt / 3.0
        gyro_sigma = math.sqrt(densities.gyro * densities.gyro / dt + gyro_walk * mean_walk)
        accel_sigma = math.sqrt(densities.accel * densities.accel / dt + accel_walk * mean_walk)
        moved = np.dot(A, walk_sums)
        for i in range(9):
            for j in range(3):
                noisy[i, j] = B[i, j] * gyro_sigma
                noisy[i, 3 + j] = B[i, 3 + j] * accel_sigma
                walk_cov[i, j] = moved[i, j] * gyro_walk
                walk_cov[i, 3 + j] = moved[i, 3 + j] * accel_walk
        crossed = np.dot(walk_cov, B.T)
        copy_into(
            sums.cov,
            np.dot(np.dot(A, sums.cov), A.T) + np.dot(noisy, noisy.T) - crossed - crossed.T,
        )
        copy_into(walk_sums, moved - B * (elapsed + 0.5 * dt))
        elapsed += dt
        # B moves position and velocity by the mean force alone, δp = ½ dt δv, which gives δp the
        # variance σ² dt³/4. That of white noise is σ² dt³/3: its mean does not tell all of δp.
        # Without the rest, the covariance of a single sub-interval would be singular.
        for i in range(6, 9):
            sums.cov[i, i] += densities.accel * densities.accel * dt * dt * dt / 12.0
        # The sums themselves come last: A and B are those at the start of the sub-interval.
        acceleration = np.dot(middle, force)
        for i in range(3):
            sums.position[i] += sums.velocity[i] * dt + 0.5 * acceleration[i] * dt * dt
            sums.velocity[i] += acceleration[i] * dt
        copy_into(rotation, np.dot(rotation, whole))
    # Given the change of the biases, M/T of it is known, and M Mᵀ/T of the variance goes.
    for i in range(9):
        for j in range(6):
            density = densities.gyro_walk if j < 3 else densities.accel_walk
            sums.bias_change_jacobian[i, j] = walk_sums[i, j] / elapsed
            walk_cov[i, j] = walk_sums[i, j] * density / math.sqrt(elapsed)
    copy_into(sums.cov, sums.cov - np.dot(walk_cov, walk_cov.T))

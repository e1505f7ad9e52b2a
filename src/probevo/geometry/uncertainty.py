"""Gaussians on SE(3), injected by left perturbations: T = Exp(ξ) T̄, ξ ~ N(0, Σ) (thesis section 2.5).

How they are sampled, inverted, compounded and scored. Barfoot & Furgale: "Associating uncertainty with
three-dimensional poses for use in estimation problems", IEEE T-RO 2014.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from probevo.arrays import FloatArray
from probevo.geometry import quaternion, se3, so3

_GENERATORS = se3.curly_wedge(np.eye(6))
"""ξ⋏ = Σ_i ξ_i G_i, [6, 6, 6]."""


def sample_poses(T_mean: FloatArray, cov: FloatArray, count: int, rng: np.random.Generator) -> FloatArray:
    """Draws of Exp(ξ) T̄: mean [4, 4] and covariance [6, 6] to [count, 4, 4] (thesis eq. 2.26)."""
    return se3.exp(_sample_zero_mean(cov, count, rng)) @ T_mean


def sample_rotations(C_mean: FloatArray, cov: FloatArray, count: int, rng: np.random.Generator) -> FloatArray:
    """Draws of Exp(φ) C̄: mean [3, 3] and covariance [3, 3], rad², to [count, 3, 3] (thesis eq. 2.27)."""
    return so3.exp(_sample_zero_mean(cov, count, rng)) @ C_mean


def sample_quaternions(q_mean: FloatArray, cov: FloatArray, count: int, rng: np.random.Generator) -> FloatArray:
    """Draws of Exp(φ) ⊗ q̄: mean [4] and covariance [3, 3], rad², to [count, 4] (thesis eq. 2.28)."""
    return quaternion.product(quaternion.exp(_sample_zero_mean(cov, count, rng)), q_mean)


def _sample_zero_mean(cov: FloatArray, count: int, rng: np.random.Generator) -> FloatArray:
    # The eigendecomposition also takes a singular covariance, such as that of motion in a plane.
    return rng.multivariate_normal(np.zeros(len(cov)), cov, size=count, method="eigh")


def invert(T_b_a: FloatArray, cov_b_a: FloatArray) -> tuple[FloatArray, FloatArray]:
    """T_a_b and its covariance, [..., 4, 4] and [..., 6, 6]: (Exp(ξ) T)⁻¹ = Exp(−Ad(T⁻¹) ξ) T⁻¹, which is exact."""
    T_a_b = se3.inverse(T_b_a)
    return T_a_b, _rotate_covariance(se3.adjoint(T_a_b), cov_b_a)


def compound(
    T_b_a: FloatArray, cov_b_a: FloatArray, T_c_b: FloatArray, cov_c_b: FloatArray, order: Literal[2, 4] = 2
) -> tuple[FloatArray, FloatArray]:
    """T_c_a = T_c_b T_b_a of two independent uncertain poses, and its covariance.

    Exp(ξ_1) T_c_b Exp(ξ_2) T_b_a = Exp(ξ_1) Exp(ξ_2') T_c_a with ξ_2' = Ad(T_c_b) ξ_2. The second order adds the
    covariances of ξ_1 and ξ_2'; the fourth order also keeps the next terms of the Baker-Campbell-Hausdorff series,
    which matter once the rotation is uncertain by some 10° (Barfoot & Furgale 2014; Barfoot 2017 section 7.3.3).

    Args:
        T_b_a, T_c_b: means, [..., 4, 4].
        cov_b_a, cov_c_b: covariances of their left perturbations, [..., 6, 6].
        order: 2 or 4, the power of the perturbations to which the covariance is right.
    """
    cov_1 = cov_c_b
    cov_2 = _rotate_covariance(se3.adjoint(T_c_b), cov_b_a)
    cov_c_a = cov_1 + cov_2
    if order == 4:
        cov_c_a = cov_c_a + _fourth_order_terms(cov_1, cov_2)
    return T_c_b @ T_b_a, cov_c_a


def compound_chain(
    T_curr_prev: FloatArray, cov_curr_prev: FloatArray, order: Literal[2, 4] = 2
) -> tuple[FloatArray, FloatArray]:
    """The trajectory that follows from K independent relative motions, and the covariance of each of its poses.

    Each step compounds T_world_curr = T_world_prev T_prev_curr. The world is the camera before the first motion: the
    first camera if, as ``StereoOdometry`` yields them, the first motion is the identity with zero covariance.
    Successive motions share the noise of a frame, so that to take them as independent is an approximation.

    Args:
        T_curr_prev: motions, p_curr = T_curr_prev p_prev, [K, 4, 4].
        cov_curr_prev: covariances of their left perturbations, [K, 6, 6].
        order: that of ``compound``.

    Returns:
        T_world_cam after each motion, p_world = T_world_cam p_cam, [K, 4, 4], and the covariances of the left
        perturbations of T_world_cam, [K, 6, 6].
    """
    T_prev_curr, cov_prev_curr = invert(T_curr_prev, cov_curr_prev)
    T_world_cam, cov_world_cam = np.empty_like(T_prev_curr), np.empty_like(cov_prev_curr)
    T, cov = np.eye(4), np.zeros((6, 6))
    for k in range(len(T_prev_curr)):
        T, cov = compound(T_prev_curr[k], cov_prev_curr[k], T, cov, order)
        T_world_cam[k], cov_world_cam[k] = T, cov
    return T_world_cam, cov_world_cam


def normalized_error_squared(T_true: FloatArray, T_estimated: FloatArray, cov: FloatArray) -> FloatArray:
    """ξᵀ Σ⁻¹ ξ with ξ = Log(T_true T_estimated⁻¹), the squared error of each pose in units of its covariance, [...].

    Known as NEES: its mean is 6 and its distribution χ²(6) where the covariance is honest. NaN where the truth is NaN.

    Args:
        T_true, T_estimated: poses, [..., 4, 4].
        cov: covariances of the left perturbations of T_estimated, [..., 6, 6].

    Raises:
        numpy.linalg.LinAlgError: a covariance is singular, as is that of a first frame.
    """
    xi = se3.log(T_true @ se3.inverse(T_estimated))
    squared: FloatArray = np.sum(xi * np.linalg.solve(cov, xi[..., None])[..., 0], axis=-1)
    return squared


def _rotate_covariance(adjoint: FloatArray, cov: FloatArray) -> FloatArray:
    """Covariance of Ad ξ, [..., 6, 6]."""
    return adjoint @ cov @ adjoint.mT


def _fourth_order_terms(cov_1: FloatArray, cov_2: FloatArray) -> FloatArray:
    """What the fourth order adds to Σ_1 + Σ_2, [..., 6, 6].

    With A_i = E[ξ_i⋏ ξ_i⋏] and B = E[ξ_1⋏ ξ_2 ξ_2ᵀ ξ_1⋏ᵀ]: (A_1 Σ_2 + Σ_2 A_1ᵀ + A_2 Σ_1 + Σ_1 A_2ᵀ) / 12 + B / 4.
    """
    A_1, A_2 = (
        np.einsum("...ij,iab,jbc->...ac", cov, _GENERATORS, _GENERATORS, optimize=True) for cov in (cov_1, cov_2)
    )
    B = np.einsum("...ij,iab,...bc,jdc->...ad", cov_1, _GENERATORS, cov_2, _GENERATORS, optimize=True)
    half: FloatArray = (A_1 @ cov_2 + A_2 @ cov_1) / 12.0 + B / 8.0
    return half + half.mT

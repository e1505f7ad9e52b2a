"""Gaussians on SE(3), injected by left perturbations: T = Exp(ξ) T̄, ξ ~ N(0, Σ).

They are inverted, compounded and scored as in thesis section 2.5 and in Barfoot & Furgale,
"Associating uncertainty with three-dimensional poses for use in estimation problems", IEEE T-RO
2014.
"""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.geometry import se3

MOTIONS_DIFFER_FROM = 22.46
"""Squared Mahalanobis distance beyond which two motions differ significantly: the 99.9 % quantile
of χ²(6)."""


def invert(T_b_a: FloatArray, cov_b_a: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return T_a_b and its covariance, [..., 4, 4] and [..., 6, 6].

    The covariance is exact, since (Exp(ξ) T)⁻¹ = Exp(−Ad(T⁻¹) ξ) T⁻¹.
    """
    T_a_b = se3.inverse(T_b_a)
    return T_a_b, _rotate_covariance(se3.adjoint(T_a_b), cov_b_a)


def compound_pair(
    T_b_a: FloatArray, cov_b_a: FloatArray, T_c_b: FloatArray, cov_c_b: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return T_c_a = T_c_b T_b_a of two independent uncertain poses, and its covariance.

    Exp(ξ_1) T_c_b Exp(ξ_2) T_b_a = Exp(ξ_1) Exp(ξ_2') T_c_a with ξ_2' = Ad(T_c_b) ξ_2. To second
    order, the covariances of ξ_1 and ξ_2' add. The next terms of the Baker-Campbell-Hausdorff
    series, omitted here, matter when the rotation is uncertain by some 10° (Barfoot & Furgale 2014;
    Barfoot 2017 section 7.3.3).

    Args:
        T_b_a: mean of the first pose, [..., 4, 4].
        cov_b_a: covariance of its left perturbation, [..., 6, 6].
        T_c_b: mean of the second pose, [..., 4, 4].
        cov_c_b: covariance of its left perturbation, [..., 6, 6].
    """
    return T_c_b @ T_b_a, cov_c_b + _rotate_covariance(se3.adjoint(T_c_b), cov_b_a)


def compound_chain(
    T_curr_prev: FloatArray, cov_curr_prev: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the trajectory of K independent relative motions, and the covariance of each pose.

    Each step compounds T_world_curr = T_world_prev T_prev_curr. The world is the camera before the
    first motion, which is the first camera if the first motion is the identity with zero
    covariance, as ``StereoOdometry`` yields it. Independence is an approximation: successive
    motions have the noise of their common frame in common.

    Args:
        T_curr_prev: motions, p_curr = T_curr_prev p_prev, [K, 4, 4].
        cov_curr_prev: covariances of their left perturbations, [K, 6, 6].

    Returns:
        T_world_cam after each motion, p_world = T_world_cam p_cam, [K, 4, 4], and the covariances
        of the left perturbations of T_world_cam, [K, 6, 6].
    """
    # T_world_curr = T_world_prev T_prev_curr is perturbed in the world, T_curr_prev in the camera.
    T_prev_curr, cov_prev_curr = invert(T_curr_prev, cov_curr_prev)
    T_world_cam = np.empty_like(T_prev_curr)
    cov_world_cam = np.empty_like(cov_prev_curr)
    # The world is known exactly; each motion adds its own uncertainty.
    T = np.eye(4)
    cov = np.zeros((6, 6))
    for k in range(len(T_prev_curr)):
        T, cov = compound_pair(T_prev_curr[k], cov_prev_curr[k], T, cov_c_b=cov)
        T_world_cam[k] = T
        cov_world_cam[k] = cov
    return T_world_cam, cov_world_cam


def advance_cov(
    cov_path: FloatArray, T_curr_prev: FloatArray, cov: FloatArray, path_cross_cov: FloatArray
) -> FloatArray:
    """Return the covariance of a path after one more motion, [6, 6]: Ad Σ Adᵀ + cov + X + Xᵀ.

    It is that of the left perturbation of the motion along the path, in the frame at its end.

    Args:
        cov_path: Σ, the covariance before the motion, [6, 6].
        T_curr_prev: the motion, [4, 4].
        cov: its covariance, [6, 6].
        path_cross_cov: X, the cross-covariance of the path's error, along the axes after the
            motion, with that of the motion, [6, 6].
    """
    moved = _rotate_covariance(se3.adjoint(T_curr_prev), cov_path)
    return moved + cov + path_cross_cov + path_cross_cov.T


def normalized_error_squared(
    T_true: FloatArray, T_estimated: FloatArray, cov: FloatArray
) -> FloatArray:
    """Return the NEES of each pose, ξᵀ Σ⁻¹ ξ with ξ = Log(T_true T_estimated⁻¹), [...].

    The normalised estimation error squared has the distribution χ²(6), with mean 6, if the
    covariance is consistent. It is NaN where the truth is NaN.

    Args:
        T_true: true poses, [..., 4, 4].
        T_estimated: estimated poses, [..., 4, 4].
        cov: covariances of the left perturbations of T_estimated, [..., 6, 6].

    Raises:
        numpy.linalg.LinAlgError: a covariance is singular, as a first frame's is.
    """
    xi = se3.log(T_true @ se3.inverse(T_estimated))
    return squared_mahalanobis(xi, cov)


def squared_mahalanobis(errors: FloatArray, covariances: FloatArray) -> FloatArray:
    """Return the squared Mahalanobis distances eᵀ Σ⁻¹ e, [...], of errors e, [..., d].

    Args:
        errors: [..., d].
        covariances: Σ, [..., d, d].

    Raises:
        numpy.linalg.LinAlgError: a covariance is singular.
    """
    # Σ⁻¹ e, [..., d]
    weighted = np.linalg.solve(covariances, errors[..., None])[..., 0]
    distances: FloatArray = np.sum(errors * weighted, axis=-1)
    return distances


def _rotate_covariance(adjoint: FloatArray, cov: FloatArray) -> FloatArray:
    """Return the covariance of Ad ξ, [..., 6, 6]."""
    return adjoint @ cov @ adjoint.mT

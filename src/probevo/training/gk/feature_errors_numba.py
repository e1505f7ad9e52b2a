"""Compiled loop: the residuals of features in the terms that a noise model is fitted to."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from probevo.arrays import FloatArray
from probevo.compiled import compiled, copy_into, factor, invert_symmetric_4
from probevo.noise.student_t_numba import regularize


class ResidualArrays(NamedTuple):
    """Residuals of m features at a motion, and their predicted noise."""

    information: FloatArray
    """Inverse scale Σ⁻¹ of each residual, [m, 4, 4], px⁻²."""
    residuals: FloatArray
    """Residual e of each feature, bias removed, [m, 4], px."""
    jacobian: FloatArray
    """Derivative J of the prediction by the K unknowns that all features share, [m, 4, K]."""
    scale: FloatArray
    """Predicted scale R, [m, 4, 4], px²."""


class ErrorArrays(NamedTuple):
    """Space for the results."""

    errors: FloatArray
    """Error of each feature, bias removed, [m, 4], px."""
    error_cov: FloatArray
    """Covariance of each error that the uncertainty of these unknowns causes, [m, 4, 4], px²."""
    squared: FloatArray
    """Squared Mahalanobis distance eᵀ Σ⁻¹ e, [m]."""
    log_det: FloatArray
    """Log determinant ln |Σ|, [m]."""


@compiled
def rescale_errors(
    features: ResidualArrays,
    mean: FloatArray,
    cov: FloatArray,
    is_of_observation: bool,
    out: ErrorArrays,
) -> None:
    """Fill in the errors of all features, of which the effect of what they share is subtracted.

    Where Σ⁻¹ is singular, Σ is taken to be R. A singular scale is made regular.

    Args:
        features: the residuals.
        mean: of what all features share, [K].
        cov: of the same, [K, K].
        is_of_observation: whether the noise is that of observations, not of residuals.
        out: filled in.
    """
    information = features.information
    residuals = features.residuals
    jacobian = features.jacobian
    scale = features.scale
    errors = out.errors
    error_cov = out.error_cov
    sigma = np.empty((4, 4))
    lower = np.zeros((4, 4))
    root = np.zeros((4, 4))
    num_common = len(cov)
    white = np.empty((4, 1 + num_common))  # Σ^-½ e and Σ^-½ J, side by side
    back = np.empty((4, 1 + num_common))  # the same in the size of an error
    times_cov = np.empty((4, num_common))  # the part of J times the covariance
    for n in range(len(residuals)):
        # Cholesky factors of Σ and R.
        if not invert_symmetric_4(information[n], sigma, lower):
            copy_into(sigma, scale[n])
        regularize(sigma)
        factor(sigma, 4, lower)
        if not factor(scale[n], 4, root):
            regularize(scale[n])
            factor(scale[n], 4, root)
        # Whiten e and J by forward substitution: with Σ = L Lᵀ, the column k of ``white`` is L⁻¹
        # times that of (e, J), and ln |Σ| = 2 Σ ln Lᵢᵢ.
        squares = 0.0
        determinant = 1.0
        for i in range(4):
            white[i, 0] = residuals[n, i]
            for j in range(num_common):
                white[i, 1 + j] = jacobian[n, i, j]
            for k in range(1 + num_common):
                for j in range(i):
                    white[i, k] -= lower[i, j] * white[j, k]
                white[i, k] /= lower[i, i]
            squares += white[i, 0] * white[i, 0]
            determinant *= lower[i, i]
        out.squared[n] = squares
        out.log_det[n] = 2.0 * math.log(determinant)
        # Colour them by R^½ if the noise is that of observations, and propagate the covariance.
        for i in range(4):
            for k in range(1 + num_common):
                if is_of_observation:
                    back[i, k] = 0.0
                    for j in range(i + 1):
                        back[i, k] += root[i, j] * white[j, k]
                elif k == 0:
                    back[i, k] = residuals[n, i]
                else:
                    back[i, k] = jacobian[n, i, k - 1]
            errors[n, i] = back[i, 0]
            for k in range(num_common):
                errors[n, i] -= back[i, 1 + k] * mean[k]
            # Row i of the covariance, J cov Jᵀ, up to its diagonal: rows before have been coloured.
            for k in range(num_common):
                times_cov[i, k] = 0.0
                for j in range(num_common):
                    times_cov[i, k] += back[i, 1 + j] * cov[j, k]
            for j in range(i + 1):
                total = 0.0
                for k in range(num_common):
                    total += times_cov[i, k] * back[j, 1 + k]
                error_cov[n, i, j] = error_cov[n, j, i] = total

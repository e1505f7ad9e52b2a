"""What the motion of a step leaves of its features' residuals: errors in the terms that a noise
model is fitted to."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.compiled import compiled, copy_into, factor, invert_symmetric_4
from probevo.estimation.reprojection import ReprojectionSolution
from probevo.noise.base import StereoNoise, log_density
from probevo.noise.student_t_numba import regularize


@dataclass(frozen=True)
class FeatureErrors:
    """The errors of m features at the motions."""

    steps: IntArray
    """The step of each, [m]."""
    features: IntArray
    """Which of the drive's features these are, [m]."""
    phi: FloatArray
    """Their places in the prediction space, [m, M]."""
    errors: FloatArray
    """What the noise model is to describe: residuals, or errors of single observations, [m, 4], px.
    """
    spread: FloatArray
    """What the doubt about the motions makes of them: their covariance, [m, 4, 4], px²."""
    log_likelihood: FloatArray
    """Of the residuals under the noise that the motions were solved with, [m], nats."""
    profile: FloatArray
    """What they tell of how much lasts of the disparity's error, as from ``time_correlation_profile``, [m,
    4]."""

    @staticmethod
    def none(columns: int) -> FeatureErrors:
        """Of no features, of so many columns."""
        nothing = np.zeros((0, 4))
        steps = np.zeros(0, np.int64)
        return FeatureErrors(
            steps,
            steps,
            np.zeros((0, columns)),
            errors=nothing,
            spread=np.zeros((0, 4, 4)),
            log_likelihood=np.zeros(0),
            profile=nothing,
        )

    @staticmethod
    def joined(parts: Sequence[FeatureErrors]) -> FeatureErrors:
        """One after another as one."""
        return FeatureErrors(
            *(
                np.concatenate([getattr(part, field.name) for part in parts])
                for field in fields(FeatureErrors)
            )
        )


def errors_of(
    solution: ReprojectionSolution, noise: StereoNoise, cov: FloatArray, chosen: IntArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Errors of m features as the noise speaks of them, what the doubt about the motion makes of
    them, and likelihoods.

    Where the noise speaks of observations, with scale R, the residual e, of scale Σ, is brought
    back to the size of one: R^½ Σ^-½ e has the scale R. The bias, which the solution has taken off,
    is put back.

    Args:
        solution: the motion, known or solved for.
        noise: the noise of its N features.
        cov: covariance of the motion, [6, 6].
        chosen: which features are wanted, [m].

    Returns:
        errors [m, 4], px; their covariance by that of the motion, [m, 4, 4], px²; log density of
        the residuals, [m].
    """
    count = len(chosen)
    errors = np.empty((count, 4))
    spread = np.empty((count, 4, 4))
    squared = np.empty(count)
    log_det = np.empty(count)
    features = (
        solution.information[chosen],
        solution.residuals[chosen],
        solution.jacobian[chosen],
        noise.scale[chosen],
    )
    _bring_back(*features, cov, noise.refers_to == "observation", errors, spread, squared, log_det)
    return errors + noise.bias[chosen], spread, log_density(squared, log_det, noise.dof[chosen])


@compiled
def _bring_back(
    information: FloatArray,
    residuals: FloatArray,
    jacobian: FloatArray,
    scale: FloatArray,
    cov: FloatArray,
    is_of_observation: bool,
    errors: FloatArray,
    spread: FloatArray,
    squared: FloatArray,
    log_det: FloatArray,
) -> None:
    """Fill in errors and spread, and eᵀ Σ⁻¹ e and ln |Σ| of each feature; where Σ⁻¹ is singular, Σ
    is taken to be R.

    A scale that is singular is made regular.
    """
    sigma = np.empty((4, 4))
    lower = np.zeros((4, 4))
    root = np.zeros((4, 4))
    white = np.empty((4, 7))
    back = np.empty((4, 7))
    doubted = np.empty((4, 6))  # of e and J, side by side
    for n in range(len(residuals)):
        if not invert_symmetric_4(information[n], sigma, lower):
            copy_into(sigma, scale[n])
        regularize(sigma)
        factor(sigma, 4, lower)
        if not factor(scale[n], 4, root):
            regularize(scale[n])
            factor(scale[n], 4, root)
        squares = 0.0
        determinant = 1.0
        for i in range(4):
            white[i, 0] = residuals[n, i]
            for j in range(6):
                white[i, 1 + j] = jacobian[n, i, j]
            for k in range(7):
                for j in range(i):
                    white[i, k] -= lower[i, j] * white[j, k]
                white[i, k] /= lower[i, i]
            squares += white[i, 0] * white[i, 0]
            determinant *= lower[i, i]
        squared[n] = squares
        log_det[n] = 2.0 * math.log(determinant)
        for i in range(4):
            for k in range(7):
                back[i, k] = (
                    0.0
                    if is_of_observation
                    else residuals[n, i]
                    if k == 0
                    else jacobian[n, i, k - 1]
                )
                for j in range(i + 1 if is_of_observation else 0):
                    back[i, k] += root[i, j] * white[j, k]
            errors[n, i] = back[i, 0]
            for k in range(6):
                doubted[i, k] = 0.0
                for j in range(6):
                    doubted[i, k] += back[i, 1 + j] * cov[j, k]
            for j in range(i + 1):
                total = 0.0
                for k in range(6):
                    total += doubted[i, k] * back[j, 1 + k]
                spread[n, i, j] = spread[n, j, i] = total

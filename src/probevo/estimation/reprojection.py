"""Motion between two frames by its reprojection errors, with covariance (PROBE-GK eq. 14)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np

from probevo.arrays import FloatArray
from probevo.compiled import invert_positive_definite
from probevo.estimation import gauss_newton
from probevo.measurements.base import Measurement
from probevo.measurements.point_priors import PointPrior
from probevo.measurements.stereo_observations import StereoObservations


@dataclass(frozen=True)
class ReprojectionSolution:
    """A motion, and the N features linearised at it."""

    T_curr_prev: FloatArray
    """[4, 4]."""
    cov: FloatArray
    """Covariance of the left perturbation ξ = [ρ; φ] of it, [6, 6]; NaN where the features do not
    fix all of ξ."""
    squared: FloatArray
    """eᵀ Σ⁻¹ e of each feature, [N]; Σ is the scale of its residual."""
    weight: FloatArray
    """Robust weight of each feature against that of a perfect one, [N], in [0, 1]."""
    irls_weight: FloatArray
    """Robust weight w itself, [N]; 0 for a feature that does not contribute."""
    points: PointPrior
    """The N points, before the solve."""
    refined: FloatArray
    """Most likely (u, v, disparity) of each feature in the previous frame given both observations,
    [N, 3], px."""
    residuals: FloatArray
    """y' − f(T g(y)), bias removed, to first order around the refined points, [N, 4], px."""
    jacobian: FloatArray
    """∂f(T g(y))/∂ξ, [N, 4, 6], px/m and px/rad."""
    disparity_jacobian: FloatArray
    """∂f(T g(y))/∂d, d the disparity in the previous frame, [N, 4]."""
    hessian: FloatArray
    """Σ w Jᵀ Σ⁻¹ J plus the information of other measurements, w the IRLS weight, [6, 6]. Its
    inverse is not the covariance."""
    information: FloatArray
    """Σ⁻¹ of each feature, [N, 4, 4], px⁻²."""
    cross_cov: FloatArray
    """Cross-covariance (scale) of the residual with the disparity d and the time-correlated error
    δ, [N, 4, 2], px²."""
    iterations: int
    converged: bool

    def whitened(self, columns: FloatArray) -> FloatArray:
        """Return w Σ⁻¹ times columns of each feature, [N, 4, K], with w the IRLS weight."""
        product: FloatArray = np.matmul(self.information, columns) * self.irls_weight[:, None, None]
        return product


def solve_reprojection(
    observations: StereoObservations,
    *,
    guess: FloatArray,
    others: Sequence[Measurement] = (),
    max_iterations: int = 20,
) -> ReprojectionSolution:
    """Find the most likely motion T_curr_prev given N features in two frames.

    It minimises Σ ρ(eᵀ Σ⁻¹ e) over T, where e = y' − f(T g(y)) is the residual. If the noise refers
    to single observations, R, then Σ = R + A S Aᵀ with S the noise of the triangulated point and
    A = ∂(f ∘ T)/∂(u, v, d), and the time-correlated error of the disparity enters, too
    (``stereo_numba.propagate_noise``); if it refers to the residual, Σ is the scale itself.

    Args:
        observations: the N features, with the previous camera as the world.
        guess: where to start, T_curr_prev, [4, 4]; within the basin of convergence, e.g. from
            RANSAC.
        others: further measurements of the same pose, such as a gyro's rotation.
        max_iterations: of Levenberg–Marquardt; 0 evaluates the features at the guess.
    """
    curr = observations.poses.curr
    # The world is the previous camera, so that the pose of any other frame than the current one,
    # which can only be the previous, is the identity and is held.
    held = {variable for other in others for variable in other.variables} - {curr}
    values = {variable: np.eye(4) for variable in held}
    values[curr] = np.array(guess, dtype=np.float64, order="C")
    optimum = gauss_newton.minimize(
        [observations, *others], values, [curr], max_iterations=max_iterations
    )
    T_curr_prev = optimum.values[curr]
    propagated = cast(StereoObservations, optimum.measurements[0])
    features = propagated.at(T_curr_prev)
    of_others = gauss_newton.information(others, optimum.values, [curr])
    return ReprojectionSolution(
        T_curr_prev=T_curr_prev,
        cov=inverse_or_nan(features.information + of_others),
        squared=features.squared,
        weight=features.weights.relative,
        irls_weight=features.weights.weight,
        points=propagated.points,
        refined=propagated.propagated_noise.refined,
        residuals=features.jacobians.residual,
        jacobian=features.jacobians.motion,
        disparity_jacobian=features.jacobians.disparity,
        hessian=features.hessian + of_others,
        information=propagated.propagated_noise.information,
        cross_cov=propagated.propagated_noise.cross_cov,
        iterations=optimum.iterations,
        converged=optimum.converged,
    )


def sum_products(left: FloatArray, right: FloatArray) -> FloatArray:
    """Return Σ_n left_nᵀ right_n of [N, 4, K] and [N, 4, L]: [K, L]."""
    total: FloatArray = left.reshape(-1, left.shape[2]).T @ right.reshape(-1, right.shape[2])
    return total


def inverse_or_nan(information: FloatArray) -> FloatArray:
    """Return the inverse, [n, n], or NaN where the information is not positive definite to working
    precision."""
    diagonal = np.diagonal(information)
    if not (np.isfinite(information).all() and (diagonal > 0.0).all()):
        return np.full(information.shape, np.nan)
    sigma = 1.0 / np.sqrt(diagonal)
    units = sigma[:, None] * sigma
    lower = np.zeros(information.shape)
    inverse = np.empty(information.shape)
    if not invert_positive_definite(information * units, lower, inverse):
        return np.full(information.shape, np.nan)
    covariance: FloatArray = inverse * units
    return covariance

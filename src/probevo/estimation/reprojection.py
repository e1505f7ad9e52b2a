"""Motion between two frames by its reprojection errors, with covariance (PROBE-GK eq. 14)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np

from probevo.arrays import FloatArray
from probevo.estimation import levenberg_marquardt
from probevo.estimation.scaled_inverse import inverse_or_nan
from probevo.geometry import se3
from probevo.geometry.uncertainty import squared_mahalanobis
from probevo.measurements.base import Measurement
from probevo.measurements.jitter_numba import JITTER_DIM, JITTER_PAIR_DIM
from probevo.measurements.point_priors import PointPrior
from probevo.measurements.stereo_observations import JitterUnknown, StereoObservations

MIN_MOTION = 100.0
"""Squared length of a motion, in units of its covariance, above which it tells of the errors of the
images; noise alone has 6. At rest, the estimated motion is noise, and so would be the errors
that are learned from it for as long as the rig stands."""
ROWS_OF_BLOCK = 64
"""Rows of a product that BLAS computes at once, on one thread."""


@dataclass(frozen=True)
class SolvedJitter:
    """The rig's jitter in both frames beside a motion."""

    eta: FloatArray
    """(η', η°), [6], in standard deviations of their priors."""
    unknown: JitterUnknown
    columns: FloatArray
    """D = −∂e/∂η, [N, 4, 6], px."""
    hessian: FloatArray
    """Hessian over (ξ, η), with the prior of η, [12, 12] (``ReprojectionSolution.hessian``)."""
    cov: FloatArray
    """Covariance of (ξ, η), [12, 12]; NaN where the features do not fix all of ξ."""

    @property
    def curr_rad(self) -> FloatArray:
        """The jitter of the current frame, [3], rad."""
        mean: FloatArray = self.unknown.curr_root @ self.eta[:JITTER_DIM]
        return mean

    @property
    def prev_rad(self) -> FloatArray:
        """The jitter of the previous frame, [3], rad."""
        prev = self.unknown.prev
        mean: FloatArray = prev.mean + prev.root @ self.eta[JITTER_DIM:]
        return mean


@dataclass(frozen=True)
class SolvedFeatures:
    """N features linearised at a motion."""

    residuals: FloatArray
    """y' − f(T g(y)), bias removed, to first order around the refined points, [N, 4], px."""
    jacobian: FloatArray
    """∂f(T g(y))/∂ξ, [N, 4, 6], px/m and px/rad."""
    disparity_jacobian: FloatArray
    """∂f(T g(y))/∂d, d the disparity in the previous frame, [N, 4]."""
    information: FloatArray
    """Σ⁻¹ of each residual, [N, 4, 4], px⁻²; Σ is the scale of its noise."""
    mahalanobis_sq: FloatArray
    """eᵀ Σ⁻¹ e, [N]."""
    weight: FloatArray
    """Robust weight against that of a perfect feature, [N], in [0, 1]."""
    irls_weight: FloatArray
    """Robust weight w itself, [N]; 0 for a feature that does not contribute."""
    curvature: FloatArray
    """Curvature of the loss, w + (2/d) w' s, [N]; 0 for a feature that does not contribute."""
    points: PointPrior
    """The N points before the solve, corrected for the jitter of the previous frame."""
    refined: FloatArray
    """Most likely (u, v, disparity) in the previous frame given both observations, [N, 3], px."""
    cross_cov: FloatArray
    """Cross-covariance (scale) of the residual with the disparity d and the time-correlated error
    δ, [N, 4, 2], px²."""


@dataclass(frozen=True)
class ReprojectionSolution:
    """A motion with its covariance, and the features linearised at it."""

    T_curr_prev: FloatArray
    """[4, 4]."""
    cov: FloatArray
    """Covariance of the left perturbation ξ = [ρ; φ] of it, [6, 6]; NaN where the features do not
    fix all of ξ."""
    hessian: FloatArray
    """Σ w Jᵀ Σ⁻¹ J plus the information of other measurements, w the IRLS weight, [6, 6]. Its
    inverse is not the covariance."""
    full_information: FloatArray
    """Fisher information on ξ, [6, 6], or on (ξ, η) with the jitter, [12, 12], without the bias
    that noise of the disparities adds to it. ``cov`` is the block of ξ of its inverse."""
    features: SolvedFeatures
    """The N features."""
    iterations: int
    converged: bool
    jitter: SolvedJitter | None = None
    """The rig's jitter; ``cov`` is marginalised over it, ``hessian`` holds it. None if the noise
    has none."""

    @property
    def is_determined(self) -> bool:
        """Whether the features fix all of the motion; a loss that descends to zero may have
        rejected all of them."""
        return bool(np.isfinite(self.cov).all() and self.features.irls_weight.any())

    @property
    def exceeds_noise(self) -> bool:
        """Whether the motion is much more than its noise (``MIN_MOTION``), in the directions that
        the features fix."""
        xi = se3.log(self.T_curr_prev)
        if not np.isfinite(self.cov).all():
            return bool(xi @ self.hessian @ xi > MIN_MOTION)
        return bool(squared_mahalanobis(xi, self.cov) > MIN_MOTION)

    @property
    def motion_information(self) -> FloatArray:
        """Fisher information on the motion, marginalised over the jitter, [6, 6]."""
        information = self.full_information
        if self.jitter is None:
            return information
        coupling = information[6:, :6]
        jitter_information = coupling.T @ np.linalg.solve(information[6:, 6:], coupling)
        return np.asarray(information[:6, :6] - jitter_information, np.float64)

    @property
    def full_jacobian(self) -> FloatArray:
        """The Jacobian by the motion and the jitter, [N, 4, 6] or [N, 4, 12]."""
        if self.jitter is None:
            return self.features.jacobian
        return np.concatenate([self.features.jacobian, self.jitter.columns], axis=2)

    @property
    def full_hessian(self) -> FloatArray:
        """The Hessian over motion and jitter, [6, 6] or [12, 12]."""
        return self.hessian if self.jitter is None else self.jitter.hessian

    @property
    def full_cov(self) -> FloatArray:
        """The covariance of motion and jitter, [6, 6] or [12, 12]."""
        return self.cov if self.jitter is None else self.jitter.cov


def solve_reprojection(
    observations: StereoObservations,
    *,
    guess: FloatArray,
    others: Sequence[Measurement] = (),
    max_iterations: int = 20,
    eta: FloatArray | None = None,
    holds_motion: bool = False,
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
        eta: where to start with the rig's jitter, [6], in its standard deviations; 0 by default.
        holds_motion: solve for the jitter alone.
    """
    curr = observations.poses.curr
    # The world is the previous camera, so that the pose of any other frame than the current one,
    # which can only be the previous, is the identity and is held.
    held = {variable for other in others for variable in other.variables} - {curr}
    values = {variable: np.eye(4) for variable in held}
    values[curr] = np.array(guess, dtype=np.float64, order="C")
    free = [] if holds_motion else [curr]
    # The rig's jitter is a further unknown, with its prior in the observations.
    unknown = observations.jitter
    if unknown is not None:
        values[unknown.variable] = np.zeros(JITTER_PAIR_DIM) if eta is None else eta
        free.append(unknown.variable)
    optimum = levenberg_marquardt.minimize(
        [observations, *others], values, free, max_iterations=max_iterations if free else 0
    )
    # Evaluate the features at the optimum, with the covariances that the solve ended with.
    T_curr_prev = optimum.values[curr]
    propagated = cast(StereoObservations, optimum.measurements[0])
    evaluated = propagated.at(optimum.values)
    # Over (ξ, η): the motion has the first six rows and columns, a jitter those behind.
    hessian = evaluated.hessian
    information = evaluated.information
    # The features' information is that of an M-estimate; other measurements add their own.
    if others:
        other_information = levenberg_marquardt.information(others, optimum.values, [curr])
        hessian[:6, :6] += other_information
        information[:6, :6] += other_information
    # The inverse of the Fisher information over (ξ, η): its block of ξ is marginalised over η.
    cov = inverse_or_nan(information)
    jitter = None
    if unknown is not None and propagated.linearized_jitter is not None:
        jitter = SolvedJitter(
            eta=optimum.values[unknown.variable],
            unknown=unknown,
            columns=propagated.linearized_jitter.columns,
            hessian=hessian,
            cov=cov,
        )
    noise = propagated.propagated_noise
    return ReprojectionSolution(
        T_curr_prev=T_curr_prev,
        cov=np.ascontiguousarray(cov[:6, :6]),
        hessian=np.ascontiguousarray(hessian[:6, :6]),
        full_information=information,
        features=SolvedFeatures(
            residuals=evaluated.jacobians.residual,
            jacobian=evaluated.jacobians.motion,
            disparity_jacobian=evaluated.jacobians.disparity,
            information=noise.information,
            mahalanobis_sq=evaluated.mahalanobis_sq,
            weight=evaluated.weights.relative,
            irls_weight=evaluated.weights.weight,
            curvature=evaluated.weights.curvature,
            points=evaluated.points,
            refined=noise.refined,
            cross_cov=noise.cross_cov,
        ),
        iterations=optimum.iterations,
        converged=optimum.converged,
        jitter=jitter,
    )


def evaluated_at(
    solution: ReprojectionSolution, observations: StereoObservations
) -> ReprojectionSolution:
    """Evaluate N features at the motion of a solve, and at its jitter of the rig, without solving.

    Args:
        solution: the solve; its features may be others, or have had filtered disparities.
        observations: the features, of two frames alone.
    """
    eta = None
    if solution.jitter is not None and observations.jitter is not None:
        # Without the filter, the jitter of either frame has the prior N(0, S), of root L'.
        root = observations.jitter.curr_root
        both = np.column_stack([solution.jitter.curr_rad, solution.jitter.prev_rad])
        eta = np.linalg.solve(root, both).astype(float).T.ravel()
    return solve_reprojection(observations, guess=solution.T_curr_prev, eta=eta, max_iterations=0)


def sum_products(left: FloatArray, right: FloatArray) -> FloatArray:
    """Return Σ_n left_nᵀ right_n of [N, 4, K] and [N, 4, L]: [K, L].

    The sum is taken block by block. BLAS would divide one large product among its threads, which
    wait for the next one in a busy loop: a frame would be no faster, and keep a second core busy.
    """
    left_rows = left.reshape(-1, left.shape[2])
    right_rows = right.reshape(-1, right.shape[2])
    total = np.zeros((left.shape[2], right.shape[2]))
    for first in range(0, len(left_rows), ROWS_OF_BLOCK):
        block = slice(first, first + ROWS_OF_BLOCK)
        total += left_rows[block].T @ right_rows[block]
    return total

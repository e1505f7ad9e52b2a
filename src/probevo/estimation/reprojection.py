"""The reprojection solve on SE(3) (PROBE-GK eq. 14), with the noise of the triangulated points
folded in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.compiled import invert_positive_definite
from probevo.estimation.gauss_newton import minimize
from probevo.measurements.normal_equations_numba import weigh
from probevo.measurements.point_priors import KnownDisparities, SeenPoints
from probevo.measurements.robust_loss import RobustLoss
from probevo.measurements.stereo_numba import residual_jacobians, sum_information
from probevo.noise.base import StereoNoise

CONVERGED_BELOW = 1e-3
"""The solve has converged once a step is shorter than this many standard deviations of the motion.
"""
LEAST_PRIOR_RAD = 1e-6
"""No rotation is known better, even from a gyro said to be without noise."""
EXPECTED_FEATURES = 20.0
"""How many features the noise model's own word counts for in the scale of the covariance, against
those seen."""


@dataclass(frozen=True)
class RotationPrior:
    """What a gyro knows of the rotation: C_curr_prev, [3, 3], and the cov of its left perturbation,
    [3, 3], rad²."""

    C_curr_prev: FloatArray
    cov: FloatArray


@dataclass(frozen=True)
class ReprojectionSolution:
    """A motion, and everything about the features at it that others need."""

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
    points: SeenPoints
    """The N points, before the solve."""
    refined: FloatArray
    """Most likely (u, v, disparity) of each feature in the previous frame given both observations,
    [N, 3], px."""
    residuals: FloatArray
    """y' − f(T g(y)), bias removed, to first order around the refined points, [N, 4], px."""
    jacobian: FloatArray
    """How ξ moves the prediction f(T g(y)), [N, 4, 6], px/m and px/rad."""
    disparity_jacobian: FloatArray
    """How the disparity in the previous frame moves it, [N, 4]."""
    hessian: FloatArray
    """Σ w Jᵀ Σ⁻¹ J plus the prior's information, w the IRLS weight, [6, 6]. Its inverse is not the
    covariance."""
    information: FloatArray
    """Σ⁻¹ of each feature, [N, 4, 4], px⁻²."""
    shared: FloatArray
    """Covariance (scale) of its residual with its disparity d and the error δ of that, [N, 4, 2],
    px²."""
    iterations: int
    converged: bool

    def whitened(self, columns: FloatArray) -> FloatArray:
        """w Σ⁻¹ times columns of each feature, [N, 4, K] to [N, 4, K], with w the IRLS weight of
        the solution."""
        product: FloatArray = np.matmul(self.information, columns) * self.irls_weight[:, None, None]
        return product


def solve_reprojection(
    prev_px: FloatArray,
    curr_px: FloatArray,
    noise: StereoNoise,
    guess: FloatArray,
    camera: StereoCamera,
    *,
    loss: RobustLoss | None = None,
    prior: RotationPrior | None = None,
    max_iterations: int = 20,
    known: KnownDisparities | None = None,
) -> ReprojectionSolution:
    """Most likely motion T_curr_prev given N features in two frames.

    Minimises Σ ρ(eᵀ Σ⁻¹ e) over T, where e = y' − f(T g(y)) is the residual. If the noise refers to
    single observations, R, then Σ = R + A S Aᵀ with S the noise of the triangulated point and A =
    ∂(f ∘ T)/∂(u, v, d), and what lasts of the disparity's error from frame to frame comes in too
    (``linearize_noise``); if it refers to the residual, Σ is the scale itself.

    Args:
        prev_px, curr_px: observations y and y', [N, 4], px. The disparity may be zero or slightly
            negative: a point at infinity still speaks of rotation.
        noise: noise of the N features.
        guess: where to start, T_curr_prev, [4, 4]; within the basin of convergence, e.g. from
            RANSAC.
        camera: the rectified camera.
        loss: robust loss; by default that of the noise's own Student-t.
        prior: rotation known from elsewhere.
        max_iterations: of Levenberg–Marquardt; 0 keeps the guess and says everything else about the
            features at it.
        known: what earlier frames say of some of the disparities.
    """
    loss = RobustLoss.student_t() if loss is None else loss
    count = len(prev_px)
    fb = camera.fu_px * camera.baseline_m
    intrinsics = np.array([camera.fu_px, camera.fv_px, camera.cu_px, camera.cv_px, fb])
    propagate = noise.refers_to == "observation"
    bias = np.broadcast_to(noise.bias, (count, 4))
    # Copies: a view of broadcast_to is read-only, for which Numba would compile the whole solve
    # once more.
    scale = np.array(np.broadcast_to(noise.scale, (count, 4, 4)), order="C")
    dof = np.array(np.broadcast_to(noise.dof, (count,)))
    parameter = loss.parameters(dof)

    points = SeenPoints.of(prev_px, scale, propagate, time_correlated=noise.time_correlated)
    if known is not None:
        points = points.knowing(known)
    seen = points.seen
    point_cov = points.cov
    curr = np.ascontiguousarray(curr_px - bias)
    curr[:, 2] += points.error

    C = np.array(guess[:3, :3])
    t = np.array(guess[:3, 3])
    refined = seen.copy()
    offset = np.zeros((count, 4))
    information = np.zeros((count, 4, 4))
    squared = np.zeros(count)
    shared = np.zeros((count, 4, 2))
    C_prior = np.eye(3) if prior is None else np.ascontiguousarray(prior.C_curr_prev)
    prior_information = np.zeros((3, 3))
    if prior is not None:
        prior_information[:] = np.linalg.inv(prior.cov + LEAST_PRIOR_RAD**2 * np.eye(3))
    iterations, converged, _ = minimize(
        C,
        t,
        intrinsics,
        seen=seen,
        point_cov=point_cov,
        curr=curr,
        scale=scale,
        kind=int(loss.kind),
        parameter=parameter,
        C_prior=C_prior,
        prior_information=prior_information,
        max_iterations=max_iterations,
        tolerance=CONVERGED_BELOW,
        refined=refined,
        offset=offset,
        information=information,
        shared=shared,
        squared=squared,
    )
    residuals = np.empty((count, 4))
    disparity_jacobian = np.empty((count, 4))
    jacobian = np.empty((count, 4, 6))
    white = np.empty((count, 4, 6))
    residual_jacobians(
        C,
        t,
        intrinsics,
        refined=refined,
        offset=offset,
        curr=curr,
        information=information,
        residual=residuals,
        motion=jacobian,
        white=white,
        disparity=disparity_jacobian,
    )
    weight = np.empty(count)
    curvature = np.empty(count)
    relative = np.empty(count)
    scatter, curved = weigh(
        int(loss.kind), parameter, squared, weight=weight, curvature=curvature, relative=relative
    )
    disparity_noise = point_cov[:, 2, 2]
    hessian, information_sum = _information(
        jacobian,
        white,
        weight,
        curvature=curvature,
        refined=refined,
        seen=seen,
        disparity_noise=disparity_noise,
    )
    variance_factor = _variance_factor(scatter, curved, loss, dof=dof)
    motion = np.eye(4)
    motion[:3, :3] = C
    motion[:3, 3] = t
    prior_block = np.zeros((6, 6))
    prior_block[3:, 3:] = prior_information
    return ReprojectionSolution(
        T_curr_prev=motion,
        cov=_inverse_or_nan(information_sum / variance_factor + prior_block),
        squared=squared,
        weight=relative,
        irls_weight=weight,
        points=points,
        refined=refined,
        residuals=residuals,
        jacobian=jacobian,
        disparity_jacobian=disparity_jacobian,
        hessian=hessian + prior_block,
        information=information,
        shared=shared,
        iterations=iterations,
        converged=converged,
    )


def _information(
    jacobian: FloatArray,
    white: FloatArray,
    weight: FloatArray,
    curvature: FloatArray,
    refined: FloatArray,
    seen: FloatArray,
    disparity_noise: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Σ w Jᵀ Σ⁻¹ J, and Σ a Jᵀ Σ⁻¹ J without what the noise of the disparities alone would lend to
    the translation.

    The translation's columns go with the disparity d. Refined, d leans towards the solution, so it
    is set back to the one seen; squared, its noise σ² has a mean of its own: E[d²] − σ² is what the
    truth contributes. Only where all disparities are mostly noise does that matter, and there it
    tells a blind translation from a known one.
    """
    disparity = np.where(np.abs(refined[:, 2]) > 1e-9, refined[:, 2], np.inf)
    share = seen[:, 2] / disparity
    lent = disparity_noise / disparity**2
    hessian = np.empty((6, 6))
    information = np.empty((6, 6))
    sum_information(
        jacobian,
        white,
        weight,
        curvature=curvature,
        share=share,
        lent=lent,
        hessian=hessian,
        information=information,
    )
    return hessian, information


def _variance_factor(scatter: float, curved: float, loss: RobustLoss, dof: FloatArray) -> float:
    """How much larger the covariance of the motion is than the inverse of A = Σ a Jᵀ Σ⁻¹ J.

    The covariance of an M-estimate is A⁻¹ B A⁻¹, with a = w + (2/d) w' s, the curvature of the loss
    (over a Student-t its mean is (ν+d)/(ν+d+2); for an outlier it vanishes), and B = Σ b Jᵀ Σ⁻¹ J,
    b = w² s/d, the scatter of its gradient. B is taken as A times the ratio of the sums of b and a:
    one if the noise is as the model says, larger if the residuals are. The sums start with the
    model's own a and b (``RobustLoss.moments``), as if a few features had shown them.
    """
    count = len(dof)
    dim = 4
    expected_curvature, expected_scatter = (
        float(np.mean(moment)) if count else 1.0 for moment in loss.moments(dof)
    )
    spent = count * dim / max(count * dim - 6.0, 1.0)
    shown = EXPECTED_FEATURES * expected_scatter + spent * scatter
    return shown / (EXPECTED_FEATURES * expected_curvature + curved)


def sum_products(left: FloatArray, right: FloatArray) -> FloatArray:
    """Σ_n left_nᵀ right_n of [N, 4, K] and [N, 4, L]: [K, L]."""
    total: FloatArray = left.reshape(-1, left.shape[2]).T @ right.reshape(-1, right.shape[2])
    return total


def _inverse_or_nan(information: FloatArray) -> FloatArray:
    """Its inverse, or NaN where the information is not positive definite to working precision, [6,
    6]."""
    diagonal = np.diagonal(information)
    if not (np.isfinite(information).all() and (diagonal > 0.0).all()):
        return np.full((6, 6), np.nan)
    scale = np.sqrt(diagonal)
    lower = np.zeros((6, 6))
    inverse = np.empty((6, 6))
    if not invert_positive_definite(information / np.outer(scale, scale), lower, inverse):
        return np.full((6, 6), np.nan)
    covariance: FloatArray = inverse / np.outer(scale, scale)
    return covariance

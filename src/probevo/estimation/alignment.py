"""Matrix-weighted alignment of triangulated points (PROBE eqs. 7-15), the paper's own motion
solution.

It takes the noise of a triangulated point as Gaussian in space, which holds only near the camera.
The error of a far point is skewed in depth, and its weight is correlated with it. The reprojection
solve has neither flaw.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.geometry import se3, so3

_FIRST_DAMPING = 1e-4
_MIN_DAMPING = 1e-9
"""Levenberg–Marquardt's damping, relative to the diagonal of the information: the first one, and
the least that it falls to."""
_CONVERGED_BELOW = 1e-9
"""Length of a step ξ, m and rad together, at which it has converged."""
_MIN_INFORMATION = 1e-12
"""Smallest information along unobservable directions, relative to the observable ones: it keeps
their covariance finite, but huge."""


class Alignment(NamedTuple):
    """The motion that best aligns two sets of points."""

    T_curr_prev: FloatArray
    """p_curr = T_curr_prev p_prev, [4, 4], m."""
    cov: FloatArray
    """Covariance of the left perturbation ξ = [ρ; φ] of T_curr_prev, [6, 6], m and rad."""
    iterations: int
    converged: bool


def solve_alignment(
    prev_px: FloatArray,
    curr_px: FloatArray,
    cov_prev_px: FloatArray,
    *,
    cov_curr_px: FloatArray,
    camera: StereoCamera,
    guess: FloatArray,
    max_iterations: int = 30,
) -> Alignment:
    """Minimise ½ Σ eᵀ Γ e with e = p_curr − T_curr_prev p_prev and p = g(y) (PROBE eq. 7),
    Levenberg–Marquardt damped.

    Γ = (G' R' G'ᵀ + C G R Gᵀ Cᵀ)⁻¹ (eq. 8) is taken anew at the rotation of each iteration, but as
    a constant in it. The covariance is the inverse of the Gauss–Newton information Σ Eᵀ Γ E,
    undamped, at the solution. Points that are too few or on one line leave it finite, but 10⁶ times
    as wide along what they do not fix as along what they do.

    PROBE perturbs r_a^ba = −Cᵀ t by ε and C by Exp(−φ_probe) (eqs. 10-11); our left perturbation of
    T_curr_prev is ρ = −C ε, φ = −φ_probe, so that eq. (12) becomes e − [1, −q^] ξ with q =
    T_curr_prev p_prev.

    Args:
        prev_px, curr_px: (u_l, v_l, u_r, v_r) of the same points in either frame, [N, 4], px; those
            without a positive disparity in both are left out.
        cov_prev_px, cov_curr_px: R and R', covariances of these, [N, 4, 4] or one [4, 4] for all,
            px².
        camera: the stereo camera.
        guess: T_curr_prev to start from, [4, 4].
        max_iterations: rejected steps count.
    """
    pairs = _PointPairs.triangulated(
        prev_px, curr_px, cov_prev_px, cov_curr_px=cov_curr_px, camera=camera
    )
    T = guess
    damping = _FIRST_DAMPING
    iterations = 0
    converged = False
    Gamma = pairs.weights(T)
    while not converged and iterations < max_iterations:
        information, gradient = pairs.normal_equations(T, Gamma)
        # Marquardt's damping is relative to the diagonal, and so indifferent to m and rad.
        step = _inverse(information + damping * np.diag(np.diag(information))) @ gradient
        T_next = se3.exp(step) @ T
        # Compare both costs under the same Γ, which depends on T.
        if pairs.cost(T_next, Gamma) <= pairs.cost(T, Gamma):
            T = T_next
            damping = max(0.1 * damping, _MIN_DAMPING)
            Gamma = pairs.weights(T)
        else:
            damping *= 10.0
        iterations += 1
        converged = bool(np.linalg.norm(step) < _CONVERGED_BELOW)
    information, _ = pairs.normal_equations(T, Gamma)
    return Alignment(T, _inverse(information), iterations, converged=converged)


@dataclass(frozen=True)
class _PointPairs:
    """N points in two frames, [N, 3], m, with the covariance of each, [N, 3, 3], m²."""

    prev: FloatArray
    curr: FloatArray
    cov_prev: FloatArray
    cov_curr: FloatArray

    @staticmethod
    def triangulated(
        prev_px: FloatArray,
        curr_px: FloatArray,
        cov_prev_px: FloatArray,
        cov_curr_px: FloatArray,
        camera: StereoCamera,
    ) -> _PointPairs:
        """Return the points p = g(y) with covariance G R Gᵀ (PROBE eqs. 8-9)."""
        # A point at infinity or beyond has no coordinates in metres.
        is_near = (prev_px[:, 0] > prev_px[:, 2]) & (curr_px[:, 0] > curr_px[:, 2])
        shape = (len(prev_px), 4, 4)
        G_prev = camera.triangulate_jacobian(prev_px[is_near])
        G_curr = camera.triangulate_jacobian(curr_px[is_near])
        return _PointPairs(
            prev=camera.triangulate(prev_px[is_near]),
            curr=camera.triangulate(curr_px[is_near]),
            cov_prev=G_prev @ np.broadcast_to(cov_prev_px, shape)[is_near] @ G_prev.mT,
            cov_curr=G_curr @ np.broadcast_to(cov_curr_px, shape)[is_near] @ G_curr.mT,
        )

    def weights(self, T: FloatArray) -> FloatArray:
        """Return Γ of each pair at the rotation of T, [N, 3, 3], m⁻² (PROBE eq. 8)."""
        C = T[:3, :3]
        return np.asarray(np.linalg.inv(self.cov_curr + C @ self.cov_prev @ C.T), dtype=np.float64)

    def cost(self, T: FloatArray, Gamma: FloatArray) -> float:
        """Return ½ Σ eᵀ Γ e (PROBE eq. 7)."""
        e = self.curr - se3.transform(T, self.prev)
        return 0.5 * float(np.einsum("ni,nij,nj", e, Gamma, e))

    def normal_equations(self, T: FloatArray, Gamma: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return Σ Eᵀ Γ E, [6, 6], and Σ Eᵀ Γ e, [6], with E = [1, −q^] (PROBE eq. 13)."""
        # Exp(ξ) moves q = T p by ρ + φ × q = [1, −q^] ξ, and e by minus that.
        q = se3.transform(T, self.prev)
        E = np.concatenate([np.broadcast_to(np.eye(3), (len(q), 3, 3)), -so3.wedge(q)], axis=2)
        weighted = Gamma @ E
        return np.einsum("nki,nkj->ij", E, weighted), np.einsum(
            "nki,nk->i", weighted, self.curr - q
        )


def _inverse(information: FloatArray) -> FloatArray:
    """Return the inverse of a positive semi-definite [6, 6] matrix, its eigenvalues bounded below
    once its diagonal is one."""
    # With a diagonal of one, eigenvalues of m and of rad can be compared.
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), _MIN_INFORMATION))
    values, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    half = scale[:, None] * vectors / np.sqrt(np.maximum(values, _MIN_INFORMATION))
    inverse: FloatArray = half @ half.T
    return inverse

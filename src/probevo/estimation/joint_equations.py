"""Normal equations of a motion and of what else moves the residuals of its features."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from probevo.arrays import FloatArray
from probevo.estimation.reprojection import ReprojectionSolution, sum_products
from probevo.estimation.rig_update_numba import weigh_columns


class JointEquations(NamedTuple):
    """Normal equations of m unknowns that are eliminated, the motion ξ first, and of R others:
    [[H, −C], [−Cᵀ, B]], with the gradients of the log-likelihood by both.

    C has a minus since J is the derivative of the prediction, and D that of the residual.
    """

    hessian: FloatArray
    """H, [m, m]."""
    cross: FloatArray
    """C = Σ w Jᵀ Σ⁻¹ D, [m, R]."""
    other_hessian: FloatArray
    """B = Σ w Dᵀ Σ⁻¹ D, [R, R]."""
    gradient: FloatArray
    """Gradient by the unknowns that are eliminated, with their priors, [m]."""
    others_gradient: FloatArray
    """Gradient by the others, without their prior, [R]."""

    @staticmethod
    def of(D: FloatArray, solution: ReprojectionSolution) -> JointEquations:
        """Sum the equations over N tracks, with the robust weights of their solution. Motion and
        jitter, (ξ, η), are what is eliminated: m = 6, or 12 with a jitter.

        Args:
            D: ∂e/∂(others), [N, 4, R].
            solution: of the N tracks.
        """
        # w Σ⁻¹ (D, e): both at once.
        features = solution.features
        D_and_residual = np.concatenate([D, features.residuals[:, :, None]], axis=2)
        weighted = np.empty_like(D_and_residual)
        weigh_columns(features.information, features.irls_weight, D_and_residual, weighted)
        motion_products = sum_products(solution.full_jacobian, weighted)
        other_products = sum_products(D, weighted)
        gradient = motion_products[:, -1]
        if solution.jitter is not None:
            gradient[6:] -= solution.jitter.eta  # of the prior η ~ N(0, I)
        return JointEquations(
            hessian=solution.full_hessian,
            cross=motion_products[:, :-1],
            other_hessian=other_products[:, :-1],
            gradient=gradient,
            others_gradient=-other_products[:, -1],
        )

    def eliminating(
        self, num: int, information: FloatArray, gradient: FloatArray
    ) -> JointEquations:
        """Return the equations with the first of the others among those that are eliminated.

        Args:
            num: how many, r.
            information: of their prior, [r, r].
            gradient: of the logarithm of their prior, [r].
        """
        cross = self.cross[:, :num]
        hessian_of_these = self.other_hessian[:num, :num] + information
        return JointEquations(
            hessian=np.block([[self.hessian, -cross], [-cross.T, hessian_of_these]]),
            cross=np.concatenate([self.cross[:, num:], -self.other_hessian[:num, num:]]),
            other_hessian=self.other_hessian[num:, num:],
            gradient=np.concatenate([self.gradient, self.others_gradient[:num] + gradient]),
            others_gradient=self.others_gradient[num:],
        )

    def solved(self) -> Elimination:
        """Eliminate: the Schur complement on the others is B − Cᵀ H⁻¹ C, and its gradient
        g_others + Cᵀ H⁻¹ g."""
        solved = np.linalg.solve(self.hessian, np.column_stack([self.cross, self.gradient]))
        gain = solved[:, :-1]
        return Elimination(
            gain=gain.astype(float, copy=False),
            step=solved[:, -1].astype(float),
            information=self.other_hessian - self.cross.T @ gain,
            gradient=gain.T @ self.gradient + self.others_gradient,
        )


class Elimination(NamedTuple):
    """Equations of R unknowns, from which m are eliminated."""

    gain: FloatArray
    """H⁻¹ C, by which those that are eliminated move with the others, [m, R]."""
    step: FloatArray
    """The Gauss–Newton step of those that are eliminated, with the others held, [m]."""
    information: FloatArray
    """Information about the others, [R, R]."""
    gradient: FloatArray
    """Gradient by the others, [R]."""

"""Robust losses of a stereo residual, and the covariance of the resulting M-estimate."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from probevo.arrays import FloatArray
from probevo.compiled import compiled
from probevo.errors import InputError
from probevo.measurements.robust_loss_numba import RESIDUAL_DIM, LossKind, robust_weight

LossName = Literal["noise", "l2", "huber", "cauchy", "tukey"]


@dataclass(frozen=True)
class RobustLoss:
    """A loss ρ(s) of the squared Mahalanobis length s = eᵀ Σ⁻¹ e of a residual, scaled such that L2
    is s/2.

    The default parameters have an efficiency of 95 % for Gaussian residuals of four dimensions.
    They are wider than the usual ones (Huber 1.345, Cauchy 2.385, Tukey 4.685), which have that
    efficiency in one dimension.

    Raises:
        InputError: the parameter is missing, not positive, or not finite.
    """

    kind: LossKind
    parameter: float | None = None
    """k of Huber, c of Cauchy and Tukey, in standard deviations; ν of Student-t, or None for that
    of each feature."""

    def __post_init__(self) -> None:
        """Refuse a loss under which every residual would have zero weight."""
        if self.kind is LossKind.L2 or (self.kind is LossKind.STUDENT_T and self.parameter is None):
            return
        if self.parameter is None or not 0.0 < self.parameter < np.inf:
            raise InputError(
                f"loss {self.kind.name.lower()}",
                f"its parameter is {self.parameter}.",
                "It is positive and finite; without a bound, take RobustLoss.l2().",
            )

    @staticmethod
    def l2() -> RobustLoss:
        """Least squares: every residual counts in full."""
        return RobustLoss(LossKind.L2)

    @staticmethod
    def huber(k: float = 1.7311) -> RobustLoss:
        """Quadratic up to a length of k, linear beyond (Huber 1964)."""
        return RobustLoss(LossKind.HUBER, k)

    @staticmethod
    def cauchy(c: float = 2.7516) -> RobustLoss:
        """ρ = c²/2 log(1 + s/c²): a residual's pull falls with its length, but never ends."""
        return RobustLoss(LossKind.CAUCHY, c)

    @staticmethod
    def tukey(c: float = 5.8103) -> RobustLoss:
        """Tukey's biweight: residuals longer than c do not count."""
        return RobustLoss(LossKind.TUKEY, c)

    @staticmethod
    def student_t(dof: float | None = None) -> RobustLoss:
        """Negative log-likelihood of a Student-t (PROBE-GK eq. 14), by default with each feature's
        own dof."""
        return RobustLoss(LossKind.STUDENT_T, dof)

    @staticmethod
    def named(name: LossName) -> RobustLoss:
        """Return the loss of that name, with its default parameter.

        ``noise`` is the likelihood of the noise model itself.
        """
        if name == "noise":
            return RobustLoss.student_t()
        losses = {
            "l2": RobustLoss.l2,
            "huber": RobustLoss.huber,
            "cauchy": RobustLoss.cauchy,
            "tukey": RobustLoss.tukey,
        }
        return losses[name]()

    def parameters(self, dof: ArrayLike) -> FloatArray:
        """Return the loss parameter of each feature for the compiled loops, given the dof of its
        noise, [...]."""
        dof = np.asarray(dof, dtype=np.float64)
        if self.parameter is not None:
            return np.full(dof.shape, self.parameter)
        return dof if self.kind is LossKind.STUDENT_T else np.zeros(dof.shape)

    def weight(self, squared: ArrayLike, dof: ArrayLike = np.inf) -> FloatArray:
        """IRLS weight w = 2 dρ/ds at squared lengths s, [...]; one at s = 0, but (ν + d)/ν of
        Student-t.

        Args:
            squared: s, [...].
            dof: ν of each residual, which Student-t takes if it has no parameter of its own; np.inf
                is Gaussian.
        """
        parameters, squared = np.broadcast_arrays(
            self.parameters(dof), np.asarray(squared, dtype=np.float64)
        )
        weights = np.empty(squared.shape)
        _fill_weights(
            int(self.kind), parameters.ravel(), squared.ravel(), weights=weights.reshape(-1)
        )
        return weights

    def moments(self, dof: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Compute the moments a and b of the loss, [...] each.

        With them cov = (Σ a_n H_n)⁻¹ (Σ b_n H_n) (Σ a_n H_n)⁻¹, where H_n = Jᵀ Σ⁻¹ J of a feature.

        The M-estimate makes Σ_n Jᵀ Σ^-½ ψ(x) zero, where ψ(x) = w(s) x and the white residual x =
        Σ^-½ e is spherical, s = xᵀx. With a 1 = E[∂ψ/∂x] and b 1 = E[ψ ψᵀ], the sandwich above is
        its covariance (Huber 1981, chapter 6):

            a = E[w + (2/d) w' s] = E[w w_ν s] / d,    b = E[w² s] / d.

        The second form of a, integrated by parts, has w_ν = (ν + d)/(ν + s) from −∇ log p = w_ν x.
        By Cauchy–Schwarz a²/b, the share of the information that is kept, is largest for w = w_ν:
        no loss beats Student-t with the dof of the noise, a = b = (ν + d)/(ν + d + 2).

        Args:
            dof: degrees of freedom ν of the Student-t of which Σ is the scale matrix, [...]; np.inf
                is Gaussian.
        """
        dof = np.asarray(dof, dtype=np.float64)
        if self.kind is LossKind.STUDENT_T and self.parameter is None:
            fisher = 1.0 / (1.0 + 2.0 / (dof + RESIDUAL_DIM))
            return fisher, fisher
        if self.kind is LossKind.L2:
            with np.errstate(divide="ignore"):
                return np.ones(dof.shape), 1.0 / np.maximum(1.0 - 2.0 / dof, 0.0)
        distinct, which = np.unique(dof, return_inverse=True)
        a, b = np.array([_moments(self, float(value)) for value in distinct]).T
        return a[which].reshape(dof.shape), b[which].reshape(dof.shape)


@lru_cache(maxsize=1024)
def _moments(loss: RobustLoss, dof: float) -> tuple[float, float]:
    """Compute a and b by Gauss–Legendre quadrature over log s, to 1e-8."""
    nodes, node_weights = np.polynomial.legendre.leggauss(16)
    # Panels of length one, with an edge where Huber and Tukey have their kink, s = parameter².
    kink = 2.0 * np.log(loss.parameter or 1.0)
    starts = kink % 1.0 + np.arange(-24.0, 48.0)
    log_s = (starts[:, None] + 0.5 * (nodes + 1.0)).ravel()
    s = np.exp(log_s)
    nu = min(dof, 1e12)  # Gaussian to rounding
    # p(x) ∝ (1 + s/ν)^(−(ν + d)/2), and the volume of a shell of log s is ∝ s^(d/2).
    density = np.exp(
        0.5 * (RESIDUAL_DIM * log_s - (nu + RESIDUAL_DIM) * np.log1p(s / nu))
    )  # of log s, up to a factor
    density *= np.tile(node_weights, len(starts))
    density /= density.sum()
    w = loss.weight(s, dof)
    w_nu = RobustLoss.student_t().weight(s, dof)
    return float(density @ (w * w_nu * s)) / RESIDUAL_DIM, float(
        density @ (w * w * s)
    ) / RESIDUAL_DIM


@compiled
def _fill_weights(
    kind: int, parameters: FloatArray, squared: FloatArray, weights: FloatArray
) -> None:
    for n in range(len(squared)):
        weights[n] = robust_weight(kind, parameters[n], squared[n])

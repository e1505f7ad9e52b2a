"""Robust losses ρ(s) of the squared Mahalanobis length s of a residual, one number at a time."""

from __future__ import annotations

import math
from enum import IntEnum

from probevo.compiled import compiled


class LossKind(IntEnum):
    """Robust losses ρ(s) of the squared Mahalanobis length s of a residual."""

    L2 = 0
    HUBER = 1
    CAUCHY = 2
    TUKEY = 3
    STUDENT_T = 4


HUBER, CAUCHY, TUKEY, STUDENT_T = (int(kind) for kind in list(LossKind)[1:])
"""The kinds of loss as plain numbers, which compiled code takes."""

RESIDUAL_DIM = 4
"""d, the dimension of a stereo residual."""

INFINITE_DOF = 1e300
"""ν from which a Student-t is computed as a Gaussian, as for ν = ∞."""


@compiled
def robust_weight(kind: int, parameter: float, squared: float) -> float:
    """IRLS weight 2 dρ/ds, one for a perfect residual of every loss but Student-t, where it is (ν +
    d)/(ν + s)."""
    if kind == STUDENT_T:
        if not parameter < INFINITE_DOF:
            return 1.0
        return (parameter + RESIDUAL_DIM) / (parameter + squared)
    if kind == HUBER:
        return 1.0 if squared <= parameter * parameter else parameter / math.sqrt(squared)
    if kind == CAUCHY:
        return 1.0 / (1.0 + squared / (parameter * parameter))
    if kind == TUKEY:
        inside = 1.0 - squared / (parameter * parameter)
        return inside * inside if inside > 0.0 else 0.0
    return 1.0


@compiled
def robust_curvature(kind: int, parameter: float, squared: float, dimension: int) -> float:
    """w + (2/d) w' s: the second derivative of the loss, averaged over the d directions of the
    residual.

    Of the d directions, the one along the residual has the curvature w + 2 w' s, the others have w.
    It is at least a quarter of the weight, so that it can stand in a Hessian (Tukey's goes
    negative).
    """
    weight = robust_weight(kind, parameter, squared)
    share = 0.0  # −w' s / w
    if kind == STUDENT_T:
        share = squared / (parameter + squared) if parameter < INFINITE_DOF else 0.0
    elif kind == HUBER:
        share = 0.5 if squared > parameter * parameter else 0.0
    elif kind == CAUCHY:
        share = squared / (parameter * parameter + squared)
    elif kind == TUKEY:
        share = 2.0 * squared / max(parameter * parameter - squared, 1e-12)
    return weight * max(0.25, 1.0 - 2.0 / dimension * share)


@compiled
def robust_bend(kind: int, parameter: float, squared: float) -> float:
    """−2 w'/w²: the multiple of a weighted gradient's outer product that Newton's Hessian is less
    than IRLS's.

    With the weighted gradient q = w Jᵀ Σ⁻¹ e, Newton's Hessian is w Jᵀ Σ⁻¹ J + (2 w'/w²) q qᵀ.
    """
    if kind == STUDENT_T:
        return 2.0 / (parameter + RESIDUAL_DIM)
    if kind == HUBER:
        return 1.0 / (parameter * math.sqrt(squared)) if squared > parameter * parameter else 0.0
    if kind == CAUCHY:
        return 2.0 / (parameter * parameter)
    if kind == TUKEY:
        inside = max(0.1, 1.0 - squared / (parameter * parameter))
        return 4.0 / (parameter * parameter * inside * inside * inside)
    return 0.0


@compiled
def robust_cost(kind: int, parameter: float, squared: float) -> float:
    """ρ(s), scaled such that L2 is s/2."""
    if kind == STUDENT_T:
        return (
            0.5 * (parameter + RESIDUAL_DIM) * math.log1p(squared / parameter)
            if parameter < INFINITE_DOF
            else 0.5 * squared
        )
    if kind == HUBER:
        if squared <= parameter * parameter:
            return 0.5 * squared
        return parameter * (math.sqrt(squared) - 0.5 * parameter)
    if kind == CAUCHY:
        return 0.5 * parameter * parameter * math.log1p(squared / (parameter * parameter))
    if kind == TUKEY:
        inside = max(0.0, 1.0 - squared / (parameter * parameter))
        return parameter * parameter / 6.0 * (1.0 - inside * inside * inside)
    return 0.5 * squared

"""The compiled loop of the rows' calibration: one pass over the stereo matches of a frame."""

from __future__ import annotations

from probevo.arrays import FloatArray
from probevo.compiled import compiled

NUM_COEFFICIENTS = 6
"""a₀ … a₅ of 1, x, y, x², x y, y²."""


@compiled
def add_row_equations(
    basis: FloatArray,
    offsets: FloatArray,
    coefficients: FloatArray,
    *,
    sigma: float,
    dof: float,
    correlated: float,
    information: FloatArray,
    gradient: FloatArray,
) -> None:
    """Add the normal equations of N row offsets, each under a Student-t around the coefficients.

    Args:
        basis: (1, x, y, x², x y, y²) of each, [N, 6].
        offsets: v_r − v_l of each, [N], px.
        coefficients: a₀ … a₅ at which the weights are taken, [6], px.
        sigma: scale of the offsets, px.
        dof: ν of their Student-t.
        correlated: how many of them count as one.
        information: Σ w B Bᵀ is added to it, [6, 6], px⁻².
        gradient: Σ w B (v_r − v_l) is added to it, [6], px⁻¹.
    """
    for n in range(len(offsets)):
        predicted = 0.0
        for i in range(NUM_COEFFICIENTS):
            predicted += basis[n, i] * coefficients[i]
        squared = ((offsets[n] - predicted) / sigma) ** 2
        weight = (dof + 1.0) / (dof + squared) / (sigma**2 * correlated)
        for i in range(NUM_COEFFICIENTS):
            weighted = weight * basis[n, i]
            gradient[i] += weighted * offsets[n]
            for j in range(NUM_COEFFICIENTS):
                information[i, j] += weighted * basis[n, j]

"""Compiled loop of the row calibration: one pass over the stereo matches of a frame."""

from __future__ import annotations

from typing import NamedTuple

from probevo.arrays import FloatArray
from probevo.compiled import compiled


class RowOffsetNoise(NamedTuple):
    """The Student-t noise of row offsets around their model."""

    sigma_px: float
    """Scale."""
    dof: float
    """Degrees of freedom ν."""
    correlated: float
    """How many offsets count as one."""


@compiled
def add_row_equations(
    basis: FloatArray,
    offsets: FloatArray,
    coefficients: FloatArray,
    *,
    noise: RowOffsetNoise,
    information: FloatArray,
    gradient: FloatArray,
) -> None:
    """Add the normal equations of N row offsets, each under a Student-t around the coefficients.

    Args:
        basis: what the K coefficients multiply at each, [N, K].
        offsets: v_r − v_l of each, [N], px.
        coefficients: those at which the weights are taken, [K].
        noise: of the offsets.
        information: Σ w B Bᵀ is added to it, [K, K], px⁻².
        gradient: Σ w B (v_r − v_l) is added to it, [K], px⁻¹.
    """
    # Neighbours err alike: as many as ``correlated`` of them weigh as much as one.
    count = len(coefficients)
    variance = noise.sigma_px**2 * noise.correlated
    for n in range(len(offsets)):
        predicted = 0.0
        for i in range(count):
            predicted += basis[n, i] * coefficients[i]
        squared = ((offsets[n] - predicted) / noise.sigma_px) ** 2
        # IRLS weight of a Student-t in one dimension: (ν + 1)/(ν + s), over the variance.
        weight = (noise.dof + 1.0) / (noise.dof + squared) / variance
        for i in range(count):
            weighted = weight * basis[n, i]
            gradient[i] += weighted * offsets[n]
            for j in range(count):
                information[i, j] += weighted * basis[n, j]

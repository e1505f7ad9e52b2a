"""Recursive robust least squares for what row offsets v_r − v_l show."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.rig_rows_numba import RowOffsetNoise, add_row_equations


def fit_row_offsets(
    basis: FloatArray,
    offsets: FloatArray,
    prior: tuple[FloatArray, FloatArray],
    *,
    noise: RowOffsetNoise,
    iterations: int,
) -> tuple[FloatArray, FloatArray]:
    """Update a Gaussian estimate of K coefficients by the row offsets of one frame, by IRLS.

    The weights are found anew in each iteration, since those of the first frame depend on the
    coefficients that it teaches.

    Args:
        basis: what the coefficients multiply at each of N features, [N, K].
        offsets: v_r − v_l of each, [N], px.
        prior: the coefficients before the frame, [K], and their information, [K, K].
        noise: of the offsets.
        iterations: how many.

    Returns:
        The coefficients after it, [K], and their information, [K, K].
    """
    coefficients, prior_information = prior
    prior_gradient = prior_information @ coefficients
    information = prior_information
    for _ in range(iterations):
        information = prior_information.copy()
        gradient = prior_gradient.copy()
        add_row_equations(
            basis,
            offsets,
            coefficients,
            noise=noise,
            information=information,
            gradient=gradient,
        )
        coefficients = np.linalg.solve(information, gradient).astype(float)
    return coefficients, information

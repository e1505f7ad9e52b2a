"""Recursive robust least squares for what row offsets v_r − v_l show."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.rig_rows_numba import RowOffsetNoise, add_row_equations


class OffsetsOfFrame(NamedTuple):
    """A random change of the K coefficients that is new in each frame, G ω with ω ~ N(0, S)."""

    effect: FloatArray
    """G, [K, J]."""
    cov: FloatArray
    """S, [J, J]."""


def fit_row_offsets(
    basis: FloatArray,
    offsets: FloatArray,
    prior: tuple[FloatArray, FloatArray],
    *,
    noise: RowOffsetNoise,
    iterations: int,
    of_frame: OffsetsOfFrame | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Update a Gaussian estimate of K coefficients by the row offsets of one frame, by IRLS.

    The weights are found anew in each iteration, since those of the first frame depend on the
    coefficients that it teaches. What changes from frame to frame is estimated with them, and
    marginalised: no number of features in a frame shows what lasts any better.

    Args:
        basis: what the coefficients multiply at each of N features, [N, K].
        offsets: v_r − v_l of each, [N], px.
        prior: the coefficients before the frame, [K], and their information, [K, K].
        noise: of the offsets.
        iterations: how many.
        of_frame: what changes from frame to frame; nothing by default.

    Returns:
        The coefficients after it, [K], and their information, [K, K].
    """
    coefficients, prior_information = prior
    prior_gradient = prior_information @ coefficients
    information = prior_information
    at = coefficients
    random_information = None if of_frame is None else np.linalg.inv(of_frame.cov)
    for _ in range(iterations):
        own_information = np.zeros_like(prior_information)
        own_gradient = np.zeros_like(prior_gradient)
        add_row_equations(
            basis,
            offsets,
            at,
            noise=noise,
            information=own_information,
            gradient=own_gradient,
        )
        if of_frame is None or random_information is None:
            information = prior_information + own_information
            coefficients = np.linalg.solve(information, prior_gradient + own_gradient).astype(float)
            at = coefficients
            continue
        # Normal equations of the coefficients and ω, of which the latter are eliminated.
        cross = own_information @ of_frame.effect
        random = of_frame.effect.T @ cross + random_information
        random_gradient = of_frame.effect.T @ own_gradient
        solved = np.linalg.solve(random, np.column_stack([cross.T, random_gradient])).astype(float)
        gain = solved[:, :-1]
        information = prior_information + own_information - cross @ gain
        gradient = prior_gradient + own_gradient - gain.T @ random_gradient
        coefficients = np.linalg.solve(information, gradient).astype(float)
        change = solved[:, -1] - gain @ coefficients
        at = coefficients + of_frame.effect @ change
    return coefficients, information

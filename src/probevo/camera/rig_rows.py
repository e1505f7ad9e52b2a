"""Recursive robust least squares on the row offsets v_r − v_l of a frame."""

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
    frame_change: OffsetsOfFrame | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Update a Gaussian estimate of K coefficients by the row offsets of one frame, by IRLS.

    The weights are updated in each iteration, since they depend on the coefficients that the frame
    determines. A random change that is new in each frame is estimated with the coefficients and
    marginalised: otherwise the many features of one frame would make them overconfident.

    Args:
        basis: basis functions of the coefficients at each of N features, [N, K].
        offsets: v_r − v_l of each, [N], px.
        prior: the coefficients before the frame, [K], and their information, [K, K].
        noise: of the offsets.
        iterations: number of iterations.
        frame_change: a random change that is new in each frame; none by default.

    Returns:
        The coefficients after it, [K], and their information, [K, K].
    """
    # The prior in information form, to which the normal equations of the frame are added.
    coefficients, prior_information = prior
    prior_gradient = prior_information @ coefficients
    information = prior_information
    frame_coefficients = coefficients
    inverse_change_cov = None if frame_change is None else np.linalg.inv(frame_change.cov)
    for _ in range(iterations):
        # Normal equations of this frame, weighted at the coefficients as they were in it.
        own_information = np.zeros_like(prior_information)
        own_gradient = np.zeros_like(prior_gradient)
        add_row_equations(
            basis,
            offsets,
            frame_coefficients,
            noise=noise,
            information=own_information,
            gradient=own_gradient,
        )
        if frame_change is None or inverse_change_cov is None:
            information = prior_information + own_information
            coefficients = np.linalg.solve(information, prior_gradient + own_gradient).astype(float)
            frame_coefficients = coefficients
            continue
        # The coefficients of this frame are a + G ω, with N = Σ w B Bᵀ and n = Σ w B (v_r − v_l):
        #
        #     [N + prior   N G          ] [a]   [n + prior gradient]
        #     [Gᵀ N        Gᵀ N G + S⁻¹ ] [ω] = [Gᵀ n              ]
        #
        # ω = ω₀ − gain · a is eliminated by the Schur complement of its block.
        G = frame_change.effect
        N_G = own_information @ G
        change_block = G.T @ N_G + inverse_change_cov
        change_gradient = G.T @ own_gradient
        gain = np.linalg.solve(change_block, N_G.T).astype(float)
        omega_0 = np.linalg.solve(change_block, change_gradient).astype(float)
        information = prior_information + own_information - N_G @ gain
        gradient = prior_gradient + own_gradient - gain.T @ change_gradient
        coefficients = np.linalg.solve(information, gradient).astype(float)
        # Back-substitution: the likeliest ω. The next iteration weighs by the residuals from
        # a + G ω, the coefficients of this frame.
        omega = omega_0 - gain @ coefficients
        frame_coefficients = coefficients + G @ omega
    return coefficients, information

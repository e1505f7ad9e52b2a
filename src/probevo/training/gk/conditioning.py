"""The motions of a drive as the features and the truth together give them."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.estimation.two_frame import BY_CHANCE
from probevo.geometry import se3
from probevo.training.supervision import Supervision

LEAST_TRUTH_SIGMA = np.array([1e-4, 1e-4, 1e-4, 1e-5, 1e-5, 1e-5])
"""No truth is better than that, m and rad."""
FEW_STRETCHES = 20
LOOP_SIGMA = np.array([0.1, 0.1, 0.1, 0.02, 0.02, 0.02])
"""How well a loop closes whose ends nobody has measured, m and rad: it is parked by hand."""


def conditioned(
    T_curr_prev: FloatArray,
    cov: FloatArray,
    supervision: Supervision,
    truth_sigma: FloatArray | None,
) -> tuple[FloatArray, FloatArray]:
    """Motions [K − 1, 4, 4] and covariances [K − 1, 6, 6], given the true motion over each stretch.

    The motion over a stretch is T = T_m … T_1, and perturbations ξ_k of its steps move it by Σ Ad_k
    ξ_k with Ad_k = Ad(T_m … T_{k+1}). With M = Σ Ad_k C_k Ad_kᵀ, the covariance P of the truth and
    its distance ξ = Log(T_true T⁻¹), each step moves by C_k Ad_kᵀ (M + P)⁻¹ ξ. Of stretches of one
    step this is the fusion of two Gaussians.

    Unless given, P is estimated from the distances of all stretches, but not for a loop that is
    only assumed to close. Truth that is then farther off than chance explains, ξᵀ(M + P)⁻¹ξ >
    BY_CHANCE, is left aside.
    """
    motions = T_curr_prev.copy()
    posterior = cov.copy()
    chains = [
        (
            first,
            last,
            *_chain(T_curr_prev[first:last], cov[first:last], supervision.T_world_cam[[i, i + 1]]),
        )
        for i, (first, last) in enumerate(supervision.stretches.tolist())
    ]
    estimated = truth_sigma is None and not supervision.is_assumed
    if truth_sigma is None:
        truth_sigma = _sigma_of_truth(chains) if estimated else LOOP_SIGMA
    P = np.diag(np.maximum(truth_sigma, LEAST_TRUTH_SIGMA) ** 2)
    for first, last, to_end, M, distance in chains:
        information = np.linalg.inv(M + P)
        if estimated and distance @ information @ distance > BY_CHANCE:
            continue
        gain = cov[first:last] @ np.swapaxes(to_end, 1, 2) @ information
        motions[first:last] = se3.exp(gain @ distance) @ T_curr_prev[first:last]
        posterior[first:last] -= gain @ to_end @ cov[first:last]
    return motions, posterior


def _chain(
    T_curr_prev: FloatArray, cov: FloatArray, T_world_cam: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Ad_k of each step, [m, 6, 6], their M, [6, 6], and how far the truth of both ends is, [6]."""
    rest = np.eye(4)
    to_end = np.empty((len(T_curr_prev), 6, 6))
    for k in range(len(T_curr_prev) - 1, -1, -1):
        to_end[k] = se3.adjoint(rest)
        rest = rest @ T_curr_prev[k]
    M: FloatArray = np.sum(to_end @ cov @ np.swapaxes(to_end, 1, 2), axis=0)
    true = se3.inverse(T_world_cam[1]) @ T_world_cam[0]
    return to_end, M, se3.log(true @ se3.inverse(rest))


def _sigma_of_truth(
    chains: list[tuple[int, int, FloatArray, FloatArray, FloatArray]],
) -> FloatArray:
    """What the scatter of the truth around the features' motions is, beyond what these are off by,
    [6], by medians.

    Few stretches may scatter little by chance: then the truth is taken to be no better than the
    features.
    """
    distances = np.abs([chain[4] for chain in chains]).reshape(-1, 2, 3)  # translations, rotations
    scatter = (1.4826 * np.median(distances, axis=(0, 2))) ** 2
    own = np.median(
        np.reshape([np.diagonal(chain[3]) for chain in chains], (-1, 2, 3)), axis=(0, 2)
    )
    least = own if len(chains) < FEW_STRETCHES else np.zeros(2)
    sigma: FloatArray = np.repeat(np.sqrt(np.maximum(scatter - own, least)), 3)
    return sigma

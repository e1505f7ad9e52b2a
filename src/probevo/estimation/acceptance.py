"""Whether to accept the solve of a step."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.config import OdometryConfig
from probevo.estimation.determined import is_determined
from probevo.estimation.feature_weights import are_selected, num_agreeing, num_inliers
from probevo.estimation.motion_estimate import Status
from probevo.estimation.motion_model import MotionPrediction
from probevo.estimation.reprojection import ReprojectionSolution
from probevo.geometry.uncertainty import MOTIONS_DIFFER_FROM


def contradicts_prediction(solution: ReprojectionSolution, prediction: MotionPrediction) -> bool:
    """Return whether a solve differs significantly from what was predicted."""
    if not np.isfinite(solution.cov).all():
        return False
    return prediction.fails_gate(solution.T_curr_prev, solution.cov, MOTIONS_DIFFER_FROM)


def are_beyond_chance(
    weights: FloatArray, *, num_tracks: int, need_larger_noise: bool, config: OdometryConfig
) -> bool:
    """Return whether enough of the N tracks of a solve agree, and not by chance.

    Args:
        weights: weight of each track that the solve used, [N].
        num_tracks: number of tracks of the step, with those that RANSAC rejected.
        need_larger_noise: whether they agree only under a larger noise than was predicted.
        config: settings of the solver.
    """
    # Tracks that were selected, and even more a minority or tracks that hardly fit, may agree by
    # chance, and then rather with large residuals than with small ones.
    if need_larger_noise or len(weights) < 0.5 * num_tracks:
        return num_inliers(weights) >= config.solver.min_tracks_beyond_chance
    if are_selected(weights, num_tracks):
        return num_inliers(weights) >= config.solver.min_tracks
    return num_agreeing(weights) >= config.solver.min_tracks


def evaluate_status(
    solution: ReprojectionSolution,
    prediction: MotionPrediction,
    *,
    is_supported: bool,
    config: OdometryConfig,
) -> Status:
    """Return OK if a solve is determined in all six dimensions by enough tracks, converged, and
    passes the gate.

    Args:
        solution: the solve.
        prediction: motion predicted before the images are used.
        is_supported: whether enough of its tracks agree (``are_beyond_chance``).
        config: settings of the solver.
    """
    if not is_determined(solution.cov, config.solver):
        return Status.DEGENERATE
    if not is_supported:
        return Status.TOO_FEW_TRACKS
    # A solve may converge to the motion relative to a passing lorry. Its tracks agree with each
    # other, but not with the predicted motion.
    if not solution.converged or prediction.fails_gate(solution.T_curr_prev, solution.cov):
        return Status.NOT_CONVERGED
    return Status.OK

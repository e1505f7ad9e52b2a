"""K by cross-validation over blocks of time, γ by the error of the training drives (PROBE IV-B),
both automatic."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from probevo.arrays import BoolArray, FloatArray, IntArray, evenly
from probevo.estimation.two_frame import solve
from probevo.noise.probe.nearest_neighbors import LARGEST_WEIGHT
from probevo.noise.probe.neighbor_index import NeighborIndex
from probevo.training.probe.subsets import Learner, Stream
from probevo.training.supervision import LEAST_ALPHA_M, from_step_to_step

NEIGHBORS = (10, 25, 50, 100, 200, 400, 800)
EXPONENTS = (0.0, 0.5, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0)
MOST_QUERIES = 20_000
"""Of all drives together, to compare values of K with; more would not change which is the best."""


@dataclass(frozen=True)
class Search:
    """Candidates for a hyperparameter, the error of each, and which was taken."""

    candidates: tuple[float, ...]
    errors: tuple[float, ...]
    chosen: float

    def as_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {
            name: list(value) if isinstance(value, tuple) else value
            for name, value in asdict(self).items()
        }


def choose_neighbors(coordinates: FloatArray, values: FloatArray, fold: IntArray) -> Search:
    """The K whose mean over neighbours from other blocks of time is nearest to the values, in
    squared error.

    Args:
        coordinates: places of N samples, [N, M].
        values: α of each, or its logarithm, [N].
        fold: fold of each, [N].
    """
    fewest = min(int((fold != k).sum()) for k in np.unique(fold))
    candidates = np.array([k for k in NEIGHBORS if k <= fewest] or [max(1, fewest)])
    queries = evenly(len(values), MOST_QUERIES)
    squared = np.zeros(len(candidates))
    for k in np.unique(fold):
        other = fold != k
        asked = queries[fold[queries] == k]
        if other.any() and len(asked):
            means = NeighborIndex.build(coordinates[other], values[other]).mean_of_nearest(
                coordinates[asked], candidates
            )
            squared += np.sum((means - values[asked, None]) ** 2, axis=0)
    errors = squared / max(len(queries), 1)
    return Search(_plain(candidates), _plain(errors), float(candidates[np.argmin(errors)]))


def out_of_fold(
    coordinates: FloatArray,
    values: FloatArray,
    fold: IntArray,
    neighbors: int,
    asked: FloatArray,
    fold_asked: IntArray,
) -> FloatArray:
    """Mean of the K nearest values from other folds than a place's own, [n].

    Args:
        coordinates, values, fold: the N samples, [N, M], [N], [N].
        neighbors: K.
        asked: places, [n, M].
        fold_asked: the fold of each, [n].
    """
    means = np.empty(len(asked))
    for k in np.unique(fold_asked):
        other = fold != k
        index = NeighborIndex.build(coordinates[other], values[other])
        own = fold_asked == k
        means[own] = index.mean_of_nearest(
            asked[own], np.array([min(neighbors, int(other.sum()))])
        )[:, 0]
    return means


def choose_exponent(
    learners: Sequence[Learner], log_relative_alphas: Sequence[FloatArray]
) -> Search:
    """The least γ whose mean α over the training drives is no worse than the best one's, within its
    standard error.

    Where a drive shows no error, or one alone, as a closed loop does, what counts is by how much
    the motions of two random halves of its features disagree, step by step: one loop that closes
    better by chance must not decide.

    Args:
        learners: the drives.
        log_relative_alphas: ln(mean of the K nearest α / ᾱ) of every feature of each drive, [n]
            each, as learned from other blocks of time than its own.
    """
    alphas = np.array(
        [
            np.concatenate(
                [
                    _alphas(learner, np.exp(np.clip(gamma * log_alpha, -LIMIT, LIMIT)))
                    for learner, log_alpha in zip(learners, log_relative_alphas, strict=True)
                ]
            )
            for gamma in EXPONENTS
        ]
    )
    moved = (alphas > LEAST_ALPHA_M).all(axis=0)  # no half of such a step could be solved otherwise
    alphas = alphas[:, moved] if moved.any() else alphas
    errors = alphas.mean(axis=1)
    excess = alphas - alphas[np.argmin(errors)]
    standard_error = excess.std(axis=1) / np.sqrt(alphas.shape[1])
    chosen = np.argmax(excess.mean(axis=1) <= standard_error)
    return Search(EXPONENTS, _plain(errors), EXPONENTS[chosen])


LIMIT = np.log(LARGEST_WEIGHT)


def _alphas(learner: Learner, beta: FloatArray) -> FloatArray:
    """Errors α of a drive solved with these β, [n]: one a stretch; one a step where halves have to
    do."""
    used = learner.drive.used
    supervision = learner.supervision
    if supervision.kind != "none" and len(supervision.stretches) > 1:
        return supervision.errors(weighted_motions(learner, beta, used))
    half = np.random.default_rng([*learner.seed, Stream.HALVES]).random(len(beta)) < 0.5
    one, other = (weighted_motions(learner, beta, used & part) for part in (half, ~half))
    return from_step_to_step(other).errors(one)


def weighted_motions(learner: Learner, beta: FloatArray, used: BoolArray) -> FloatArray:
    """T_curr_prev of each step, [K − 1, 4, 4], with the noise of the features scaled by β, [n]."""
    drive, motions = learner.drive, learner.drive.T_curr_prev.copy()
    for step in range(len(motions)):
        rows = drive.rows(step)
        chosen = np.flatnonzero(used[rows])
        if len(chosen) >= learner.solver.min_tracks:
            noise = learner.base.predict(np.zeros((len(chosen), 0))).scaled(beta[rows][chosen])
            tracks = drive.tracks(step).kept(chosen)
            solution = solve(
                tracks,
                noise,
                drive.T_curr_prev[step],
                camera=learner.camera,
                prior=None,
                config=learner.solver,
            )
            if solution.converged and np.isfinite(solution.cov).all():
                motions[step] = solution.T_curr_prev
    return motions


def _plain(values: FloatArray | IntArray) -> tuple[float, ...]:
    return tuple(float(value) for value in values)

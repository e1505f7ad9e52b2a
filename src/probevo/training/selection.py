"""K by cross-validation over blocks of time, γ by the error of the training drives (PROBE IV-B), both automatic."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from probevo.arrays import BoolArray, FloatArray, IntArray
from probevo.motion.visual import solve
from probevo.noise.nearest_neighbors import LARGEST_WEIGHT
from probevo.noise.neighbors import NeighborIndex
from probevo.training.subsets import Learner

NEIGHBORS = (10, 25, 50, 100, 200, 400, 800)
EXPONENTS = (0.0, 0.5, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0)
MOST_QUERIES = 20_000
"""Of a drive, to compare values of K with; more would not change which is the best."""
HALVES = 8
"""Random halves of the features with which a drive is solved, where it has but one error to show for all of it."""


@dataclass(frozen=True)
class Search:
    """Candidates for a hyperparameter, the error of each, and which was taken."""

    candidates: tuple[float, ...]
    errors: tuple[float, ...]
    chosen: float

    def as_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(self).items()}


def choose_neighbors(coordinates: FloatArray, values: FloatArray, fold: IntArray) -> Search:
    """The K whose mean over neighbours from other blocks of time is nearest to the values, in squared error.

    Args:
        coordinates: places of N samples, [N, M].
        values: α of each, or its logarithm, [N].
        fold: fold of each, [N].
    """
    fewest = min(int((fold != k).sum()) for k in np.unique(fold))
    candidates = np.array([k for k in NEIGHBORS if k <= fewest] or [max(1, fewest)])
    queries = np.unique(np.linspace(0, len(values) - 1, min(MOST_QUERIES, len(values))).astype(np.int64))
    squared = np.zeros(len(candidates))
    for k in np.unique(fold):
        other, asked = fold != k, queries[fold[queries] == k]
        if other.any() and len(asked):
            means = NeighborIndex.build(coordinates[other], values[other]).mean_of_nearest(
                coordinates[asked], candidates
            )
            squared += np.sum((means - values[asked, None]) ** 2, axis=0)
    errors = squared / max(len(queries), 1)
    return Search(_plain(candidates), _plain(errors), float(candidates[np.argmin(errors)]))


def out_of_fold(
    coordinates: FloatArray, values: FloatArray, fold: IntArray, neighbors: int, asked: FloatArray, fold_asked: IntArray
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
        if not other.any():  # a drive so short that all lies in one fold
            other[:] = True
        index = NeighborIndex.build(coordinates[other], values[other])
        own = fold_asked == k
        means[own] = index.mean_of_nearest(asked[own], np.array([min(neighbors, int(other.sum()))]))[:, 0]
    return means


def choose_exponent(learners: Sequence[Learner], log_relative_alphas: Sequence[FloatArray]) -> Search:
    """The least γ whose mean α over the training drives is no worse than the best one's, within its standard error.

    Where a drive shows one error alone, as a closed loop does, it is solved with random halves of its features, so that
    there is a scatter to judge by: one loop that closes better by chance must not decide.

    Args:
        learners: the drives.
        log_relative_alphas: ln(mean of the K nearest α / ᾱ) of every feature of each drive, [n] each, as learned from
            other blocks of time than its own.
    """
    alphas = np.array(
        [
            np.concatenate([_alphas(learner, np.exp(np.clip(gamma * log_alpha, -LIMIT, LIMIT)))
                            for learner, log_alpha in zip(learners, log_relative_alphas, strict=True)])
            for gamma in EXPONENTS
        ]
    )  # fmt: skip
    errors = alphas.mean(axis=1)
    excess = alphas - alphas[np.argmin(errors)]
    standard_error = excess.std(axis=1) / np.sqrt(alphas.shape[1])
    chosen = np.argmax(excess.mean(axis=1) <= standard_error)
    return Search(EXPONENTS, _plain(errors), EXPONENTS[chosen])


LIMIT = np.log(LARGEST_WEIGHT)


def _alphas(learner: Learner, beta: FloatArray) -> FloatArray:
    """Errors α of a drive solved with these β, [n]: one a stretch; or, where all of it is one, one a random half.

    Without any truth, what two halves of the features disagree by.
    """
    supervision, used = learner.supervision, learner.drive.used
    rng = np.random.default_rng([*learner.seed, HALVES])
    halves = rng.random((HALVES, len(beta))) < 0.5
    if supervision.kind == "none":
        one, other = (weighted_motions(learner, beta, used & half) for half in (halves[0], ~halves[0]))
        return supervision.completed(other).errors(one)
    if len(supervision.stretches) > 1:
        return supervision.errors(weighted_motions(learner, beta, used))
    return np.concatenate(
        [learner.supervision.errors(weighted_motions(learner, beta, learner.drive.used & half)) for half in halves]
    )


def weighted_motions(learner: Learner, beta: FloatArray, used: BoolArray) -> FloatArray:
    """T_curr_prev of each step, [K − 1, 4, 4], with the noise of the features scaled by β, [n]."""
    drive, motions = learner.drive, learner.drive.T_curr_prev.copy()
    for step in range(len(motions)):
        rows = drive.rows(step)
        chosen = np.flatnonzero(used[rows])
        if len(chosen) >= learner.subset:
            noise = learner.base.predict(np.zeros((len(chosen), 0))).scaled(beta[rows][chosen])
            tracks = drive.tracks(step).kept(chosen)
            solution = solve(tracks, noise, drive.T_curr_prev[step], learner.camera, None, learner.solver)
            if np.isfinite(solution.cov).all():
                motions[step] = solution.T_curr_prev
    return motions


def _plain(values: FloatArray | IntArray) -> tuple[float, ...]:
    return tuple(float(value) for value in values)

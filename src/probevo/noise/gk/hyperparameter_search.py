"""Choice of the hyperparameters of a generalized kernel by cross-validation.

The score is the mean predictive log-likelihood of held-out groups of errors, as a gain over the
static Student-t, in nats a feature. The search is greedy: first the columns of the prediction
space by forward selection, then their weights, then one hyperparameter after another.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.errors import InputError
from probevo.noise.base import StereoNoise
from probevo.noise.gk.folds import MAX_SAMPLES, Fold, folds_of
from probevo.noise.gk.posterior import KernelPosterior, KernelSamples, KernelShape
from probevo.noise.metric import MAX_WEIGHT
from probevo.noise.student_t_arrays import DIM, Neighborhoods
from probevo.noise.student_t_numba import MAX_DOF, MIN_DOF

FACTORS = (0.5, 2.0)
"""Factors by which the weight of each column is tried, once the columns are chosen."""
SEARCH_ITERATIONS = 6
"""EM iterations of each fit of the search; the final fit takes more."""
MIN_GAIN = 2e-3
"""Gain by which another column, or another weight, must improve the score, nats a feature."""
STANDARD_ERRORS = 1.0
"""Number of standard errors of that improvement by which it must exceed zero."""
TIE = 2e-4
"""Difference of scores below which two values are equally good, nats a feature. It is small, since
the few best features determine the motion: a prior that is too heavy for these only, or a K that is
too large, hardly shows in the mean over all features."""
LIGHT_COUNTS = 1.0
"""Pseudo-counts of the prior while the rest is chosen: under a heavier prior, a small K looks worse
than it is."""
DOF_TOLERANCE = 0.1
"""Accuracy of the prior degrees of freedom, of ln ν."""
DEFAULT_REACH = 0.5
"""Reach of the published variant before one is chosen."""
CANDIDATES: dict[str, tuple[float, ...]] = {
    "neighbors": (1600, 800, 400, 200, 100, 50),
    "bias_counts": (np.inf, 100.0, 10.0),
    "prior_counts": (64.0, 16.0, 4.0, 1.0, 0.25, 0.0625),
    "dof_counts": (np.inf, 300.0, 100.0, 30.0, 10.0),
}
"""Values that are tried in the robust variant, in this order, the stiffest first."""
PUBLISHED_CANDIDATES: dict[str, tuple[float, ...]] = {
    "reach": (0.125, 0.25, 0.5, 1.0, 2.0),
    "prior_counts": (5.0, 20.0, 80.0),
}
"""Values that are tried in the published variant."""
NEIGHBORS_EXPONENT = 0.5
"""K grows with this power of the number of samples: N^(4/(4 + M)), the optimal rate, for M = 4
effective columns."""
SearchLog = dict[str, dict[str, Any]]
"""For each hyperparameter that was chosen: ``candidates``, their ``gains`` in nats a feature, and
``chosen``."""


def check_given(given: Mapping[str, Any], dimension: int, published: bool) -> None:
    """Refuse hyperparameters that are not valid for points of M columns.

    Raises:
        InputError: names the hyperparameter, its value and what is wrong.
    """
    if dimension == 0:
        raise InputError(
            "predictors", "there is no column.", "Without any, StudentT says the same."
        )
    # Numbers: positive, finite where they count samples, and whole where they count neighbours or
    # centers.
    where = "generalized kernel"
    smallest_positive = np.nextafter(0.0, np.inf)
    lowest = {
        "neighbors": 1,
        "centers": 1,
        # The published ν* − d + 1 degrees of freedom must be positive.
        "prior_counts": np.nextafter(DIM - 1.0 if published else 0.0, np.inf),
    }
    for name, value in given.items():
        if name == "weights":
            continue
        if not value >= lowest.get(name, smallest_positive):
            raise InputError(
                where, f"{name} is {value}, which is too small.", "Leave it to be chosen."
            )
        if name in ("neighbors", "centers", "prior_counts") and not np.isfinite(value):
            raise InputError(
                where, f"{name} is {value}, which is not finite.", "Leave it to be chosen."
            )
        if name in ("neighbors", "centers") and int(value) != value:
            raise InputError(where, f"{name} is {value}, which is not a whole number.", "Round it.")
    # Weights: one a column, not all zero.
    weights = np.asarray(given.get("weights", np.ones(dimension)), dtype=np.float64)
    are_within_bounds = bool(((weights >= 0.0) & (weights <= MAX_WEIGHT)).all())
    if weights.shape != (dimension,) or not are_within_bounds or not weights.any():
        raise InputError(
            where,
            f"weights are {weights}, where {dimension} from 0 to {MAX_WEIGHT:g} are expected, not"
            " all of them 0.",
            "Leave them to be chosen.",
        )


def choose_shape(
    samples: KernelSamples,
    groups: IntArray | None,
    given: Mapping[str, Any],
    *,
    published: bool,
    on_progress: Callable[[int, int], None] | None = None,
) -> tuple[FloatArray, KernelShape, SearchLog]:
    """Choose the weights of the columns and the hyperparameters of the kernel.

    What is given stays as it is. With fewer than two groups no cross-validation is possible, and
    what is not given keeps its default.

    Args:
        samples: N samples.
        groups: group of each sample, [N]; by default blocks of consecutive samples.
        given: values that need not be chosen, by the names of ``KernelShape``, and ``weights``.
        published: choose the support ρ instead of K, and no weights.
        on_progress: called with the number of steps done, and the largest number of them.

    Returns:
        The weights [M], the hyperparameters, and a log of the search.
    """
    # Start from what is given and from the defaults.
    dimension = samples.coordinates.shape[1]
    weights = np.asarray(given.get("weights", np.ones(dimension)), dtype=np.float64)
    fixed = {name: value for name, value in given.items() if name != "weights"}
    if "neighbors" in fixed:
        fixed["neighbors"] = int(fixed["neighbors"])
    shape = replace(KernelShape(), **fixed)
    if published and "reach" not in given:
        shape = replace(shape, reach=DEFAULT_REACH)
    # Divide the samples into folds, unless there is nothing to choose, or too few groups.
    candidates = {
        name: values
        for name, values in (PUBLISHED_CANDIDATES if published else CANDIDATES).items()
        if name not in given
    }
    if published and not candidates:
        return weights, shape, {}
    folds = folds_of(samples, groups, published)
    if len(folds) < 2:
        return weights, shape, {}

    # The search learns from a part of the samples, of which as many neighbours would reach farther.
    num_samples = len(samples.errors)
    if "neighbors" in fixed:
        shape = replace(shape, neighbors=neighbors_in_search(shape.neighbors, num_samples))
    if not published and "prior_counts" not in given:
        shape = replace(shape, prior_counts=LIGHT_COUNTS)
    has_free_weights = "weights" not in given and not published
    weight_steps = dimension * (dimension + 1) // 2 if has_free_weights else 0
    search = _Search(folds, published, on_progress, total_steps=weight_steps + len(candidates))

    # Greedy search: columns and their weights, then one hyperparameter after another. The prior
    # degrees of freedom are estimated before the other hyperparameters, and again after them.
    if has_free_weights:
        weights = search.choose_weights(dimension, shape)
    if candidates and not published:
        shape = search.choose_dof(weights, shape)
    for name, values in candidates.items():
        shape = search.choose(name, values, weights, shape)
    if not published:
        shape = search.choose_dof(weights, shape)
    # K for all samples again
    neighbors = fixed.get("neighbors", neighbors_of_all(shape.neighbors, num_samples))
    return weights, replace(shape, neighbors=neighbors), search.log


def neighbors_in_search(neighbors: int, num_samples: int) -> int:
    """Return the K of the search, which has fewer samples, for a K of all N samples."""
    return max(1, round(neighbors / _neighbors_ratio(num_samples)))


def neighbors_of_all(neighbors: int, num_samples: int) -> int:
    """Return the K of all N samples for a K of the search."""
    return round(neighbors * _neighbors_ratio(num_samples))


def _neighbors_ratio(num_samples: int) -> float:
    """Return K of all N samples over K of the search."""
    return math.pow(max(1.0, num_samples / MAX_SAMPLES), NEIGHBORS_EXPONENT)


class _HeldOut(NamedTuple):
    """What the errors of a fold that are held out are predicted from."""

    posterior: KernelPosterior
    """Posterior of the samples in the other folds."""
    near: Neighborhoods
    """Samples of the other folds near each point of the fold, with their kernel values."""


class _Search:
    """The state of a search: its folds, its log, and the neighbourhoods that were found last."""

    def __init__(
        self,
        folds: list[Fold],
        published: bool,
        on_progress: Callable[[int, int], None] | None,
        *,
        total_steps: int,
    ) -> None:
        self.folds = folds
        self.groups = np.concatenate([fold.groups for fold in folds])
        self.published = published
        self.on_progress = on_progress
        self.total_steps = total_steps
        self.steps_done = 0
        self.log: SearchLog = {}
        self._cached_for: tuple[bytes, int, float] | None = None
        self._cached: list[_HeldOut] = []

    def choose_weights(self, dimension: int, shape: KernelShape) -> FloatArray:
        """Choose columns by forward selection, then the weight of each: [M].

        The first column stays even if it gains nothing: keeping all of them would be worse.
        """
        weights = np.zeros(dimension)
        best_gains = np.zeros(1)
        order: list[tuple[int, float]] = []
        varies = np.any(
            [np.ptp(fold.training.coordinates, axis=0) > 0.0 for fold in self.folds], axis=0
        )
        # Add the column that gains the most beside the chosen ones, as long as it gains enough.
        while len(free := np.flatnonzero(varies & (weights == 0.0))):
            options = [_with_weight(weights, m, 1.0) for m in free.tolist()]
            option, gains = self._best_of(options, shape)
            self._advance(len(free))
            gains_more = is_better(gains, best_gains, self.groups)
            if order and not gains_more:
                break
            added = int(np.flatnonzero(option != weights)[0])
            order.append((added, float(gains.mean())))
            weights = option
            if gains_more:
                best_gains = gains
        # Try to halve and to double the weight of each. Unless ρ is given, the K-th neighbour sets
        # the support, so that only ratios of the weights matter.
        for m, _ in order:
            options = [_with_weight(weights, m, factor) for factor in FACTORS]
            option, gains = self._best_of(options, shape)
            if is_better(gains, best_gains, self.groups):
                weights = option
                best_gains = gains
        self.log["weights"] = {
            "candidates": [m for m, _ in order],
            "gains": [gain for _, gain in order],
            "chosen": weights.tolist(),
        }
        return weights if weights.any() else np.ones(dimension)

    def choose(
        self, name: str, values: tuple[float, ...], weights: FloatArray, shape: KernelShape
    ) -> KernelShape:
        """Choose one hyperparameter; of values that are equally good, the first, stiffest one."""
        changes: list[dict[str, Any]] = [
            {name: int(value) if name == "neighbors" else value} for value in values
        ]
        options = [replace(shape, **change) for change in changes]
        gains = [float(np.mean(self.gains(weights, option))) for option in options]
        chosen = int(np.argmax(np.array(gains) > max(gains) - TIE))
        # JSON has no infinity.
        plain = [value if np.isfinite(value) else "none" for value in values]
        self.log[name] = {"candidates": plain, "gains": gains, "chosen": plain[chosen]}
        self._advance()
        return options[chosen]

    def choose_dof(self, weights: FloatArray, shape: KernelShape) -> KernelShape:
        """Choose the prior degrees of freedom, under which each error has the scale of its point.

        The likelihood is maximised without preference for a stiff value: with too few degrees of
        freedom the scale shrinks as well, and confidence regions hold too few errors.
        """
        from scipy.optimize import minimize_scalar  # slow to import, and needed in training only

        # With the degrees of freedom held at the prior, the likelihood is a function of these only.
        held = replace(shape, dof_counts=np.inf)

        def loss(log_dof: float) -> float:
            """Return minus the mean log likelihood, nats a sample, at ln ν."""
            return -float(np.mean(self.gains(weights, replace(held, dof=math.exp(log_dof)))))

        best = minimize_scalar(
            loss,
            bounds=(math.log(MIN_DOF), math.log(MAX_DOF)),
            method="bounded",
            options={"xatol": DOF_TOLERANCE},
        )
        dof = math.exp(best.x)
        self.log["dof"] = {"candidates": [dof], "gains": [-float(best.fun)], "chosen": dof}
        return replace(shape, dof=dof)

    def gains(self, weights: FloatArray, shape: KernelShape) -> FloatArray:
        """Compute the log-likelihood of each held-out error over the static one, [Q], nats."""
        with ThreadPoolExecutor(2) as pool:
            # Finding neighbourhoods takes as long as fitting, and most shapes that are tried have
            # the same ones, so the last ones are kept.
            key = (weights.tobytes(), shape.neighbors, shape.reach)
            if self._cached_for != key:
                self._cached = list(
                    pool.map(lambda fold: self._neighborhoods(fold, weights, shape), self.folds)
                )
                self._cached_for = key
            parts = pool.map(
                lambda fold, held_out: _gains_of_fold(fold, held_out, shape),
                self.folds,
                self._cached,
            )
            return np.concatenate(list(parts))

    def _best_of(
        self, options: list[FloatArray], shape: KernelShape
    ) -> tuple[FloatArray, FloatArray]:
        """Return the weights with the largest mean gain, and the gain of each error, [Q]."""
        gains = [self.gains(weights, shape) for weights in options]
        best = int(np.argmax([np.mean(gain) for gain in gains]))
        return options[best], gains[best]

    def _neighborhoods(self, fold: Fold, weights: FloatArray, shape: KernelShape) -> _HeldOut:
        # Columns without weight do not enter the tree.
        used = weights > 0.0
        coordinates = np.ascontiguousarray((fold.training.coordinates * weights)[:, used])
        points = np.ascontiguousarray((fold.held_out.coordinates * weights)[:, used])
        posterior = KernelPosterior.of(
            replace(fold.training, coordinates=coordinates),
            published=self.published,
            prior=fold.prior,
        )
        return _HeldOut(posterior=posterior, near=posterior.around(points, shape))

    def _advance(self, steps: int = 1) -> None:
        self.steps_done += steps
        if self.on_progress is not None:
            self.on_progress(self.steps_done, self.total_steps)


def _gains_of_fold(fold: Fold, held_out: _HeldOut, shape: KernelShape) -> FloatArray:
    fitted, _ = held_out.posterior.fit(held_out.near, shape, SEARCH_ITERATIONS)
    noise = StereoNoise(scale=fitted.scale, dof=fitted.dof, bias=fitted.bias)
    return noise.log_likelihood(fold.held_out.errors) - fold.static


def is_better(gains: FloatArray, prev_gains: FloatArray, groups: IntArray) -> bool:
    """Decide whether the gains of the same errors improve by more than chance explains.

    The mean difference must exceed both ``MIN_GAIN`` and its own standard error.

    Args:
        gains: log-likelihood of each error over the static one, [Q], nats.
        prev_gains: the same before, [Q], or [1] for all of them.
        groups: number of the group of each error, [Q]; at least two groups.
    """
    # Paired: both likelihoods are of the same errors, whose own scatter cancels.
    more = gains - prev_gains
    return bool(more.mean() > max(MIN_GAIN, STANDARD_ERRORS * _standard_error(more, groups)))


def _standard_error(values: FloatArray, groups: IntArray) -> float:
    """Return the cluster-robust standard error of the mean of Q values in G groups.

    Values of one group are correlated, so that only the sums of the groups are independent:

        √(G/(G − 1) Σ_g (Σ_{q in g} (v_q − v̄))²) / Q.
    """
    num_groups = len(np.unique(groups))
    sums = np.bincount(groups, weights=values - values.mean())
    variance = num_groups / (num_groups - 1) * np.sum(sums**2)
    return float(np.sqrt(variance)) / len(values)


def _with_weight(weights: FloatArray, column: int, weight: float) -> FloatArray:
    return np.where(np.arange(len(weights)) == column, weight, weights)

"""What a generalized kernel is not told, it chooses by the predictive likelihood of groups left
out."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.errors import InputError
from probevo.noise.base import StereoNoise
from probevo.noise.gk.folds import MOST_SAMPLES, Fold, folds_of
from probevo.noise.gk.posterior import KernelPosterior, KernelShape
from probevo.noise.student_t_fit import DIM, Neighborhoods
from probevo.noise.student_t_numba import LEAST_DOF, MOST_DOF

LARGEST_WEIGHT = 1e6
"""Of a column, so that squares of distances stay within single precision."""
FACTORS = (0.5, 2.0)
"""By which a column's weight is tried, once the columns are chosen."""
SEARCH_ITERATIONS = 6
"""Of each fit; the chosen shape is fitted with more."""
LEAST_GAIN = 2e-3
"""Nats a feature that another column, or another weight of one, must gain."""
STANDARD_ERRORS = 1.0
"""By which it must, as far as the features asked differ in it."""
TIE = 2e-4
"""Nats a feature by which shapes of the kernel are as good as each other. It is small, as the few
best features carry the motion: a prior that is too heavy for them alone, or a K too large, hardly
shows in the mean over all."""
LIGHT = 1.0
"""Errors that the prior counts for while the rest is chosen: under a heavier one small K look worse
than they are."""
DOF_TOLERANCE = 0.1
"""Of ln ν."""
CANDIDATES: dict[str, tuple[float, ...]] = {
    "neighbors": (1600, 800, 400, 200, 100, 50),
    "bias_counts": (np.inf, 100.0, 10.0),
    "prior_counts": (64.0, 16.0, 4.0, 1.0, 0.25, 0.0625),
    "dof_counts": (np.inf, 300.0, 100.0, 30.0, 10.0),
}
PUBLISHED: dict[str, tuple[float, ...]] = {
    "reach": (0.125, 0.25, 0.5, 1.0, 2.0),
    "prior_counts": (5.0, 20.0, 80.0),
}
NEIGHBORS_GROW = 0.5
"""K goes with this power of the number of samples: as N^(4/(4 + M)) is best for M of four effective
columns."""
Search = dict[str, dict[str, Any]]
"""By the name of what was chosen: candidates, nats a feature that each gains over the static model,
and the chosen."""


def check_given(given: Mapping[str, Any], dimension: int, published: bool) -> None:
    """Refuse a shape of the kernel that is not valid for places of M columns.

    Raises:
        InputError: names what is wrong.
    """
    if dimension == 0:
        raise InputError(
            "predictors", "there is no column.", "Without any, StudentT says the same."
        )
    least = {
        "neighbors": 1,
        "centers": 1,
        "prior_counts": np.nextafter(DIM - 1.0 if published else 0.0, np.inf),
    }
    for name, value in given.items():
        if name == "weights":
            continue
        if not value >= least.get(name, np.nextafter(0.0, np.inf)):
            raise InputError(
                "generalized kernel",
                f"{name} is {value}, which is too small.",
                "Leave it to be chosen.",
            )
        if name in ("neighbors", "centers", "prior_counts") and not np.isfinite(value):
            raise InputError(
                "generalized kernel",
                f"{name} is {value}, which is no number.",
                "Leave it to be chosen.",
            )
        if name in ("neighbors", "centers") and int(value) != value:
            raise InputError(
                "generalized kernel", f"{name} is {value}, which is no whole number.", "Round it."
            )
    weights = np.asarray(given.get("weights", np.ones(dimension)), dtype=np.float64)
    fits = weights.shape == (dimension,) and bool(
        ((weights >= 0.0) & (weights <= LARGEST_WEIGHT)).all()
    )
    if not fits or not weights.any():
        what = (
            f"weights are {weights}, where {dimension} from 0 to {LARGEST_WEIGHT:g} are expected,"
            " not all of them 0."
        )
        raise InputError("generalized kernel", what, "Leave them to be chosen.")


def choose_shape(
    coordinates: FloatArray,
    errors: FloatArray,
    spread: FloatArray | None,
    groups: IntArray | None,
    given: Mapping[str, Any],
    published: bool,
    on_progress: Callable[[int, int], None] | None = None,
) -> tuple[FloatArray, KernelShape, Search]:
    """Weights of the columns, [M], and the shape of the kernel: what is given stays, the rest is
    searched one by one.

    With fewer than two groups there is nothing to judge by, and what is not given keeps its
    default.

    Args:
        coordinates, errors, spread: the N samples, standardised, [N, M], [N, 4] and [N, 4, 4] or
            None.
        groups: [N]; consecutive samples by default.
        given: what need not be chosen, by the names of ``KernelShape``, and ``weights``.
        published: choose a fixed support instead of K, and all weights alike.
        on_progress: called with how many steps are done, and how many there are at most.
    """
    dimension = coordinates.shape[1]
    weights = np.asarray(given.get("weights", np.ones(dimension)), dtype=np.float64)
    given = {name: int(value) if name == "neighbors" else value for name, value in given.items()}
    shape = replace(
        KernelShape(), **{name: value for name, value in given.items() if name != "weights"}
    )
    if published and "reach" not in given:
        shape = replace(shape, reach=0.5)
    candidates = {
        name: c for name, c in (PUBLISHED if published else CANDIDATES).items() if name not in given
    }
    if not candidates and published:
        return weights, shape, {}
    folds = folds_of(coordinates, errors, spread, groups=groups, published=published)
    if len(folds) < 2:
        return weights, shape, {}
    # The search learns from fewer samples, where K as large would reach farther.
    shape = shape if published or "prior_counts" in given else replace(shape, prior_counts=LIGHT)
    fewer = max(1.0, len(errors) / MOST_SAMPLES) ** NEIGHBORS_GROW
    shape = (
        replace(shape, neighbors=max(1, round(shape.neighbors / fewer)))
        if "neighbors" in given
        else shape
    )
    search = _Search(folds, published, on_progress)
    is_free = "weights" not in given and not published
    search.total = (dimension * (dimension + 1) // 2 if is_free else 0) + len(candidates)
    if is_free:
        weights = search.choose_weights(dimension, shape)
    if candidates and not published:
        shape = search.choose_dof(weights, shape)
    for name, values in candidates.items():
        shape = search.choose(name, values, weights, shape)
    if not published:  # again, for the neighbourhoods that were chosen
        shape = search.choose_dof(weights, shape)
    return (
        weights,
        replace(shape, neighbors=given.get("neighbors", round(shape.neighbors * fewer))),
        search.found,
    )


class _Search:
    def __init__(
        self, folds: list[Fold], published: bool, on_progress: Callable[[int, int], None] | None
    ) -> None:
        self.folds = folds
        self.published = published
        self.on_progress = on_progress
        self.found: Search = {}
        self._at: tuple[bytes, int, float] | None = None
        self._near: list[tuple[KernelPosterior, Neighborhoods]] = []
        self.done = self.total = 0

    def gain(self, weights: FloatArray, shape: KernelShape) -> float:
        """Mean log-likelihood over that of the static model, nats a feature."""
        return float(np.mean(self.gains(weights, shape)))

    def gains(self, weights: FloatArray, shape: KernelShape) -> FloatArray:
        """The same of each feature that is asked, of one fold after another, [Q]."""
        with ThreadPoolExecutor(2) as pool:
            # Most shapes that are tried share their neighbourhoods, which take as long to find as
            # to fit to.
            if self._at != (at := (weights.tobytes(), shape.neighbors, shape.reach)):
                self._near = list(
                    pool.map(lambda fold: self._neighborhoods(fold, weights, shape), self.folds)
                )
                self._at = at
            parts = pool.map(
                lambda fold, near: _gains_of_fold(fold, near[0], near[1], shape=shape),
                self.folds,
                self._near,
            )
            return np.concatenate(list(parts))

    def choose_weights(self, dimension: int, shape: KernelShape) -> FloatArray:
        """Column after column, that which gains the most beside those before; then each one's
        weight.

        The first stays even if it gains nothing: all of them would do more harm.
        """
        weights = np.zeros(dimension)
        best = np.zeros(1)
        order: list[tuple[int, float]] = []
        varies = np.any([np.ptp(fold.coordinates, axis=0) > 0.0 for fold in self.folds], axis=0)
        while len(free := np.flatnonzero(varies & (weights == 0.0))):
            found = self._best([_with(weights, m, 1.0) for m in free.tolist()], shape)
            self._step(len(free))
            gains_more = is_better(found[1], best)
            if order and not gains_more:
                break
            order.append((int(np.flatnonzero(found[0] != weights)[0]), float(found[1].mean())))
            weights = found[0]
            best = found[1] if gains_more else best
        for m, _ in order:
            found = self._best([_with(weights, m, factor) for factor in FACTORS], shape)
            if is_better(found[1], best):
                weights, best = found
        self.found["weights"] = {
            "candidates": [m for m, _ in order],
            "gains": [gain for _, gain in order],
            "chosen": weights.tolist(),
        }
        return weights if weights.any() else np.ones(dimension)

    def _best(self, options: list[FloatArray], shape: KernelShape) -> tuple[FloatArray, FloatArray]:
        """The weights that gain the most, and the gain of each feature, [Q]."""
        gains = [self.gains(weights, shape) for weights in options]
        best = int(np.argmax([np.mean(gain) for gain in gains]))
        return options[best], gains[best]

    def choose(
        self, name: str, values: tuple[float, ...], weights: FloatArray, shape: KernelShape
    ) -> KernelShape:
        """One hyperparameter; of those that are as good, the first: the stiffest."""
        changes: list[dict[str, Any]] = [
            {name: int(v) if name == "neighbors" else v} for v in values
        ]
        options = [replace(shape, **change) for change in changes]
        gains = [self.gain(weights, option) for option in options]
        chosen = int(np.argmax(np.array(gains) > max(gains) - TIE))
        plain = [value if np.isfinite(value) else "none" for value in values]
        self.found[name] = {"candidates": plain, "gains": gains, "chosen": plain[chosen]}
        self._step()
        return options[chosen]

    def choose_dof(self, weights: FloatArray, shape: KernelShape) -> KernelShape:
        """The degrees of freedom under which errors are the most likely, each against the scale of
        its own place.

        They have no stiff end that a tie should go to: too few take the scale down with them, and
        then half of all
        errors are outside the region that should hold them.
        """
        from scipy.optimize import minimize_scalar  # slow to load, and only training needs it

        held = replace(shape, dof_counts=np.inf)
        best = minimize_scalar(
            lambda logarithm: -self.gain(weights, replace(held, dof=math.exp(logarithm))),
            bounds=(math.log(LEAST_DOF), math.log(MOST_DOF)),
            method="bounded",
            options={"xatol": DOF_TOLERANCE},
        )
        dof = math.exp(best.x)
        self.found["dof"] = {"candidates": [dof], "gains": [-float(best.fun)], "chosen": dof}
        return replace(shape, dof=dof)

    def _neighborhoods(
        self, fold: Fold, weights: FloatArray, shape: KernelShape
    ) -> tuple[KernelPosterior, Neighborhoods]:
        used = weights > 0.0
        coordinates, places = (
            np.ascontiguousarray((x * weights)[:, used]) for x in (fold.coordinates, fold.places)
        )
        posterior = KernelPosterior.of(
            coordinates, fold.errors, fold.spread, published=self.published, prior=fold.prior
        )
        return posterior, posterior.around(places, shape)

    def _step(self, steps: int = 1) -> None:
        self.done += steps
        if self.on_progress is not None:
            self.on_progress(self.done, self.total)


def _gains_of_fold(
    fold: Fold, posterior: KernelPosterior, near: Neighborhoods, shape: KernelShape
) -> FloatArray:
    students, _ = posterior.fit(near, shape, SEARCH_ITERATIONS)
    noise = StereoNoise(students.scale, students.dof, students.bias)
    return noise.log_likelihood(fold.asked) - fold.static


def is_better(gains: FloatArray, before: FloatArray) -> bool:
    """Whether the same features, [Q], gain more than chance explains, and enough."""
    more = gains - before
    return bool(more.mean() > max(LEAST_GAIN, STANDARD_ERRORS * more.std() / np.sqrt(len(more))))


def _with(weights: FloatArray, column: int, weight: float) -> FloatArray:
    return np.where(np.arange(len(weights)) == column, weight, weights)

"""The noise at a place of the prediction space, from the errors of the training data around it
(PROBE-GK eqs. 6-12).

As published, a kernel of fixed support ρ, k = 1 − (distance/ρ)², adds every squared error within to
an inverse-Wishart prior: Ψ* = Ψ₀ + Σ k e eᵀ, ν* = ν₀ + Σ k [1.8, 1.9], and the noise is the
Student-t of ν* − d + 1 degrees of freedom and scale Ψ*/(ν* − d + 1) [1.12]. One gross outlier then
inflates Ψ* for all its neighbours, and ν* grows with the number of samples, whatever their tails:
the loss becomes quadratic.

Ours is the fit of a Student-t with a bias to the K nearest errors, weighed by the same kernel,
whose support ends at the K-th and at ρ at the latest; the prior is the Student-t of all errors.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from probevo.arrays import FloatArray, IntArray
from probevo.noise.student_t_fit import (
    DIM,
    Neighborhoods,
    StudentPrior,
    Students,
    fit_static,
    fit_students,
    floored,
)

THREADS = 2
BLOCK = 2000
MOST_PAIRS = 4_000_000
"""Places whose neighbours are held in memory at a time, and pairs of a place and a neighbour, in
the worst case."""

LEAF = 32
"""Samples of a leaf of the tree: with hundreds of neighbours, a third faster than SciPy's 10 in
eight columns."""
SEED = 0
"""Of the order in which samples go into the tree."""


@dataclass(frozen=True)
class KernelShape:
    """Everything that is chosen from the data unless given."""

    reach: float = np.inf
    """ρ: samples farther away do not contribute, in standard deviations."""
    neighbors: int = 400
    """K; as published, all within ρ contribute."""
    prior_counts: float = 16.0
    """How many errors the prior counts for."""
    dof_counts: float = 100.0
    """The same for the degrees of freedom; np.inf holds them."""
    bias_counts: float = 100.0
    """The same for the bias, which is zero; np.inf holds it there."""
    dof: float | None = None
    """What they shrink to: those of errors held against the scale of their own place. None takes
    those of all errors against one scale, which are fewer: a mixture of good and bad places looks
    heavy-tailed, whatever each of them."""

    def as_given(self) -> dict[str, Any]:
        """As ``GeneralizedKernel`` takes what it need not choose; ``dof`` it always estimates."""
        return {name: value for name, value in asdict(self).items() if name != "dof"}


@dataclass(frozen=True)
class KernelPosterior:
    """N samples: places and errors, and the prior."""

    coordinates: FloatArray
    """[N, M]."""
    errors: FloatArray
    """[N, 4], px."""
    spread: FloatArray | None
    """Covariance of what is not known of each error, [N, 4, 4], px²; None if all are exact."""
    published: bool
    prior: Students
    """C = 1: what holds where nothing is known."""
    order: IntArray = field(repr=False)
    """A random one, in which the tree holds the samples: of many at one and the same place it finds
    the first K, and these must not be one end of the recording, [N]."""
    tree: KDTree = field(repr=False)

    @staticmethod
    def of(
        coordinates: FloatArray,
        errors: FloatArray,
        spread: FloatArray | None,
        *,
        published: bool = False,
        prior: Students | None = None,
    ) -> KernelPosterior:
        """Samples [N, M], [N, 4]; the prior, if it is not given, is fitted to all of them."""
        prior = prior or prior_of(errors, spread, published=published)
        order = np.random.default_rng(SEED).permutation(len(coordinates))
        return KernelPosterior(
            coordinates,
            errors,
            spread,
            published=published,
            prior=prior,
            order=order,
            tree=KDTree(coordinates[order], LEAF),
        )

    def at(
        self, places: FloatArray, shape: KernelShape, iterations: int = 12
    ) -> tuple[Students, FloatArray]:
        """The noise at n places, [n, M], and Σk of each, [n]."""
        neighbors = len(self.errors) if self.published else min(shape.neighbors, len(self.errors))
        block = max(min(MOST_PAIRS // neighbors, BLOCK, -(-len(places) // THREADS)), 1)
        blocks = [places[start : start + block] for start in range(0, max(len(places), 1), block)]
        with ThreadPoolExecutor(THREADS) as pool:
            parts = list(
                pool.map(lambda part: self.fit(self.around(part, shape), shape, iterations), blocks)
            )
        students = Students(
            *(
                np.concatenate([getattr(p[0], name) for p in parts])
                for name in ("scale", "dof", "bias")
            )
        )
        return students, np.concatenate([part[1] for part in parts])

    def radius(self, places: FloatArray, neighbors: int) -> FloatArray:
        """Distance from each place, [n, M], to its K-th nearest sample, [n]."""
        distance: FloatArray = np.asarray(
            self.tree.query(places, [min(neighbors, len(self.errors))])[0]
        )
        return distance[:, 0]

    def around(self, places: FloatArray, shape: KernelShape) -> Neighborhoods:
        """The samples that contribute at n places, [n, M], and how much each does."""
        return self._within(places, shape) if self.published else self._nearest(places, shape)

    def _within(self, places: FloatArray, shape: KernelShape) -> Neighborhoods:
        """All samples within ρ."""
        found = self.tree.query_ball_point(places, shape.reach, return_sorted=True)
        lists = [self.order[own] for own in found]
        first: IntArray = np.cumsum([0, *map(len, lists)])
        index = np.concatenate([np.zeros(0, np.int64), *lists])
        owner = np.repeat(np.arange(len(places)), np.diff(first))
        squared = np.sum((self.coordinates[index] - places[owner]) ** 2, axis=1)
        return Neighborhoods(first, index, 1.0 - squared / shape.reach**2)

    def _nearest(self, places: FloatArray, shape: KernelShape) -> Neighborhoods:
        """The K nearest samples within ρ; the kernel ends at the K-th."""
        ranks = np.arange(1, min(shape.neighbors, len(self.errors)) + 1)
        distance, near = map(
            np.asarray, self.tree.query(places, ranks, distance_upper_bound=shape.reach)
        )
        found = np.isfinite(distance)
        # The K-th itself contributes a little, and where all K lie at the very place, all do.
        support = np.where(found[:, -1:], distance[:, -1:], shape.reach) * (1.0 + 1e-3) + 1e-12
        kernel = np.where(found, 1.0 - (np.where(found, distance, 0.0) / support) ** 2, 0.0)
        first: IntArray = np.concatenate([[0], np.cumsum(found.sum(axis=1))])
        return Neighborhoods(first, self.order[near[found]], kernel[found])

    def fit(
        self, near: Neighborhoods, shape: KernelShape, iterations: int
    ) -> tuple[Students, FloatArray]:
        """The noise of places around which these samples are, and Σk of each, [n]."""
        counts = near.counts
        prior_dof = float(self.prior.dof[0]) if shape.dof is None else shape.dof
        prior = StudentPrior(
            self.prior.scale[0],
            prior_dof,
            shape.prior_counts,
            dof_counts=shape.dof_counts,
            bias_counts=shape.bias_counts,
        )
        fitted = fit_students(
            self.errors,
            near,
            prior,
            spread=self.spread,
            iterations=iterations,
            robust=not self.published,
        )
        if self.published:
            posterior = shape.prior_counts + counts  # ν*
            dof = posterior - DIM + 1.0
            fitted = Students(fitted.scale * (posterior / dof)[:, None, None], dof, fitted.bias)
        return fitted, counts


def prior_of(errors: FloatArray, spread: FloatArray | None = None, *, published: bool) -> Students:
    """What holds where nothing is known: the Student-t of all errors; as published R̂ = Ψ₀/ν₀,
    their mean square."""
    if not published:
        return fit_static(errors, spread=spread)
    squares = errors.T @ errors + (0.0 if spread is None else spread.sum(axis=0))
    return Students(floored(squares / len(errors))[None], np.array([np.inf]), np.zeros((1, DIM)))

"""The distribution of the error at a point of the prediction space, from the errors around it.

As published (PROBE-GK eqs. (6)-(12)), a kernel of fixed support ρ, k(φ, φᵢ) = 1 − (|φ − φᵢ|/ρ)²,
weighs the squared errors within and adds them to an inverse-Wishart prior,

    Ψ* = Ψ₀ + Σ kᵢ eᵢ eᵢᵀ  (8),        ν* = ν₀ + Σ kᵢ  (9),

which predicts a Student-t of ν* − d + 1 degrees of freedom and scale Ψ*/(ν* − d + 1) (12). A single
gross outlier then inflates Ψ* for all points near it, and ν* grows with the number of samples
whatever the tails of their errors, so that the loss becomes quadratic.

The robust variant fits a Student-t with a bias to the K nearest errors under the same kernel, with
a prior that counts as further errors (``student_t_fit``). Its support ends at the K-th neighbour,
or at ρ if that is nearer. Its prior is the Student-t of all errors.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from probevo.arrays import FloatArray, IntArray
from probevo.noise.student_t_arrays import DIM, Neighborhoods, StudentTBatch, StudentTPrior
from probevo.noise.student_t_fit import fit_static, fit_student_ts, regularized

THREADS = 2
BLOCK = 2000
"""Number of points whose neighbours are held in memory at a time."""
MAX_PAIRS = 4_000_000
"""Number of pairs of a point and a neighbour that a block has at most."""
TREE_LEAF = 32
"""Samples in a leaf of the k-d tree: for hundreds of neighbours in eight columns, a third faster
than SciPy's 10."""
SEED = 0
"""Seed of the order in which samples go into the tree."""


@dataclass(frozen=True)
class KernelShape:
    """The hyperparameters of a kernel and its prior; chosen from the data unless given."""

    reach: float = np.inf
    """Support ρ, in standard deviations: samples farther away do not contribute."""
    neighbors: int = 400
    """K of the robust variant; as published, all samples within ρ contribute."""
    prior_counts: float = 16.0
    """Pseudo-counts of the prior scale; as published, ν₀."""
    dof_counts: float = 100.0
    """Pseudo-counts of the prior degrees of freedom; np.inf holds them."""
    bias_counts: float = 100.0
    """Pseudo-counts of the bias, whose prior is zero; np.inf holds it there."""
    dof: float | None = None
    """Prior degrees of freedom, estimated from errors under the scales of their own points. None
    takes the degrees of freedom of all errors under one scale, which are too few: a mixture of good
    and bad points has heavy tails even if each point is Gaussian."""

    def as_given(self) -> dict[str, Any]:
        """Return the arguments by which ``GeneralizedKernel`` need not choose any of these again.

        ``dof`` is not among them; it is always estimated.
        """
        return {name: value for name, value in asdict(self).items() if name != "dof"}


@dataclass(frozen=True)
class KernelSamples:
    """N training samples: points in the prediction space, and an error at each."""

    coordinates: FloatArray
    """Places, in the coordinates of the metric, [N, M]."""
    errors: FloatArray
    """[N, 4], px."""
    error_cov: FloatArray | None = None
    """Covariance of each error, [N, 4, 4], px²; None if they are known exactly."""

    def subset(self, chosen: IntArray) -> KernelSamples:
        """Return some of the samples, given their indices."""
        error_cov = None if self.error_cov is None else self.error_cov[chosen]
        return KernelSamples(
            coordinates=self.coordinates[chosen], errors=self.errors[chosen], error_cov=error_cov
        )


@dataclass(frozen=True)
class KernelPosterior:
    """The posterior predictive distribution at any point, given N samples and a prior."""

    samples: KernelSamples
    published: bool
    """Whether this is the published variant, or the robust one."""
    prior: StudentTBatch
    """The distribution without any sample near, C = 1."""
    order: IntArray = field(repr=False)
    """Random order in which the tree holds the samples, [N]. Of many samples at the same point the
    tree returns the first K, which must not all be from one end of the recording."""
    tree: KDTree = field(repr=False)

    @staticmethod
    def of(
        samples: KernelSamples, *, published: bool = False, prior: StudentTBatch | None = None
    ) -> KernelPosterior:
        """Store the samples; a prior that is not given is fitted to all of them."""
        order = np.random.default_rng(SEED).permutation(len(samples.errors))
        return KernelPosterior(
            samples=samples,
            published=published,
            prior=prior or prior_of(samples, published=published),
            order=order,
            tree=KDTree(samples.coordinates[order], TREE_LEAF),
        )

    def at(
        self, points: FloatArray, shape: KernelShape, iterations: int = 12
    ) -> tuple[StudentTBatch, FloatArray]:
        """Compute the predictive distribution at n points, [n, M].

        Returns:
            The n distributions, and the effective number of samples Σ k of each, [n].
        """
        # The points are divided into blocks, so that the pairs of a point and a neighbour fit into
        # memory, and each thread has work.
        count = len(self.samples.errors)
        neighbors = count if self.published else min(shape.neighbors, count)
        block = max(min(MAX_PAIRS // neighbors, BLOCK, -(-len(points) // THREADS)), 1)
        starts = range(0, max(len(points), 1), block)

        def predict(start: int) -> tuple[StudentTBatch, FloatArray]:
            """Predict at the points of one block."""
            near = self.around(points[start : start + block], shape)
            return self.fit(near, shape, iterations)

        with ThreadPoolExecutor(THREADS) as pool:
            parts = list(pool.map(predict, starts))
        fitted = StudentTBatch(
            scale=np.concatenate([part.scale for part, _ in parts]),
            dof=np.concatenate([part.dof for part, _ in parts]),
            bias=np.concatenate([part.bias for part, _ in parts]),
        )
        return fitted, np.concatenate([counts for _, counts in parts])

    def around(self, points: FloatArray, shape: KernelShape) -> Neighborhoods:
        """Find the samples that contribute at n points [n, M], and the kernel k of each."""
        if self.published:
            return self._within_reach(points, shape)
        return self._nearest(points, shape)

    def _within_reach(self, points: FloatArray, shape: KernelShape) -> Neighborhoods:
        """Find all samples within ρ."""
        # The tree returns a list of neighbours for each point; they are joined into one array.
        tree_positions = self.tree.query_ball_point(points, shape.reach, return_sorted=True)
        members_of_each = [self.order[positions] for positions in tree_positions]
        first: IntArray = np.cumsum([0, *map(len, members_of_each)])
        members = np.concatenate([np.zeros(0, np.int64), *members_of_each])
        # The point that each of the members belongs to, and k = 1 − (|φ − φᵢ|/ρ)² there
        point = np.repeat(np.arange(len(points)), np.diff(first))
        squared = np.sum((self.samples.coordinates[members] - points[point]) ** 2, axis=1)
        return Neighborhoods(first=first, members=members, kernel=1.0 - squared / shape.reach**2)

    def _nearest(self, points: FloatArray, shape: KernelShape) -> Neighborhoods:
        """Find the K nearest samples within ρ; the kernel ends at the K-th."""
        # The tree reports a missing neighbour at distance ∞.
        ranks = np.arange(1, min(shape.neighbors, len(self.samples.errors)) + 1)
        nearest = self.tree.query(points, ranks, distance_upper_bound=shape.reach)
        distance = np.asarray(nearest[0])
        near = np.asarray(nearest[1])
        is_within = np.isfinite(distance)  # [n, K]; nearest first, hence a missing one is last
        # Support of the kernel of each point, [n, 1]: the distance of the K-th sample, or ρ if
        # fewer are within it. It is a little wider, so that the K-th contributes, and all do where
        # all K lie at the very point.
        radius = np.where(is_within[:, -1:], distance[:, -1:], shape.reach)
        support = radius * (1.0 + 1e-3) + 1e-12
        kernel = np.where(is_within, 1.0 - (np.where(is_within, distance, 0.0) / support) ** 2, 0.0)
        first: IntArray = np.concatenate([[0], np.cumsum(is_within.sum(axis=1))])
        return Neighborhoods(
            first=first, members=self.order[near[is_within]], kernel=kernel[is_within]
        )

    def fit(
        self, near: Neighborhoods, shape: KernelShape, iterations: int
    ) -> tuple[StudentTBatch, FloatArray]:
        """Compute the predictive distribution of given neighbourhoods; the prior, if one is empty.

        Returns:
            The n distributions, and Σ k of each, [n].
        """
        counts = near.counts
        prior = StudentTPrior(
            scale=self.prior.scale[0],
            dof=float(self.prior.dof[0]) if shape.dof is None else shape.dof,
            counts=shape.prior_counts,
            dof_counts=shape.dof_counts,
            bias_counts=shape.bias_counts,
        )
        fitted = fit_student_ts(
            self.samples.errors,
            near,
            prior,
            error_cov=self.samples.error_cov,
            iterations=iterations,
            robust=not self.published,
        )
        if self.published:
            # The fit is Ψ*/ν*, by eqs. (8) and (9) with Ψ₀ = ν₀ R̂; eq. (12) divides by ν* − d + 1.
            # prior_counts is ν₀, so that ν* = ν₀ + Σ k.
            nu = shape.prior_counts + counts
            dof = nu - DIM + 1.0
            scale = fitted.scale * (nu / dof)[:, None, None]
            return StudentTBatch(scale=scale, dof=dof, bias=fitted.bias), counts
        # ν of the shape belongs to errors under the scale of their point. The scale of all errors
        # goes with the ν that was fitted together with it.
        is_empty = counts == 0.0
        fitted.scale[is_empty] = self.prior.scale
        fitted.dof[is_empty] = self.prior.dof
        return fitted, counts

    def radius(self, points: FloatArray, neighbors: int) -> FloatArray:
        """Return the distance from each point, [n, M], to its K-th nearest sample, [n]."""
        rank = min(neighbors, len(self.samples.errors))
        distance: FloatArray = np.asarray(self.tree.query(points, [rank])[0])
        return distance[:, 0]


def prior_of(samples: KernelSamples, *, published: bool) -> StudentTBatch:
    """Fit the prior to all samples, C = 1.

    The robust prior is their Student-t. The published one is their mean square R̂ = Ψ₀/ν₀.
    """
    if not published:
        return fit_static(samples.errors, samples.error_cov)
    errors = samples.errors
    added = 0.0 if samples.error_cov is None else samples.error_cov.sum(axis=0)
    # E[e eᵀ] of an error that is known with the covariance U only is e eᵀ + U.
    mean_square = (errors.T @ errors + added) / len(errors)
    return StudentTBatch(
        scale=regularized(mean_square)[None], dof=np.array([np.inf]), bias=np.zeros((1, DIM))
    )

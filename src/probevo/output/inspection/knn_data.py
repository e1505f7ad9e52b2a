"""A PROBE model over its own training data, and what it makes of the features of a frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from probevo.arrays import FloatArray, evenly
from probevo.noise.probe.nearest_neighbors import NearestNeighbors
from probevo.output.inspection.profiles import Profile, profile_along

MAX_QUERIES = 4000
"""Training samples whose weights are shown."""
MAX_RADII = 800
"""Training samples whose distance to their neighbours is measured, at 20 ms each."""
MAX_NEIGHBORS_OF = 50_000
"""Training samples that distances are measured to. Of more, this number is chosen evenly, and K is
reduced in proportion."""
FAR_QUANTILE = 0.99
"""A feature is far from the training data if its K-th nearest sample is farther away than that of
this share of the training samples."""
_BLOCK = 64
"""Queries whose distances to all samples are held in memory at a time."""


class Searched(NamedTuple):
    """A hyperparameter of PROBE that was searched for."""

    symbol: str
    errors: str
    """Errors by which the candidates are compared, in words."""
    errors_in_short: str
    """Shorter name of the errors, for a small figure."""
    unit_factor: float
    """Factor on the errors to the unit that they are shown in."""


SEARCHED = {
    "neighbors": Searched(
        "K", "squared error of left-out samples", "squared error, left-out samples", unit_factor=1.0
    ),
    "exponent": Searched(
        "γ",
        "mean error on the training drives, mm",
        "mean α, training drives, mm",
        unit_factor=1e3,
    ),
}
"""The hyperparameters, by their names in the log of the searches."""


@dataclass(frozen=True)
class ModelView:
    """A model of M columns over its own N training samples."""

    name: str
    model: NearestNeighbors
    units: Mapping[str, str]
    """Unit of each column whose unit is known."""
    points: FloatArray
    """φ of the samples, [N, M]; NaN where undefined."""
    log_alpha: FloatArray
    """ln(α/ᾱ) of each, [N]."""
    profiles: tuple[Profile, ...]
    """How ln(α/ᾱ) varies along each of the M columns."""
    beta: FloatArray
    """Weights of evenly chosen samples."""
    radius: FloatArray
    """Distances to the K-th nearest sample, of evenly chosen samples."""

    @staticmethod
    def of(name: str, model: NearestNeighbors, units: Mapping[str, str]) -> ModelView:
        """Compute all that is shown of a fitted model."""
        points, log_alpha = model.samples()
        chosen = points[evenly(len(points), MAX_QUERIES)]
        return ModelView(
            name=name,
            model=model,
            units=units,
            points=points,
            log_alpha=log_alpha,
            profiles=tuple(profile_along(column, log_alpha) for column in points.T),
            beta=model.weights(chosen),
            radius=neighbor_radius(model, points[evenly(len(points), MAX_RADII)]),
        )

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the M columns."""
        return self.model.columns

    @property
    def order(self) -> list[int]:
        """Rank the columns, from the one along which α varies most."""
        return sorted(range(len(self.columns)), key=lambda m: -self.profiles[m].share_explained)

    @property
    def far_radius(self) -> float:
        """Distance to the K-th nearest sample beyond which a point is far from the data."""
        return float(np.quantile(self.radius, FAR_QUANTILE))


@dataclass(frozen=True)
class FrameWeights:
    """Weights of the N features of a frame by a model."""

    beta: FloatArray
    """Weight of each, [N]."""
    radius: FloatArray
    """Distance of each to the K-th nearest training sample, [N]."""

    @staticmethod
    def of(model: NearestNeighbors, phi: FloatArray) -> FrameWeights:
        """Weigh features at these points of the prediction space, [N, M]."""
        return FrameWeights(beta=model.weights(phi), radius=neighbor_radius(model, phi))


def neighbor_radius(model: NearestNeighbors, points: FloatArray) -> FloatArray:
    """Measure the distance from n points, [n, M], to the K-th nearest training sample each, [n].

    The nearest sample would mislead: a point that was tracked over some frames left as many samples
    close together, and the training data would look denser than any other drive can be.
    """
    all_samples = model.index_.samples
    samples = all_samples[:, evenly(all_samples.shape[1], MAX_NEIGHBORS_OF)]
    wanted = max(1, round(model.neighbors * samples.shape[1] / all_samples.shape[1]))
    half_squares = 0.5 * np.sum(samples * samples, axis=0)
    queries = model.metric_.coordinates(points).astype(np.float32)
    radius = np.empty(len(queries))
    # ‖q − s‖² = ‖q‖² + 2 (‖s‖²/2 − q·s): the order of the samples depends on the bracket only.
    for start in range(0, len(queries), _BLOCK):
        block = queries[start : start + _BLOCK]
        halves = np.partition(half_squares - block @ samples, wanted - 1, axis=1)[:, wanted - 1]
        radius[start : start + _BLOCK] = np.sqrt(
            np.maximum(2.0 * halves + np.sum(block * block, axis=1), 0.0)
        )
    return radius


def rank_correlation(points: FloatArray) -> FloatArray:
    """Compute Spearman's correlation of the columns of [N, M], [M, M].

    Undefined values are left out; a constant column has correlation 0.
    """
    ranks = np.full(points.shape, np.nan)
    for m, column in enumerate(points.T):
        known = np.isfinite(column)
        # Equal values share the mean of their ranks, so that their order does not matter.
        _, inverse, count = np.unique(column[known], return_inverse=True, return_counts=True)
        ranks[known, m] = (np.cumsum(count) - 0.5 * (count - 1))[inverse]
        ranks[:, m] -= ranks[known, m].mean() if known.any() else 0.0
    known = np.isfinite(ranks).astype(float)
    ranks = np.nan_to_num(ranks)
    squares = (ranks**2).T @ known
    scale = np.sqrt(squares * squares.T)
    correlation: FloatArray = np.where(
        scale > 0.0, ranks.T @ ranks / np.where(scale > 0.0, scale, 1.0), 0.0
    )
    return correlation

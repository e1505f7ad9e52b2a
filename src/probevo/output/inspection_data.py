"""What a page about a noise model shows: the model over its own training data, and the features of
one frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from probevo.arrays import FloatArray, Image, evenly
from probevo.noise.base import StereoNoise
from probevo.noise.probe.nearest_neighbors import NearestNeighbors
from probevo.output.profiles import Profile, profile_along

MOST_QUERIES = 4000
"""Training samples whose weight is shown; and whose neighbours are looked for, of which each costs
20 ms."""
MOST_RADII = 800
MOST_NEIGHBORS_OF = 50_000
"""Training samples that distances are measured to; of more, evenly chosen ones, and K shrinks
alike."""
FAR_QUANTILE = 0.99
"""A feature is far from the training data if its K nearest reach farther than for so many of these
themselves."""
_BLOCK = 64


@dataclass(frozen=True)
class ModelView:
    """A model of M columns over its own N training samples."""

    name: str
    model: NearestNeighbors
    units: Mapping[str, str]
    """Unit of each column whose unit is known."""
    places: FloatArray
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
        """Take all that is shown from a fitted model."""
        places, log_alpha = model.samples()
        chosen = places[evenly(len(places), MOST_QUERIES)]
        return ModelView(
            name=name,
            model=model,
            units=units,
            places=places,
            log_alpha=log_alpha,
            profiles=tuple(profile_along(column, log_alpha) for column in places.T),
            beta=model.weights(chosen),
            radius=neighbor_radius(model, places[evenly(len(places), MOST_RADII)]),
        )

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the M columns."""
        return self.model.columns

    @property
    def order(self) -> list[int]:
        """The columns, from that along which α varies the most."""
        return sorted(range(len(self.columns)), key=lambda m: -self.profiles[m].share_explained)

    @property
    def far_radius(self) -> float:
        """Distance to the K-th nearest from which on a place counts as far from the training data."""
        return float(np.quantile(self.radius, FAR_QUANTILE))


@dataclass(frozen=True)
class FrameView:
    """The N features of one frame, their M predictors, and what a model makes of them."""

    recording: str
    """Name of the recording."""
    index: int
    """Of the frame, from 0."""
    left: Image | None
    """Left image; None where the recording has none."""
    size_px: tuple[int, int]
    """(width, height) of the image, or of the area in which features were seen."""
    uv: FloatArray
    """Where the features are in the left image, [N, 2], px."""
    columns: Mapping[str, str]
    """Name and unit of each of the M columns."""
    phi: FloatArray
    """Their places in the prediction space, [N, M]; NaN where undefined."""
    beta: FloatArray | None = None
    """Weight of each, [N]; None without a model of such."""
    radius: FloatArray | None = None
    """Distance to the K-th nearest training sample of each, [N]; None without a model of weights.
    """
    noise: StereoNoise | None = None
    """What a generalized kernel predicts of each, [N]; None without one."""


@dataclass(frozen=True)
class ColumnSummary:
    """One column of φ in figures; None where there is no model, no frame, or no feature with a
    value."""

    name: str
    unit: str
    training: tuple[float, float] | None
    """Mean and standard deviation over the training data."""
    frame_mean: float | None
    undefined: float
    """Share of the frame's features, or else of the training samples, where it is undefined."""


def column_summaries(model: ModelView | None, frame: FrameView | None) -> list[ColumnSummary]:
    """Figures of each column, in the order of φ."""
    phi = (
        frame.phi if frame is not None else model.places if model is not None else np.zeros((0, 0))
    )
    units: Mapping[str, str] = (
        frame.columns
        if frame is not None
        else {c: model.units.get(c, "") for c in model.columns}
        if model
        else {}
    )
    summaries = []
    for m, (name, unit) in enumerate(units.items()):
        known = phi[np.isfinite(phi[:, m]), m]
        training = (
            (float(model.model.metric_.mean[m]), float(model.model.metric_.spread[m]))
            if model
            else None
        )
        frame_mean = float(known.mean()) if frame is not None and len(known) else None
        summaries.append(
            ColumnSummary(
                name,
                unit,
                training,
                frame_mean=frame_mean,
                undefined=1.0 - len(known) / max(len(phi), 1),
            )
        )
    return summaries


def neighbor_radius(model: NearestNeighbors, places: FloatArray) -> FloatArray:
    """Distance from each of n places, [n, M], to the K-th nearest training sample in the model's
    metric, [n].

    Not to the nearest alone: a point that was followed for some frames left as many samples close
    together, which
    would make the training data look denser than any other drive can be.
    """
    all_samples = model.index_.samples
    samples = all_samples[:, evenly(all_samples.shape[1], MOST_NEIGHBORS_OF)]
    wanted = max(1, round(model.neighbors * samples.shape[1] / all_samples.shape[1]))
    half_squares = 0.5 * np.sum(samples * samples, axis=0)
    queries = model.metric_.coordinates(places).astype(np.float32)
    radius = np.empty(len(queries))
    for start in range(0, len(queries), _BLOCK):
        block = queries[start : start + _BLOCK]
        halves = np.partition(half_squares - block @ samples, wanted - 1, axis=1)[:, wanted - 1]
        radius[start : start + _BLOCK] = np.sqrt(
            np.maximum(2.0 * halves + np.sum(block * block, axis=1), 0.0)
        )
    return radius


def rank_correlation(places: FloatArray) -> FloatArray:
    """Spearman's correlation of the columns of [N, M], [M, M]; undefined values are left out,
    constants give 0."""
    ranks = np.full(places.shape, np.nan)
    for m, column in enumerate(places.T):
        known = np.isfinite(column)
        # Equal values share the mean of their ranks, lest their order in the file count.
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


def is_the_same(values: FloatArray) -> bool:
    """Whether all of several features have one and the same value, as the turn rate has, [N]."""
    return len(values) > 1 and bool((values == values[0]).all())

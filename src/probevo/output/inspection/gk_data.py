"""A PROBE-GK model at its own centers: the noise that it predicts there, and how it was chosen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from probevo.arrays import FloatArray
from probevo.noise.base import StereoNoise
from probevo.noise.gk.generalized_kernel import GeneralizedKernel
from probevo.output.inspection.profiles import inner_edges

AXES = ("u_l", "v_l", "disparity")
"""Coordinates whose σ and bias are shown: those of the right image are much like the left ones."""
TO_AXES = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [1.0, 0.0, -1.0, 0.0]])
"""Takes (u_l, v_l, u_r, v_r) to these, [3, 4]."""
SEARCHED = {
    "weights": "predictors",
    "reach": "ρ",
    "neighbors": "K",
    "bias_counts": "counts for no bias",
    "prior_counts": "counts for the prior",
    "dof_counts": "counts for ν",
}
"""Settings that may have been searched for, in that order, and what they are called."""
MAX_BINS = 16


@dataclass(frozen=True)
class UsedColumn:
    """A column of φ that says something about the noise."""

    index: int
    """Index among the M columns."""
    name: str
    weight: float
    """Weight of a standard deviation of the column in the distance."""
    gain: float | None
    """Likelihood that the column adds to those before it, nats a feature; None if it was not
    searched for."""


@dataclass(frozen=True)
class CentersView:
    """A model of M columns, L of which are used, at its own C centers.

    The centers are points of training samples, evenly chosen.
    """

    name: str
    model: GeneralizedKernel
    units: Mapping[str, str]
    """Unit of each column whose unit is known."""
    used: tuple[UsedColumn, ...]
    """The used columns, [L], in the order of their gain."""
    points: FloatArray
    """φ of the centers along the used columns, [C, L]; NaN where undefined."""
    noise: StereoNoise
    """The predicted noise at the centers, [C]."""

    @staticmethod
    def of(name: str, model: GeneralizedKernel, units: Mapping[str, str]) -> CentersView:
        """Predict the noise at the centers of a fitted model."""
        used = used_columns(model)
        metric = model.metric_
        coordinates = model.centers_.points.T.astype(np.float64)
        students, out_of_domain = model.centers_.at(coordinates, model.domain_radius_, model.prior_)
        # The centers hold only the columns whose weight is not 0, each times its weight.
        chosen = [column.index for column in used]
        stored = np.searchsorted(np.flatnonzero(metric.weight), chosen)
        standard = coordinates[:, stored] / metric.weight[chosen]
        # Stored in single precision; no value that is defined lies so close except by chance.
        may_be_undefined = np.array(metric.may_be_undefined)[chosen]
        tolerance = 1e-6 * np.abs(metric.undefined_at[chosen])
        undefined = may_be_undefined & (np.abs(standard - metric.undefined_at[chosen]) < tolerance)
        points = np.where(undefined, np.nan, standard * metric.spread[chosen] + metric.mean[chosen])
        noise = StereoNoise(
            students.scale,
            students.dof,
            students.bias,
            refers_to=model.refers_to,
            out_of_domain=out_of_domain,
        )
        return CentersView(name, model, units, used=used, points=points, noise=noise)


def used_columns(model: GeneralizedKernel) -> tuple[UsedColumn, ...]:
    """List the columns whose weight is not 0.

    Those that a search has chosen come first, in its order; then the others, the heaviest first.
    """
    weights = model.metric_.weight
    search = model.training.get("searches", {}).get("weights", {"candidates": [], "gains": []})
    steps = np.diff([0.0, *search["gains"]]).tolist()
    steps_by_name = zip(search["candidates"], steps, strict=True)
    used = np.flatnonzero(weights).tolist()
    names = {model.columns[m] for m in used}
    gains = {name: step for name, step in steps_by_name if name in names}
    chosen = [model.columns.index(name) for name in gains]
    others = [m for m in used if m not in chosen]
    others.sort(key=lambda m: -weights[m])
    return tuple(
        UsedColumn(
            index=m,
            name=model.columns[m],
            weight=float(weights[m]),
            gain=gains.get(model.columns[m]),
        )
        for m in (*chosen, *others)
    )


def gained(searches: Mapping[str, Mapping[str, Any]]) -> float | None:
    """Find the gain over the static model of the last search, nats a feature that was left out.

    None if nothing was searched for.
    """
    for name in reversed(SEARCHED):
        search = searches.get(name)
        if search and name == "weights":
            return float(search["gains"][-1]) if search["gains"] else None
        if search:
            return float(search["gains"][search["candidates"].index(search["chosen"])])
    return None


def share_out_of_domain(noise: StereoNoise) -> float:
    """Compute the share, 0 … 1, of features that lie out of the model's domain."""
    if noise.out_of_domain is None or len(noise.out_of_domain) == 0:
        return 0.0
    return float(noise.out_of_domain.mean())


@dataclass(frozen=True)
class Course:
    """Quantiles of a value along a column, in B bins of equally many centers."""

    center: FloatArray
    """Median of the column in each bin, [B], ascending."""
    quantiles: FloatArray
    """16, 50 and 84 % of the value, [3, B]."""
    undefined: FloatArray | None
    """Quantiles of the value where the column is undefined, [3]; None if it never is."""


def course_along(column: FloatArray, values: FloatArray) -> Course:
    """Follow C values [C] along a column [C], NaN where undefined."""
    # Bins of equally many centers; equal values stay together.
    known = np.isfinite(column)
    edges = inner_edges(column[known], MAX_BINS)
    bins = np.searchsorted(edges, column[known], side="right")
    share = (0.16, 0.5, 0.84)
    filled = np.unique(bins)
    quantiles = [np.quantile(values[known][bins == b], share) for b in filled]
    return Course(
        center=np.array([np.median(column[known][bins == b]) for b in filled]),
        quantiles=np.array(quantiles).reshape(-1, 3).T,
        undefined=None if known.all() else np.quantile(values[~known], share),
    )


def sigma_px(scale: FloatArray) -> FloatArray:
    """Compute the σ along ``AXES``, [N, 3], px, of scale matrices [N, 4, 4], px²."""
    sigma: FloatArray = np.sqrt(np.einsum("ai,nij,aj->na", TO_AXES, scale, TO_AXES))
    return sigma


def size_px(scale: FloatArray) -> FloatArray:
    """Compute the geometric mean of the σ along the principal axes of each scale, [N], px."""
    log_det: FloatArray = np.linalg.slogdet(scale)[1]
    return np.exp(log_det / 8.0)

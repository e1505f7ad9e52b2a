"""What a page about a generalized kernel shows: the noise that it predicts at each of its centers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from probevo.arrays import FloatArray
from probevo.noise.base import StereoNoise
from probevo.noise.gk.generalized_kernel import GeneralizedKernel
from probevo.noise.metric import UNDEFINED
from probevo.output.model_facts import UsedColumn, used_columns

AXES = ("u_l", "v_l", "disparity")
"""What σ and bias are shown of: the right image's are much like the left one's."""
TO_AXES = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [1.0, 0.0, -1.0, 0.0]])
"""Of (u_l, v_l, u_r, v_r), [3, 4]."""
MOST_BINS = 16
FEWEST_IN_BIN = 40


@dataclass(frozen=True)
class KernelView:
    """A model of M columns, L of which are used, at its own C centers: places of training samples,
    evenly chosen."""

    name: str
    model: GeneralizedKernel
    units: Mapping[str, str]
    """Unit of each column whose unit is known."""
    used: tuple[UsedColumn, ...]
    """[L]."""
    places: FloatArray
    """φ of the centers along the used columns, [C, L]; NaN where undefined."""
    noise: StereoNoise
    """What is predicted there, [C]."""

    @staticmethod
    def of(name: str, model: GeneralizedKernel, units: Mapping[str, str]) -> KernelView:
        """Take all that is shown from a fitted model."""
        used = used_columns(model)
        metric = model.metric_
        coordinates = model.centers_.places.T.astype(np.float64)
        students, out_of_domain = model.centers_.at(coordinates, model.domain_radius_, model.prior_)
        chosen = [column.index for column in used]
        standard = (
            coordinates[:, np.searchsorted(np.flatnonzero(metric.weight), chosen)]
            / metric.weight[chosen]
        )
        # Stored in single precision; no value that is defined lies so close by more than chance.
        undefined = np.array(metric.may_be_undefined)[chosen] & (
            np.abs(standard - UNDEFINED) < 1e-5
        )
        places = np.where(undefined, np.nan, standard * metric.spread[chosen] + metric.mean[chosen])
        noise = StereoNoise(
            students.scale,
            students.dof,
            students.bias,
            refers_to=model.refers_to,
            out_of_domain=out_of_domain,
        )
        return KernelView(name, model, units, used=used, places=places, noise=noise)


@dataclass(frozen=True)
class Course:
    """How a value varies along a column: its quantiles in B bins of equally many centers."""

    center: FloatArray
    """Median of the column in each bin, [B], ascending."""
    quantiles: FloatArray
    """16, 50 and 84 % of the value, [3, B]."""
    undefined: FloatArray | None
    """The same where the column is undefined, [3]; None if it never is."""


def course_along(column: FloatArray, values: FloatArray) -> Course:
    """The course of C values [C] along a column [C], NaN where undefined."""
    known = np.isfinite(column)
    count = int(np.clip(known.sum() // FEWEST_IN_BIN, 1, MOST_BINS))
    inner = np.linspace(0.0, 1.0, count + 1)[1:-1] if known.any() else np.zeros(0)
    edges = np.unique(np.quantile(column[known], inner)) if len(inner) else inner
    bins = np.searchsorted(edges, column[known], side="right")
    share = (0.16, 0.5, 0.84)
    filled = np.unique(bins)
    center = np.array([np.median(column[known][bins == b]) for b in filled])
    inside = (
        np.array([np.quantile(values[known][bins == b], share) for b in filled]).reshape(-1, 3).T
    )
    return Course(center, inside, None if known.all() else np.quantile(values[~known], share))


def sigma_px(scale: FloatArray) -> FloatArray:
    """Of scales [N, 4, 4], px², the σ along ``AXES``, [N, 3], px."""
    sigma: FloatArray = np.sqrt(np.einsum("ai,nij,aj->na", TO_AXES, scale, TO_AXES))
    return sigma


def size_px(scale: FloatArray) -> FloatArray:
    """The geometric mean of the σ along the principal axes of each scale, [N], px."""
    log_det: FloatArray = np.linalg.slogdet(scale)[1]
    return np.exp(log_det / 8.0)

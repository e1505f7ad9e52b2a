"""The metric of a prediction space: how far apart two places φ are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from probevo.arrays import FloatArray
from probevo.errors import InputError

UNDEFINED = -4.0
"""Where an undefined value lies, in standard deviations: a place of its own, in which it is near to its like only.

A feature of a kind that training never saw is that far from all samples alike, and the other columns decide.
"""
FEWEST_DEFINED = 2
"""Values that a column needs for a mean and a spread."""
CONSTANT_BELOW = 1e-9
"""Spread over the mean: below, it is rounding."""
FARTHEST = 1e3
"""Standard deviations; what is farther out lies there, so that squares of distances stay exact enough."""


@dataclass(frozen=True)
class Metric:
    """Euclidean distance over standardised columns, each with a weight."""

    columns: tuple[str, ...]
    """Names of the M columns."""
    may_be_undefined: tuple[bool, ...]
    """Which of them may hold NaN."""
    mean: FloatArray
    """Of the training data, [M]."""
    spread: FloatArray
    """Their standard deviation, [M]; 1 for a column that is constant."""
    weight: FloatArray
    """How much a standard deviation of each column counts, [M]."""

    @staticmethod
    def fitted(
        predictors: FloatArray,
        columns: Sequence[str] = (),
        may_be_undefined: Sequence[bool] = (),
        weight: FloatArray | None = None,
    ) -> Metric:
        """The metric in which the training data [N, M] have mean 0 and spread 1 along each column.

        Args:
            predictors: places of the samples; NaN where undefined.
            columns: names of the columns; "column 0" … if left out.
            may_be_undefined: which columns may hold NaN; none if left out.
            weight: of the columns; all 1 if left out.

        Raises:
            InputError: a value is infinite, or NaN where it must not be, or nearly all of a column is.
        """
        if predictors.ndim != 2:
            raise InputError("predictors", f"their shape is {predictors.shape}, where [N, M] is expected.")
        count = predictors.shape[1]
        names = tuple(columns) or tuple(f"column {m}" for m in range(count))
        may_be = tuple(may_be_undefined) or (False,) * count
        weight = np.ones(count) if weight is None else weight
        blank = Metric(names, may_be, np.zeros(count), np.ones(count), weight)
        blank._check(predictors)
        for name, column in zip(names, predictors.T, strict=True):
            if np.isfinite(column).sum() < FEWEST_DEFINED:
                what = f"it is undefined for all but {np.isfinite(column).sum()} of {len(column)} features."
                raise InputError(f"predictor {name}", what, "Leave it out.")
        mean, spread = np.nanmean(predictors, axis=0), np.nanstd(predictors, axis=0)
        return Metric(names, may_be, mean, np.where(spread > CONSTANT_BELOW * np.abs(mean), spread, 1.0), weight)

    def coordinates(self, predictors: FloatArray) -> FloatArray:
        """Places in which the distance is Euclidean, [N, M], finite, at most FARTHEST standard deviations out.

        Raises:
            InputError: not M columns, or a value is infinite, or NaN where it must not be.
        """
        self._check(predictors)
        standard = np.clip((predictors - self.mean) / self.spread, -FARTHEST, FARTHEST)
        return np.where(np.isnan(standard), UNDEFINED, standard) * self.weight

    def _check(self, predictors: FloatArray) -> None:
        if predictors.ndim != 2 or predictors.shape[1] != len(self.columns):
            expected = f"[N, {len(self.columns)}]: {', '.join(self.columns)}"
            raise InputError("predictors", f"their shape is {predictors.shape}, where the model takes {expected}.")
        wrong = np.where(self.may_be_undefined, np.isinf(predictors), ~np.isfinite(predictors))
        if wrong.any():
            row, m = np.argwhere(wrong)[0].tolist()
            what = f"feature {row} (from 0) has the value {predictors[row, m]}."
            raise InputError(f"predictor {self.columns[m]}", what, "Only a predictor that may be undefined can be NaN.")

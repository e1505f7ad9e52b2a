"""The metric of a prediction space: how far apart two places φ are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.errors import InputError
from probevo.noise.moments import Moments

UNDEFINED = -4.0
"""Where an undefined value lies, in standard deviations: a place of its own, in which it is near to
its like only.

A feature of a kind that training never saw is that far from all samples alike, and the other
columns decide.
"""
FEWEST_DEFINED = 2
"""Values that a column needs for a mean and a spread; of a single sample, its one will do."""
CONSTANT_BELOW = 1e-9
"""Spread over the mean: below, it is rounding."""
FARTHEST = 1e3
"""Standard deviations; what is farther out lies there, so that squares of distances stay exact
enough."""


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
    ) -> Metric:
        """The metric in which the training data [N, M] have mean 0 and spread 1 along each column,
        all of weight 1.

        Args:
            predictors: places of the samples; NaN where undefined.
            columns: names of the columns; "column 0" … if left out.
            may_be_undefined: which columns may hold NaN; none if left out.

        Raises:
            InputError: a value is infinite, or NaN where it must not be, or nearly all of a column
                is.
        """
        if predictors.ndim != 2:
            raise InputError(
                "predictors", f"their shape is {predictors.shape}, where [N, M] is expected."
            )
        names = tuple(columns) or tuple(f"column {m}" for m in range(predictors.shape[1]))
        check_defined(predictors, names, may_be_undefined)
        return Metric.of_moments(Moments.of(predictors), names, may_be_undefined)

    @staticmethod
    def of_moments(
        moments: Moments,
        columns: Sequence[str],
        may_be_undefined: Sequence[bool] = (),
    ) -> Metric:
        """The same from the moments of training data that ``check_defined`` has let through.

        Raises:
            InputError: nearly all of a column is undefined.
        """
        for name, count in zip(columns, moments.count.tolist(), strict=True):
            if count < max(min(FEWEST_DEFINED, moments.rows), 1):
                what = f"it is undefined for all but {count} of {moments.rows} features."
                raise InputError(f"predictor {name}", what, "Leave it out.")
        mean = moments.mean
        spread = moments.spread
        return Metric(
            tuple(columns),
            tuple(may_be_undefined) or (False,) * len(columns),
            mean,
            spread=np.where(spread > CONSTANT_BELOW * np.abs(mean), spread, 1.0),
            weight=np.ones(len(columns)),
        )

    def coordinates(self, predictors: FloatArray) -> FloatArray:
        """Places in which the distance is Euclidean, [N, M], finite, at most FARTHEST standard
        deviations out.

        Raises:
            InputError: not M columns, or a value is infinite, or NaN where it must not be.
        """
        check_defined(predictors, self.columns, self.may_be_undefined)
        return self._placed(predictors)

    def contributing(self, predictors: FloatArray) -> FloatArray:
        """The same, but only of the columns that have a weight; raises the same."""
        check_defined(predictors, self.columns, self.may_be_undefined)
        columns = np.flatnonzero(self.weight)
        return self.kept(columns)._placed(predictors[:, columns])

    def kept(self, columns: IntArray) -> Metric:
        """The metric of some of the columns."""
        names, may_be = (
            tuple(part[m] for m in columns) for part in (self.columns, self.may_be_undefined)
        )
        return Metric(
            names,
            may_be,
            self.mean[columns],
            spread=self.spread[columns],
            weight=self.weight[columns],
        )

    def _placed(self, predictors: FloatArray) -> FloatArray:
        standard = (predictors - self.mean) / self.spread
        np.clip(standard, -FARTHEST, FARTHEST, out=standard)
        standard[np.isnan(standard)] = UNDEFINED
        standard *= self.weight
        return standard


def check_defined(
    predictors: FloatArray, columns: Sequence[str], may_be_undefined: Sequence[bool] = ()
) -> None:
    """Refuse places that are not [N, M], or infinite, or NaN in a column that must not be.

    Raises:
        InputError: gives the shape, or names the column.
    """
    if predictors.ndim != 2 or predictors.shape[1] != len(columns):
        expected = f"[N, {len(columns)}]: {', '.join(columns)}"
        raise InputError(
            "predictors", f"their shape is {predictors.shape}, where the model takes {expected}."
        )
    wrong = ~np.isfinite(predictors)
    if wrong.any():
        wrong &= ~(np.isnan(predictors) & (tuple(may_be_undefined) or (False,) * len(columns)))
    if wrong.any():
        row, m = np.argwhere(wrong)[0].tolist()
        what = f"feature {row} (from 0) has the value {predictors[row, m]}."
        raise InputError(
            f"predictor {columns[m]}", what, "Only a predictor that may be undefined can be NaN."
        )

"""The metric of a prediction space: the distance between two points φ.

Each column is standardised by the training data and multiplied by a weight w_m; the distance is
Euclidean:  d² = Σ_m w_m² ((φ_m − φ'_m)/σ_m)².
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from probevo.arrays import AnyArray, BoolArray, FloatArray, IntArray
from probevo.errors import InputError
from probevo.noise.moments import Moments

UNDEFINED = -4.0
"""Coordinate of an undefined value, in standard deviations: apart from nearly all defined values,
so that undefined values are close to each other only."""
RARELY_UNDEFINED = 2.0**-20
"""The same in a column of which training had hardly any undefined value: the mean, so that the
other columns decide. Apart from defined values, it would be nearest to the lowest of them. It is
not quite 0, so that undefined values can be distinguished from those of a constant column."""
MIN_UNDEFINED_SHARE = 0.01
"""Share of undefined values in the training data from which a column has enough of them to learn
what they mean."""
MIN_DEFINED = 2
"""Number of values that a column needs for mean and spread; of a single sample, one suffices."""
CONSTANT_BELOW = 1e-9
"""Ratio of spread to mean below which a column is constant but for rounding."""
FARTHEST = 1e3
"""Bound of the coordinates, in standard deviations, so that squared distances stay accurate."""
MAX_WEIGHT = 1e6
"""Bound of the weight of a column, which keeps squared distances within single precision."""


@dataclass(frozen=True)
class Metric:
    """Euclidean distance over standardised columns, each with a weight."""

    columns: tuple[str, ...]
    """Names of the M columns."""
    may_be_undefined: tuple[bool, ...]
    """Which columns may hold NaN."""
    mean: FloatArray
    """Mean of the training data, [M]."""
    spread: FloatArray
    """Standard deviation of the training data, [M]; 1 for a constant column."""
    weight: FloatArray
    """Factor on the standardised column, [M]; 0 ignores it."""
    undefined_at: FloatArray
    """Coordinate of undefined values in the standardised column, [M]: ``UNDEFINED`` or
    ``RARELY_UNDEFINED``."""

    @staticmethod
    def fitted(
        predictors: FloatArray,
        columns: Sequence[str] = (),
        may_be_undefined: Sequence[bool] = (),
    ) -> Metric:
        """Return the metric that standardises the training data [N, M], with all weights 1.

        Args:
            predictors: points of the samples; NaN where undefined.
            columns: names of the columns; by default "column 0", "column 1", …
            may_be_undefined: which columns may hold NaN; by default none.

        Raises:
            InputError: a value is infinite, or NaN in a column that must be defined, or nearly all
                values of a column are undefined.
        """
        if predictors.ndim != 2:
            raise InputError(
                "predictors", f"their shape is {predictors.shape}, where [N, M] is expected."
            )
        # Without names, as in quick experiments, the columns are numbered.
        names = tuple(columns) or tuple(f"column {m}" for m in range(predictors.shape[1]))
        check_defined(predictors, names, may_be_undefined)
        return Metric.of_moments(Moments.of(predictors), names, may_be_undefined)

    @staticmethod
    def of_moments(
        moments: Moments,
        columns: Sequence[str],
        may_be_undefined: Sequence[bool] = (),
    ) -> Metric:
        """Return the same metric from the moments of data that ``check_defined`` has accepted.

        Raises:
            InputError: nearly all values of a column are undefined.
        """
        required = max(min(MIN_DEFINED, moments.rows), 1)
        for name, count in zip(columns, moments.count.tolist(), strict=True):
            if count < required:
                raise InputError(
                    f"predictor {name}",
                    f"it is undefined for all but {count} of {moments.rows} features.",
                    "Leave it out.",
                )
        num_undefined = moments.rows - moments.count
        has_undefined = num_undefined >= max(MIN_UNDEFINED_SHARE * moments.rows, 1)
        # A constant column says nothing; dividing by its spread of rounding errors would make it
        # the most important of all.
        is_constant = moments.spread <= CONSTANT_BELOW * np.abs(moments.mean)
        return Metric(
            columns=tuple(columns),
            may_be_undefined=tuple(map(bool, may_be_undefined)) or (False,) * len(columns),
            mean=moments.mean,
            spread=np.where(is_constant, 1.0, moments.spread),
            weight=np.ones(len(columns)),
            undefined_at=np.where(has_undefined, UNDEFINED, RARELY_UNDEFINED),
        )

    @staticmethod
    def from_arrays(
        columns: tuple[str, ...],
        may_be_undefined: tuple[bool, ...],
        arrays: Mapping[str, AnyArray],
    ) -> Metric:
        """Return the metric whose ``arrays`` are among the arrays of a file."""
        return Metric(
            columns=columns,
            may_be_undefined=may_be_undefined,
            mean=arrays["mean"],
            spread=arrays["spread"],
            weight=arrays["weight"],
            undefined_at=arrays["undefined_at"],
        )

    @property
    def arrays(self) -> dict[str, AnyArray]:
        """The arrays of the metric by their names in a file."""
        return {
            "mean": self.mean,
            "spread": self.spread,
            "weight": self.weight,
            "undefined_at": self.undefined_at,
        }

    @property
    def is_valid(self) -> bool:
        """Whether columns and arrays of a file make a metric: M distinct columns, σ > 0, bounds."""
        count = len(self.columns)
        return (
            have_shapes([(array, (count,), np.float64) for array in self.arrays.values()])
            and len(set(self.columns)) == count == len(self.may_be_undefined)
            and bool((self.spread > 0.0).all())
            and bool(((self.weight >= 0.0) & (self.weight <= MAX_WEIGHT)).all())
            and bool(np.isin(self.undefined_at, (UNDEFINED, RARELY_UNDEFINED)).all())
        )

    def coordinates(self, predictors: FloatArray) -> FloatArray:
        """Return coordinates in which the distance is Euclidean, [N, M], finite.

        Raises:
            InputError: not M columns, or a value is infinite, or NaN in a column that must be
                defined.
        """
        check_defined(predictors, self.columns, self.may_be_undefined)
        return self._standardised(predictors)

    def contributing(self, predictors: FloatArray) -> FloatArray:
        """Return the coordinates of the columns with a positive weight only; raises the same."""
        check_defined(predictors, self.columns, self.may_be_undefined)
        # The distance is the same without the columns of weight 0, and takes less time.
        columns = np.flatnonzero(self.weight)
        return self.subset(columns)._standardised(predictors[:, columns])

    def subset(self, columns: IntArray) -> Metric:
        """Return the metric of some of the columns, given their indices."""
        return Metric(
            columns=tuple(self.columns[m] for m in columns),
            may_be_undefined=tuple(self.may_be_undefined[m] for m in columns),
            mean=self.mean[columns],
            spread=self.spread[columns],
            weight=self.weight[columns],
            undefined_at=self.undefined_at[columns],
        )

    def with_undefined_apart(self, columns: BoolArray) -> Metric:
        """Return the metric in which the undefined values of these columns only, [M], are apart
        from the defined ones."""
        return replace(self, undefined_at=np.where(columns, UNDEFINED, RARELY_UNDEFINED))

    def is_unknown(self, predictors: FloatArray) -> BoolArray:
        """Return which of N points [N, M] have an undefined value in a column that contributes, and
        of which training had hardly any, [N]."""
        columns = np.flatnonzero((self.weight > 0.0) & (self.undefined_at == RARELY_UNDEFINED))
        unknown: BoolArray = np.any(np.isnan(predictors[:, columns]), axis=1)
        return unknown

    def _standardised(self, predictors: FloatArray) -> FloatArray:
        # w_m (φ_m − mean_m)/σ_m. Undefined values pass through as NaN until they get their own
        # coordinate.
        standard = (predictors - self.mean) / self.spread
        np.clip(standard, -FARTHEST, FARTHEST, out=standard)
        np.copyto(standard, self.undefined_at, where=np.isnan(standard))
        standard *= self.weight
        return standard


def have_shapes(expected: Sequence[tuple[AnyArray, tuple[int, ...], type]]) -> bool:
    """Return whether all arrays of a file are finite, and have the expected shape and type."""
    return all(
        array.shape == shape and array.dtype == dtype and bool(np.isfinite(array).all())
        for array, shape, dtype in expected
    )


def check_defined(
    predictors: FloatArray, columns: Sequence[str], may_be_undefined: Sequence[bool] = ()
) -> None:
    """Refuse points that are not [N, M], infinite, or NaN in a column that must be defined.

    Raises:
        InputError: states the shape, or the column and the first such value.
    """
    if predictors.ndim != 2 or predictors.shape[1] != len(columns):
        expected = f"[N, {len(columns)}]: {', '.join(columns)}"
        raise InputError(
            "predictors", f"their shape is {predictors.shape}, where the model takes {expected}."
        )
    wrong = ~np.isfinite(predictors)
    # Infinity is wrong everywhere, NaN where a column must be defined.
    if wrong.any():
        optional = np.array(tuple(map(bool, may_be_undefined)) or (False,) * len(columns))
        wrong &= ~(np.isnan(predictors) & optional)
    if wrong.any():
        row, m = np.argwhere(wrong)[0].tolist()
        raise InputError(
            f"predictor {columns[m]}",
            f"feature {row} (from 0) has the value {predictors[row, m]}.",
            "Only a predictor that may be undefined can be NaN.",
        )

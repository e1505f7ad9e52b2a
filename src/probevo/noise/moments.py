"""Mean and standard deviation of the columns of a prediction space, accumulated part by part.

The moments of two parts combine exactly into the moments of the whole. Hence no part of the
training data has to be held in memory for the next.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probevo.arrays import FloatArray, IntArray


@dataclass(frozen=True)
class Moments:
    """Mean and sum of squared deviations of the defined values of each of M columns."""

    rows: int
    """Number of all values of a column, undefined ones included."""
    count: IntArray
    """Number of defined values, [M]."""
    mean: FloatArray
    """Mean of the defined values, [M]; 0 if there is none."""
    squares: FloatArray
    """Sum of squared deviations from the mean, [M]."""

    @staticmethod
    def of(predictors: FloatArray) -> Moments:
        """Compute the moments of places [N, M], NaN where undefined."""
        defined = ~np.isnan(predictors)
        count = defined.sum(axis=0)
        mean = np.sum(predictors, axis=0, where=defined) / np.maximum(count, 1)
        squares = np.sum((predictors - mean) ** 2, axis=0, where=defined)
        return Moments(rows=len(predictors), count=count, mean=mean, squares=squares)

    @staticmethod
    def none(columns: int) -> Moments:
        """Return the moments of no data, the neutral element of the addition."""
        return Moments(
            rows=0,
            count=np.zeros(columns, np.int64),
            mean=np.zeros(columns),
            squares=np.zeros(columns),
        )

    def __add__(self, other: Moments) -> Moments:
        """Combine the moments of two parts (Chan, Golub & LeVeque 1983)."""
        # The deviations of each part are around its own mean; the last term of the squares, shift²
        # n₁ n₂/(n₁ + n₂), moves them to the common mean.
        count = self.count + other.count
        share = other.count / np.maximum(count, 1)
        shift = other.mean - self.mean
        return Moments(
            rows=self.rows + other.rows,
            count=count,
            mean=self.mean + shift * share,
            squares=self.squares + other.squares + shift**2 * self.count * share,
        )

    @property
    def spread(self) -> FloatArray:
        """Standard deviation, [M]; 0 if there is no value."""
        spread: FloatArray = np.sqrt(self.squares / np.maximum(self.count, 1))
        return spread

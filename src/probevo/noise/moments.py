"""Mean and spread of the columns of a prediction space, gathered part by part: no part need be held
for the next."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probevo.arrays import FloatArray, IntArray


@dataclass(frozen=True)
class Moments:
    """Of the defined values of each of M columns."""

    rows: int
    """All values of a column, those that are undefined counted."""
    count: IntArray
    """Those that are defined, [M]."""
    mean: FloatArray
    """[M]; 0 without any."""
    squares: FloatArray
    """Sum of squared deviations from the mean, [M]."""

    @staticmethod
    def of(predictors: FloatArray) -> Moments:
        """Of places [N, M], NaN where undefined."""
        defined = ~np.isnan(predictors)
        count = defined.sum(axis=0)
        mean = np.sum(predictors, axis=0, where=defined) / np.maximum(count, 1)
        squares = np.sum((predictors - mean) ** 2, axis=0, where=defined)
        return Moments(len(predictors), count, mean, squares=squares)

    @staticmethod
    def none(columns: int) -> Moments:
        """Of nothing."""
        return Moments(0, np.zeros(columns, np.int64), np.zeros(columns), squares=np.zeros(columns))

    def __add__(self, other: Moments) -> Moments:
        """Of both together (Chan, Golub & LeVeque 1983)."""
        count = self.count + other.count
        share = other.count / np.maximum(count, 1)
        apart = other.mean - self.mean
        squares = self.squares + other.squares + apart**2 * self.count * share
        return Moments(self.rows + other.rows, count, self.mean + apart * share, squares=squares)

    @property
    def spread(self) -> FloatArray:
        """Standard deviation, [M]; 0 without any value."""
        spread: FloatArray = np.sqrt(self.squares / np.maximum(self.count, 1))
        return spread

"""The mean over the K nearest samples in a space of several dimensions, in microseconds.

In ten dimensions and more a k-d tree looks at nearly all samples (25 to 50 ms for 1,000 queries of
10⁵). Here samples lie sorted into the Voronoi cells of a few hundred of them, and a query looks at
the nearest cells alone: it misses some of the K nearest, and takes others hardly farther, which the
mean over K does not notice. The tests hold it against the exact one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from probevo.arrays import FloatArray, IntArray
from probevo.compiled import compiled

Single = NDArray[np.float32]

LARGEST_CELL = 500
"""Samples in a mean cell, at most: up to its square there are as many cells as samples in each,
then more cells."""
CROWD = 4
"""Where values repeat, as those of a constant column do, many samples share a cell. Of more than so
many times the largest mean cell, that many are looked at."""
CANDIDATES = 8
"""Cells are looked at from the nearest on until they hold so many times the K wanted."""
FEWEST_CELLS = 4
HALVINGS = 24
"""Of the interval that holds the squared distance of the K-th nearest, four times their mean: to
2e-7 of that."""


@dataclass(frozen=True)
class NeighborIndex:
    """N samples with a value each, sorted into C cells. M is the dimension of the space."""

    centers: Single
    """[M, C]."""
    first_of_cell: IntArray
    """Where the samples of each cell begin, and the end of the last, [C + 1]."""
    samples: Single
    """[M, N]."""
    values: Single
    """[N]."""

    @staticmethod
    def build(samples: FloatArray, values: FloatArray) -> NeighborIndex:
        """Sort samples [N, M], finite, with values [N] into cells around evenly chosen ones of
        them."""
        points = np.ascontiguousarray(samples, dtype=np.float32)
        count = max(1, round(math.sqrt(len(points))), len(points) // LARGEST_CELL)
        centers = points[np.linspace(0, len(points) - 1, count).astype(np.int64)]
        cell = _nearest_center(points, centers)
        # At random within a cell, so that the first of a crowded one stand for all of it.
        order = np.lexsort((np.random.default_rng(0).permutation(len(points)), cell))
        first = np.searchsorted(cell[order], np.arange(count + 1))
        sorted_values = np.asarray(values, dtype=np.float32)[order]
        return NeighborIndex(
            np.ascontiguousarray(centers.T),
            first,
            np.ascontiguousarray(points[order].T),
            values=sorted_values,
        )

    def mean_of_nearest(self, queries: FloatArray, neighbors: IntArray) -> FloatArray:
        """Mean value over the K nearest samples of each query, for several K.

        Args:
            queries: [n, M], finite.
            neighbors: the numbers K, [J], each at most N.

        Returns:
            [n, J].
        """
        means = np.empty((len(queries), len(neighbors)))
        points = np.ascontiguousarray(queries, dtype=np.float32)
        _fill_means(
            points,
            self.centers,
            self.first_of_cell,
            samples=self.samples,
            values=self.values,
            neighbors=np.asarray(neighbors, np.int64),
            means=means,
        )
        return means


def _nearest_center(points: Single, centers: Single, block: int = 8192) -> IntArray:
    """Index of the center nearest to each point, [N]."""
    half_squares = 0.5 * np.sum(centers * centers, axis=1)
    return np.concatenate(
        [
            np.argmin(half_squares - points[start : start + block] @ centers.T, axis=1)
            for start in range(0, len(points), block)
        ]
    )


@compiled
def _fill_means(
    queries: Single,
    centers: Single,
    first_of_cell: IntArray,
    samples: Single,
    values: Single,
    neighbors: IntArray,
    means: FloatArray,
) -> None:
    num_cells = centers.shape[1]
    wanted = CANDIDATES * neighbors.max()
    crowd = max(wanted, CROWD * LARGEST_CELL)
    to_cell = np.empty(num_cells, np.float32)
    squared = np.empty(len(values), np.float32)
    value = np.empty(len(values), np.float32)
    for n in range(len(queries)):
        _add_squares(queries[n], centers, 0, end=num_cells, squared=to_cell)
        count = 0
        looked_at = 0
        while looked_at < num_cells and (count < wanted or looked_at < FEWEST_CELLS):
            nearest = np.argmin(to_cell)
            if (
                to_cell[nearest] == np.inf
            ):  # too far for single precision; none may be looked at twice
                break
            to_cell[nearest] = np.inf
            looked_at += 1
            first = first_of_cell[nearest]
            end = min(first_of_cell[nearest + 1], first + crowd)
            _add_squares(queries[n], samples, first, end=end, squared=squared[count:])
            for i in range(end - first):
                value[count + i] = values[first + i]
            count += end - first
        for j in range(len(neighbors)):
            means[n, j] = _mean_of_smallest(squared[:count], value[:count], neighbors[j])


@compiled
def _add_squares(query: Single, points: Single, first: int, end: int, squared: Single) -> None:
    """Squared distances of the points ``first`` to ``end`` from the query; each loop is one run
    through memory."""
    squared[: end - first] = 0.0
    for m in range(len(points)):
        row = points[m, first:end]
        q = query[m]
        for i in range(len(row)):
            difference = row[i] - q
            squared[i] += difference * difference


@compiled
def _mean_of_smallest(squared: Single, value: Single, wanted: int) -> float:
    """Mean of the values that belong to the ``wanted`` smallest squared distances.

    The limit is found by halving an interval, since counting fills vector registers; ties at the
    limit all count.
    """
    one = np.float32(1.0)
    none = np.float32(0.0)
    total = np.float32(0.0)
    for i in range(len(squared)):
        total += squared[i]
    low = none
    high = np.float32(4.0) * total / np.float32(len(squared))
    for halving in range(HALVINGS):
        middle = high if halving == 0 else np.float32(0.5) * (low + high)
        below = none
        for i in range(len(squared)):
            below += one if squared[i] <= middle else none
        if halving == 0 and below < wanted:
            low = high
            high = total
        elif below >= wanted:
            high = middle
        else:
            low = middle
        if below == wanted:
            break
    sum_of_values = none
    number = none
    for i in range(len(squared)):
        counts = one if squared[i] <= high else none
        sum_of_values += counts * value[i]
        number += counts
    return float(sum_of_values / number)

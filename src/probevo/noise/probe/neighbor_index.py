"""The mean over the K nearest samples in a space of several dimensions, in microseconds.

In ten dimensions and more, a k-d tree visits nearly all samples: 25 to 50 ms for 1,000 queries of
10⁵ samples. This index is an inverted file instead: the samples are sorted into the Voronoi cells
of a few hundred of them, and a query visits only the cells nearest to it. The search is
approximate: it misses a few of the K nearest samples and takes others that are hardly farther. The
mean over K changes very little; the tests compare it with the exact one.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from probevo.arrays import FloatArray, IntArray
from probevo.compiled import compiled

SingleArray = NDArray[np.float32]

MEAN_CELL_SIZE = 500
"""Largest mean number of samples of a cell. N samples form √N cells, and more for large N, so that
the mean stays below."""
CELL_CAP = 4
"""A cell holds many samples where values repeat, as those of a constant column do. At most so many
times ``MEAN_CELL_SIZE`` of them are visited."""
CANDIDATES_PER_NEIGHBOR = 8
"""Cells are visited, nearest first, until they hold so many times K samples."""
MIN_CELLS = 4
"""Number of cells that every query visits."""
BISECTIONS = 24
"""Iterations that find the squared distance of the K-th nearest, to 2⁻²³ of four times the mean."""


class NeighborIndex(NamedTuple):
    """N samples in M dimensions with a value each, sorted into C cells."""

    centers: SingleArray
    """Centers of the cells, [M, C]."""
    first_of_cell: IntArray
    """Index of the first sample of each cell, and N at the end, [C + 1]."""
    samples: SingleArray
    """Coordinates of the samples, cell after cell, [M, N]."""
    values: SingleArray
    """Value of each sample, [N]."""

    @staticmethod
    def build(samples: FloatArray, values: FloatArray) -> NeighborIndex:
        """Sort samples [N, M], finite, with their values [N] into cells.

        The centers are samples at regular steps of the training data.
        """
        points = np.ascontiguousarray(samples, dtype=np.float32)
        num_cells = max(1, round(math.sqrt(len(points))), len(points) // MEAN_CELL_SIZE)
        centers = points[np.linspace(0, len(points) - 1, num_cells).astype(np.int64)]
        cell = _nearest_center(points, centers)
        # The order within a cell is random, so that its first samples represent all of it where
        # only CELL_CAP of them are visited.
        order = np.lexsort((np.random.default_rng(0).permutation(len(points)), cell))
        return NeighborIndex(
            centers=np.ascontiguousarray(centers.T),
            first_of_cell=np.searchsorted(cell[order], np.arange(num_cells + 1)),
            samples=np.ascontiguousarray(points[order].T),
            values=np.asarray(values, dtype=np.float32)[order],
        )

    def mean_of_nearest(self, queries: FloatArray, neighbors: IntArray) -> FloatArray:
        """Compute the mean value over the K nearest samples of each query, for several K.

        The largest K decides how many cells are visited, for all of them.

        Args:
            queries: coordinates, [n, M], finite.
            neighbors: the numbers K, [J], each at most N.

        Returns:
            The means, [n, J].
        """
        means = np.empty((len(queries), len(neighbors)))
        points = np.ascontiguousarray(queries, dtype=np.float32)
        _fill_means(self, points, np.asarray(neighbors, np.int64), means=means)
        return means


def _nearest_center(points: SingleArray, centers: SingleArray, block: int = 8192) -> IntArray:
    """Return the index of the center nearest to each point, [N].

    |p − c|² = |p|² + 2 (|c|²/2 − p·c), whose first term does not depend on the center.
    """
    half_squares = 0.5 * np.sum(centers * centers, axis=1)
    return np.concatenate(
        [
            np.argmin(half_squares - points[start : start + block] @ centers.T, axis=1)
            for start in range(0, len(points), block)
        ]
    )


@compiled
def _fill_means(
    index: NeighborIndex, queries: SingleArray, neighbors: IntArray, means: FloatArray
) -> None:
    num_cells = index.centers.shape[1]
    wanted = CANDIDATES_PER_NEIGHBOR * neighbors.max()
    most_of_cell = max(wanted, CELL_CAP * MEAN_CELL_SIZE)
    to_center = np.empty(num_cells, np.float32)
    squared = np.empty(len(index.values), np.float32)
    value = np.empty(len(index.values), np.float32)
    for n in range(len(queries)):
        _squared_distances(queries[n], index.centers, 0, end=num_cells, squared=to_center)
        # Collect candidates from the nearest cells, until they hold enough samples.
        count = 0
        visited = 0
        while visited < num_cells and (count < wanted or visited < MIN_CELLS):
            nearest = np.argmin(to_center)
            # ∞ marks cells that were visited, or are too far for single precision; none may be
            # visited twice.
            if to_center[nearest] == np.inf:
                break
            to_center[nearest] = np.inf
            visited += 1
            first = index.first_of_cell[nearest]
            end = min(index.first_of_cell[nearest + 1], first + most_of_cell)
            _squared_distances(queries[n], index.samples, first, end=end, squared=squared[count:])
            for i in range(end - first):
                value[count + i] = index.values[first + i]
            count += end - first
        for j in range(len(neighbors)):
            means[n, j] = _mean_of_smallest(squared[:count], value[:count], neighbors[j])


@compiled
def _squared_distances(
    query: SingleArray, points: SingleArray, first: int, end: int, squared: SingleArray
) -> None:
    """Compute squared distances of the points ``first`` to ``end`` from the query.

    The points are stored column by column, so that each loop runs through contiguous memory.
    """
    squared[: end - first] = 0.0
    for m in range(len(points)):
        row = points[m, first:end]
        q = query[m]
        for i in range(len(row)):
            difference = row[i] - q
            squared[i] += difference * difference


@compiled
def _mean_of_smallest(squared: SingleArray, value: SingleArray, wanted: int) -> float:
    """Compute the mean of the values that belong to the ``wanted`` smallest squared distances.

    The threshold is found by bisection, since counting vectorises and sorting does not. Samples
    whose distance equals the threshold all count.
    """
    one = np.float32(1.0)
    zero = np.float32(0.0)
    total = np.float32(0.0)
    for i in range(len(squared)):
        total += squared[i]
    # The first bracket ends at four times the mean; if it holds too few, it is extended to the sum
    # of all, which no distance exceeds.
    low = zero
    high = np.float32(4.0) * total / np.float32(len(squared))
    for iteration in range(BISECTIONS):
        middle = high if iteration == 0 else np.float32(0.5) * (low + high)
        below = zero
        for i in range(len(squared)):
            below += one if squared[i] <= middle else zero
        if iteration == 0 and below < wanted:
            low = high
            high = total
        elif below >= wanted:
            high = middle
        else:
            low = middle
        if below == wanted:
            break
    sum_of_values = zero
    number = zero
    for i in range(len(squared)):
        counts = one if squared[i] <= high else zero
        sum_of_values += counts * value[i]
        number += counts
    return float(sum_of_values / number)

"""Compiled loops of the nearest-neighbour index (see ``neighbor_index``)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from probevo.arrays import FloatArray, IntArray, SingleArray
from probevo.compiled import compiled, compiled_with_free_order

if TYPE_CHECKING:
    from probevo.noise.probe.neighbor_index import NeighborIndex

CANDIDATES_PER_NEIGHBOR = 8
"""Cells are visited, nearest first, until they hold this many times K samples."""
MIN_CELLS = 4
"""Number of cells that every query visits."""
MAX_VISITED_OF_CELL = 2000
"""Number of samples of one cell that are visited at most, unless K requires more candidates. A cell
holds more only where values repeat, as those of a constant column do."""
BISECTIONS = 24
"""Iterations that find the squared distance of the K-th nearest, to 2⁻²³ of four times the mean."""


@compiled
def fill_means(
    index: NeighborIndex, queries: SingleArray, neighbors: IntArray, means: FloatArray
) -> None:
    """Fill in the mean value over the K nearest samples of each query, [n, J]."""
    # Work space: distances to all centers, and distances and values of the candidates.
    num_cells = index.centers.shape[1]
    wanted = CANDIDATES_PER_NEIGHBOR * neighbors.max()
    most_of_cell = max(wanted, MAX_VISITED_OF_CELL)
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
        # The candidates serve every K.
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
    # The first bracket ends at four times the mean; if it holds too few, it is extended to the sum
    # of all, which no distance exceeds.
    total = np.float32(_sum_within(squared, squared, np.float32(np.inf)))
    # Invariant from the second iteration on: at least ``wanted`` distances are within high.
    low = np.float32(0.0)
    high = np.float32(4.0) * total / np.float32(len(squared))
    for iteration in range(BISECTIONS):
        middle = high if iteration == 0 else np.float32(0.5) * (low + high)
        num_within = _count_within(squared, middle)
        if iteration == 0 and num_within < wanted:
            low = high
            high = total
        elif num_within >= wanted:
            high = middle
        else:
            low = middle
        if num_within == wanted:
            break
    # With equal distances, more than ``wanted`` may be within: the mean is over all of these.
    num_averaged = _count_within(squared, high)
    return float(_sum_within(squared, value, high) / np.float32(num_averaged))


@compiled
def _count_within(squared: SingleArray, threshold: np.float32) -> int:
    """Count the squared distances that are no larger than the threshold."""
    count = np.int32(0)
    for i in range(len(squared)):
        count += np.int32(1) if squared[i] <= threshold else np.int32(0)
    return int(count)


@compiled_with_free_order
def _sum_within(squared: SingleArray, value: SingleArray, threshold: np.float32) -> np.float32:
    """Add up the values whose squared distances are no larger than the threshold."""
    total = np.float32(0.0)
    for i in range(len(squared)):
        total += value[i] if squared[i] <= threshold else np.float32(0.0)
    return np.float32(total)

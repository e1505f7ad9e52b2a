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

from probevo.arrays import FloatArray, IntArray, SingleArray
from probevo.noise.probe.neighbor_index_numba import fill_means

MEAN_CELL_SIZE = 500
"""Largest mean number of samples of a cell. N samples form √N cells, and more for large N, so that
the mean stays below."""


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
        # About √N cells of √N samples, so that neither centers nor cells dominate a query.
        points = np.ascontiguousarray(samples, dtype=np.float32)
        num_cells = max(1, round(math.sqrt(len(points))), len(points) // MEAN_CELL_SIZE)
        centers = points[np.linspace(0, len(points) - 1, num_cells).astype(np.int64)]
        cell = _nearest_center(points, centers)
        # The order within a cell is random, so that its first samples represent all of it where not
        # all are visited. Sorted by cell first (the last key of lexsort), then at random.
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
        fill_means(self, points, np.asarray(neighbors, np.int64), means=means)
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

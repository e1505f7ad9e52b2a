"""Exact search for the few centers nearest to each feature, which skips most of the others.

A rotation does not change distances. Rotated onto the principal axes of the centers, the first
coordinates hold most of every distance, so that they alone rule out most centers. Centers that lie
close together are stored together, in leaves; a leaf is skipped if its bounding box is farther away
than the nearest centers found so far.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from probevo.arrays import FloatArray, IntArray, SingleArray
from probevo.noise.gk.center_search_numba import (
    HEAD,
    LEAF,
    NEAREST,
    search_leaves,
)


class NearestCenters(NamedTuple):
    """The k centers nearest to each of n points, nearest first."""

    centers: IntArray
    """Index of each center, [n, k]."""
    squared: SingleArray
    """Squared distance to it, [n, k]; ∞ beyond single precision, where the center is arbitrary."""


class Leaves(NamedTuple):
    """C centers in M dimensions, rotated onto their principal axes and stored leaf by leaf."""

    axes: FloatArray
    """Principal axes of the centers as columns, [M, M], ordered by decreasing variance."""
    centers: IntArray
    """Index of the center in each position, [C]."""
    head: SingleArray
    """The first coordinates, [C / LEAF rounded up, HEAD, LEAF]; ∞ in positions without a center."""
    tail: SingleArray
    """The other coordinates, [C / LEAF rounded up, max(M − HEAD, 0), LEAF]."""
    boxes: SingleArray
    """Minimum and maximum of the first coordinates in each leaf, [2, HEAD, C / LEAF rounded up]."""

    @staticmethod
    def of(points: FloatArray) -> Leaves:
        """Sort C centers [C, M] into leaves."""
        # Rotate onto the principal axes, ordered by decreasing variance.
        centered = points - points.mean(axis=0)
        axes = np.linalg.eigh(centered.T @ centered)[1][:, ::-1].astype(float)
        rotated = _with_whole_head(points @ axes)
        # Store them leaf by leaf; the last leaf is filled up with ∞.
        centers = _leaf_order(rotated[:, :HEAD])
        count = len(points)
        num_leaves = -(-count // LEAF)
        rows = np.full((num_leaves * LEAF, rotated.shape[1]), np.inf, np.float32)
        rows[:count] = rotated[centers]
        leaves = rows.reshape(num_leaves, LEAF, -1).transpose(0, 2, 1)
        # Bounding box of each leaf in the first coordinates, without the positions that are filled
        # up.
        starts = np.arange(0, count, LEAF)
        heads = rows[:count, :HEAD]
        lowest = np.minimum.reduceat(heads, starts).T
        highest = np.maximum.reduceat(heads, starts).T
        return Leaves(
            axes=axes,
            centers=centers,
            head=np.ascontiguousarray(leaves[:, :HEAD]),
            tail=np.ascontiguousarray(leaves[:, HEAD:]),
            boxes=np.array([lowest, highest]),
        )

    def nearest(self, queries: FloatArray) -> NearestCenters:
        """Find the NEAREST centers of n points [n, M], or all centers if there are fewer."""
        count = min(NEAREST, len(self.centers))
        nearest = NearestCenters(
            centers=np.zeros((len(queries), count), np.int64),
            squared=np.full((len(queries), count), np.inf, np.float32),
        )
        search_leaves(self, _with_whole_head(queries @ self.axes), nearest)
        return nearest._replace(centers=self.centers[nearest.centers])


def _with_whole_head(rotated: FloatArray) -> SingleArray:
    """Return the coordinates in single precision, with columns of zeros up to HEAD of them."""
    # Queries beyond single precision become ∞, which is handled as infinitely far.
    rows, columns = rotated.shape
    whole = np.zeros((rows, max(columns, HEAD)), np.float32)
    with np.errstate(over="ignore"):
        whole[:, :columns] = rotated
    return whole


def _leaf_order(points: SingleArray) -> IntArray:
    """Return an order of points [C, M] in which the points of a leaf are close to each other.

    The points are halved along their widest column until each part fits into a leaf, as in a k-d
    tree.
    """
    done: list[IntArray] = []
    waiting = [np.arange(len(points))]
    while waiting:
        part = waiting.pop()
        if len(part) <= LEAF:
            done.append(part)
            continue
        # Split at a multiple of LEAF, so that all leaves but the last are full.
        column = int(np.argmax(np.ptp(points[part], axis=0)))
        order = part[np.argsort(points[part, column], kind="stable")]
        # The part that is popped first is the lower one, so that the short leaf comes last.
        middle = LEAF * -(-len(part) // (2 * LEAF))
        waiting += [order[middle:], order[:middle]]
    return np.concatenate(done)

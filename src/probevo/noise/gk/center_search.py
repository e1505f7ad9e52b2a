"""Exact search for the few centers nearest to each feature, which skips most of the others.

A rotation does not change distances. Rotated onto the principal axes of the centers, the first
coordinates hold most of every distance, so that they alone rule out most centers. Centers that lie
close together are stored together, in leaves; a leaf is skipped if its bounding box is farther away
than the nearest centers found so far.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from probevo.arrays import FloatArray, IntArray
from probevo.compiled import compiled

SingleArray = NDArray[np.float32]

LEAF = 64
"""Number of centers in a leaf."""
HEAD = 8
"""Number of coordinates that rule out a center; ``_search`` spells them out. If there are fewer,
zeros are appended."""
NEAREST = 4
"""Number of centers that are found."""
INFINITE_BITS = np.int32(np.float32(np.inf).view(np.int32))
"""Bits of ∞. The bits of non-negative floats are ordered as the floats, and the minimum of integers
vectorises."""
ABOVE = np.float32(1.0 + 1e-6)
TINY = np.float32(1e-30)
"""ABOVE x + TINY is slightly above x ≥ 0."""


class NearestCenters(NamedTuple):
    """The k centers nearest to each of n places, nearest first."""

    centers: IntArray
    """Index of each center, [n, k]."""
    squared: SingleArray
    """Squared distance to it, [n, k]; ∞ beyond single precision, where the center is arbitrary."""


class Leaves(NamedTuple):
    """C centers in M dimensions, rotated onto their principal axes and stored leaf by leaf."""

    axes: FloatArray
    """Principal axes of the centers as columns, [M, M], that of the largest variance first."""
    centers: IntArray
    """Index of the center in each position, [C]."""
    head: SingleArray
    """The first coordinates, [C / LEAF rounded up, HEAD, LEAF]; ∞ in positions without a center."""
    tail: SingleArray
    """The other coordinates, [C / LEAF rounded up, max(M − HEAD, 0), LEAF]."""
    boxes: SingleArray
    """Minimum and maximum of the first coordinates in each leaf, [2, HEAD, C / LEAF rounded up]."""

    @staticmethod
    def of(places: FloatArray) -> Leaves:
        """Sort C centers [C, M] into leaves."""
        # Rotate onto the principal axes, that of the largest variance first.
        centered = places - places.mean(axis=0)
        axes = np.linalg.eigh(centered.T @ centered)[1][:, ::-1].astype(float)
        rotated = _with_whole_head(places @ axes)
        # Store them leaf by leaf; the last leaf is filled up with ∞.
        centers = _leaf_order(rotated[:, :HEAD])
        count = len(places)
        num_leaves = -(-count // LEAF)
        rows = np.full((num_leaves * LEAF, rotated.shape[1]), np.inf, np.float32)
        rows[:count] = rotated[centers]
        by_leaf = rows.reshape(num_leaves, LEAF, -1).transpose(0, 2, 1)
        starts = np.arange(0, count, LEAF)
        heads = rows[:count, :HEAD]
        lowest = np.minimum.reduceat(heads, starts).T
        highest = np.maximum.reduceat(heads, starts).T
        return Leaves(
            axes=axes,
            centers=centers,
            head=np.ascontiguousarray(by_leaf[:, :HEAD]),
            tail=np.ascontiguousarray(by_leaf[:, HEAD:]),
            boxes=np.array([lowest, highest]),
        )

    def nearest(self, queries: FloatArray) -> NearestCenters:
        """Find the NEAREST centers of n places [n, M], or all centers if there are fewer."""
        count = min(NEAREST, len(self.centers))
        found = NearestCenters(
            centers=np.zeros((len(queries), count), np.int64),
            squared=np.full((len(queries), count), np.inf, np.float32),
        )
        _search(self, _with_whole_head(queries @ self.axes), found)
        return found._replace(centers=self.centers[found.centers])


def _with_whole_head(rotated: FloatArray) -> SingleArray:
    """Return the coordinates in single precision, with columns of zeros up to HEAD."""
    rows, columns = rotated.shape
    whole = np.zeros((rows, max(columns, HEAD)), np.float32)
    with np.errstate(over="ignore"):
        whole[:, :columns] = rotated
    return whole


def _leaf_order(places: SingleArray) -> IntArray:
    """Return an order of places [C, M] in which those of a leaf are close to each other.

    The places are halved along their widest column until each part fits into a leaf, as in a k-d
    tree.
    """
    done: list[IntArray] = []
    waiting = [np.arange(len(places))]
    while waiting:
        part = waiting.pop()
        if len(part) <= LEAF:
            done.append(part)
            continue
        column = int(np.argmax(np.ptp(places[part], axis=0)))
        order = part[np.argsort(places[part, column], kind="stable")]
        middle = LEAF * -(-len(part) // (2 * LEAF))
        waiting += [order[middle:], order[:middle]]
    return np.concatenate(done)


@compiled
def _search(leaves: Leaves, query: SingleArray, found: NearestCenters) -> None:
    """Fill in the nearest centers of rotated places, [n, M].

    It is one piece: passing rows of arrays to functions would take longer than the search.
    """
    head = leaves.head
    tail = leaves.tail
    boxes = leaves.boxes
    index = found.centers
    squared = found.squared
    last = squared.shape[1] - 1
    zero = np.float32(0.0)
    num_leaves, num_tail = tail.shape[:2]
    bound = np.empty(num_leaves, np.float32)
    distance = np.empty(LEAF, np.float32)
    least = np.empty(NEAREST, np.float32)
    bound_bits = bound.view(np.int32)
    distance_bits = distance.view(np.int32)
    least_bits = least.view(np.int32)
    for n in range(len(query)):
        # Lower bound of the squared distance to the centers of each leaf: that to its box.
        bound[:] = zero
        for m in range(HEAD):
            q = query[n, m]
            for leaf in range(num_leaves):
                below = boxes[0, m, leaf] - q
                above = q - boxes[1, m, leaf]
                outside = below if below > above else above
                outside = outside if outside > zero else zero
                bound[leaf] += outside * outside
        least_bits[0] = INFINITE_BITS
        for leaf in range(num_leaves):
            least_bits[0] = min(least_bits[0], bound_bits[leaf])
        nearest = 0
        while bound[nearest] > least[0]:
            nearest += 1
        q0 = query[n, 0]
        q1 = query[n, 1]
        q2 = query[n, 2]
        q3 = query[n, 3]
        q4 = query[n, 4]
        q5 = query[n, 5]
        q6 = query[n, 6]
        q7 = query[n, 7]
        worst = squared[n, last]
        for visit in range(num_leaves):
            # The nearest leaf is visited first, swapped with leaf 0: what it holds rules out more
            # of the others.
            leaf = nearest if visit == 0 else 0 if visit == nearest else visit
            if bound[leaf] >= worst:
                continue
            # Distances in the first coordinates. Written out, the sums stay in registers, which
            # takes half of the time of a loop over columns.
            bits = INFINITE_BITS
            for i in range(LEAF):
                d0 = head[leaf, 0, i] - q0
                d1 = head[leaf, 1, i] - q1
                d2 = head[leaf, 2, i] - q2
                d3 = head[leaf, 3, i] - q3
                d4 = head[leaf, 4, i] - q4
                d5 = head[leaf, 5, i] - q5
                d6 = head[leaf, 6, i] - q6
                d7 = head[leaf, 7, i] - q7
                near = (d0 * d0 + d1 * d1) + (d2 * d2 + d3 * d3)
                far = (d4 * d4 + d5 * d5) + (d6 * d6 + d7 * d7)
                distance[i] = near + far
                bits = min(bits, np.float32(near + far).view(np.int32))
            least_bits[0] = bits
            if least[0] >= worst:
                continue
            # Add the other coordinates.
            for m in range(num_tail):
                q = query[n, HEAD + m]
                for i in range(LEAF):
                    difference = tail[leaf, m, i] - q
                    distance[i] += difference * difference
            # Bound from the first leaf: the minima of NEAREST parts of it are as many centers, so
            # that none farther than the largest of them is among the nearest.
            if visit == 0:
                for part in range(NEAREST):
                    bits = INFINITE_BITS
                    for i in range(LEAF // NEAREST):
                        bits = min(bits, distance_bits[part * (LEAF // NEAREST) + i])
                    least_bits[part] = bits
                worst = ABOVE * max(max(least[0], least[1]), max(least[2], least[3])) + TINY
            # Insert what is nearer into the sorted list.
            for i in range(LEAF):
                if distance[i] < worst:
                    place = last
                    total = distance[i]
                    while place > 0 and squared[n, place - 1] > total:
                        squared[n, place] = squared[n, place - 1]
                        index[n, place] = index[n, place - 1]
                        place -= 1
                    squared[n, place] = total
                    index[n, place] = leaf * LEAF + i
                    worst = min(worst, squared[n, last])

"""The few centers nearest to each feature, exactly, without looking at most of the others.

Distances stay what they are when the space is turned. Turned onto the principal axes of the centers, the first few
coordinates hold most of every distance, so that they alone rule out most centers. Those that lie together are stored
together, in leaves, and a leaf is passed over if the box around it is farther away than what has been found so far.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from probevo.arrays import FloatArray, IntArray
from probevo.compiled import compiled

Single = NDArray[np.float32]

LEAF = 64
"""Centers of a leaf."""
HEAD = 8
"""Coordinates by which a center is ruled out, if it has so many."""
NEAREST = 4
"""Centers that are found."""
INFINITE_BITS = np.int32(np.float32(np.inf).view(np.int32))
"""Bits of numbers that are not negative are in the numbers' order; of integers, the least is found eight at a time."""
ABOVE, TINY = np.float32(1.0 + 1e-6), np.float32(1e-30)
"""ABOVE x + TINY is just above x."""


@dataclass(frozen=True)
class Leaves:
    """C centers in a space of M columns, turned onto their principal axes, leaf by leaf."""

    axes: FloatArray
    """[M, M]."""
    centers: IntArray
    """Which center each is, [C]."""
    head: Single
    """First coordinates, at most HEAD, [C / LEAF rounded up, H, LEAF]; ∞ where no center is."""
    tail: Single
    """The other coordinates, [C / LEAF, M − H, LEAF]."""
    boxes: Single
    """Least and largest of the first coordinates of each leaf, [2, H, C / LEAF]."""

    @staticmethod
    def of(places: FloatArray) -> Leaves:
        """Sort C centers [C, M]."""
        apart = places - places.mean(axis=0)
        axes = np.linalg.eigh(apart.T @ apart)[1][:, ::-1].astype(float)  # the widest first
        turned = places @ axes
        centers = _together(turned[:, :HEAD])
        count, leaves = len(places), -(-len(places) // LEAF)
        rows = np.full((leaves * LEAF, places.shape[1]), np.inf, np.float32)
        rows[:count] = turned[centers]
        starts = np.arange(0, count, LEAF)
        boxes = np.array([side.reduceat(rows[:count, :HEAD], starts).T for side in (np.minimum, np.maximum)])
        by_leaf = rows.reshape(leaves, LEAF, -1).transpose(0, 2, 1)
        head, tail = (np.ascontiguousarray(part) for part in (by_leaf[:, :HEAD], by_leaf[:, HEAD:]))
        return Leaves(axes, centers, head, tail, boxes)

    def nearest(self, queries: FloatArray) -> tuple[IntArray, Single]:
        """The NEAREST centers of n places [n, M], or all if there are fewer, and their squared distances, [n, NEAREST].

        The nearest comes first. A distance beyond single precision is ∞, and its center anyone.
        """
        count = min(NEAREST, len(self.centers))
        index, squared = np.zeros((len(queries), count), np.int64), np.full((len(queries), count), np.inf, np.float32)
        with np.errstate(over="ignore"):
            turned = (queries @ self.axes).astype(np.float32)
        head, tail = (np.ascontiguousarray(part) for part in (turned[:, :HEAD], turned[:, HEAD:]))
        _find(head, tail, self.head, self.tail, self.boxes, index, squared)
        return self.centers[index], squared


def _together(places: FloatArray) -> IntArray:
    """An order of places [C, M] in which those of a leaf lie close together: halves, again and again."""
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
def _find(
    query_head: Single, query_tail: Single, head: Single, tail: Single, boxes: Single, index: IntArray, squared: Single
) -> None:
    """Fill in the nearest centers; in one piece, since to hand rows of arrays on would take longer than the search."""
    last, nothing = squared.shape[1] - 1, np.float32(0.0)
    leaves, heads, tails = len(head), head.shape[1], tail.shape[1]
    bound, distance = np.empty(leaves, np.float32), np.empty(LEAF, np.float32)
    least = np.empty(NEAREST, np.float32)
    bound_bits, distance_bits, least_bits = bound.view(np.int32), distance.view(np.int32), least.view(np.int32)
    for n in range(len(query_head)):
        bound[:] = nothing  # how near, squared, each box comes
        for m in range(heads):
            q = query_head[n, m]
            for leaf in range(leaves):
                below, above = boxes[0, m, leaf] - q, q - boxes[1, m, leaf]
                outside = below if below > above else above
                outside = outside if outside > nothing else nothing
                bound[leaf] += outside * outside
        worst = squared[n, last]
        least_bits[0] = INFINITE_BITS
        for leaf in range(leaves):
            least_bits[0] = min(least_bits[0], bound_bits[leaf])
        nearest = 0
        while bound[nearest] > least[0]:
            nearest += 1
        for turn in range(leaves):  # that one first, in the place of the first: the more are ruled out by what it holds
            leaf = nearest if turn == 0 else 0 if turn == nearest else turn
            if bound[leaf] >= worst:
                continue
            distance[:] = nothing
            for m in range(heads):
                q = query_head[n, m]
                for i in range(LEAF):
                    difference = head[leaf, m, i] - q
                    distance[i] += difference * difference
            nearer = np.int32(0)  # counted in one sweep: mostly there is none
            for i in range(LEAF):
                nearer += np.int32(distance[i] < worst)
            if nearer == 0:
                continue
            for m in range(tails):
                q = query_tail[n, m]
                for i in range(LEAF):
                    difference = tail[leaf, m, i] - q
                    distance[i] += difference * difference
            if turn == 0:  # as many centers as are wanted are at least this near: one in each part of the leaf
                for part in range(NEAREST):
                    bits = INFINITE_BITS
                    for i in range(LEAF // NEAREST):
                        bits = min(bits, distance_bits[part * (LEAF // NEAREST) + i])
                    least_bits[part] = bits
                worst = ABOVE * max(max(least[0], least[1]), max(least[2], least[3])) + TINY
            for i in range(LEAF):
                if distance[i] < worst:
                    place, total = last, distance[i]
                    while place > 0 and squared[n, place - 1] > total:
                        squared[n, place], index[n, place] = squared[n, place - 1], index[n, place - 1]
                        place -= 1
                    squared[n, place], index[n, place] = total, leaf * LEAF + i
                    worst = min(worst, squared[n, last])

"""The few centers nearest to each feature, exactly, without looking at most of the others.

Distances stay what they are when the space is turned. Turned onto the principal axes of the
centers, the first few coordinates hold most of every distance, so that they alone rule out most
centers. Those that lie together are stored together, in leaves, and a leaf is passed over if the
box around it is farther away than what has been found so far.
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
"""Coordinates by which a center is ruled out; ``_find`` spells them out. Where there are fewer,
zeros follow."""
NEAREST = 4
"""Centers that are found."""
INFINITE_BITS = np.int32(np.float32(np.inf).view(np.int32))
"""Bits of numbers that are not negative are in the numbers' order; of integers, the least is found
eight at a time."""
ABOVE = np.float32(1.0 + 1e-6)
TINY = np.float32(1e-30)
"""ABOVE x + TINY is just above x."""


@dataclass(frozen=True)
class Leaves:
    """C centers in a space of M columns, turned onto their principal axes, leaf by leaf."""

    axes: FloatArray
    """[M, M]."""
    centers: IntArray
    """Which center each is, [C]."""
    head: Single
    """First coordinates, [C / LEAF rounded up, HEAD, LEAF]; ∞ where no center is."""
    tail: Single
    """The other coordinates, [C / LEAF, M − HEAD if there are so many, LEAF]."""
    boxes: Single
    """Least and largest of the first coordinates of each leaf, [2, HEAD, C / LEAF]."""

    @staticmethod
    def of(places: FloatArray) -> Leaves:
        """Sort C centers [C, M]."""
        apart = places - places.mean(axis=0)
        axes = np.linalg.eigh(apart.T @ apart)[1][:, ::-1].astype(float)  # the widest first
        turned = _with_whole_head(places @ axes)
        centers = _together(turned[:, :HEAD])
        count = len(places)
        leaves = -(-len(places) // LEAF)
        rows = np.full((leaves * LEAF, turned.shape[1]), np.inf, np.float32)
        rows[:count] = turned[centers]
        starts = np.arange(0, count, LEAF)
        boxes = np.array(
            [side.reduceat(rows[:count, :HEAD], starts).T for side in (np.minimum, np.maximum)]
        )
        by_leaf = rows.reshape(leaves, LEAF, -1).transpose(0, 2, 1)
        head, tail = (np.ascontiguousarray(part) for part in (by_leaf[:, :HEAD], by_leaf[:, HEAD:]))
        return Leaves(axes, centers, head, tail=tail, boxes=boxes)

    def nearest(self, queries: FloatArray) -> tuple[IntArray, Single]:
        """The NEAREST centers of n places [n, M], or all if there are fewer, and their squared
        distances, [n, NEAREST].

        The nearest comes first. A distance beyond single precision is ∞, and its center anyone.
        """
        count = min(NEAREST, len(self.centers))
        index = np.zeros((len(queries), count), np.int64)
        squared = np.full((len(queries), count), np.inf, np.float32)
        _find(
            _with_whole_head(queries @ self.axes),
            self.head,
            self.tail,
            boxes=self.boxes,
            index=index,
            squared=squared,
        )
        return self.centers[index], squared


def _with_whole_head(turned: FloatArray) -> Single:
    """In single precision, with columns of zeros up to HEAD."""
    rows, columns = turned.shape
    whole = np.zeros((rows, max(columns, HEAD)), np.float32)
    with np.errstate(over="ignore"):
        whole[:, :columns] = turned
    return whole


def _together(places: Single) -> IntArray:
    """An order of places [C, M] in which those of a leaf lie close together: halves, again and
    again."""
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
    query: Single, head: Single, tail: Single, boxes: Single, index: IntArray, squared: Single
) -> None:
    """Fill in the nearest centers; in one piece, since to hand rows of arrays on would take longer
    than the search."""
    last = squared.shape[1] - 1
    nothing = np.float32(0.0)
    leaves, tails = tail.shape[:2]
    bound = np.empty(leaves, np.float32)
    distance = np.empty(LEAF, np.float32)
    least = np.empty(NEAREST, np.float32)
    bound_bits = bound.view(np.int32)
    distance_bits = distance.view(np.int32)
    least_bits = least.view(np.int32)
    for n in range(len(query)):
        bound[:] = nothing  # how near, squared, each box comes
        for m in range(HEAD):
            q = query[n, m]
            for leaf in range(leaves):
                below = boxes[0, m, leaf] - q
                above = q - boxes[1, m, leaf]
                outside = below if below > above else above
                outside = outside if outside > nothing else nothing
                bound[leaf] += outside * outside
        least_bits[0] = INFINITE_BITS
        for leaf in range(leaves):
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
        for turn in range(
            leaves
        ):  # that one first, in the place of the first: the more are ruled out by what it holds
            leaf = nearest if turn == 0 else 0 if turn == nearest else turn
            if bound[leaf] >= worst:
                continue
            bits = INFINITE_BITS
            for i in range(
                LEAF
            ):  # sums of a head stay in registers: half of the time of a loop over columns
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
            for m in range(tails):
                q = query[n, HEAD + m]
                for i in range(LEAF):
                    difference = tail[leaf, m, i] - q
                    distance[i] += difference * difference
            if (
                turn == 0
            ):  # as many centers as are wanted are at least this near: one in each part of the leaf
                for part in range(NEAREST):
                    bits = INFINITE_BITS
                    for i in range(LEAF // NEAREST):
                        bits = min(bits, distance_bits[part * (LEAF // NEAREST) + i])
                    least_bits[part] = bits
                worst = ABOVE * max(max(least[0], least[1]), max(least[2], least[3])) + TINY
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

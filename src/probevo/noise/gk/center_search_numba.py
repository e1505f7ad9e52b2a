"""Compiled loop of the search for the nearest centers (see ``center_search``)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from probevo.arrays import SingleArray
from probevo.compiled import compiled

if TYPE_CHECKING:
    from probevo.noise.gk.center_search import Leaves, NearestCenters

LEAF = 64
"""Number of centers in a leaf."""
HEAD = 8
"""Number of coordinates that rule out a center; the loop spells them out."""
NEAREST = 4
"""Number of centers that are found."""
INFINITE_BITS = np.int32(np.float32(np.inf).view(np.int32))
"""Bits of ∞. The bits of non-negative floats are ordered as the floats, and the minimum of integers
vectorises."""
ABOVE = np.float32(1.0 + 1e-6)
TINY = np.float32(1e-30)
"""ABOVE x + TINY is slightly above x ≥ 0."""


@compiled
def search_leaves(leaves: Leaves, query: SingleArray, found: NearestCenters) -> None:
    """Fill in the nearest centers of rotated points, [n, M].

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
        # The leaf with the least bound is visited first.
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
        # Invariant: no center at ``worst`` or farther is among the nearest; ∞ at the beginning.
        worst = squared[n, last]
        for visit in range(num_leaves):
            # The nearest leaf is visited first, swapped with leaf 0: what it holds rules out more
            # of the others.
            leaf = visit
            if visit == 0:
                leaf = nearest
            elif visit == nearest:
                leaf = 0
            if bound[leaf] >= worst:
                continue
            # Squared distances in the first coordinates. Written out, the sums stay in registers,
            # which takes half of the time of a loop over columns.
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
                first_half = (d0 * d0 + d1 * d1) + (d2 * d2 + d3 * d3)
                second_half = (d4 * d4 + d5 * d5) + (d6 * d6 + d7 * d7)
                distance[i] = first_half + second_half
                bits = min(bits, np.float32(first_half + second_half).view(np.int32))
            # If already the partial distances of all centers exceed that, skip the leaf.
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
                    rank = last
                    total = distance[i]
                    while rank > 0 and squared[n, rank - 1] > total:
                        squared[n, rank] = squared[n, rank - 1]
                        index[n, rank] = index[n, rank - 1]
                        rank -= 1
                    squared[n, rank] = total
                    index[n, rank] = leaf * LEAF + i
                    worst = min(worst, squared[n, last])

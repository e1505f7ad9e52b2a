"""A noise model distilled into a few thousand centers: what a prediction costs no longer depends on
the training data.

Between centers, the nearest few are averaged, nearer ones more: scales by their Cholesky factors,
whose diagonal goes
by its logarithm, so that every mixture is positive definite and σ of 0.1 and 10 px meet at 1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import KDTree

from probevo.arrays import BoolArray, FloatArray, IntArray
from probevo.compiled import compiled
from probevo.noise.gk.center_search import NEAREST, Leaves, Single
from probevo.noise.student_t_fit import Students

LARGEST_LOGARITHM = 100.0
"""Of a σ in pixels, or of degrees of freedom: no number of a sound model."""
VALUES = 15
LOGARITHMS = [4, 6, 9, 13, 14]
"""Which of the values are such: the Cholesky factor's diagonal and ν (``Students.mixable``)."""
MOST_SAMPLES = 0.999
MARGIN = 1.5
LEAST_EDGE = 1e-6
"""The domain ends so many times as far from the nearest center as that share of the training data
lies at most."""
FADE = MARGIN / (MARGIN - 1.0)
"""What is known begins to fade where that share of the data ends."""


@dataclass(frozen=True)
class Centers:
    """C places in a space of M coordinates, and what holds at each."""

    places: Single
    """[M, C]."""
    values: Single
    """``Students.mixable``, [C, VALUES]."""

    @property
    def logarithms(self) -> Single:
        """Those of the Cholesky factor's diagonal and of the degrees of freedom, [C, 5]."""
        return self.values[:, LOGARITHMS]

    @staticmethod
    def of(places: FloatArray, students: Students) -> Centers:
        """Take up what was fitted at C places [C, M]."""
        return Centers(np.ascontiguousarray(places.T, np.float32), students.mixable)

    def edge_of(self, samples: FloatArray) -> float:
        """Distance from the nearest center at which the domain of samples [N, M] ends; no center is
        among them.

        Of too few to see that share of them, each center's distance from the next one counts too.
        """
        tree = KDTree(self.places.T)
        distance = np.asarray(tree.query(samples)[0]) if len(samples) else np.zeros(0)
        if len(samples) * (1.0 - MOST_SAMPLES) < 1.0 and len(self.values) > 1:
            distance = np.concatenate([distance, np.ravel(tree.query(self.places.T, [2])[0])])
        distance = distance if len(distance) else np.ones(1)
        return max(MARGIN * float(np.quantile(distance, MOST_SAMPLES)), LEAST_EDGE)

    def at(self, queries: FloatArray, edge: float, prior: Students) -> tuple[Students, BoolArray]:
        """The distributions at n places, [n, M].

        Over the outermost part of the way from the nearest center to the edge, the prior takes
        over.

        Args:
            queries: finite.
            edge: distance from the nearest center at which nothing is known.
            prior: C = 1; what holds beyond.

        Returns:
            the distributions, and which places are beyond the edge, [n].
        """
        count = len(queries)
        scale = np.empty((count, 4, 4))
        dof = np.empty(count)
        bias = np.empty((count, 4))
        index, squared = self._leaves.nearest(queries)
        _mix(
            index,
            squared,
            self.values,
            own=prior.mixable[0],
            edge=edge,
            scale=scale,
            dof=dof,
            bias=bias,
        )
        return Students(scale, dof, bias), np.asarray(squared[:, 0] >= edge**2)

    @cached_property
    def _leaves(self) -> Leaves:
        return Leaves.of(self.places.T.astype(np.float64))


@compiled
def _mix(
    index: IntArray,
    squared: Single,
    values: Single,
    own: Single,
    edge: float,
    scale: FloatArray,
    dof: FloatArray,
    bias: FloatArray,
) -> None:
    """Fill in the distributions from the nearest centers and their squared distances, [n, k]."""
    count, nearest = index.shape
    mixed = np.empty(VALUES)
    lower = np.zeros((4, 4))
    weight = np.zeros(NEAREST)
    for n in range(count):
        total = 0.0
        farthest = squared[n, nearest - 1]
        for k in range(nearest):  # inverse squares, bounded at a hundredth of the farthest
            weight[k] = (
                1.0 / (squared[n, k] + 0.01 * farthest + 1e-12) if farthest < np.inf else 0.0
            )
            total += weight[k]
        a = index[n, 0]
        b = index[n, 1 % nearest]
        c = index[n, 2 % nearest]
        d = index[n, 3 % nearest]
        share = (
            min(1.0, max(0.0, FADE * (1.0 - math.sqrt(squared[n, 0]) / edge)))
            if total > 0.0
            else 0.0
        )
        part = share / total if share > 0.0 else 0.0
        wa = part * weight[0]
        wb = part * weight[1]
        wc = part * weight[2]
        wd = part * weight[3]
        for j in range(VALUES):
            near = wa * values[a, j] + wb * values[b, j] + wc * values[c, j] + wd * values[d, j]
            mixed[j] = (1.0 - share) * own[j] + near
        for i in range(4):
            bias[n, i] = mixed[i]
            for j in range(i + 1):
                factor = mixed[4 + i * (i + 1) // 2 + j]
                lower[i, j] = math.exp(factor) if i == j else factor
        for i in range(4):
            for j in range(i + 1):
                product = 0.0
                for k in range(j + 1):
                    product += lower[i, k] * lower[j, k]
                scale[n, i, j] = scale[n, j, i] = product
        dof[n] = math.exp(mixed[14])

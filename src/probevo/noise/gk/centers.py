"""A generalized kernel sampled at a few thousand centers, between which it is interpolated.

The cost of a prediction then no longer depends on the amount of training data. Between centers,
the parameters of the nearest few are averaged with weights of inverse squared distance. The
parameters are the ones in ``StudentTBatch.log_cholesky``: every mean is a valid distribution, and
half way between σ = 0.1 px and 10 px lies 1 px.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import KDTree

from probevo.arrays import BoolArray, FloatArray, SingleArray
from probevo.noise.gk.center_search import Leaves
from probevo.noise.gk.centers_numba import DOMAIN_MARGIN, interpolate
from probevo.noise.student_t_arrays import LOG_PARAMETERS, StudentTBatch

MAX_LOG = 100.0
"""Bound of the logarithms of σ in pixels and of ν; a valid model stays far below."""
DOMAIN_QUANTILE = 0.999
"""The radius of the domain is ``DOMAIN_MARGIN`` times the distance from the nearest center within
which this share of the training data lies."""
MIN_DOMAIN_RADIUS = 1e-6


@dataclass(frozen=True)
class Centers:
    """C points in M dimensions, and the distribution at each."""

    points: SingleArray
    """Coordinates, [M, C]."""
    parameters: SingleArray
    """Log-Cholesky parameters of each distribution, [C, NUM_PARAMETERS]."""

    @staticmethod
    def of(points: FloatArray, fitted: StudentTBatch) -> Centers:
        """Store the distributions that were fitted at C points [C, M]."""
        return Centers(
            points=np.ascontiguousarray(points.T, np.float32), parameters=fitted.log_cholesky()
        )

    @property
    def logarithms(self) -> SingleArray:
        """The parameters that are logarithms: of the Cholesky diagonal and of ν, [C, 5]."""
        return self.parameters[:, LOG_PARAMETERS]

    def domain_radius_of(self, samples: FloatArray) -> float:
        """Return the distance from the nearest center at which the domain of the data ends.

        Args:
            samples: training data that are no centers, [N, M]. If they are too few to determine the
                quantile, the distances between neighbouring centers count, too.
        """
        # Distances of the other training samples from their nearest centers.
        tree = KDTree(self.points.T)
        distance = np.asarray(tree.query(samples)[0]) if len(samples) else np.zeros(0)
        if len(samples) * (1.0 - DOMAIN_QUANTILE) < 1.0 and len(self.parameters) > 1:
            to_next_center = np.ravel(tree.query(self.points.T, [2])[0])
            distance = np.concatenate([distance, to_next_center])
        if not len(distance):
            distance = np.ones(1)
        radius = DOMAIN_MARGIN * float(np.quantile(distance, DOMAIN_QUANTILE))
        return max(radius, MIN_DOMAIN_RADIUS)

    def at(
        self, queries: FloatArray, domain_radius: float, prior: StudentTBatch
    ) -> tuple[StudentTBatch, BoolArray]:
        """Interpolate the distributions at n points, [n, M].

        Over the outermost part of the domain, the interpolated distribution turns into the prior.

        Args:
            queries: coordinates, finite.
            domain_radius: distance from the nearest center beyond which the prior holds.
            prior: the distribution outside of the domain, C = 1.

        Returns:
            The n distributions, and which points are outside of the domain, [n].
        """
        count = len(queries)
        mixed = StudentTBatch(
            scale=np.empty((count, 4, 4)), dof=np.empty(count), bias=np.empty((count, 4))
        )
        nearest = self._leaves.nearest(queries)
        interpolate(
            nearest,
            self.parameters,
            prior.log_cholesky()[0],
            domain_radius=domain_radius,
            mixed=mixed,
        )
        # Beyond the radius the share of the centers is 0: such a point has the prior.
        return mixed, np.asarray(nearest.squared[:, 0] >= domain_radius**2)

    @cached_property
    def _leaves(self) -> Leaves:
        return Leaves.of(self.points.T.astype(np.float64))

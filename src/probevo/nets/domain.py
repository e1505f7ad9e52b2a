"""Whether an input is like those that a network has learned from, by its features."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from probevo.arrays import AnyArray, FloatArray

SHRINKAGE = 0.01
"""Share of the mean variance that is added to each: features that hardly vary decide nothing."""
USUAL_SHARE = 0.99
"""Share of the data left out that counts as within the domain."""
FARTHEST = 16.0
"""Widening beyond which a network has nothing to say."""


class Domain(NamedTuple):
    """The distribution of the features of the training data, as a Gaussian.

    Its arrays are of single precision, as they are in the file.
    """

    mean: AnyArray
    """Mean of each feature, [f]."""
    information: AnyArray
    """Inverse of the covariance, [f, f]."""
    limit: AnyArray
    """Squared Mahalanobis distance of the usual, [], as of data left out."""

    @staticmethod
    def of(features: FloatArray, left_out: FloatArray) -> Domain:
        """Return the domain of training data, [N, f], with its limit from others, [N', f]."""
        features = np.asarray(features, np.float64)
        mean = features.mean(axis=0)
        covariance = np.atleast_2d(np.cov(features, rowvar=False))
        covariance += SHRINKAGE * np.trace(covariance) / len(covariance) * np.eye(len(covariance))
        information = np.linalg.inv(covariance)
        domain = Domain(
            np.asarray(mean, np.float32),
            np.asarray(information, np.float32),
            np.ones((), np.float32),
        )
        # The limit comes from data left out, since the network has not adapted to them.
        limit = np.quantile(domain.distance_squared(left_out), USUAL_SHARE)
        return domain._replace(limit=np.asarray(limit, np.float32))

    def distance_squared(self, features: FloatArray) -> FloatArray:
        """Return the squared Mahalanobis distance of features [N, f] from the mean, [N]."""
        from_mean = features - np.asarray(self.mean, np.float64)
        distance: FloatArray = np.einsum("ni,ij,nj->n", from_mean, self.information, from_mean)
        return distance

    def widening(self, features: FloatArray) -> FloatArray:
        """Return the factors, [N], ≥ 1, on the covariances of inputs with features [N, f].

        Within the domain it is 1. Outside, the standard deviation grows as the squared distance
        does beyond the limit.
        """
        # σ × beyond, and so Σ × beyond²
        beyond = self.distance_squared(features) / float(self.limit)
        return np.maximum(beyond, 1.0) ** 2

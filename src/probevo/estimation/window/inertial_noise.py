"""How much noisier an IMU is than its data sheet says, from how far its predictions were off.

Data sheets give the noise of a sensor at rest; on a vehicle that vibrates it is larger. What the
images show, less what the IMU predicted, has the covariance A + k B: A from the images and from the
window's velocity, biases and gravity, B from the noise of the samples by the data sheet. The noise
factor k is the one at which the last of these distances are as large in the median as they should
be. They are tested again at each k, whatever factor was used at their time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.optimize

from probevo.arrays import FloatArray

MEDIAN_SQUARED = 5.348
"""Median of χ² of six degrees of freedom."""
ACCURACY = 1e-3
"""Relative accuracy of a noise factor, which twenty innovations know to about a half."""


@dataclass(frozen=True)
class InertialInnovation:
    """How far a predicted motion was off, along six axes in which both covariances are diagonal."""

    whitened_sq: FloatArray
    """Squared differences over the variances of images and states, [6]."""
    noise: FloatArray
    """Variances of the samples' noise over those of images and states, [6]."""

    def squared_distance(self, noise_factor: float) -> float:
        """Return the squared Mahalanobis distance, with the samples' variances times a factor."""
        return float((self.whitened_sq / (1.0 + noise_factor * self.noise)).sum())


def innovation_of(
    difference: FloatArray, cov_of_others: FloatArray, cov_of_samples: FloatArray
) -> InertialInnovation:
    """Return how far a predicted motion was off; infinitely, where that cannot be computed.

    Args:
        difference: perturbation between the motion of the images and that predicted, [6].
        cov_of_others: of the images and of the states that the prediction starts from, [6, 6].
        cov_of_samples: of the noise of the samples, by the data sheet, [6, 6].
    """
    unknown = InertialInnovation(whitened_sq=np.full(6, np.inf), noise=np.zeros(6))
    # V with Vᵀ A V = I and Vᵀ B V = diag(λ): νᵀ (A + k B)⁻¹ ν = Σ (Vᵀν)² / (1 + k λ).
    try:
        noise, axes = scipy.linalg.eigh(cov_of_samples, cov_of_others)
    except (np.linalg.LinAlgError, ValueError):
        # NaN; or covariances so large, after a long blackout, that rounding makes them indefinite.
        return unknown
    whitened_sq = (axes.T @ difference) ** 2
    if not np.isfinite(whitened_sq).all():
        return unknown
    return InertialInnovation(whitened_sq, np.maximum(noise, 0.0))


def median_excess(innovations: Sequence[InertialInnovation], noise_factor: float) -> float:
    """Return by how much covariances with this noise factor are still too small in the median."""
    whitened_sq, noise = _stacked(innovations)
    return _median_excess(whitened_sq, noise, noise_factor)


def estimated_noise_factor(innovations: Sequence[InertialInnovation], *, largest: float) -> float:
    """Return the noise factor at which the median of the distances is that of χ².

    The median leaves out what is gated.

    Args:
        innovations: of the last predictions.
        largest: upper bound; the lower one is 1, the data sheet.
    """
    whitened_sq, noise = _stacked(innovations)

    def surplus(noise_factor: float) -> float:
        """Return by how much the median is too large; it falls with the factor."""
        return _median_excess(whitened_sq, noise, noise_factor) - 1.0

    if surplus(1.0) <= 0.0:
        return 1.0
    if surplus(largest) >= 0.0:
        return largest
    return float(scipy.optimize.brentq(surplus, 1.0, largest, rtol=ACCURACY))


def _stacked(innovations: Sequence[InertialInnovation]) -> tuple[FloatArray, FloatArray]:
    """Return squared differences and noise of T innovations, [T, 6] each."""
    whitened_sq = np.array([innovation.whitened_sq for innovation in innovations])
    noise = np.array([innovation.noise for innovation in innovations])
    return whitened_sq, noise


def _median_excess(whitened_sq: FloatArray, noise: FloatArray, noise_factor: float) -> float:
    """Return the median of squared distances over that of χ²."""
    distances = (whitened_sq / (1.0 + noise_factor * noise)).sum(axis=1)
    return float(np.median(distances)) / MEDIAN_SQUARED

"""Draws of an uncertain pose, for checks by Monte Carlo: ``from geometry.samples import
sample_poses``."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.geometry import se3


def sample_poses(
    T_mean: FloatArray, cov: FloatArray, count: int, rng: np.random.Generator
) -> FloatArray:
    """Draws of Exp(ξ) T̄: mean [4, 4] and covariance [6, 6] to [count, 4, 4] (thesis eq. 2.26)."""
    return se3.exp(rng.multivariate_normal(np.zeros(6), cov, size=count, method="eigh")) @ T_mean

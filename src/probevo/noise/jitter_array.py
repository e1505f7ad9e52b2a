"""The covariance of the rig's jitter as learned models keep it in their files."""

from __future__ import annotations

import numpy as np

from probevo.arrays import AnyArray, FloatArray
from probevo.noise.base import NoiseModel
from probevo.noise.model_file import ModelFile
from probevo.noise.positive_definite import is_positive_definite

NAME = "jitter_cov"
MAX_SIGMA_RAD = 0.1
"""Largest plausible σ of an angle: with more, the two images would not match at all."""


def jitter_arrays(jitter_cov: FloatArray | None) -> dict[str, AnyArray]:
    """Return the array of a file for the covariance S, [3, 3], rad²; none where it is None."""
    return {} if jitter_cov is None else {NAME: np.asarray(jitter_cov, dtype=np.float64)}


def jitter_cov_of(file: ModelFile) -> FloatArray | None:
    """Read S, [3, 3], rad², from a file; None if its model has not learned it.

    Raises:
        ValueError: it is no covariance of small angles.
    """
    cov = file.arrays.get(NAME)
    if cov is None:
        return None
    if not is_positive_definite(cov, 3):
        raise ValueError("its covariance of the jitter is not a positive definite matrix")
    if np.diagonal(cov).max() > MAX_SIGMA_RAD**2:
        raise ValueError("its jitter is not a small rotation")
    return cov


def learned_jitter_cov(model: NoiseModel) -> FloatArray | None:
    """Return the covariance of the jitter that a noise model has learned, [3, 3], rad².

    It is the attribute ``jitter_cov``, which a model need not have; None without it.
    """
    cov: FloatArray | None = getattr(model, NAME, None)
    return cov

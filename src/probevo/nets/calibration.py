"""The factor on predicted covariances that recordings left out ask for, errors in time included."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from probevo.arrays import FloatArray
from probevo.nets.covariance_scale import covariance_scale, coverage, negative_log_likelihoods

BLOCK = 10
"""Successive data whose errors are added up to see how far they are correlated in time."""


class Claimed(NamedTuple):
    """Errors on one recording of N inputs, and what was claimed for them."""

    errors: FloatArray
    """Error of each estimate along the tangent directions, [N, d]."""
    covariances: FloatArray
    """Covariance claimed for each, [N, d, d]."""
    widening: FloatArray
    """Factor by which each covariance was widened because the input is unlike the training data,
    [N]."""


class Calibration(NamedTuple):
    """The factor on all covariances, and statistics of the errors with it."""

    scale: float
    """The larger of the two that follow."""
    scale_single: float
    """The factor by single errors."""
    scale_blocks: float
    """The factor by sums of ten successive errors."""
    nll: float
    coverage_90: float
    """Share of single errors within their 90 % region."""
    num: int
    """Data left out."""

    def facts(self) -> dict[str, Any]:
        """Return what the file of a network says of it."""
        return {
            "scale": self.scale,
            "scale_single": self.scale_single,
            "scale_blocks": self.scale_blocks,
            "nll": self.nll,
            "coverage_90": self.coverage_90,
            "num_left_out": self.num,
        }


def calibration(left_out: Sequence[Claimed]) -> Calibration:
    """Return the factor on covariances, from errors of recordings that were not learned from.

    Errors of successive data are correlated: the same street is seen again. A path adds them up,
    and each measurement enters with a covariance of its own, and the sum of ten errors has to fit
    the sum of their covariances, too. The larger of the two factors counts.
    """
    all_errors = np.concatenate([each.errors for each in left_out])
    all_covariances = np.concatenate([each.covariances for each in left_out])
    single = covariance_scale(all_errors, all_covariances)
    # No block reaches from one recording into the next.
    block_scale = covariance_scale(
        np.concatenate([block_sums(each.errors) for each in left_out]),
        np.concatenate([block_sums(each.covariances) for each in left_out]),
    )
    # Both scales are s = 1/(N d) Σ φᵀ Σ⁻¹ φ.
    scale = max(single, block_scale)
    nll = negative_log_likelihoods(all_errors, scale * all_covariances)
    return Calibration(
        scale,
        single,
        block_scale,
        nll=float(np.mean(nll)),
        coverage_90=coverage(all_errors, scale * all_covariances, 0.9),
        num=len(all_errors),
    )


def block_sums(values: FloatArray) -> FloatArray:
    """Return the sums of each ten successive values, [N, …], in [N // 10, …]."""
    num_blocks = len(values) // BLOCK
    blocks = values[: num_blocks * BLOCK].reshape(num_blocks, BLOCK, *values.shape[1:])
    return np.asarray(blocks.sum(axis=1))

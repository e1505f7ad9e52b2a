"""The error α along one predictor: means in bins of equally many samples, with standard errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probevo.arrays import FloatArray, IntArray

MAX_BINS = 20
MIN_IN_BIN = 40
"""Values in a bin, at least: a mean or a median of fewer says little."""


@dataclass(frozen=True)
class Profile:
    """Mean ln(α/ᾱ) of the samples in each of B bins along a column."""

    center: FloatArray
    """Median of the column in each bin, [B], ascending."""
    mean: FloatArray
    """Mean ln(α/ᾱ) in each bin, [B]."""
    standard_error: FloatArray
    """Standard error of the mean, [B]: the samples of one subset share its α, and count as one."""
    undefined: tuple[float, float] | None
    """Mean and standard error where the column is undefined; None if it never is."""
    share_undefined: float
    share_explained: float
    """Share of the variance of ln α that the bins explain, less what chance would give them."""


def inner_edges(values: FloatArray, most: int) -> FloatArray:
    """Return the edges between at most ``most`` bins of equally many values each, ascending."""
    num_bins = int(np.clip(len(values) // MIN_IN_BIN, 1, most))
    if num_bins == 1:
        return np.zeros(0)
    quantiles = np.linspace(0.0, 1.0, num_bins + 1)[1:-1]
    return np.unique(np.quantile(values, quantiles))


def profile_along(values: FloatArray, log_alpha: FloatArray) -> Profile:
    """Compute the profile of N samples.

    Args:
        values: value of the column for each sample, [N]; NaN where undefined.
        log_alpha: ln(α/ᾱ) of each, [N].

    Samples of equal α are taken to be of one subset: α is a real number, which two motions hardly
    share.
    """
    # Bins of equally many samples; equal values stay together, undefined ones have the last bin.
    known = np.isfinite(values)
    edges = inner_edges(values[known], MAX_BINS)
    bins = np.where(known, np.searchsorted(edges, values, side="right"), MAX_BINS)
    used, bins = np.unique(bins, return_inverse=True)
    mean, error, number = _bin_means(bins, log_alpha)
    # Variance between the bins, less the one that chance would give their means.
    variance_between = np.sum(number * ((mean - log_alpha.mean()) ** 2 - error**2)) / len(values)
    total = float(log_alpha.var())
    regular = used < MAX_BINS
    center = np.array([np.median(values[bins == b]) for b in np.flatnonzero(regular)])
    undefined = None if known.all() else (float(mean[-1]), float(error[-1]))
    share = float(np.clip(variance_between / total, 0.0, 1.0)) if total > 0.0 else 0.0
    return Profile(
        center,
        mean[regular],
        error[regular],
        undefined=undefined,
        share_undefined=1.0 - float(known.mean()),
        share_explained=share,
    )


def _bin_means(bins: IntArray, log_alpha: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Compute mean, its standard error over subsets, and number of samples of B bins, [B] each."""
    # Samples of a subset have one α, and so the same error: the variance of a bin's mean is the sum
    # of the squared errors of its subsets, and not of its samples.
    number = np.bincount(bins).astype(np.float64)
    mean = np.bincount(bins, log_alpha) / number
    distinct, subset = np.unique(log_alpha, return_inverse=True)
    pairs, pair = np.unique(bins * len(distinct) + subset, return_inverse=True)
    bin_of_pair = pairs // len(distinct)
    sums = np.bincount(pair, log_alpha - mean[bins])
    subsets = np.bincount(bin_of_pair)
    # With few subsets their sums scatter less around the mean of the same ones than around the true
    # one.
    correction = subsets / np.maximum(subsets - 1, 1)
    return mean, np.sqrt(np.bincount(bin_of_pair, sums**2) * correction) / number, number

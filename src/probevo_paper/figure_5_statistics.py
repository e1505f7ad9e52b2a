"""The statistics of PROBE Fig. 5: mean and spread of errors at low and at high blur.

Errors within a second are correlated, since slow motion keeps its direction for about as long. Each
second is therefore a cluster: standard errors are cluster-robust, and the bootstrap draws clusters.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probevo.arrays import BoolArray, FloatArray, IntArray
from probevo.output.table import readable
from probevo_paper.figure_5 import BlurObservations

STANDARD_ERRORS = 3.0
"""A mean within so many standard errors of 0 counts as zero."""
SMALL_SIGMAS = 0.1
"""A mean that does not, but is below this part of σ, counts as nearly zero."""
INSTANTS_PER_CLUSTER = 5
"""Instants of one cluster: 1 s."""
RESAMPLES = 4000
INTERVAL_PERCENT = (2.5, 97.5)
CORE = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""
NORMAL_TAILS = 1.2
"""Errors whose σ is up to so many times their core's pass for normal."""
FAR_PX = 3.0
KINDS = ("reprojection", "tracking")
AXES = ("horizontal", "vertical")


@dataclass(frozen=True)
class ErrorSummary:
    """Errors along one axis in one class of blur. Values that need more errors are NaN."""

    count: int
    """Number of errors."""
    instants: int
    """Number of instants at which they were seen."""
    mean_px: float
    standard_error_px: float
    """Cluster-robust standard error of the mean."""
    sigma_px: float
    """Standard deviation."""
    core_px: float
    """Robust standard deviation, which describes the core: 1.4826 times the median absolute
    deviation."""
    median_px: float
    far_share: float
    """Share of the errors beyond 3 px."""

    @property
    def is_zero_mean(self) -> bool:
        """Whether 0 lies within 3 standard errors of the mean."""
        return abs(self.mean_px) <= STANDARD_ERRORS * self.standard_error_px


@dataclass(frozen=True)
class Finding:
    """One error along one axis, at low and at high blur."""

    kind: str
    """Either reprojection or tracking."""
    axis: str
    """Either horizontal or vertical."""
    low: ErrorSummary
    high: ErrorSummary
    ratio: float
    """Variance at high over that at low blur."""
    ratio_interval: tuple[float, float]
    """Its 95 % interval, by bootstrap over clusters."""
    core_ratio: float
    """The same ratio of the squared spreads of the cores."""

    @property
    def is_zero_mean(self) -> bool:
        """Whether the mean is zero at low and at high blur."""
        return self.low.is_zero_mean and self.high.is_zero_mean

    @property
    def variance_grows(self) -> bool:
        """Whether the whole interval of the ratio lies above 1."""
        return self.ratio_interval[0] > 1.0


def findings(observations: BlurObservations, rng: np.random.Generator) -> tuple[Finding, ...]:
    """Summarise reprojection and tracking error, horizontal and vertical each.

    Args:
        observations: the errors, and the blur of each.
        rng: draws the resamples of the bootstrap.

    """
    errors_px = {
        "reprojection": observations.reprojection_px,
        "tracking": observations.tracking_px,
    }
    result = []
    for kind in KINDS:
        for axis, along_px in zip(AXES, errors_px[kind].T, strict=True):
            known = np.isfinite(along_px)
            error = along_px[known]
            instant = observations.instant[known]
            is_high = observations.is_high[known]
            low = summarise(error[~is_high], instant[~is_high])
            high = summarise(error[is_high], instant[is_high])
            finding = Finding(
                kind=kind,
                axis=axis,
                low=low,
                high=high,
                ratio=_square_ratio(high.sigma_px, low.sigma_px),
                ratio_interval=variance_ratio_interval(error, instant, is_high, rng=rng),
                core_ratio=_square_ratio(high.core_px, low.core_px),
            )
            result.append(finding)
    return tuple(result)


def summarise(error: FloatArray, instant: IntArray) -> ErrorSummary:
    """Summarise errors, [N], px, seen at the numbered instants, [N].

    The variance of the mean is the cluster-robust estimate
    Σ_g (Σ_i (e_i − mean))² / N² · G / (G − 1), with the inner sum over the errors of cluster g and
    the outer one over the G clusters.
    """
    count = len(error)
    if count == 0:
        return ErrorSummary(
            count=0,
            instants=0,
            mean_px=np.nan,
            standard_error_px=np.nan,
            sigma_px=np.nan,
            core_px=np.nan,
            median_px=np.nan,
            far_share=np.nan,
        )
    mean = float(error.mean())
    median = float(np.median(error))
    cluster, num_clusters = _clusters(instant)
    standard_error = np.nan
    if num_clusters > 1:
        sums = np.bincount(cluster, weights=error - mean)
        variance = np.sum(sums**2) * num_clusters / (num_clusters - 1)
        standard_error = float(np.sqrt(variance)) / count
    return ErrorSummary(
        count=count,
        instants=len(np.unique(instant)),
        mean_px=mean,
        standard_error_px=standard_error,
        sigma_px=float(error.std(ddof=1)) if count > 1 else np.nan,
        core_px=CORE * float(np.median(np.abs(error - median))),
        median_px=median,
        far_share=float(np.mean(np.abs(error) > FAR_PX)),
    )


def variance_ratio_interval(
    error: FloatArray, instant: IntArray, is_high: BoolArray, rng: np.random.Generator
) -> tuple[float, float]:
    """Return the 95 % interval of the variance at high over that at low blur; NaN if undefined.

    A bootstrap that draws whole clusters: an F-test would need independent normal errors, and these
    are neither.
    """
    cluster, num_clusters = _clusters(instant)
    if num_clusters == 0:
        return np.nan, np.nan

    # Number, sum and sum of squares of the errors of each cluster, [2 (low, high), 3, G].
    classes = np.array([is_high == part for part in (False, True)])
    powers = error ** np.arange(3)[:, None]
    moments = classes[:, None] * powers
    sums = np.stack([[np.bincount(cluster, weights=m) for m in part] for part in moments])

    # The same of each resample, in which cluster g is drawn ``drawn[r, g]`` times.
    drawn = rng.multinomial(num_clusters, np.full(num_clusters, 1.0 / num_clusters), size=RESAMPLES)
    number, total, squares = np.moveaxis(np.einsum("rg,pmg->rpm", drawn, sums), -1, 0)

    # A resample without errors in one of the classes has no ratio.
    enough = (number > 1).all(axis=1)
    if not enough.any():
        return np.nan, np.nan
    variance = squares[enough] / number[enough] - (total[enough] / number[enough]) ** 2
    ratio = variance[:, 1] / np.maximum(variance[:, 0], 1e-12)
    low, high = np.percentile(ratio, INTERVAL_PERCENT)
    return float(low), float(high)


def _clusters(instant: IntArray) -> tuple[IntArray, int]:
    """Return the cluster of each error, [N], counted over those that have any, and their number."""
    clusters, cluster = np.unique(instant // INSTANTS_PER_CLUSTER, return_inverse=True)
    return cluster, len(clusters)


def _square_ratio(high: float, low: float) -> float:
    return (high / low) ** 2 if low > 0.0 else np.nan


def verdicts(results: tuple[Finding, ...]) -> list[str]:
    """Say in words whether the paper's claim holds: the means, the variances, and the shape."""
    parts = [part for finding in results for part in (finding.low, finding.high)]
    return [_mean_verdict(parts), _variance_verdict(results), _shape_verdict(results, parts)]


def _mean_verdict(parts: list[ErrorSummary]) -> str:
    """Say whether errors are zero-mean."""
    unbiased = sum(part.is_zero_mean for part in parts)
    most_errors = max(abs(part.mean_px) / part.standard_error_px for part in parts)
    most_sigmas = max(abs(part.mean_px) / part.sigma_px for part in parts)
    if unbiased == len(parts):
        answer = "yes"
    elif most_sigmas <= SMALL_SIGMAS:
        answer = "nearly"
    else:
        answer = "no"
    return (
        f"Zero-mean: {answer}; {unbiased} of {len(parts)} means lie within {STANDARD_ERRORS:g}"
        f" standard errors of 0, the farthest {most_errors:.1f}; the largest is"
        f" {most_sigmas:.2f} σ."
    )


def _variance_verdict(results: tuple[Finding, ...]) -> str:
    """Say whether the variance grows with blur."""
    answer = "yes" if all(finding.variance_grows for finding in results) else "not for all"
    factors = " / ".join(readable(finding.ratio) for finding in results)
    lowest = min(finding.ratio_interval[0] for finding in results)
    return (
        f"Variance grows with blur: {answer}; factors {factors}, and no 95 % interval begins below"
        f" {readable(lowest)}."
    )


def _shape_verdict(results: tuple[Finding, ...], parts: list[ErrorSummary]) -> str:
    """Say whether errors are normal."""
    tails = max(part.sigma_px / part.core_px for part in parts)
    answer = "yes" if tails <= NORMAL_TAILS else "only the core"
    factors = " / ".join(readable(finding.core_ratio) for finding in results)
    far_share = max(part.far_share for part in parts)
    return (
        f"Normal: {answer}; σ is up to {tails:.1f} times that of the core. Without its tails the"
        f" variance grows by factors {factors}; up to {100 * far_share:.1f} % of the errors of a"
        f" class lie beyond {FAR_PX:g} px."
    )

"""Mean and spread of errors at low and high blur, with uncertainties that know what errors have in
common."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probevo.arrays import BoolArray, FloatArray, IntArray
from probevo.output.table import readable
from probevo_paper.blur import BlurObservations

STANDARD_ERRORS = 3.0
SMALL_SIGMAS = 0.1
"""A mean within so many standard errors of 0 counts as zero; if it is not, but below this part of
σ, as nearly so."""
STRETCH = 5
"""Instants, 1 s, whose errors are taken to have causes in common: slow motion keeps its direction
for about as long."""
RESAMPLES = 4000
INTERVAL_PERCENT = (2.5, 97.5)
CORE = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""
NORMAL_TAILS = 1.2
"""Errors whose σ is up to so many times that of their core pass for normal."""
FAR_PX = 3.0
KINDS = ("reprojection", "tracking")
AXES = ("horizontal", "vertical")


@dataclass(frozen=True)
class ErrorSummary:
    """Errors along one axis in one class of blur. Every value is NaN that too few errors leave
    undefined."""

    count: int
    instants: int
    """Number of instants at which they were seen."""
    mean_px: float
    standard_error_px: float
    """Of the mean; all errors within a second are taken as one observation of unknown correlation.
    """
    sigma_px: float
    """Standard deviation."""
    core_px: float
    """That of the core: 1.4826 times the median absolute deviation, which errors far out do not
    touch."""
    median_px: float
    far: float
    """Share of the errors beyond 3 px."""

    @property
    def is_zero_mean(self) -> bool:
        """Whether 0 lies within 3 standard errors of the mean."""
        return abs(self.mean_px) <= STANDARD_ERRORS * self.standard_error_px


@dataclass(frozen=True)
class Finding:
    """One error along one axis, at low and at high blur."""

    kind: str
    """reprojection or tracking."""
    axis: str
    """horizontal or vertical."""
    low: ErrorSummary
    high: ErrorSummary
    ratio: float
    """Variance at high over that at low blur."""
    ratio_interval: tuple[float, float]
    """95 % of it, by bootstrap over seconds."""
    core_ratio: float
    """The same ratio of the squared spreads of the cores."""

    @property
    def is_zero_mean(self) -> bool:
        """At low and at high blur."""
        return self.low.is_zero_mean and self.high.is_zero_mean

    @property
    def variance_grows(self) -> bool:
        """Whether the whole interval of the ratio lies above 1."""
        return self.ratio_interval[0] > 1.0


def findings(observations: BlurObservations, rng: np.random.Generator) -> tuple[Finding, ...]:
    """Reprojection and tracking error, horizontal and vertical each; ``rng`` is that of the
    bootstrap."""
    result = []
    for kind, errors in zip(
        KINDS, (observations.reprojection_px, observations.tracking_px), strict=True
    ):
        for axis, along in zip(AXES, errors.T, strict=True):
            known = np.isfinite(along)
            error = along[known]
            instant = observations.instant[known]
            is_high = observations.is_high[known]
            low, high = (summarise(error[part], instant[part]) for part in (~is_high, is_high))
            interval = variance_ratio_interval(error, instant, is_high, rng=rng)
            ratio = _square_ratio(high.sigma_px, low.sigma_px)
            core_ratio = _square_ratio(high.core_px, low.core_px)
            result.append(
                Finding(
                    kind,
                    axis,
                    low,
                    high=high,
                    ratio=ratio,
                    ratio_interval=interval,
                    core_ratio=core_ratio,
                )
            )
    return tuple(result)


def summarise(error: FloatArray, instant: IntArray) -> ErrorSummary:
    """Summary of errors [N], px, seen at the numbered instants [N].

    The variance of the mean is Σ_g (Σ_i (e_i − mean))² / N² · G / (G − 1), with the inner sum over
    the errors of stretch g, a second, and the outer one over the G stretches: the cluster-robust
    estimate.
    """
    count = len(error)
    groups, clusters = _stretches(instant)
    if count == 0:
        return ErrorSummary(0, 0, *[np.nan] * 6)
    mean = float(error.mean())
    median = float(np.median(error))
    sums = np.bincount(groups, weights=error - mean)
    spread = (
        float(np.sqrt(np.sum(sums**2) * clusters / (clusters - 1))) / count
        if clusters > 1
        else np.nan
    )
    return ErrorSummary(
        count=count,
        instants=len(np.unique(instant)),
        mean_px=mean,
        standard_error_px=spread,
        sigma_px=float(error.std(ddof=1)) if count > 1 else np.nan,
        core_px=CORE * float(np.median(np.abs(error - median))),
        median_px=median,
        far=float(np.mean(np.abs(error) > FAR_PX)),
    )


def variance_ratio_interval(
    error: FloatArray, instant: IntArray, is_high: BoolArray, rng: np.random.Generator
) -> tuple[float, float]:
    """95 % interval of the variance at high over that at low blur, by drawing whole seconds anew;
    NaN if undefined.

    An F-test would take the errors for independent and normal, and they are neither.
    """
    groups, clusters = _stretches(instant)
    if clusters == 0:
        return np.nan, np.nan
    moments = (
        np.array([is_high == part for part in (False, True)])[:, None]
        * error ** np.arange(3)[:, None]
    )
    sums = np.stack([[np.bincount(groups, weights=m) for m in part] for part in moments])
    drawn = rng.multinomial(clusters, np.full(clusters, 1.0 / clusters), size=RESAMPLES)
    number, total, squares = np.moveaxis(np.einsum("rg,pmg->rpm", drawn, sums), -1, 0)
    enough = (number > 1).all(axis=1)
    if not enough.any():
        return np.nan, np.nan
    variance = squares[enough] / number[enough] - (total[enough] / number[enough]) ** 2
    low, high = np.percentile(variance[:, 1] / np.maximum(variance[:, 0], 1e-12), INTERVAL_PERCENT)
    return float(low), float(high)


def _stretches(instant: IntArray) -> tuple[IntArray, int]:
    """To which stretch of time each error belongs, [N], counted over those that have any, and how
    many these are."""
    stretches, groups = np.unique(instant // STRETCH, return_inverse=True)
    return groups, len(stretches)


def _square_ratio(high: float, low: float) -> float:
    return (high / low) ** 2 if low > 0.0 else np.nan


def verdicts(results: tuple[Finding, ...]) -> list[str]:
    """Whether the paper's claim holds here, in words: the means, the variances, and the shape."""
    parts = [part for finding in results for part in (finding.low, finding.high)]
    biased = sum(not part.is_zero_mean for part in parts)
    most_errors = max(abs(part.mean_px) / part.standard_error_px for part in parts)
    most_sigmas = max(abs(part.mean_px) / part.sigma_px for part in parts)
    zero = "yes" if biased == 0 else "nearly" if most_sigmas <= SMALL_SIGMAS else "no"
    within = (
        f"{len(parts) - biased} of {len(parts)} means lie within {STANDARD_ERRORS:g} standard"
        " errors of 0"
    )
    ratios = [finding.ratio for finding in results]
    lows = [finding.ratio_interval[0] for finding in results]
    grows = all(finding.variance_grows for finding in results)
    factor = (
        f"factors {' / '.join(map(readable, ratios))}, and no 95 % interval begins below"
        f" {readable(min(lows))}"
    )
    cores = " / ".join(readable(finding.core_ratio) for finding in results)
    far = max(part.far for part in parts)
    tails = max(part.sigma_px / part.core_px for part in parts)
    shape = "yes" if tails <= NORMAL_TAILS else "only the core"
    return [
        (
            f"Zero-mean: {zero}; {within}, the farthest {most_errors:.1f}; the largest is"
            f" {most_sigmas:.2f} σ."
        ),
        f"Variance grows with blur: {'yes' if grows else 'not for all'}; {factor}.",
        (
            f"Normal: {shape}; σ is up to {tails:.1f} times that of the core. Without its tails the"
            f" variance grows by factors {cores}; up to {100 * far:.1f} % of the errors of a class"
            f" lie beyond {FAR_PX:g} px."
        ),
    ]

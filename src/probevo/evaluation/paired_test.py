"""Randomization test of whether one run over a recording is better than another.

Two runs over the same recording are paired: each step of the vehicle was estimated by both. If both
estimators are equally good, it does not matter which of the two motions of a step is called whose.
The randomization test (Fisher 1935, sec. 21) exchanges them at random, compounds both paths anew,
and so draws from the distribution of the difference of any error under this hypothesis. The truth
stays where it is: its own errors, from frame to frame and over the path, enter all draws alike.

Errors of neighbouring steps are correlated, since they see the same features. Therefore steps are
exchanged in blocks of random length, whose mean follows from the autocorrelation of the difference
of the motions (Politis and White 2004, with the correction of Patton, Politis and White 2009).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probevo.arrays import BoolArray, FloatArray, IntArray
from probevo.evaluation import segments
from probevo.geometry import se3

ERRORS = ("armse_m", "final_error_m", "short_t_percent", "short_r_deg_per_m")
"""Errors that are compared, by their names in ``Metrics``."""
DRAWS = 999
"""Number of random exchanges; a p-value is then a multiple of 1/1000."""
_DRAWS_AT_ONCE = 50
"""Draws that are computed together: what limits the memory."""
_ROUNDING = 1e-9
"""Variation below this, relative to the largest value, is rounding, and so is the difference of two
errors, relative to these."""
_FEWEST_STEPS = 10
"""Fewer steps than this give too few exchanges for any statement."""


@dataclass(frozen=True)
class PairedDifference:
    """An error of a run A and of a run B over the same recording."""

    error_a: float
    """Error of A."""
    error_b: float
    """Error of B."""
    margin: float
    """Quantile of |A − B| under the hypothesis that both are equally good, at the confidence of the
    test."""
    p_value: float
    """Share of the exchanges whose |A − B| is at least that of the runs, themselves included; what
    differs by rounding is equal."""
    confidence: float
    """Probability that the margin holds if the hypothesis does."""

    @property
    def is_significant(self) -> bool:
        """Whether the difference exceeds the noise of repetition."""
        return self.p_value <= 1.0 - self.confidence

    @property
    def reduction_percent(self) -> tuple[float, float, float]:
        """By how much A is less than B, % of B, with both ends of its confidence interval.

        The interval is that of a shift: the margin to both sides of the difference.
        """
        percent = 100.0 / self.error_b if self.error_b > 0.0 else 0.0  # both are without error
        difference = self.error_b - self.error_a
        return (
            difference * percent,
            (difference - self.margin) * percent,
            (difference + self.margin) * percent,
        )


def paired_differences(
    motions_a: FloatArray,
    motions_b: FloatArray,
    T_world_cam_true: FloatArray,
    rng: np.random.Generator,
    *,
    confidence: float = 0.95,
    draws: int = DRAWS,
) -> dict[str, PairedDifference]:
    """Test for each of ``ERRORS`` whether two runs over N frames differ.

    Args:
        motions_a: motions T_curr_prev of run A, [N-1, 4, 4], m.
        motions_b: motions of run B, [N-1, 4, 4], m.
        T_world_cam_true: true poses, [N, 4, 4], m, in any world frame; NaN where unknown.
        rng: what draws the exchanges.
        confidence: probability that runs which are equally good are not found to differ.
        draws: number of random exchanges.

    Returns:
        The differences of the figures that are defined; nothing with fewer than ten steps.
    """
    known = np.flatnonzero(np.isfinite(T_world_cam_true).all(axis=(1, 2)))
    if len(known) < 2 or len(motions_a) < _FEWEST_STEPS:
        return {}
    truth = _Truth(known, T_world_cam_true[known])
    steps = len(motions_a)

    def errors_after(exchanged: BoolArray) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
        """Compute the errors of A and of B after R exchanges, [R, N-1]: [R] for each figure."""
        return (
            truth.errors(_path(motions_a, motions_b, exchanged)),
            truth.errors(_path(motions_b, motions_a, exchanged)),
        )

    # The errors of the runs as they are, and after random exchanges of the motions of blocks.
    errors_a, errors_b = errors_after(np.zeros((1, steps), bool))
    block = mean_block_length(se3.log(motions_a @ se3.inverse(motions_b)))
    drawn: dict[str, list[FloatArray]] = {name: [] for name in errors_a}
    for start in range(0, draws, _DRAWS_AT_ONCE):
        count = min(_DRAWS_AT_ONCE, draws - start)
        drawn_a, drawn_b = errors_after(random_blocks(count, steps, block, rng))
        for name, differences in drawn.items():
            differences.append(drawn_a[name] - drawn_b[name])
    return {
        name: _compared(
            float(errors_a[name][0]),
            float(errors_b[name][0]),
            np.concatenate(differences),
            confidence=confidence,
        )
        for name, differences in drawn.items()
    }


def _compared(
    error_a: float, error_b: float, drawn: FloatArray, *, confidence: float
) -> PairedDifference:
    """Compare the difference of two errors with those after R exchanges, [R]."""
    as_run = abs(error_a - error_b)
    # The runs as they are are one of the exchanges, so that the level of the test is exact.
    differences = np.append(np.abs(drawn), as_run)
    # Many exchanges may give the very difference of the runs, as where these differ in few steps.
    # Ties count, whatever the rounding of either path.
    is_tie = np.abs(differences - as_run) <= _ROUNDING * max(error_a, error_b)
    differences[is_tie] = as_run
    return PairedDifference(
        error_a=error_a,
        error_b=error_b,
        margin=float(np.quantile(differences, confidence, method="higher")),
        p_value=float(np.mean(differences >= as_run)),
        confidence=confidence,
    )


def random_blocks(count: int, steps: int, block: float, rng: np.random.Generator) -> BoolArray:
    """Draw which steps are exchanged, [count, steps], in blocks of geometric length.

    Each block is exchanged with probability ½, independently of the others.

    Args:
        count: number of draws.
        steps: number of steps of the runs.
        block: mean length of a block, steps, ≥ 1.
        rng: what draws.
    """
    begins = rng.random((count, steps)) < 1.0 / block
    begins[:, 0] = True
    # Number of the block of each step. Geometric lengths: a block ends after each step with the
    # probability 1/mean.
    number = np.cumsum(begins, axis=1) - 1
    of_block = rng.random((count, steps)) < 0.5
    return np.take_along_axis(of_block, number, axis=1)


def mean_block_length(series: FloatArray) -> float:
    """Find the mean length of blocks for the stationary bootstrap of series, [K, C], ≥ 1 step.

    It is the largest that any of the C columns asks for (Politis and White 2004, eq. 9 and sec. 3.2
    with their constants; Patton, Politis and White 2009), and at most the length of the series. A
    column that is constant asks for blocks of one step.
    """
    centered = series - series.mean(axis=0)
    # What is constant but for rounding asks for nothing.
    varies = np.abs(centered).max(axis=0) > _ROUNDING * np.abs(series).max()
    return max([1.0, *(_block_length_of(column) for column in centered[:, varies].T)])


def _block_length_of(values: FloatArray) -> float:
    """Find the block length of one series without its mean, [K]."""
    count = len(values)
    centered = values / np.abs(values).max()
    # The lag m after which K_N successive autocorrelations are insignificant.
    run = max(5, int(np.sqrt(np.log10(count))))
    bound = 2.0 * np.sqrt(np.log10(count) / count)
    longest = min(int(np.ceil(np.sqrt(count))) + run, count - 1)
    # Autocovariance R(k) at each lag that is needed, with the divisor K.
    covariance = np.array(
        [centered[: count - k] @ centered[k:] / count for k in range(longest + 1)]
    )
    correlation = covariance / covariance[0]
    is_small = np.abs(correlation[1 : longest + 1]) < bound
    lag = next(
        (k for k in range(len(is_small) - run + 1) if is_small[k : k + run].all()),
        None,
    )
    if lag is None:
        significant = np.flatnonzero(~is_small)
        lag = int(significant[-1]) + 1 if len(significant) else 1
    # Flat-top lag window of Politis and Romano over 2 m lags.
    bandwidth = min(2 * max(lag, 1), longest)
    # λ(t) = 1 up to t = ½, then 2 (1 − t), with t = |k|/bandwidth
    lags = np.arange(-bandwidth, bandwidth + 1)
    window = np.clip(2.0 * (1.0 - np.abs(lags) / bandwidth), 0.0, 1.0)
    weighted = window * covariance[np.abs(lags)]
    spectrum = weighted.sum()
    if spectrum <= 0.0:
        return 1.0  # the sum of the series varies less than that of independent values
    # b = (2 G²/D)^(1/3) K^(1/3), with G = Σ λ |k| R(k), and D = 2 g(0)², g(0) = Σ λ R(k)
    slope = (np.abs(lags) * weighted).sum()
    length = (slope**2 / spectrum**2 * count) ** (1.0 / 3.0)
    return float(np.clip(length, 1.0, count))


@dataclass(frozen=True)
class _Truth:
    """The true poses of K frames that have one."""

    frames: IntArray
    """Their indices, [K]."""
    T_world_cam: FloatArray
    """Their poses, [K, 4, 4], m."""

    def errors(self, T_world_cam_est: FloatArray) -> dict[str, FloatArray]:
        """Compute the errors of R paths, [R, N, 4, 4], m: for each figure that is defined, [R]."""
        est = T_world_cam_est[:, self.frames]
        true = self.T_world_cam
        # The first known poses are made equal, as in ``position_errors``.
        from_first_est = se3.inverse(est[:, :1]) @ est
        from_first_true = se3.inverse(true[:1]) @ true
        distance = np.linalg.norm((from_first_est - from_first_true)[..., :3, 3], axis=-1)
        errors = {
            "armse_m": distance.mean(axis=1) / np.sqrt(3.0),
            "final_error_m": distance[:, -1],
        }
        drift = segments.segment_errors(
            est,
            true,
            segments.SHORT_LENGTHS_M,
            starts=np.arange(len(true)),
            frames=self.frames,
        )
        if len(drift.first):
            errors["short_t_percent"] = 100.0 * drift.translation.mean(axis=-1)
            errors["short_r_deg_per_m"] = np.rad2deg(drift.rotation_rad_m.mean(axis=-1))
        return errors


def _path(motions: FloatArray, rival: FloatArray, exchanged: BoolArray) -> FloatArray:
    """Compound R paths, [R, N, 4, 4], with the rival's motions where exchanged, [R, N-1]."""
    T_prev_curr = np.where(exchanged[..., None, None], se3.inverse(rival), se3.inverse(motions))
    poses = np.empty((len(exchanged), len(motions) + 1, 4, 4))
    poses[:, 0] = np.eye(4)
    for k in range(len(motions)):
        poses[:, k + 1] = poses[:, k] @ T_prev_curr[:, k]
    return poses

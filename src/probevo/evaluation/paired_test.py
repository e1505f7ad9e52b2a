"""Randomization test of whether one run over a recording is better than another.

Two runs over the same recording are paired: each step of the vehicle was estimated by both. If both
estimators are equally good, it does not matter which of the two motions of a step is called whose.
The randomization test (Fisher 1935, sec. 21) exchanges them at random, compounds both paths anew,
and so draws from the distribution of the difference of any error under this hypothesis. The truth
stays where it is: its own errors, from frame to frame and over the path, enter all draws alike.

Errors of neighbouring steps are correlated: steps that see the same features have errors alike, and
along the live path of a window each step corrects those before. Exchanged one by one, the former
would cancel each other, and the latter would no longer. Therefore the innovations of the difference
of both motions are exchanged, which is to say that each has a random sign, and the differences are
computed from them anew: an autoregressive sieve (Bühlmann 1997) with random signs (Liu 1988) in
place of resampling. What correlation the model has missed is weak but may last, so that neighbours
are exchanged together, in short blocks (prewhitening, Andrews and Monahan 1992). If steps are
independent, this is the exchange of their motions.

The hypothesis is about this recording. An error that is constant all through it counts as one of
the estimator, although it may be another one on the next recording: there is one value of it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.evaluation import segments
from probevo.evaluation.autoregression import fit_autoregression, innovations, series_of
from probevo.geometry import se3

ERRORS = ("armse_m", "final_error_m", "short_t_percent", "short_r_deg_per_m")
"""Errors that are compared, by their names in ``Metrics``."""
DRAWS = 999
"""Number of random exchanges; a p-value is then a multiple of 1/1000."""
_SIGNS_AT_ONCE = 50
"""Draws whose signs are drawn together."""
_STEPS_AT_ONCE = 100_000
"""Steps of all draws that are computed together, but for one draw of more: what limits the memory.
"""
_ROUNDING = 1e-9
"""A difference of two errors below this, relative to these, is rounding."""
MIN_STEPS = 25
"""With fewer steps, more than 1 % of the exchanges leave all motions where they are, or
exchange all of them, so that hardly anything could be significant."""


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
    """Share of the exchanges whose |A − B| is at least as large as in the runs, which are included.
    Differences by rounding do not count."""
    confidence: float
    """Probability that the margin holds if the hypothesis does."""

    @property
    def is_significant(self) -> bool:
        """Whether the difference exceeds the noise of repetition."""
        return self.p_value <= 1.0 - self.confidence

    @property
    def reduction_percent(self) -> tuple[float, float, float]:
        """By how much A is less than B, % of B, with both ends of its confidence interval.

        The interval assumes a shift: it is the margin to both sides of the difference.
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
        The differences of the figures that are defined; nothing with fewer than ``MIN_STEPS``.
    """
    known = np.flatnonzero(np.isfinite(T_world_cam_true).all(axis=(1, 2)))
    if len(known) < 2 or len(motions_a) < MIN_STEPS:
        return {}
    truth = _Truth(known, T_world_cam_true[known])
    errors_a = truth.errors(_path(motions_a[None]))
    errors_b = truth.errors(_path(motions_b[None]))
    # Each motion is half the difference away from the one in the middle, A to one side and B to the
    # other. An exchange leaves the middle where it is.
    difference = se3.log(motions_a @ se3.inverse(motions_b))
    middle = se3.exp(-0.5 * difference) @ motions_a
    models = [fit_autoregression(values) for values in difference.T]
    drawn: dict[str, list[FloatArray]] = {name: [] for name in errors_a}
    for signs in _all_signs(draws, len(difference), rng):
        half = se3.exp(0.5 * exchanged_differences(difference, models, signs))
        drawn_a = truth.errors(_path(half @ middle))
        drawn_b = truth.errors(_path(se3.inverse(half) @ middle))
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
    """Compare the difference of two errors with the differences after R exchanges, [R]."""
    observed = abs(error_a - error_b)
    # The runs as they are count as one of the exchanges; only then is the level of the test exact.
    differences = np.append(np.abs(drawn), observed)
    # Many exchanges may give the very difference of the runs, as where these differ in few steps.
    # Ties count, whatever the rounding of either path.
    is_tie = np.abs(differences - observed) <= _ROUNDING * max(error_a, error_b)
    differences[is_tie] = observed
    return PairedDifference(
        error_a=error_a,
        error_b=error_b,
        margin=float(np.quantile(differences, confidence, method="higher")),
        p_value=float(np.mean(differences >= observed)),
        confidence=confidence,
    )


def _all_signs(draws: int, steps: int, rng: np.random.Generator) -> Iterator[FloatArray]:
    """Draw the signs of all draws, in batches of as many as are computed together, [R, K].

    They do not depend on the size of the batches.
    """
    batch = max(1, _STEPS_AT_ONCE // steps)
    for start in range(0, draws, _SIGNS_AT_ONCE):
        signs = random_signs(min(_SIGNS_AT_ONCE, draws - start), steps, rng)
        for first in range(0, len(signs), batch):
            yield signs[first : first + batch]


def random_signs(count: int, steps: int, rng: np.random.Generator) -> FloatArray:
    """Draw which innovations are exchanged, [count, steps]: −1 where they are, and 1 elsewhere."""
    # Blocks of geometric length (Politis and Romano 1994), whose mean is of the best order for a
    # variance, the cube root of the number of steps (Künsch 1989).
    begins = rng.random((count, steps)) < steps ** (-1.0 / 3.0)
    begins[:, 0] = True
    number = np.cumsum(begins, axis=1) - 1
    block_signs = rng.choice([-1.0, 1.0], size=(count, steps))
    return np.take_along_axis(block_signs, number, axis=1)


def exchanged_differences(
    difference: FloatArray, models: Sequence[FloatArray], signs: FloatArray
) -> FloatArray:
    """Compute differences of motions after exchanges of their innovations, [R, K, 6].

    Args:
        difference: of the motions of A and B at K steps, left tangent vectors, [K, 6], m and rad.
        models: coefficients of the autoregression of each of its columns.
        signs: of the innovations of each step after each of R exchanges, [R, K]: the same for
            all six axes, whose correlation thus remains.
    """
    drawn = np.empty((len(signs), *difference.shape))
    for axis, coefficients in enumerate(models):
        step_innovations = innovations(coefficients, difference[:, axis])
        drawn[..., axis] = series_of(coefficients, signs * step_innovations)
    return drawn


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


def _path(motions: FloatArray) -> FloatArray:
    """Compound R paths, [R, N, 4, 4], of the motions T_curr_prev, [R, N-1, 4, 4]."""
    T_prev_curr = se3.inverse(motions)
    steps = motions.shape[1]
    poses = np.empty((len(motions), steps + 1, 4, 4))
    poses[:, 0] = np.eye(4)
    for k in range(steps):
        poses[:, k + 1] = poses[:, k] @ T_prev_curr[:, k]
    return poses

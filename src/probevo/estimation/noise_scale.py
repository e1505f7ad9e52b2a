"""How large the errors of this recording's features are against their noise model, learned online.

A model with a default scale describes no camera and scene in particular, and one that was learned
describes those of its training. If all its variances are too large by one factor, so is the
covariance of the motion; and outliers keep too much weight, since they are compared with errors
that do not occur. A scale that was given is kept, and so is that of PROBE-GK as published.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

SCATTER = 0.85
"""Standard deviation of the logarithm of the factor between recordings."""
PRIOR_STEPS = 1.0
"""Steps that the noise model counts for. Between the steps of a recording, the logarithm scatters
by 0.1 to 0.5: a step tells more than the model."""
MEMORY_STEPS = 100.0
"""Steps after which a step has lost 1 − 1/e of its influence: light and blur change meanwhile."""
MAX_FACTOR = 100.0
"""By how much the variances of a model may be too small or too large. No recording here reaches it.
Clean rendered ones would reach a bound of 10; their steps then claim up to a third too much."""


@dataclass(frozen=True)
class NoiseScale:
    """Running mean of the logarithm of the factor that the residuals of each step show.

    It is the logarithm that is averaged, so that a single noisy frame does not count for many.
    """

    log_mean: float = 0.0
    weight: float = PRIOR_STEPS
    """Steps that the mean is over."""

    @property
    def factor(self) -> float:
        """Factor of the variances of the noise model."""
        return math.exp(self.log_mean)

    def after(self, factor_shown: float | None) -> NoiseScale:
        """Return the scale after a step.

        Args:
            factor_shown: factor of the model's variances that the residuals of the step show; None
                or NaN if they show nothing.
        """
        if factor_shown is None or math.isnan(factor_shown):
            return self
        log_shown = math.log(min(max(factor_shown, 1.0 / MAX_FACTOR), MAX_FACTOR))
        kept = self.weight * math.exp(-1.0 / MEMORY_STEPS)
        weight = kept + 1.0
        return NoiseScale((kept * self.log_mean + log_shown) / weight, weight)

"""How large the accelerations of this rig are, learned from its own motion.

The settings describe a car. A camera in a hand or on a drone turns ten times as suddenly: with the
car's accelerations, its search for features starts too near, and its correct solves are rejected.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probevo.arrays import FloatArray

MEMORY_S = 10.0
"""Time after which an acceleration has lost 1 − 1/e of its influence: a rig that is carried stands
still in between."""
PRIOR_S = 1.0
"""Time of motion that the settings count for."""

MAX_FACTOR = 10.0
"""With the default settings, 50 m/s² and 20 rad/s², more than any rig is shaken by. Without a
bound, a wrong stamp would look like any acceleration."""


@dataclass(frozen=True)
class AccelerationScale:
    """Running mean square of the accelerations, in the variances of the settings.

    What may come is at least as large as by the settings: a car that drives evenly now may still
    brake.
    """

    mean_square: tuple[float, float] = (1.0, 1.0)
    """Mean square of the acceleration along an axis, and of the angular one, over that of the
    settings."""
    weight_s: float = PRIOR_S
    """Time that the mean is over."""

    @property
    def factors(self) -> FloatArray:
        """Factors of the standard deviations of the settings, at least 1, [6]."""
        return np.repeat(np.sqrt(np.maximum(self.mean_square, 1.0)), 3)

    @property
    def usual_factors(self) -> FloatArray:
        """Factors by the accelerations that were seen, which may be below 1, [6]."""
        return np.repeat(np.sqrt(self.mean_square), 3)

    def after(
        self,
        twist_change: FloatArray,
        change_variance: FloatArray,
        *,
        accelerations: FloatArray,
        duration_s: float,
    ) -> AccelerationScale:
        """Return the scale after a change of the twist was measured.

        Args:
            twist_change: [6], m/s and rad/s.
            change_variance: what its measurement adds to its square, [6].
            accelerations: standard deviations of the settings, [6], m/s² and rad/s².
            duration_s: time that the change took.
        """
        # The square of what is measured is that of the change plus the variance of its noise.
        squares = (twist_change**2 - change_variance) / (accelerations * duration_s) ** 2
        shown = np.clip(squares.reshape(2, 3).mean(axis=1), -(MAX_FACTOR**2), MAX_FACTOR**2)
        kept_s = self.weight_s * np.exp(-duration_s / MEMORY_S)
        weight_s = kept_s + duration_s
        mean_square = (kept_s * np.array(self.mean_square) + duration_s * shown) / weight_s
        # Where noise is all that is measured, half of the squares are negative, and average out.
        mean_square = np.maximum(mean_square, 0.0)
        return AccelerationScale((float(mean_square[0]), float(mean_square[1])), float(weight_s))

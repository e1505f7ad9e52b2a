"""Why a window does not use its IMU: what is wrong with it, and the sentence that says so."""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple


class ImuFault(Enum):
    """What keeps a window from using its IMU, whatever the numbers of a step."""

    # What the samples of a step are like.
    NO_SAMPLES = "no_samples"
    """There are none."""
    EMPTY_INTERVAL = "empty_interval"
    """The interval between the frames has no length."""
    NO_ACCELEROMETER = "no_accelerometer"
    """Only the gyro has samples."""
    OUTSIDE_INTERVAL = "outside_interval"
    """All are before the interval, or all behind it."""
    NO_USABLE_SAMPLE = "no_usable_sample"
    """None has a finite, plausible rate and force."""
    SINGLE_SAMPLE = "single_sample"
    """Only one has."""
    FEW_SAMPLES = "few_samples"
    """They are too few, and too far apart."""
    STAMPS_NOT_ASCENDING = "stamps_not_ascending"
    """Their stamps are out of order."""
    HOLE = "hole"
    """None for a part of the interval."""
    INTEGRAL_NOT_FINITE = "integral_not_finite"
    """Their sum overflows."""
    # The test before its use.
    TESTING = "being_tested"
    """It has not been tested yet, or the test would show nothing yet, as in the first steps of any
    run."""
    NO_FINITE_RESIDUAL = "no_finite_residual"
    """The fit to the poses of the images overflows."""
    CONTRADICTION = "contradiction"
    """χ² of the fit is too large."""
    WRONG_GRAVITY = "wrong_gravity"
    """The fit shows gravity of another length."""
    LARGE_BIAS = "large_bias"
    """The fit shows biases that the calibration does not allow for."""
    UNTESTABLE = "untestable"
    """The covariance of the poses is too large to be accurate."""
    SHORT_WINDOW = "short_window"
    """The window has too few frames for the test."""
    # The tests in use.
    GATED = "gated"
    """Its prediction is beyond the gate in this step."""
    GATED_OFTEN = "gated_often"
    """It was so in too many of the last steps, or too noisy in the median."""
    UNKNOWN_VELOCITY = "unknown_velocity"
    """Its velocity is known less than by other means."""
    NO_SOLUTION = "no_solution"
    """The normal equations with its states are singular."""

    @property
    def is_of_samples(self) -> bool:
        """Whether it is what the samples of a step are like, which no calibration mends."""
        return self in _OF_SAMPLES


_OF_SAMPLES = frozenset(
    {
        ImuFault.NO_SAMPLES,
        ImuFault.EMPTY_INTERVAL,
        ImuFault.NO_ACCELEROMETER,
        ImuFault.OUTSIDE_INTERVAL,
        ImuFault.NO_USABLE_SAMPLE,
        ImuFault.SINGLE_SAMPLE,
        ImuFault.FEW_SAMPLES,
        ImuFault.STAMPS_NOT_ASCENDING,
        ImuFault.HOLE,
        ImuFault.INTEGRAL_NOT_FINITE,
    }
)


class ImuReason(NamedTuple):
    """Why an IMU is not used."""

    fault: ImuFault
    text: str
    """The same as a phrase that continues "the IMU …", with the numbers."""

    def for_good(self) -> ImuReason:
        """Return the reason of an IMU that is left out for good."""
        return self._replace(text=f"is left out for good: it {self.text}")

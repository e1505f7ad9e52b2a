"""What a frame lacks: samples, features and images that a step could not use, counted by kind."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Defect(Enum):
    """Why a part of a frame was not used. The value names its count in ``metrics.json``."""

    STAMP_REPEATED = "imu_samples_with_the_stamp_of_the_sample_before"
    RATE_NOT_FINITE = "imu_samples_without_a_finite_angular_rate"
    RATE_TOO_LARGE = "imu_samples_with_an_implausible_angular_rate"
    RATE_IS_SPIKE = "imu_samples_whose_angular_rate_is_a_spike"
    FORCE_NOT_FINITE = "imu_samples_without_a_finite_specific_force"
    FORCE_TOO_LARGE = "imu_samples_with_an_implausible_specific_force"
    PIXEL_NOT_FINITE = "features_whose_pixels_are_not_finite"
    PIXEL_TOO_LARGE = "features_with_implausible_pixels"
    REPEATED_IMAGES = "frames_whose_images_repeat_those_before"


@dataclass(frozen=True)
class MissingData:
    """How many samples, features or frames have one defect; as text, a phrase."""

    defect: Defect
    count: int
    """Number of samples, features or frames that have the defect."""
    total: int
    """Number of all samples, features or frames."""

    def __str__(self) -> str:
        """Return such as ``3 of 20 IMU samples without a finite angular rate``."""
        words = self.defect.value.replace("_", " ").replace("imu", "IMU")
        return f"{self.count} of {self.total} {words}"

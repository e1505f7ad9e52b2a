"""What the calibration of an IMU has left, as images have shown it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from probevo.arrays import FloatArray


class EstimatedError(NamedTuple):
    """One of the errors, with standard deviations before and after images have shown it."""

    value: float
    sigma: float
    prior_sigma: float

    def exceeds(self, sigmas: float, prior_sigmas: float = 0.0) -> bool:
        """Return whether it differs from zero by so many standard deviations of both."""
        return abs(self.value) > max(sigmas * self.sigma, prior_sigmas * self.prior_sigma)


@dataclass(frozen=True)
class ImuCalibrationErrors:
    """Errors of an IMU's calibration, estimated together with the poses (``NUM_ERRORS``)."""

    errors: FloatArray
    """Mounting [3], rad; delay of the stamps, s; scales of gyro and accelerometer; and position in
    the camera's frame [3], m: [9]. They are what is to be added to the calibration."""
    sigma: FloatArray
    """Standard deviations, [9]."""
    prior_sigma: FloatArray
    """Standard deviations before anything was measured, [9]."""

    @property
    def mounting_rad(self) -> EstimatedError:
        """Angle by which the IMU is mounted otherwise."""
        return self._length(slice(0, 3))

    @property
    def delay_s(self) -> EstimatedError:
        """How late the stamps are; negative if they are early."""
        return self._element(3)

    @property
    def gyro_scale(self) -> EstimatedError:
        """Share by which the gyro measures too little."""
        return self._element(4)

    @property
    def accelerometer_scale(self) -> EstimatedError:
        """Share by which the accelerometer measures too little."""
        return self._element(5)

    @property
    def position_m(self) -> EstimatedError:
        """Distance by which the IMU is somewhere else."""
        return self._length(slice(6, 9))

    def _element(self, at: int) -> EstimatedError:
        return EstimatedError(
            float(self.errors[at]), float(self.sigma[at]), float(self.prior_sigma[at])
        )

    def _length(self, part: slice) -> EstimatedError:
        """Return the length of a vector, with standard deviations along it."""
        error = self.errors[part]
        length = float(np.linalg.norm(error))
        along = error / max(length, 1e-12)
        return EstimatedError(
            length,
            float(np.linalg.norm(along * self.sigma[part])),
            float(np.linalg.norm(along * self.prior_sigma[part])),
        )

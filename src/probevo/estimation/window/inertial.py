"""The IMU of a window as one value, and how far it has come: from its first samples, via the test
against the images, to its states.

What a step does with it is in ``inertial_steps``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum, auto
from typing import TYPE_CHECKING

import numpy as np

from probevo.arrays import BoolArray, FloatArray, IntArray
from probevo.estimation.window.equations import POSE
from probevo.estimation.window.inertial_noise import (
    InertialInnovation,
    estimated_noise_factor,
    median_excess,
)
from probevo.estimation.window.inertial_states import (
    CALIBRATION_SIGMAS,
    InertialStates,
    moved,
    with_frame,
)
from probevo.measurements.imu_calibration_errors import ImuCalibrationErrors
from probevo.measurements.imu_reason import ImuReason
from probevo.measurements.preintegration import Preintegration
from probevo.sequences.imu_calibration import ImuCalibration

if TYPE_CHECKING:
    from probevo.estimation.window.inertial_equations import InertialSystem
    from probevo.estimation.window.inertial_prediction import InertialPrediction
    from probevo.estimation.window.window import Window

USUAL_NOISE_FACTOR = 16.0
"""Largest factor of the samples' variances on a vehicle: four times the standard deviation of the
data sheet. An IMU is left out where even with it the variances are too small by ``MAX_EXCESS``."""
MAX_EXCESS = 4.0
"""Largest χ² over its degrees of freedom, at the start and later: what factors and images together
may be noisier than they say."""
MAX_NOISE_FACTOR = USUAL_NOISE_FACTOR * MAX_EXCESS
"""Largest factor that is used. It is the one beyond which an IMU is left out, if the noise of the
samples is most of what it differs by: an IMU that is used claims the noise that it has shown."""
NUM_TESTED = 20
"""Last factors over which the noise is estimated, and those beyond the gate are counted."""
MIN_INNOVATIONS = 8
"""Minimum number of them that says how large the noise is."""


class ImuStatus(Enum):
    """How far an IMU has come, from its first samples to its use."""

    ABSENT = auto()
    """There is none."""
    UNUSABLE = auto()
    """None of its samples could be preintegrated, neither within the window nor after it."""
    WAITING = auto()
    """Not tested yet, and without a preintegration to the next frame."""
    TESTING = auto()
    """Not tested yet, with a preintegration to the next frame."""
    USED = auto()
    """The poses of the window depend on it."""
    EXCLUDED = auto()
    """It has failed a test, or the window is too short for one: it is left out for good."""


@dataclass(frozen=True)
class Inertial:
    """The IMU of a window with K frames."""

    calibration: ImuCalibration | None
    """None if there is no IMU."""
    factors: tuple[Preintegration | None, ...] = ()
    """Preintegrated samples between successive frames, [K − 1]; None where there are none."""
    stamps_ns: Mapping[int, int] = field(default_factory=dict)
    """Time of each frame of the window, and of the next one, by its index: biases walk with or
    without samples."""
    pending: Preintegration | None = None
    """Preintegrated samples from the last frame to the next one."""
    prediction: InertialPrediction | None = None
    """The motion to the next frame; None before the states are known, or without samples."""
    states: InertialStates | None = None
    """None before the IMU has passed its test."""
    innovations: tuple[InertialInnovation, ...] = ()
    """How far the last predictions that were tested were off."""
    was_gated: tuple[bool, ...] = ()
    """Which of these were beyond the gate."""
    noise_factor: float = 1.0
    """What the variances of the samples by the data sheet are multiplied by: by the test at the
    start, and then by the last innovations."""
    attempts: int = 0
    """Frames at which the test at the start was failed."""
    reason: ImuReason | None = None
    """Why the IMU says nothing of the last step; None if it does."""
    is_excluded: bool = False
    """Whether it has been left out for good."""
    has_measured: bool = False
    """Whether its samples have covered any interval so far."""

    @staticmethod
    def none() -> Inertial:
        """Return no IMU, of the window of a first frame."""
        return Inertial(calibration=None)

    @staticmethod
    def of(window: Window | None) -> Inertial:
        """Return the IMU of a window; none without a window."""
        return Inertial.none() if window is None else window.inertial

    @property
    def status(self) -> ImuStatus:
        """How far it has come."""
        if self.calibration is None:
            return ImuStatus.ABSENT
        if self.is_excluded:
            return ImuStatus.EXCLUDED
        if self.states is not None:
            return ImuStatus.USED
        if self.pending is not None:
            return ImuStatus.TESTING
        return ImuStatus.WAITING if self.has_factors else ImuStatus.UNUSABLE

    @property
    def is_used(self) -> bool:
        """Whether the window's poses depend on it."""
        return self.status is ImuStatus.USED

    @property
    def trusts_gyro(self) -> bool:
        """Whether the gyro may predict the motion to the next frame.

        While the IMU can still be tested against the window but has not passed, it may not. A gyro
        that can never be tested there, since it has too few samples or no accelerometer, or since
        the window does without it, may.
        """
        return self.status in (ImuStatus.ABSENT, ImuStatus.UNUSABLE, ImuStatus.USED)

    @property
    def may_bridge(self) -> bool:
        """Whether it knows the motion through frames without features, or may yet come to know it.

        One whose samples have covered no interval of the window may not: too few of them, or none
        of an accelerometer.
        """
        return self.status in (ImuStatus.WAITING, ImuStatus.TESTING, ImuStatus.USED)

    @property
    def predicts_next(self) -> bool:
        """Whether it predicts the motion to the next frame, so that no other dead reckoning is
        needed."""
        return self.prediction is not None

    @property
    def bridges_newest(self) -> bool:
        """Whether it connects the last frame with the one before."""
        return self.is_used and self.factors[-1] is not None

    @property
    def has_factors(self) -> bool:
        """Whether its samples cover an interval between frames of the window."""
        return any(factor is not None for factor in self.factors)

    @property
    def first_covered(self) -> int:
        """Place of the first frame after which samples cover all intervals, 0 … K − 1."""
        missing = [at for at, factor in enumerate(self.factors) if factor is None]
        return missing[-1] + 1 if missing else 0

    @property
    def noise_factor_in_use(self) -> float | None:
        """By how much the samples' variances exceed those of the calibration; None unless the
        window uses it."""
        return self.noise_factor if self.is_used else None

    @property
    def calibration_errors_in_use(self) -> ImuCalibrationErrors | None:
        """What the images have shown of the calibration's errors; None unless the window uses the
        IMU."""
        states = self.states
        if states is None:
            return None
        return ImuCalibrationErrors(
            states.calibration_errors, states.calibration_sigma, CALIBRATION_SIGMAS
        )

    @property
    def excess(self) -> float:
        """By how much the covariances of the last innovations, with the largest usual noise factor,
        are still too small in the median; at most 1 if that explains them."""
        if len(self.innovations) < MIN_INNOVATIONS:
            return 1.0
        return median_excess(self.innovations, USUAL_NOISE_FACTOR)

    @property
    def mean_excess(self) -> float:
        """By how much the covariances by the data sheet are too small in the mean, with innovations
        beyond the gate.

        A step that no image has tested may be as wrong as any of these. An IMU that lies errs the
        same way in each step, so that its errors add up: the factor is used on top of
        ``noise_factor``, with which the covariances describe errors that are independent.
        """
        distances = [innovation.squared_distance(1.0) for innovation in self.innovations]
        known = [squared for squared in distances if np.isfinite(squared)]
        if not known:
            return self.noise_factor
        # The mean of χ² of six degrees of freedom is six.
        return max(1.0, float(np.mean(known)) / POSE)

    def durations_s(self, frames: IntArray) -> FloatArray:
        """Return the times between successive frames of the window, [K − 1], given their indices,
        [K]."""
        stamps_ns = np.array([self.stamps_ns[frame] for frame in frames.tolist()])
        return 1e-9 * np.diff(stamps_ns)

    def tested(self, innovation: InertialInnovation, *, is_gated: bool) -> Inertial:
        """Return the IMU with one more innovation, and the noise that the last of them show."""
        innovations = (*self.innovations[1 - NUM_TESTED :], innovation)
        noise_factor = self.noise_factor
        if len(innovations) >= MIN_INNOVATIONS:
            noise_factor = estimated_noise_factor(innovations, largest=MAX_NOISE_FACTOR)
        return replace(
            self,
            innovations=innovations,
            was_gated=(*self.was_gated[1 - NUM_TESTED :], is_gated),
            noise_factor=noise_factor,
        )

    def without_measurement(self, reason: ImuReason | None) -> Inertial:
        """Return the IMU as saying nothing of the motion to the next frame, for a reason."""
        return replace(self, pending=None, prediction=None, reason=reason)

    def with_new_frame(self) -> Inertial:
        """Return the IMU with one more frame, to which the pending factor leads, and its states."""
        states = self.states
        if states is not None:
            velocity = states.velocity[-1]
            if self.prediction is not None:
                velocity = self.prediction.velocity
            states = with_frame(states, velocity)
        factors = (*self.factors, self.pending)
        return replace(self, factors=factors, states=states, pending=None, prediction=None)

    def kept(self, stays: BoolArray) -> Inertial:
        """Return the IMU with the factors that remain if only some frames stay, [K]."""
        # A factor leads from a frame to the next one, and stays where both of them do.
        factors = tuple(
            self.factors[slot - 1] if stays[slot - 1] else None
            for slot in np.flatnonzero(stays)[1:]
        )
        return replace(self, factors=factors)

    def after_increment(self, system: InertialSystem | None, increment: FloatArray) -> Inertial:
        """Return the IMU after an increment of poses and rig, [6K + 4]; its states follow."""
        if self.states is None or system is None:
            return self
        return replace(self, states=moved(self.states, system.increment(increment)))

    def with_covariance(self, system: InertialSystem | None, pose_cov: FloatArray) -> Inertial:
        """Return the IMU with the covariance of its states, given that of poses and rig."""
        if self.states is None or system is None:
            return self
        cov, cross_cov = system.covariances(pose_cov)
        return replace(self, states=replace(self.states, cov=cov, cross_cov=cross_cov))

    def restarted(self) -> Inertial:
        """Return the IMU as before its start, with the factors of the window."""
        return replace(
            self,
            states=None,
            prediction=None,
            pending=None,
            innovations=(),
            was_gated=(),
            noise_factor=1.0,
        )

    def excluded(self, reason: ImuReason) -> Inertial:
        """Return the IMU as left out for good, for a reason."""
        factors = (None,) * len(self.factors)
        return replace(self.restarted(), factors=factors, reason=reason, is_excluded=True)

"""Whether the gyro turns as the pictures do: the usual mistakes of an IMU's calibration, seen
before they do harm."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice, pairwise
from typing import TYPE_CHECKING

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.estimation.motion_estimate import Status
from probevo.geometry import so3
from probevo.measurements.gyro import integrate_gyro
from probevo.odometry import StereoOdometry

if TYPE_CHECKING:
    from probevo.sequences import Sequence
    from probevo.sequences.imu import ImuStream
    from probevo.sequences.imu_calibration import ImuCalibration

MOST_STEPS = 60
"""Steps that are looked at: the first."""
FEWEST_STEPS = 10
"""With fewer, nothing can be told."""
DISAGREES = 0.5
LEAST_TURN_RAD = 5e-3
"""Share of the turn of a step, and of this at least, by which the two may differ in the median. On
KITTI it is 0.03 to 0.4, where tracks are poor; a degree of misalignment makes 0.02."""
LAGS_S = np.arange(-0.2, 0.2001, 0.01)
DEGREES = np.rad2deg(1.0)


@dataclass(frozen=True)
class Turns:
    """Of K steps, as the pictures show them."""

    between_ns: IntArray
    """Stamps of the two frames of each, [K, 2]."""
    seen_rad: FloatArray
    """Rotation vector Log(C_curr_prev), [K, 3], camera."""

    @staticmethod
    def of(sequence: Sequence) -> Turns:
        """Those of the first steps that can be solved without the IMU."""
        odometry = StereoOdometry(sequence.camera)
        frames = list(islice(sequence, MOST_STEPS + 1))
        motions = [odometry.step(frame) for frame in frames][1:]
        solved = [k for k, motion in enumerate(motions) if motion.status is Status.OK]
        between_ns = np.array(list(pairwise(frame.stamp_ns for frame in frames)), np.int64).reshape(
            -1, 2
        )
        seen = np.array([motion.T_curr_prev[:3, :3] for motion in motions]).reshape(-1, 3, 3)
        return Turns(between_ns[solved], so3.log(seen[solved]))

    def felt(self, stream: ImuStream, calibration: ImuCalibration, lag_s: float) -> FloatArray:
        """The same by a gyro whose stamps are too early by so much, [K, 3], less such a bias as its
        calibration holds possible; NaN where it does not cover the step."""
        turns = np.full(self.seen_rad.shape, np.nan)
        for k, (start_ns, end_ns) in enumerate((self.between_ns - round(1e9 * lag_s)).tolist()):
            samples = stream.between(start_ns, end_ns)
            if samples is not None:
                turns[k] = so3.log(
                    integrate_gyro(samples, start_ns, end_ns, calibration=calibration).C_curr_prev
                )
        known = np.isfinite(turns).all(axis=1)
        pace_s = 1e-9 * np.diff(self.between_ns, axis=1)
        bias = (
            np.median((turns - self.seen_rad)[known] / pace_s[known], axis=0)
            if known.any()
            else np.zeros(3)
        )
        possible = 3.0 * calibration.gyro_bias_sigma_rad_s / max(float(np.linalg.norm(bias)), 1e-12)
        return np.asarray(turns - min(1.0, possible) * bias * pace_s)


def imu_doubt(turns: Turns, stream: ImuStream, calibration: ImuCalibration) -> str:
    """What is odd about the gyro beside the pictures, and the likely cause; empty if nothing is, or
    can be seen."""
    seen = turns.seen_rad
    felt = turns.felt(stream, calibration, 0.0)
    known = np.isfinite(felt).all(axis=1)
    off = _apart(seen, felt)
    if known.sum() < FEWEST_STEPS or off < DISAGREES:
        return ""
    what = f"its turns and those of the pictures differ by {off:.0%}: "
    scale = _usual(felt[known]) / max(_usual(seen[known]), 1e-9)
    if 0.7 < scale / DEGREES < 1.4:
        return f"{what}it turns {scale:.0f} times as far. Is it in degrees a second?"
    lags = [_apart(seen, turns.felt(stream, calibration, lag_s)) for lag_s in LAGS_S]
    if min(lags) < 0.5 * off:
        return (
            f"{what}half of that or less if its stamps were"
            f" {1e3 * LAGS_S[int(np.argmin(lags))]:+.0f} ms later."
        )
    if _apart(seen, -felt) < 0.5 * off:
        return (
            f"{what}it turns the other way. Is its rotation to the camera the inverse of what is"
            " meant?"
        )
    return f"{what}is its rotation to the camera right, and is it in rad/s?"


def _apart(seen: FloatArray, felt: FloatArray) -> float:
    """Share of the turns by which the felt ones are off; infinite where they cover too few."""
    known = np.isfinite(felt).all(axis=1)
    if known.sum() < FEWEST_STEPS:
        return np.inf
    return _usual(felt[known] - seen[known]) / max(_usual(seen[known]), LEAST_TURN_RAD)


def _usual(vectors: FloatArray) -> float:
    """Length in the median: a few steps that went wrong should not matter."""
    return float(np.median(np.linalg.norm(vectors, axis=1)))

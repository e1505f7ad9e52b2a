"""Sensors beside the camera are asked in their order, and a correction once there is a motion."""

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo.errors import InputError
from probevo.measurements.correction import MotionCorrection
from probevo.measurements.relative_pose import RelativePose
from probevo.measurements.sensor import NoMeasurement
from probevo.measurements.sensor_suite import SensorSuite
from probevo.measurements.variables import pose_of
from probevo.sequences.frame import Frame
from worlds import FORWARD, blind_frame


def night(prev_frame: Frame, frame: Frame) -> NoMeasurement:
    """A sensor that sees nothing."""
    return NoMeasurement("night")


class Doubled(MotionCorrection):
    """Says that a motion has four times the covariance."""

    name = "doubled"

    def correct(
        self, prev_frame: Frame, frame: Frame, T_curr_prev: FloatArray, *, cov: FloatArray
    ) -> RelativePose:
        return RelativePose(
            T_curr_prev, 4.0 * cov, curr=pose_of(frame.index), prev=pose_of(prev_frame.index)
        )


FRAMES = (blind_frame(0), blind_frame(1))


def test_readings_come_in_the_order_of_the_sensors() -> None:
    readings = SensorSuite([night, Doubled(), night]).read(*FRAMES, is_excluded=lambda name: False)
    assert [one.name for one in readings] == ["night", "doubled", "night 2"]
    assert [one.reason for one in readings] == ["night", None, "night"]


def test_an_excluded_sensor_is_not_asked() -> None:
    suite = SensorSuite([night, night])
    readings = suite.read(*FRAMES, is_excluded=lambda name: name == "night 2")
    assert [one.reason for one in readings] == ["night", None]


def test_a_correction_is_asked_about_a_motion_only() -> None:
    suite = SensorSuite([night, Doubled()])
    found = suite.read_correction(*FRAMES, FORWARD, cov=np.eye(6), is_solved=True)
    assert found is not None
    assert (found.name, found.corrects) == ("doubled", True)
    (measured,) = found.measurements
    assert isinstance(measured, RelativePose)
    np.testing.assert_array_equal(measured.covariance, 4.0 * np.eye(6))
    reckoned = suite.read_correction(*FRAMES, FORWARD, cov=np.eye(6), is_solved=False)
    assert reckoned is not None
    assert (reckoned.measurements, reckoned.reason) == ((), "dead-reckoned step")


def test_without_a_correction_there_is_nothing_to_ask() -> None:
    assert (
        SensorSuite([night]).read_correction(*FRAMES, FORWARD, cov=np.eye(6), is_solved=True)
        is None
    )


def test_two_corrections_are_refused() -> None:
    """Each was learned from the motion that the images give, not from what the other left of it."""
    with pytest.raises(InputError, match="2 of them correct the motion"):
        SensorSuite([Doubled(), Doubled()])

"""What a sensor gets wrong is refused by name where it is made, and not deep in a solve."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo.errors import InputError
from probevo.geometry import se3, so3
from probevo.measurements.correction import MotionCorrection, read_correction
from probevo.measurements.direction import Direction
from probevo.measurements.heading import Heading
from probevo.measurements.north import NORTH
from probevo.measurements.pose_prior import PosePrior
from probevo.measurements.position import Position
from probevo.measurements.relative_pose import RelativePose
from probevo.measurements.relative_rotation import RelativeRotation
from probevo.measurements.sensor import read_sensor
from probevo.measurements.travelled_distance import TravelledDistance
from probevo.measurements.variables import Variable, pose_of
from probevo.measurements.vector_measurement import VectorMeasurement
from probevo.sequences.frame import Frame

PREV = Frame(index=0, stamp_ns=0)
CURR = Frame(index=1, stamp_ns=100_000_000)
POSE = pose_of(1)
MISTAKES: dict[str, tuple[Callable[[], Any], str]] = {
    "the nadir has no azimuth": (
        lambda: Direction.of_angles(POSE, (0.0, math.pi), np.array([0.0, 1.0, 0.0]), np.eye(2)),
        "has no azimuth",
    ),
    "a zenith angle beyond half a turn": (
        lambda: Direction.of_angles(POSE, (0.0, 4.0), np.array([0.0, 1.0, 0.0]), np.eye(2)),
        "has no azimuth",
    ),
    "heading with a negative σ": (lambda: Heading(POSE, 0.0, -0.2), "Heading: sigma_rad"),
    "distance with a negative σ": (
        lambda: TravelledDistance(1.0, -0.1, POSE),
        "TravelledDistance: sigma_m",
    ),
    "pose with the covariance of a position": (
        lambda: PosePrior(POSE, np.eye(4), np.eye(3)),
        r"shape \(3, 3\)",
    ),
    "motion with the covariance of a rotation": (
        lambda: RelativePose(np.eye(4), np.eye(3), POSE),
        r"shape \(3, 3\)",
    ),
    "rotation with the covariance of a pose": (
        lambda: RelativeRotation(np.eye(3), np.eye(6), POSE),
        r"RelativeRotation: covariance: it has shape \(6, 6\)",
    ),
    "rotation as a vector": (
        lambda: RelativeRotation(np.zeros(3), np.eye(3), POSE),
        r"RelativeRotation: C_curr_prev: it has shape \(3,\)",
    ),
    "rotation as a transform": (
        lambda: RelativeRotation(np.eye(4), np.eye(3), POSE),
        r"RelativeRotation: C_curr_prev: it has shape \(4, 4\)",
    ),
    "rotation of words": (
        lambda: RelativeRotation([["a"] * 3] * 3, np.eye(3), POSE),
        r"RelativeRotation: C_curr_prev: it is \[\['a', 'a', 'a'\]",
    ),
    "rotation of zeros": (
        lambda: RelativeRotation(np.zeros((3, 3)), np.eye(3), POSE),
        "RelativeRotation: C_curr_prev: this is not a rotation matrix",
    ),
    "rotation that scales": (
        lambda: RelativeRotation(2.0 * np.eye(3), np.eye(3), POSE),
        "RelativeRotation: C_curr_prev: this is not a rotation matrix",
    ),
    "rotation that mirrors": (
        lambda: RelativeRotation(-np.eye(3), np.eye(3), POSE),
        "RelativeRotation: C_curr_prev: this is not a rotation matrix",
    ),
    "rotation with one variance": (
        lambda: RelativeRotation(np.eye(3), 1e-4, POSE),
        r"RelativeRotation: covariance: it has shape \(\)",
    ),
    "pose that scales": (
        lambda: PosePrior(POSE, np.diag([2.0, 2.0, 2.0, 1.0]), np.eye(6)),
        "PosePrior: T_cam_world: this is not a rotation matrix",
    ),
    "motion with its translation below": (
        lambda: RelativePose(np.eye(4) + np.eye(4, k=-3), np.eye(6), POSE),
        "RelativePose: T_curr_prev: the last row",
    ),
    "direction of two numbers": (
        lambda: Direction(POSE, [0.0, 1.0], [0.0, 1.0, 0.0], np.eye(2)),
        r"Direction: in_camera: it has shape \(2,\)",
    ),
    "antenna at an unknown place": (
        lambda: Position(POSE, np.zeros(3), np.eye(3), lever_m=np.full(3, np.nan)),
        "Position: lever_m: it is not finite",
    ),
    "heading without a value": (lambda: Heading(POSE, None, 0.2), "heading_rad: is None"),
    "distance as a list": (
        lambda: TravelledDistance([1.0], 0.1, POSE),
        r"TravelledDistance: distance_m: is \[1\.0\]",
    ),
    "distance with a list of σ": (
        lambda: TravelledDistance(1.0, [0.1], POSE),
        r"TravelledDistance: sigma_m: is \[0\.1\]",
    ),
    "angles without a value": (
        lambda: Direction.of_angles(POSE, (None, 1.0), np.array([0.0, 1.0, 0.0]), np.eye(2)),
        "Direction: angles_rad: is None",
    ),
    "no angles": (
        lambda: Direction.of_angles(POSE, None, np.array([0.0, 1.0, 0.0]), np.eye(2)),
        "Direction: angles_rad: is None",
    ),
    "angles without a covariance": (
        lambda: Direction.of_angles(POSE, (0.0, 1.0), np.array([0.0, 1.0, 0.0]), None),
        r"Direction: covariance: it has shape \(\)",
    ),
    "heading of no pose": (
        lambda: read_sensor("gps", lambda prev, curr: [Heading(None, 0.1, 0.1)], PREV, CURR),
        r"sensor gps: at frame 1 it measured None, which is no pose\.\n *Give the current",
    ),
    "motion without its last row": (
        lambda: RelativePose(np.eye(4)[:3], np.eye(6), POSE),
        r"T_curr_prev: it has shape \(3, 4\)",
    ),
}


@pytest.mark.parametrize("name", list(MISTAKES))
def test_a_mistake_is_named(name: str) -> None:
    make, said = MISTAKES[name]
    with pytest.raises(InputError, match=said):
        make()


def test_lists_are_arrays() -> None:
    rotation = RelativeRotation(np.eye(3).tolist(), (0.01 * np.eye(3)).tolist(), POSE)
    np.testing.assert_array_equal(rotation.residual({POSE: np.eye(4)}), np.zeros(3))
    distance = TravelledDistance(np.float32(1.0), np.array(0.1), POSE, axis=[0.0, 0.0, 1.0])
    np.testing.assert_array_equal(distance.residual({POSE: np.eye(4)}), [1.0])


WITHOUT_A_FIX: list[VectorMeasurement] = [
    RelativeRotation(np.full((3, 3), np.nan), np.eye(3), POSE, pose_of(0)),
    RelativePose(np.full((4, 4), np.nan), np.eye(6), POSE, pose_of(0)),
    PosePrior(POSE, np.full((4, 4), np.nan), np.eye(6)),
    Position(POSE, np.full(3, np.nan), np.eye(3)),
    TravelledDistance(math.nan, 0.1, POSE, pose_of(0)),
]


@pytest.mark.parametrize("measurement", WITHOUT_A_FIX)
def test_what_has_no_fix_is_no_measurement(measurement: VectorMeasurement) -> None:
    """NaN is not refused where a value can be missing."""
    found = read_sensor("any", lambda prev, curr: [measurement], PREV, CURR)
    assert found.reason == "not a finite value"


class OfABias(VectorMeasurement):
    """A measurement of a pose, and of something that the odometry does not estimate."""

    @property
    def variables(self) -> tuple[Variable, ...]:
        return (POSE, Variable("bias", 0))

    def residual(self, values: Any) -> FloatArray:
        return np.zeros(1)


def test_a_measurement_of_what_is_not_estimated_is_refused() -> None:
    with pytest.raises(InputError, match=r"sensor gps: at frame 1 it measured .*bias"):
        read_sensor("gps", lambda prev, curr: [OfABias(np.eye(1))], PREV, CURR)


class Course(OfABias):
    """The course over ground from north: the direction of the way between two frames."""

    @property
    def variables(self) -> tuple[Variable, ...]:
        return (pose_of(0), POSE, NORTH)


def test_a_measurement_of_a_motion_from_north_is_refused() -> None:
    with pytest.raises(InputError, match=r"sensor gps: at frame 1 it measured north .*previous"):
        read_sensor("gps", lambda prev, curr: [Course(np.eye(1))], PREV, CURR)


def test_an_exception_of_a_measurement_is_passed_on() -> None:
    """It is a mistake in the sensor's code, and not a receiver without a fix."""

    class Wrong(Heading):
        def residual(self, values: Any) -> FloatArray:
            raise ValueError("shapes do not fit")

    with pytest.raises(ValueError, match="shapes do not fit"):
        read_sensor("gps", lambda prev, curr: [Wrong(POSE, 0.0, 0.1)], PREV, CURR)


@pytest.mark.parametrize("heading_rad", [math.nan, math.inf, -math.inf])
def test_a_heading_without_a_fix_is_no_measurement(heading_rad: float) -> None:
    found = read_sensor("gps", lambda prev, curr: [Heading(POSE, heading_rad, 0.1)], PREV, CURR)
    assert found.measurements == ()
    assert found.reason == "not a finite value"


@pytest.mark.parametrize("prev", [None, pose_of(7), POSE])
def test_a_correction_between_other_frames_is_refused(prev: Variable | None) -> None:
    """Without ``prev``, it would be taken for the pose in the world."""

    class Elsewhere(MotionCorrection):
        name = "elsewhere"

        def correct(
            self, prev_frame: Frame, frame: Frame, T_curr_prev: FloatArray, *, cov: FloatArray
        ) -> RelativePose:
            return RelativePose(T_curr_prev, cov, curr=POSE, prev=prev)

    with pytest.raises(InputError, match="sensor elsewhere: its motion is not from"):
        read_correction(Elsewhere(), PREV, CURR, np.eye(4), name="elsewhere", cov=np.eye(6))


def test_a_correction_without_a_value_is_no_measurement() -> None:
    class Broken(MotionCorrection):
        name = "broken"

        def correct(
            self, prev_frame: Frame, frame: Frame, T_curr_prev: FloatArray, *, cov: FloatArray
        ) -> RelativePose:
            return RelativePose(np.full((4, 4), np.nan), cov, POSE)

    found = read_correction(Broken(), PREV, CURR, np.eye(4), name="broken", cov=np.eye(6))
    assert found.measurements == ()
    assert found.reason == "not a finite value"


def test_what_is_a_rotation_up_to_rounding_is_made_one() -> None:
    """Inverses are transposes; a file of six digits is no rotation to the last one."""
    rounded = np.eye(3)
    rounded[0] *= 1.0004
    rotation = RelativeRotation(rounded, np.eye(3), POSE)
    np.testing.assert_allclose(rotation.C_curr_prev @ rotation.C_curr_prev.T, np.eye(3), atol=1e-12)
    pose = np.eye(4)
    pose[:3, :3] = rounded
    motion = RelativePose(pose, np.eye(6), POSE)
    C = motion.T_curr_prev[:3, :3]
    np.testing.assert_allclose(C @ C.T, np.eye(3), atol=1e-12)


@pytest.mark.parametrize("pitch_deg", [90.0, 86.0, -90.0])
def test_a_camera_that_looks_straight_up_or_down_has_no_heading(pitch_deg: float) -> None:
    """There, a compass would pin the attitude by a Jacobian without bounds."""
    pitch = math.radians(pitch_deg)
    T_cam_world = se3.from_parts(so3.exp(np.array([pitch, 0.0, 0.0])), np.zeros(3))
    assert np.isnan(Heading(POSE, 0.3, 0.02).residual({POSE: T_cam_world})).all()
    level = se3.from_parts(so3.exp(np.array([0.9 * pitch, 0.0, 0.0])), np.zeros(3))
    assert np.isfinite(Heading(POSE, 0.3, 0.02).residual({POSE: level})).all()


def test_a_direction_that_was_not_seen_is_no_mistake() -> None:
    """NaN is what a sensor without a fix gives, here as elsewhere."""
    down = np.array([0.0, 1.0, 0.0])
    for unseen in (
        Direction(POSE, np.full(3, np.nan), down, np.eye(2)),
        Direction.of_angles(POSE, (math.nan, math.nan), down, np.eye(2)),
    ):
        assert np.isnan(unseen.residual({POSE: np.eye(4)})).all()

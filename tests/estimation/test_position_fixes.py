"""Fixes of a satellite receiver: they bound the drift, and the claimed covariance holds."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import probevo as pv
from intervals import chi2_interval
from probevo.arrays import FloatArray
from probevo.errors import InputError
from probevo.geometry import se3
from probevo.geometry.uncertainty import normalized_error_squared
from probevo.measurements import NORTH, Position, pose_of
from probevo.measurements.base import Measurement
from probevo.measurements.north import ORIGIN, attitude_of_enu
from probevo.measurements.sensor import Sensor
from probevo.measurements.variables import Variable
from probevo.measurements.vector_measurement import VectorMeasurement
from probevo.sequences.frame import Frame
from worlds import CAMERA, FORWARD, drive

LEVER_M = np.array([0.2, -1.1, -0.5])
START_M = np.array([691_000.0, 5_334_000.0, 512.0])
HEADING_RAD = np.deg2rad(40.0)
SIGMA_M = 0.3
STEPS = 40
DRIVES = 8


def receiver(
    rng: np.random.Generator, sigma_m: float = SIGMA_M, outliers: dict[int, float] | None = None
) -> Sensor:
    """Return a sensor that measures where the antenna is, with noise; of some frames, with an error
    so large, m."""
    north = np.array([0.02, -0.01, HEADING_RAD])
    noise = sigma_m * rng.normal(size=(STEPS + 1, 3))
    for index, size_m in (outliers or {}).items():
        direction = rng.normal(size=3)
        noise[index] += size_m * direction / np.linalg.norm(direction)

    def fix(prev_frame: pv.Frame, frame: pv.Frame) -> list[Position]:
        T_world_cam = np.linalg.matrix_power(se3.inverse(FORWARD), frame.index)
        antenna = se3.transform(T_world_cam, LEVER_M[None])[0]
        position = START_M + attitude_of_enu(north).T @ antenna + noise[frame.index]
        return [Position(pose_of(frame.index), position, sigma_m**2 * np.eye(3), lever_m=LEVER_M)]

    return fix


def config(heading_deg: float | None) -> dict[str, object]:
    heading = {} if heading_deg is None else {"heading_deg": heading_deg, "heading_sigma_deg": 5.0}
    return {"estimator": "two-frame", "north": {"tilt_sigma_deg": 2.0, **heading}}


def test_the_pose_and_the_first_camera_are_as_certain_as_claimed() -> None:
    squared = []
    origins = []
    for seed in range(DRIVES):
        rng = np.random.default_rng([3, seed])
        odometry = pv.StereoOdometry(
            CAMERA, config=config(40.0 + 5.0 * rng.normal()), sensors=[receiver(rng)]
        )
        for frame in drive(rng, STEPS + 1, points=80):
            estimate = odometry.step(frame)
        assert estimate.sensors[0].state == "used"
        T_cam_world = np.linalg.matrix_power(FORWARD, STEPS)
        squared.append(
            normalized_error_squared(estimate.T_cam_world, T_cam_world, estimate.cov_cam_world)
        )
        assert odometry.state is not None
        pose = odometry.state.pose
        values = {state.variable: state.value for state in pose.further}
        found = np.concatenate([values[NORTH][2:], values[ORIGIN]])
        error = found - np.concatenate([[HEADING_RAD], START_M])
        at = pose.slice_of(NORTH), pose.slice_of(ORIGIN)
        assert at[0] is not None
        assert at[1] is not None
        rows = np.r_[at[0].stop - 1, at[1]]
        origins.append(error @ np.linalg.solve(pose.joint_cov[np.ix_(rows, rows)], error))
    assert np.mean(squared) < chi2_interval(6, DRIVES)[1]
    low, high = chi2_interval(4, DRIVES)
    assert low < np.mean(origins) < high


@pytest.mark.parametrize("size_m", [5.0, 30.0])
@pytest.mark.parametrize("indices", [(1,), (1, 2, 3), (20,)])
def test_wild_fixes_lose_no_receiver(indices: tuple[int, ...], size_m: float) -> None:
    """The first fix says where the world is. Before, all later ones then seemed wrong."""
    rng = np.random.default_rng(7)
    sensor = receiver(rng, outliers=dict.fromkeys(indices, size_m))
    odometry = pv.StereoOdometry(CAMERA, config=config(40.0), sensors=[sensor])
    estimates = [odometry.step(frame) for frame in drive(rng, STEPS + 1, points=80)]
    assert estimates[-1].sensors[0].state == "used"
    reasons = {outcome.reason for estimate in estimates for outcome in estimate.sensors}
    says_so = any(reason and reason.startswith("it is reset") for reason in reasons)
    assert says_so == (indices[0] == 1)
    assert odometry.state is not None
    values = {state.variable: state.value for state in odometry.state.pose.further}
    assert np.linalg.norm(values[ORIGIN] - START_M) < 4.0 * SIGMA_M


def test_a_receiver_that_only_lies_is_excluded() -> None:
    """It may start anew a few times, and no more."""
    rng = np.random.default_rng(8)
    sensor = receiver(rng, outliers=dict.fromkeys(range(STEPS + 1), 20.0))
    odometry = pv.StereoOdometry(CAMERA, config=config(40.0), sensors=[sensor])
    estimates = [odometry.step(frame) for frame in drive(rng, STEPS + 1, points=80)]
    assert estimates[-1].sensors[0].state == "excluded"


class Altitude(VectorMeasurement):
    """The height above the origin of positions, which a barometer knows."""

    def __init__(self, pose: Variable) -> None:
        super().__init__(np.eye(1))
        self.pose = pose

    @property
    def variables(self) -> tuple[Variable, ...]:
        return (self.pose, NORTH, ORIGIN)

    def residual(self, values: Any) -> FloatArray:
        return np.zeros(1)

    def jacobians(self, values: Any) -> tuple[FloatArray, ...]:
        return (np.zeros((1, 6)), np.zeros((1, 3)), np.zeros((1, 3)))


def test_what_is_relative_to_positions_needs_one_first() -> None:
    def barometer(prev_frame: Frame, frame: Frame) -> list[Measurement]:
        return [Altitude(pose_of(frame.index))]

    odometry = pv.StereoOdometry(CAMERA, config=config(40.0), sensors=[barometer])
    first, second = drive(np.random.default_rng(4), 2)
    odometry.step(first)
    with pytest.raises(InputError, match="Measure a Position first"):
        odometry.step(second)


def test_positions_without_a_heading_are_refused() -> None:
    rng = np.random.default_rng(4)
    frames = drive(rng, 2)
    odometry = pv.StereoOdometry(CAMERA, config=config(None), sensors=[receiver(rng)])
    odometry.step(frames[0])
    with pytest.raises(InputError, match="heading of the first camera is unknown"):
        odometry.step(frames[1])

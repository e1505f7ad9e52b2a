"""Fixes of a satellite receiver: they bound the drift, and the claimed covariance holds."""

from __future__ import annotations

import numpy as np
import pytest

import probevo as pv
from intervals import chi2_interval
from probevo.errors import InputError
from probevo.geometry import se3
from probevo.geometry.uncertainty import normalized_error_squared
from probevo.measurements import NORTH, Position, pose_of
from probevo.measurements.north import ORIGIN, attitude_of_enu
from probevo.measurements.sensor import Sensor
from worlds import CAMERA, FORWARD, drive

LEVER_M = np.array([0.2, -1.1, -0.5])
START_M = np.array([691_000.0, 5_334_000.0, 512.0])
HEADING_RAD = np.deg2rad(40.0)
SIGMA_M = 0.3
STEPS = 40


def receiver(rng: np.random.Generator, sigma_m: float = SIGMA_M) -> Sensor:
    """Return a sensor that measures where the antenna is, with noise."""
    north = np.array([0.02, -0.01, HEADING_RAD])
    noise = sigma_m * rng.normal(size=(STEPS + 1, 3))

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
    for seed in range(12):
        rng = np.random.default_rng([3, seed])
        odometry = pv.StereoOdometry(
            CAMERA, config=config(40.0 + 5.0 * rng.normal()), sensors=[receiver(rng)]
        )
        for frame in drive(rng, STEPS + 1):
            estimate = odometry.step(frame)
        assert estimate.sensors[0].state == "used"
        T_cam_world = np.linalg.matrix_power(FORWARD, STEPS)
        squared.append(
            normalized_error_squared(
                se3.inverse(estimate.T_world_cam), T_cam_world, estimate.pose_cov
            )
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
    assert np.mean(squared) < chi2_interval(6, 12)[1]
    low, high = chi2_interval(4, 12)
    assert low < np.mean(origins) < high


def test_positions_without_a_heading_are_refused() -> None:
    rng = np.random.default_rng(4)
    frames = drive(rng, 2)
    odometry = pv.StereoOdometry(CAMERA, config=config(None), sensors=[receiver(rng)])
    odometry.step(frames[0])
    with pytest.raises(InputError, match="heading of the first camera is unknown"):
        odometry.step(frames[1])

"""Blind frames of a window beside a sensor of the motion, or an IMU that is not used."""

from dataclasses import replace

import numpy as np
import pytest

from inertial_worlds import CALIBRATION, SmoothPath, inertial_drive
from probevo import StereoOdometry
from probevo.arrays import FloatArray
from probevo.estimation.motion_estimate import Status
from probevo.geometry import se3, so3
from probevo.measurements.base import Measurement
from probevo.measurements.relative_rotation import RelativeRotation
from probevo.measurements.variables import pose_of
from probevo.sequences.frame import Frame
from worlds import CAMERA, FORWARD, blind_frame, drive, motion_error

FIRST = 14
"""The first blind frame: older landmarks have left the window, and begun anew."""
ATTITUDE_SIGMA_RAD = 1e-3


def rotation_sensor(prev: Frame, curr: Frame, C_curr_prev: FloatArray) -> list[Measurement]:
    """A truthful measurement of the rotation between two frames."""
    return [
        RelativeRotation(
            C_curr_prev,
            ATTITUDE_SIGMA_RAD**2 * np.eye(3),
            curr=pose_of(curr.index),
            prev=pose_of(prev.index),
        )
    ]


def odometry_before_the_dark(C_in_the_dark: FloatArray) -> StereoOdometry:
    """Return an odometry after ``FIRST`` frames, with a sensor that tells this rotation next."""

    def sensor(prev: Frame, curr: Frame) -> list[Measurement]:
        rotation = C_in_the_dark if curr.index >= FIRST else FORWARD[:3, :3]
        return rotation_sensor(prev, curr, rotation)

    odometry = StereoOdometry(CAMERA, sensors=[sensor])
    for frame in drive(np.random.default_rng(3), FIRST, points=150, sigma_px=0.2):
        odometry.step(frame)
    return odometry


def darkened(frames: list[Frame], num_dark: int) -> list[Frame]:
    """Return a drive with so many blind frames from ``FIRST`` on, and other points behind them."""
    seen = []
    for frame in frames:
        if FIRST <= frame.index < FIRST + num_dark:
            frame = blind_frame(frame.index)
        elif frame.index >= FIRST + num_dark and frame.features is not None:
            features = replace(frame.features, ids=frame.features.ids + 10**6)
            frame = replace(frame, features=features)
        seen.append(frame)
    return seen


def test_a_precise_sensor_counts_where_dead_reckoning_is_far_off() -> None:
    """By ten and more standard deviations of the sensor, but not by many of its own."""
    turn = so3.exp(np.array([0.0, 0.03, 0.0]))
    odometry = odometry_before_the_dark(turn)
    assert odometry.state is not None
    attitude = odometry.state.pose.T_world_cam[:3, :3]
    for number in range(1, 5):
        estimate = odometry.step(blind_frame(FIRST + number - 1))
        attitude = attitude @ turn.T
        error = np.linalg.norm(so3.log(estimate.T_world_cam[:3, :3] @ attitude.T))
        claimed = np.sqrt(np.linalg.eigvalsh(estimate.cov_cam_world[3:, 3:])[-1])
        assert error < claimed
        assert estimate.sensors[0].weight == 1.0
        # That of the pose before, and one of the sensor for each step.
        assert 0.9 < claimed / (ATTITUDE_SIGMA_RAD * np.sqrt(number)) < 1.5


def test_a_sensor_that_contradicts_dead_reckoning_beyond_its_covariance_hardly_counts() -> None:
    odometry = odometry_before_the_dark(so3.exp(np.array([0.0, 3.0, 0.0])))
    estimate = odometry.step(blind_frame(FIRST))
    assert np.linalg.norm(so3.log(estimate.T_curr_prev[:3, :3] @ FORWARD[:3, :3].T)) < 0.1
    assert estimate.sensors[0].weight is not None
    assert estimate.sensors[0].weight < 1e-3


class BrakingPath(SmoothPath):
    """It brakes from the first blind frame on."""

    def position(self, t_s: FloatArray) -> FloatArray:
        position = super().position(t_s)
        position[:, 2] -= 0.5 * 5.0 * np.clip(t_s - 0.1 * (FIRST - 1), 0.0, None) ** 2
        return position


@pytest.mark.parametrize("imu", ["in degrees", "silent in the dark"])
def test_an_imu_that_does_not_measure_makes_no_blackout_more_certain(imu: str) -> None:
    drawn = SmoothPath.drawn(np.random.default_rng(0), swing=0.1)
    path = BrakingPath(drawn.speed_m_s, drawn.amplitude_m, drawn.amplitude_rad, drawn.phase)
    frames, _ = inertial_drive(np.random.default_rng(1), FIRST + 12, path)
    sigmas = []
    for calibration in (None, CALIBRATION):
        odometry = StereoOdometry(CAMERA, config={"window": {"correlation": 0.0}}, imu=calibration)
        for frame in frames:
            samples = frame.imu
            if samples is not None and imu == "in degrees":
                samples = replace(samples, gyro_rad_s=np.rad2deg(samples.gyro_rad_s))
            if frame.index >= FIRST:
                samples = None if imu == "silent in the dark" else samples
                frame = blind_frame(frame.index)
            estimate = odometry.step(replace(frame, imu=samples if calibration else None))
        sigmas.append(np.sqrt(estimate.cov_cam_world[2, 2]))
    without, beside = sigmas
    assert beside == pytest.approx(without, rel=0.02)


def test_steps_after_a_long_blackout_claim_what_the_images_show() -> None:
    """The place is uncertain by metres then, the attitude is not, and a step by millimetres."""

    def sensor(prev: Frame, curr: Frame) -> list[Measurement]:
        return rotation_sensor(prev, curr, FORWARD[:3, :3])

    num_dark = 40
    frames = drive(np.random.default_rng(0), FIRST + num_dark + 20, points=150, sigma_px=0.2)
    odometry = StereoOdometry(CAMERA, sensors=[sensor])
    squared = []
    for frame in darkened(frames, num_dark):
        estimate = odometry.step(frame)
        if frame.index > FIRST + num_dark + 10:
            assert estimate.status is Status.OK
            assert np.sqrt(estimate.cov_cam_world[2, 2]) > 1.0
            assert np.sqrt(estimate.cov[:3, :3].diagonal().max()) < 0.03
            error = motion_error(estimate.T_curr_prev)
            squared.append(error @ np.linalg.solve(estimate.cov, error) / 6.0)
    assert np.mean(squared) < 1.3


def test_what_is_not_known_of_the_place_stays_unknown_among_near_points() -> None:
    """A blackout leaves it known to tens of metres; no later frame tells more of it, but for
    rounding, which moves σ by up to a seventh."""
    near = (0.5, 2.0)

    def sensor(prev: Frame, curr: Frame) -> list[Measurement]:
        return rotation_sensor(prev, curr, slow[:3, :3])

    slow = se3.exp(np.array([0.0, 0.0, -0.01, 0.0, 0.002, 0.0]))
    num_dark = 40
    frames = drive(
        np.random.default_rng(0),
        FIRST + num_dark + 14,
        slow,
        points=300,
        sigma_px=0.1,
        depth_m=near,
    )
    odometry = StereoOdometry(CAMERA, sensors=[sensor])
    sigmas = []
    for frame in darkened(frames, num_dark):
        estimate = odometry.step(frame)
        sigmas.append(np.sqrt(estimate.cov_cam_world[:3, :3].diagonal().min()))
    at_dawn = sigmas[FIRST + num_dark]
    assert at_dawn > 1.0
    assert sigmas[-1] > 0.8 * at_dawn

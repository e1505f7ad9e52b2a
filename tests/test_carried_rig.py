"""A camera in a hand turns by up to 13° from frame to frame, and no prediction knows where to."""

from dataclasses import replace

import numpy as np
import pytest

import probevo as pv
from probevo.arrays import FloatArray
from probevo.geometry import se3, so3
from probevo.geometry.uncertainty import normalized_error_squared
from probevo.prediction import predict
from probevo_sim.scene.config import RigConfig, SceneConfig
from probevo_sim.scene.recording import SceneRecording, open_scene

RIG = RigConfig(width_px=320, height_px=240, focal_px=200.0, baseline_m=0.1, rate_hz=20.0)


@pytest.fixture(scope="module")
def walk() -> tuple[SceneRecording, list[pv.Frame]]:
    """Two metres along a street, with 117 °/s rms."""
    config = SceneConfig(preset="residential", seed=1, distance_m=2.0, carried=1.0, rig=RIG)
    recording = open_scene(config)
    return recording, list(recording)


@pytest.mark.parametrize(
    ("estimator", "has_imu"), [("two-frame", False), ("window", False), ("window", True)]
)
def test_no_step_is_refused_and_each_is_as_good_as_claimed(
    walk: tuple[SceneRecording, list[pv.Frame]], estimator: str, has_imu: bool
) -> None:
    recording, frames = walk
    assert recording.truth is not None
    truth = recording.truth.T_world_cam
    imu = recording.imu if has_imu else None
    odometry = pv.StereoOdometry(recording.camera, imu=imu, config={"estimator": estimator})
    squared = []
    for k, frame in enumerate(frames):
        estimate = odometry.step(frame if has_imu else replace(frame, imu=None))
        if k == 0:
            continue
        assert estimate.status is pv.Status.OK, k
        squared.append(_error_squared(estimate, se3.inverse(truth[k]) @ truth[k - 1]))
    # The step of frame 0 to 1 is followed by 29 others; 6 is consistent.
    assert 1.0 < np.mean(squared) < 9.0
    end = se3.inverse(truth[0]) @ truth[len(frames) - 1]
    assert np.linalg.norm(estimate.T_world_cam[:3, 3] - end[:3, 3]) < 0.02


def test_the_gyro_is_an_alternative_until_it_has_been_tested(
    walk: tuple[SceneRecording, list[pv.Frame]],
) -> None:
    """Then the last velocity is, to which no sudden turn is conceded any more."""
    recording, frames = walk
    assert recording.truth is not None
    truth = recording.truth.T_world_cam
    odometry = pv.StereoOdometry(recording.camera, imu=recording.imu)
    roles = []
    for k, frame in enumerate(frames):
        if k > 1:
            assert odometry.state is not None
            first = predict(odometry.state, frame, recording.imu).motion
            second = first.alternative
            assert second is not None
            C_curr_prev = (se3.inverse(truth[k]) @ truth[k - 1])[:3, :3]
            off_rad = [
                np.linalg.norm(so3.log(motion.T_curr_prev[:3, :3] @ C_curr_prev.T))
                for motion in (first, second)
            ]
            gyro_is_first = bool(np.argmin(off_rad) == 0)
            assert off_rad[1 - gyro_is_first] < np.deg2rad(0.2)
            assert first.sudden_turn_rad == (0.0 if gyro_is_first else pytest.approx(0.05))
            assert second.sudden_turn_rad == 0.0
            roles.append(gyro_is_first)
        odometry.step(frame)
    assert not roles[0]
    assert roles[-1]
    assert np.count_nonzero(np.diff(roles)) == 1


def _error_squared(estimate: pv.MotionEstimate, T_curr_prev: FloatArray) -> float:
    """Return the squared error of a step in its standard deviations."""
    found = normalized_error_squared(
        estimate.T_curr_prev[None], T_curr_prev[None], estimate.cov[None]
    )
    return float(found[0])

"""A simulated drive as a sequence: frames, IMU, truth and reproducibility."""

from functools import cache

import numpy as np
import pytest

from probevo.errors import InputError
from probevo.geometry import se3, so3
from probevo.measurements.gyro import integrate_gyro
from probevo.sequences.frame import Frame
from probevo_sim.scene.config import Effects, RigConfig, SceneConfig
from probevo_sim.scene.recording import SceneRecording, open_scene

SMALL = RigConfig(width_px=96, height_px=48, focal_px=60.0)
SHORT = SceneConfig(preset="road", distance_m=20.0, rig=SMALL)


@cache
def short() -> SceneRecording:
    return open_scene(SHORT)


@cache
def short_frames() -> list[Frame]:
    return list(short())


def test_frames_carry_images_times_and_imu() -> None:
    recording = short()
    frames = short_frames()
    assert len(frames) == len(recording) >= 9
    assert [frame.stamp_ns for frame in frames] == recording.stamps_ns.tolist()
    np.testing.assert_array_equal(np.diff(recording.stamps_ns), 100_000_000)
    assert frames[0].imu is None
    for frame in frames:
        assert frame.left is not None
        assert frame.right is not None
        assert frame.left.shape == frame.right.shape == (48, 96)
        assert frame.left.std() > 10.0
        assert not np.array_equal(frame.left, frame.right)


def test_truth_is_relative_to_the_first_camera_and_agrees_with_the_imu() -> None:
    """The gyro's rotation of each frame is the truth's, up to its bias of some mrad/s."""
    recording = short()
    assert recording.truth is not None
    T = recording.truth.T_world_cam
    np.testing.assert_allclose(T[0], np.eye(4), atol=1e-12)
    for frame in short_frames()[1:]:
        T_curr_prev = se3.inverse(T[frame.index]) @ T[frame.index - 1]
        assert frame.imu is not None
        start_ns = int(recording.stamps_ns[frame.index - 1])
        end_ns = int(recording.stamps_ns[frame.index])
        gyro = integrate_gyro(
            frame.imu, start_ns, end_ns, calibration=recording.imu, bias_rad_s=np.zeros(3)
        )
        assert gyro is not None
        assert np.linalg.norm(so3.log(gyro.C_curr_prev @ T_curr_prev[:3, :3].T)) < 0.1 * 5 * 2e-3


def test_flow_of_the_pixels_leads_to_the_next_frame() -> None:
    recording = short()
    truth = recording.pixel_truth(3)
    assert recording.truth is not None
    T_next_curr = se3.inverse(recording.truth.T_world_cam[4]) @ recording.truth.T_world_cam[3]
    u = 40
    v = 40
    d = truth.disparity_px[v, u]
    point = recording.camera.triangulate(np.array([u, v, u - d, v], float))
    flow_px = recording.camera.project(se3.transform(T_next_curr, point))[:2] - [u, v]
    np.testing.assert_allclose(truth.flow_px[v, u], flow_px, atol=1e-6)


def test_same_settings_same_bytes() -> None:
    config = SHORT.model_copy(
        update={"drive": 1, "effects": Effects(noise=0.5, exposure=0.5, blur=0.3)}
    )
    first = open_scene(config)
    second = open_scene(config)
    np.testing.assert_array_equal(first.images(4), second.images(4))
    np.testing.assert_array_equal(first.imu_samples.gyro_rad_s, second.imu_samples.gyro_rad_s)


def test_another_drive_is_another_path_through_the_same_place() -> None:
    first = short()
    second = open_scene(SHORT.model_copy(update={"drive": 1}))
    np.testing.assert_array_equal(
        first.renderer.world.solids.T_object_solid, second.renderer.world.solids.T_object_solid
    )
    assert not np.array_equal(first.images(2), second.images(2))


def test_truth_can_be_withheld() -> None:
    loop = open_scene(SceneConfig(preset="rover", distance_m=60.0, truth="loop", rig=SMALL)).truth
    assert loop is not None
    assert np.flatnonzero(loop.known).tolist() == [0, len(loop.known) - 1]
    np.testing.assert_allclose(loop.T_world_cam[-1], np.eye(4), atol=1e-9)
    assert open_scene(SHORT.model_copy(update={"truth": "none"})).truth is None


def test_truth_of_a_loop_is_refused_without_a_loop() -> None:
    with pytest.raises(InputError, match="drives no loop"):
        open_scene(SHORT.model_copy(update={"truth": "loop"}))


def test_flow_of_the_last_frame_continues_the_drive() -> None:
    """At the lowest rate the next frame would come half a second after the end."""
    recording = open_scene(
        SHORT.model_copy(update={"rig": SMALL.model_copy(update={"rate_hz": 2.0})})
    )
    last = recording.pixel_truth(len(recording) - 1).flow_px
    previous = recording.pixel_truth(len(recording) - 2).flow_px
    lower = np.s_[26:34, :]  # the road, far enough ahead that it stays there
    previous_px = np.nanmedian(np.abs(previous[lower]))
    assert np.nanmedian(np.abs(last[lower])) == pytest.approx(previous_px, rel=0.5)


def test_noise_of_left_and_right_is_independent() -> None:
    quiet = short()
    noisy = open_scene(SHORT.model_copy(update={"effects": Effects(noise=1.0)}))
    left, right = (
        a.astype(float) - b for a, b in zip(noisy.images(2), quiet.images(2), strict=True)
    )
    assert left.std() > 5.0
    assert abs(np.corrcoef(left.ravel(), right.ravel())[0, 1]) < 0.1


def test_a_drive_of_less_than_a_frame_is_refused() -> None:
    with pytest.raises(InputError, match="distance_m"):
        open_scene(
            SceneConfig(
                preset="road", distance_m=1.1, rig=SMALL.model_copy(update={"rate_hz": 2.0})
            )
        )

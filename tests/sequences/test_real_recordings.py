"""The real recordings: counts, lengths and times that are known, or were measured when the format
was written."""

from pathlib import Path

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo.geometry import so3
from probevo.sequences import Sequence, open_sequence
from probevo.sequences.yaml_file import load_yaml

pytestmark = pytest.mark.data

RECORDINGS = {
    "kitti_raw/2011_09_26/2011_09_26_drive_0005_sync": ("kitti-raw", 154, 69.39),
    "kitti_odometry/sequences/06": ("kitti-odometry", 51, 59.86),
    "euroc/V1_01_micro": ("euroc", 40, 0.01),
    "kitti_tracks/2011_09_26_drive_0001.npz": ("tracks", 108, 106.92),
    "kitti_tracks/2011_09_26_drive_0005.npz": ("tracks", 154, 69.39),
    "kitti_tracks/2011_09_26_drive_0009.npz": ("tracks", 446, 332.93),
    "kitti_tracks/2011_09_26_drive_0027.npz": ("tracks", 188, 346.75),
    "kitti_tracks/2011_09_26_drive_0036.npz": ("tracks", 250, 178.64),
    "kitti_tracks/2011_09_30_drive_0027.npz": ("tracks", 500, 329.03),
}


@pytest.mark.parametrize("name", RECORDINGS)
def test_frames_and_length_of_the_path(name: str, data_root: Path) -> None:
    format, frames, path_m = RECORDINGS[name]
    sequence = open_sequence(data_root / name)
    assert (sequence.format, len(sequence)) == (format, frames)
    assert sequence.truth is not None
    assert sequence.truth.known.all()
    steps = np.diff(sequence.truth.T_world_cam[:, :3, 3], axis=0)
    assert np.linalg.norm(steps, axis=1).sum() == pytest.approx(path_m, abs=0.005)


def turn_errors_rad(sequence: Sequence) -> FloatArray:
    """Rotation of each frame by the gyro (trapezoids) less that of the truth, [K − 1, 3], camera
    axes."""
    assert sequence.truth is not None
    assert sequence.imu is not None
    errors = []
    for frame in sequence:
        if frame.imu is None:
            continue
        start, end = sequence.stamps_ns[frame.index - 1 : frame.index + 1]
        inner = (frame.imu.stamps_ns > start) & (frame.imu.stamps_ns < end)
        stamps = np.r_[start, frame.imu.stamps_ns[inner], end] - start
        rates = np.stack(
            [np.interp(stamps, frame.imu.stamps_ns - start, w) for w in frame.imu.gyro_rad_s.T],
            axis=1,
        )
        turn = sequence.imu.C_cam_imu @ np.trapezoid(rates, stamps / 1e9, axis=0)
        C_prev, C_curr = sequence.truth.T_world_cam[frame.index - 1 : frame.index + 1, :3, :3]
        errors.append(turn - so3.log(C_prev.T @ C_curr))
    return np.array(errors)


@pytest.mark.parametrize(
    ("name", "median_deg"),
    [
        ("kitti_raw/2011_09_26/2011_09_26_drive_0005_sync", 0.021),
        ("kitti_tracks/2011_09_26_drive_0001.npz", 0.016),
        ("kitti_tracks/2011_09_30_drive_0027.npz", 0.042),
    ],
)
def test_gyro_agrees_with_truth(name: str, median_deg: float, data_root: Path) -> None:
    """Wrong axes, a wrong calibration or samples half a period late would triple these figures."""
    errors = turn_errors_rad(open_sequence(data_root / name))
    assert np.degrees(np.median(np.linalg.norm(errors, axis=1))) < median_deg


def test_euroc_gyro_shows_its_known_bias(data_root: Path) -> None:
    """The body rests; the bias that the ground truth lists is (−0.002, 0.022, 0.077) rad/s."""
    sequence = open_sequence(data_root / "euroc/V1_01_micro")
    rates = np.concatenate([frame.imu.gyro_rad_s for frame in sequence if frame.imu is not None])
    np.testing.assert_allclose(rates.mean(axis=0), [-0.002, 0.022, 0.077], atol=0.002)


@pytest.mark.parametrize("name", ["V1_01_micro", "MH_01_micro"])
def test_euroc_imu_is_where_sensor_yaml_puts_it(name: str, data_root: Path) -> None:
    """Rectification turns the left camera and leaves it where it is: the distance of the IMU from
    it, and the IMU's coordinates in the raw camera, are those of the two T_BS."""
    folder = data_root / "euroc" / name
    imu = open_sequence(folder).imu
    assert imu is not None
    T_body_cam0, T_body_imu = (
        np.reshape(load_yaml(folder / "mav0" / sensor / "sensor.yaml")["T_BS"]["data"], (4, 4))
        for sensor in ("cam0", "imu0")
    )
    T_cam0_imu = np.linalg.inv(T_body_cam0) @ T_body_imu
    C_cam_cam0 = imu.C_cam_imu @ T_cam0_imu[:3, :3].T
    np.testing.assert_allclose(C_cam_cam0 @ T_cam0_imu[:3, 3], imu.T_cam_imu[:3, 3], atol=1e-9)
    np.testing.assert_allclose(imu.T_cam_imu[:3, 3], [0.0653, -0.0206, -0.0082], atol=1e-3)
    assert np.linalg.norm(imu.T_cam_imu[:3, 3]) == pytest.approx(0.0689, abs=1e-4)
    assert imu.accel_noise_m_s2_sqrt_hz == 2e-3
    assert imu.accel_bias_walk_m_s3_sqrt_hz == 3e-3


def test_kitti_raw_and_its_tracks_have_the_imu_at_the_same_place(data_root: Path) -> None:
    """The tracks file was made by others, from the same calibration files."""
    drive = open_sequence(data_root / "kitti_raw/2011_09_26/2011_09_26_drive_0005_sync").imu
    tracks = open_sequence(data_root / "kitti_tracks/2011_09_26_drive_0005.npz").imu
    assert drive is not None
    assert tracks is not None
    np.testing.assert_allclose(drive.T_cam_imu, tracks.T_cam_imu, atol=1e-6)
    # KITTI's sensor setup: the IMU is 0.81 m behind and 0.32 m beside the laser scanner,
    # which is 0.27 m behind and 0.08 m above the camera.
    np.testing.assert_allclose(drive.T_cam_imu[:3, 3], [-0.32, 0.72, -1.08], atol=0.03)


def test_images_have_the_size_of_the_calibration(data_root: Path) -> None:
    for name in list(RECORDINGS)[:3]:
        sequence = open_sequence(data_root / name)
        frame = next(iter(sequence))
        assert frame.left is not None
        assert frame.right is not None
        assert frame.left.shape == frame.right.shape == sequence.camera.size_px[::-1]
        assert frame.left.dtype == np.uint8

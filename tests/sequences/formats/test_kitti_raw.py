"""KITTI raw: the development kit's geodesy, and the times of the OXTS packets."""

from pathlib import Path

import numpy as np
import pytest

from probevo.sequences import open_sequence
from probevo.sequences.formats.kitti_raw import imu_poses
from sequences.recordings import poses, stamps_ns, write_kitti_raw


def test_mercator_projection_by_hand() -> None:
    """At latitude 0 the scale is 1: a degree of longitude is er·π/180 = 111319.4908 m; north is
    er·ln tan(45.5°)."""
    T_map_imu = imu_poses(np.array([[0.0, 0.0, 5.0], [1.0, 1.0, 7.0]]), np.zeros((2, 3)))
    np.testing.assert_allclose(T_map_imu[0, :3, 3], [0.0, 0.0, 5.0], atol=1e-8)
    np.testing.assert_allclose(T_map_imu[1, :3, 3], [111319.490793, 111325.142866, 7.0], atol=1e-5)


def test_scale_is_that_of_the_first_latitude() -> None:
    """cos 60° = 1/2, for the second packet as well, though it lies elsewhere."""
    T_map_imu = imu_poses(np.array([[60.0, 2.0, 0.0], [61.0, 2.0, 0.0]]), np.zeros((2, 3)))
    np.testing.assert_allclose(T_map_imu[:, 0, 3], 111319.490793, atol=1e-5)


def test_attitude_is_yaw_after_pitch_after_roll() -> None:
    """Forward by yaw 90° is north; nose down by pitch 90° looks to the ground."""
    angles = np.radians([[0.0, 0.0, 90.0], [0.0, 90.0, 0.0], [90.0, 0.0, 90.0]])
    C = imu_poses(np.zeros((3, 3)), angles)[:, :3, :3]
    np.testing.assert_allclose(C[0] @ [1, 0, 0], [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(C[1] @ [1, 0, 0], [0, 0, -1], atol=1e-12)
    np.testing.assert_allclose(C[2] @ [0, 1, 0], [0, 0, 1], atol=1e-12)


@pytest.mark.parametrize("delay_ns", [-8_000_000, 5_000_000])
def test_truth_is_carried_from_the_packets_to_the_images(delay_ns: int, tmp_path: Path) -> None:
    """The vehicle moves steadily, so that late packets make no difference to the motion, at the
    ends either."""
    truth = open_sequence(write_kitti_raw(tmp_path, packet_delay_ns=delay_ns)).truth
    assert truth is not None
    np.testing.assert_allclose(truth.T_world_cam, poses(4), atol=1e-6)


def test_gyro_packet_holds_since_the_packet_before(tmp_path: Path) -> None:
    """Packet 2 (0.03 + 2 rad/s) lasts from packet 1 to packet 2; interpolated anywhere between, it
    is that value."""
    frame = list(open_sequence(write_kitti_raw(tmp_path)))[2]
    assert frame.imu is not None
    inside = np.linspace(0.01, 0.1, 7) * 1e9
    rate = np.interp(inside, frame.imu.stamps_ns - stamps_ns(4)[1], frame.imu.gyro_rad_s[:, 2])
    np.testing.assert_allclose(rate, 2.03)
    np.testing.assert_allclose(frame.imu.accel_m_s2[:, 2], 9.81)

"""Ground truth interpolated to other times, and refused if it is impossible."""

import numpy as np
import pytest

from probevo.errors import InputError
from probevo.geometry import se3, so3
from probevo.sequences.poses import ground_truth, interpolate_poses

MS = 1_000_000
STAMPS_NS = 100 * MS * np.arange(5)


def steady_motion(at_ns: np.ndarray) -> np.ndarray:
    """Turning by 2 rad/s about a skew axis while moving at a constant velocity."""
    seconds = (at_ns / 1e9)[:, None]
    return se3.from_parts(so3.exp(seconds * [1.2, 0.0, 1.6]), seconds * [10.0, -1.0, 3.0])


@pytest.mark.parametrize("shift_ms", [-40, -1, 0, 13, 49])
def test_interpolation_is_exact_for_steady_motion(shift_ms: int) -> None:
    at_ns = STAMPS_NS + shift_ms * MS
    np.testing.assert_allclose(
        interpolate_poses(STAMPS_NS, steady_motion(STAMPS_NS), at_ns),
        steady_motion(at_ns),
        atol=1e-12,
    )


def test_truth_is_unknown_in_gaps_and_beyond_the_ends() -> None:
    stamps_ns = np.array([0, 100, 700, 800]) * MS
    at_ns = np.array([-60, -50, 50, 300, 700, 850, 860]) * MS
    poses = interpolate_poses(stamps_ns, steady_motion(stamps_ns), at_ns)
    np.testing.assert_array_equal(
        np.isnan(poses).any(axis=(1, 2)), [True, False, False, True, False, False, True]
    )


def test_a_pose_at_the_very_time_is_taken_whatever_gaps_are_beside_it() -> None:
    stamps_ns = 1000 * MS * np.arange(4)
    poses = interpolate_poses(stamps_ns, steady_motion(stamps_ns), np.r_[stamps_ns, 1500 * MS])
    np.testing.assert_allclose(poses[:4], steady_motion(stamps_ns), atol=1e-12)
    assert np.isnan(poses[4]).all()
    single = interpolate_poses(stamps_ns[1:2], steady_motion(stamps_ns[1:2]), stamps_ns)
    np.testing.assert_array_equal(np.isnan(single).any(axis=(1, 2)), [True, False, True, True])


def test_a_motion_goes_on_for_half_as_long_as_it_was_seen() -> None:
    """So that truth that ends earlier than the frames, at their rate, has no pose for the next."""
    stamps_ns = np.array([0, 100, 102]) * MS
    poses = interpolate_poses(stamps_ns, steady_motion(stamps_ns), np.array([103, 104]) * MS)
    np.testing.assert_array_equal(np.isnan(poses).any(axis=(1, 2)), [False, True])


def test_truth_is_relative_to_its_first_known_pose() -> None:
    T = steady_motion(STAMPS_NS + 500 * MS)
    T[0] = np.nan
    truth = ground_truth(STAMPS_NS, T, "poses.txt")
    np.testing.assert_array_equal(truth.known, [False, True, True, True, True])
    np.testing.assert_allclose(truth.T_world_cam[1], np.eye(4), atol=1e-12)
    np.testing.assert_allclose(truth.T_world_cam[3], se3.inverse(T[1]) @ T[3], atol=1e-12)


@pytest.mark.parametrize("C", [np.zeros((3, 3)), 1.01 * np.eye(3), np.diag([1.0, 1.0, -1.0])])
def test_a_matrix_that_does_not_rotate_is_refused(C: np.ndarray) -> None:
    with pytest.raises(InputError, match="not a rotation matrix"):
        so3.check_rotation(C, "calib.yaml: C_cam_imu")


def test_rounded_rotations_become_orthonormal() -> None:
    C = so3.check_rotation(np.round(so3.exp(np.array([0.3, -0.2, 0.9])), 5), "calib.txt")
    np.testing.assert_allclose(C @ C.T, np.eye(3), atol=1e-14)

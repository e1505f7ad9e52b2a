import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from probevo.arrays import FloatArray
from probevo.evaluation.segments import KITTI_LENGTHS_M, SHORT_LENGTHS_M, segment_errors
from probevo.geometry import se3


def straight_line(count: int, step_m: float) -> FloatArray:
    T_world_cam = np.tile(np.eye(4), (count, 1, 1))
    T_world_cam[:, 2, 3] = step_m * np.arange(count)
    return T_world_cam


def test_scale_error_on_a_line() -> None:
    """Steps of 1 m: a segment of length L ends after L + 1 steps, the first that exceed L: the
    error is s (L + 1)/L."""
    starts = np.arange(0, 1001, 10)
    errors = segment_errors(
        straight_line(1001, 1.03), straight_line(1001, 1.0), KITTI_LENGTHS_M, starts=starts
    )
    np.testing.assert_allclose(
        errors.translation, 0.03 * (errors.length_m + 1.0) / errors.length_m, rtol=1e-9
    )
    np.testing.assert_array_equal(errors.rotation_rad_m, 0.0)
    assert set(errors.length_m) == set(KITTI_LENGTHS_M)
    assert set(errors.first) <= set(starts)


def test_turn_rate_error_on_a_line() -> None:
    """A heading error of 0.01°/m yields just that, over the L + 1 m that a segment really has."""
    true = straight_line(201, 1.0)
    est = true.copy()
    est[:, :3, :3] = Rotation.from_rotvec(
        np.outer(np.deg2rad(0.01) * np.arange(201), [0, 1, 0])
    ).as_matrix()
    errors = segment_errors(est, true, (100.0,), starts=np.arange(0, 201, 10))
    assert errors.mean_rotation_deg_per_m == pytest.approx(0.01 * 101 / 100)


def test_matches_the_devkit_written_out() -> None:
    """Frame by frame, as evaluate_odometry.cpp does it."""
    rng = np.random.default_rng(0)
    steps_true = se3.exp(rng.normal([0, 0, 0.8, 0, 0.03, 0], 0.1, (150, 6)))
    steps_est = steps_true @ se3.exp(rng.normal(0.0, 0.003, (150, 6)))
    true, est = (
        np.array(list(np.eye(4)[None]) + list(_chain(steps))) for steps in (steps_true, steps_est)
    )
    distance = np.concatenate(
        [[0.0], np.cumsum(np.linalg.norm(np.diff(true[:, :3, 3], axis=0), axis=1))]
    )
    expected = []
    for first in range(len(true)):
        for length in SHORT_LENGTHS_M:
            last = next(
                (i for i in range(first, len(true)) if distance[i] > distance[first] + length), -1
            )
            if last == -1:
                continue
            delta_true = np.linalg.inv(true[first]) @ true[last]
            delta_est = np.linalg.inv(est[first]) @ est[last]
            error = np.linalg.inv(delta_est) @ delta_true
            angle = np.arccos(np.clip(0.5 * (np.trace(error[:3, :3]) - 1.0), -1.0, 1.0))
            expected.append((first, length, np.linalg.norm(error[:3, 3]) / length, angle / length))
    errors = segment_errors(est, true, SHORT_LENGTHS_M, starts=np.arange(len(true)))
    found = np.stack(
        [errors.first, errors.length_m, errors.translation, errors.rotation_rad_m], axis=1
    )
    np.testing.assert_allclose(found, expected, atol=1e-9)


@pytest.mark.parametrize("every", [1, 5, 10, 50, 100])
def test_a_scale_error_is_the_same_however_sparse_the_truth_is(every: int) -> None:
    """Steps of 1 m. With truth at every frame a segment is one step too long, as in the devkit;
    with sparser truth it is as much too long at most, whatever the gap."""
    frames = np.arange(0, 301, every)
    errors = segment_errors(
        straight_line(301, 1.01)[frames],
        straight_line(301, 1.0)[frames],
        SHORT_LENGTHS_M,
        starts=np.arange(len(frames)),
        frames=frames,
    )
    assert errors.mean_translation_percent == pytest.approx(1.0, rel=0.06)
    if every >= 50:
        np.testing.assert_allclose(errors.translation, 0.01, rtol=1e-9)


def test_a_segment_after_a_gap_ends_as_without_it_if_it_is_a_step_too_long() -> None:
    """Truth of frames 0 and 11 alone: 11 m are what the devkit takes for 10 m, but frame 13 is too
    far."""
    line = straight_line(14, 1.0)
    for last, length_m in ((11, 10.0), (13, 13.0)):
        frames = np.array([0, last])
        est = straight_line(14, 1.01)[frames]
        errors = segment_errors(est, line[frames], (10.0,), np.array([0]), frames=frames)
        np.testing.assert_allclose(errors.translation, 0.01 * last / length_m, rtol=1e-9)
        np.testing.assert_array_equal(errors.length_m, 10.0)


def test_gaps_elsewhere_change_no_bit() -> None:
    """Only the gap at the end of a segment counts."""
    rng = np.random.default_rng(1)
    true = se3.chain_motions(se3.exp(rng.normal([0, 0, 0.8, 0, 0.03, 0], 0.1, (150, 6))))
    est = se3.chain_motions(se3.exp(rng.normal([0, 0, 0.8, 0, 0.03, 0], 0.1, (150, 6))))
    frames = np.arange(len(true))
    dense = segment_errors(est, true, SHORT_LENGTHS_M, starts=frames)
    given = segment_errors(est, true, SHORT_LENGTHS_M, starts=frames, frames=frames)
    np.testing.assert_array_equal(dense.translation, given.translation)
    late = segment_errors(
        est, true, SHORT_LENGTHS_M, starts=frames, frames=np.where(frames < 5, frames, frames + 9)
    )
    ends_later = late.first >= 5
    np.testing.assert_array_equal(late.translation[ends_later], dense.translation[ends_later])


def _chain(steps: FloatArray) -> FloatArray:
    poses = [steps[0]]
    for step in steps[1:]:
        poses.append(poses[-1] @ step)
    return np.array(poses)


@pytest.mark.parametrize("count", [1, 2, 50])
def test_nothing_fits_a_short_path(count: int) -> None:
    line = straight_line(count, 1.0)
    errors = segment_errors(line, line, KITTI_LENGTHS_M, starts=np.arange(count))
    assert errors.mean_translation_percent is None
    assert errors.mean_rotation_deg_per_m is None

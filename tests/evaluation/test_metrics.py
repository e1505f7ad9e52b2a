import json

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo.errors import InputError
from probevo.evaluation.metrics import evaluate
from probevo.evaluation.trajectory_errors import relative_motions
from probevo.geometry import se3

KEYS = {
    "armse_m",
    "final_error_m",
    "rot_armse_rad",
    "path_length_m",
    "ate_rmse_m",
    "kitti_t_percent",
    "kitti_r_deg_per_m",
    "short_t_percent",
    "short_r_deg_per_m",
    "rpe_t_m",
    "rpe_r_deg",
    "anees",
}


def walk(rng: np.random.Generator, count: int, noise: float = 0.0) -> FloatArray:
    poses = [np.eye(4)]
    for xi in rng.normal([0, 0, 1, 0, 0.02, 0], noise, (count - 1, 6)):
        poses.append(poses[-1] @ se3.exp(xi))
    return np.array(poses)


def test_all_metrics_of_a_long_run() -> None:
    rng = np.random.default_rng(0)
    true = walk(rng, 200)
    est = walk(rng, 200, 0.01)
    metrics = evaluate(
        est, true, relative_motions(est), cov=np.tile(1e-4 * np.eye(6), (199, 1, 1))
    ).as_dict()
    assert metrics.keys() >= KEYS
    assert all(np.isfinite(metrics[key]) for key in KEYS)
    json.dumps(metrics, allow_nan=False)


def test_perfect_estimate_has_no_error() -> None:
    true = walk(np.random.default_rng(1), 150)
    metrics = evaluate(se3.exp(np.full(6, 0.3)) @ true, true)
    for key in (
        "armse_m",
        "final_error_m",
        "rot_armse_rad",
        "ate_rmse_m",
        "kitti_t_percent",
        "short_r_deg_per_m",
    ):
        assert getattr(metrics, key) == pytest.approx(0.0, abs=1e-9)
    assert metrics.anees is None


def test_unknown_poses_are_left_out() -> None:
    """A truth known on frames 10 to 59 only gives what these frames alone give; segments start
    where they did."""
    rng = np.random.default_rng(2)
    true = walk(rng, 80)
    est = walk(rng, 80, 0.01)
    cov = np.tile(1e-4 * np.eye(6), (79, 1, 1))
    partial = np.full_like(true, np.nan)
    partial[10:60] = true[10:60]
    found = evaluate(est, partial, relative_motions(est), cov=cov).as_dict()
    cut = evaluate(est[10:60], true[10:60], relative_motions(est)[10:59], cov=cov[10:59]).as_dict()
    assert found.pop("nees_coverage") == cut.pop("nees_coverage")
    assert found["num_frames"] == 50
    for key in KEYS - {"kitti_t_percent", "kitti_r_deg_per_m"}:
        assert found[key] == pytest.approx(cut[key], rel=1e-9)
    assert found["kitti_t_percent"] is None


@pytest.mark.parametrize("known", [0, 1])
@pytest.mark.parametrize("count", [1, 2, 5])
def test_too_few_poses_leave_everything_undefined(count: int, known: int) -> None:
    true = walk(np.random.default_rng(3), count)
    true[known:] = np.nan
    metrics = evaluate(walk(np.random.default_rng(3), count), true).as_dict()
    assert metrics.pop("num_frames") == known
    assert set(metrics.values()) == {None}


def test_two_frames() -> None:
    true = walk(np.random.default_rng(4), 2)
    metrics = evaluate(true, true)
    assert metrics.path_length_m == pytest.approx(1.0, rel=1e-4)
    assert metrics.short_t_percent is None


def test_at_rest() -> None:
    rest = np.tile(np.eye(4), (10, 1, 1))
    metrics = evaluate(rest, rest)
    assert metrics.path_length_m == metrics.ate_rmse_m == metrics.rpe_r_deg == 0.0


def test_lengths_must_agree() -> None:
    with pytest.raises(InputError, match="has 4 poses, the estimate has 5"):
        evaluate(np.tile(np.eye(4), (5, 1, 1)), np.tile(np.eye(4), (4, 1, 1)))


def test_sparse_truth_does_not_inflate_the_drift() -> None:
    """A path that is 1 % too long, with truth every 25 m."""
    motions = np.tile([0.0, 0.0, -1.0, 0.0, 0.0, 0.0], (300, 1))
    true = se3.chain_motions(se3.exp(motions))
    true[np.arange(301) % 25 != 0] = np.nan
    metrics = evaluate(se3.chain_motions(se3.exp(1.01 * motions)), true)
    assert metrics.short_t_percent == pytest.approx(1.0, rel=1e-6)
    assert metrics.kitti_t_percent == pytest.approx(1.0, rel=1e-6)

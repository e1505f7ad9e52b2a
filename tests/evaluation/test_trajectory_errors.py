import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from probevo.arrays import FloatArray
from probevo.evaluation import trajectory_errors as te
from probevo.geometry import se3

DATA = Path(
    os.environ.get("PROBEVO_DATA") or Path(__file__).resolve().parents[3] / "shared" / "data"
)


def random_walk(rng: np.random.Generator, count: int = 60) -> FloatArray:
    """A path that turns and climbs, with steps of about 1 m, [count, 4, 4]."""
    steps = se3.exp(rng.normal([0, 0, 1, 0, 0.02, 0], 0.05, (count - 1, 6)))
    poses = [se3.exp(rng.normal(size=6))]
    for step in steps:
        poses.append(poses[-1] @ step)
    return np.array(poses)


def disturbed(T_world_cam: FloatArray, rng: np.random.Generator, sigma: float = 0.01) -> FloatArray:
    return T_world_cam @ se3.exp(rng.normal(0.0, sigma, (len(T_world_cam), 6)))


def straight_line(count: int, step_m: float) -> FloatArray:
    T_world_cam = np.tile(np.eye(4), (count, 1, 1))
    T_world_cam[:, 2, 3] = step_m * np.arange(count)
    return T_world_cam


def test_armse_averages_the_root_mean_square_over_axes() -> None:
    assert te.armse(np.array([[3.0, 0.0, 0.0], [0.0, -5.0, 0.0]])) == pytest.approx(
        4.0 / np.sqrt(3.0)
    )


def test_position_errors_are_in_the_first_camera_frame_and_blind_to_the_world_frame() -> None:
    rng = np.random.default_rng(0)
    true = random_walk(rng)
    est = random_walk(rng)
    e = te.position_errors(est, true)
    np.testing.assert_allclose(
        te.position_errors(se3.exp(rng.normal(size=6)) @ est, true), e, atol=1e-12
    )
    np.testing.assert_allclose(
        e[7], (se3.inverse(est[0]) @ est[7] - se3.inverse(true[0]) @ true[7])[:3, 3], atol=1e-12
    )


def test_scale_error_on_a_line() -> None:
    """With positions (1 + s) z, e_k = s z_k: every figure has a closed form."""
    true = straight_line(101, 1.0)
    est = straight_line(101, 1.02)
    e = te.position_errors(est, true)
    assert te.armse(e) == pytest.approx(0.02 * 50.0 / np.sqrt(3.0))
    assert te.ate_rmse(est, true, align=False) == pytest.approx(
        0.02 * np.sqrt(np.mean(np.arange(101.0) ** 2))
    )
    assert te.ate_rmse(est, true) == pytest.approx(0.02 * np.std(np.arange(101.0)))
    assert te.path_length(true) == pytest.approx(100.0)
    assert te.rpe_rmse(est, true) == pytest.approx((0.02, 0.0))


def test_constant_turn_rate_error() -> None:
    """A yaw error of 0.001 rad a frame grows to 0.001 k, about the same axis in any frame."""
    true = straight_line(51, 1.0)
    est = true.copy()
    est[:, :3, :3] = Rotation.from_rotvec(np.outer(0.001 * np.arange(51), [0, 1, 0])).as_matrix()
    assert te.armse(te.rotation_errors(est, true)) == pytest.approx(0.025 / np.sqrt(3.0))


def test_alignment_recovers_a_rigid_motion() -> None:
    rng = np.random.default_rng(1)
    points = rng.normal(size=(30, 3))
    T = se3.exp(rng.normal(size=6))
    np.testing.assert_allclose(te.rigid_alignment(points, se3.transform(T, points)), T, atol=1e-12)


def test_alignment_of_noisy_points_is_the_least_squares_one() -> None:
    rng = np.random.default_rng(4)
    points = rng.normal(scale=10.0, size=(30, 3))
    T = se3.exp(rng.normal(size=6))
    target = se3.transform(T, points) + rng.normal(size=(30, 3))
    found = te.rigid_alignment(points, target)
    expected, _ = Rotation.align_vectors(target - target.mean(axis=0), points - points.mean(axis=0))
    np.testing.assert_allclose(found[:3, :3], expected.as_matrix(), atol=1e-12)
    np.testing.assert_allclose(
        se3.transform(found, points).mean(axis=0), target.mean(axis=0), atol=1e-12
    )


def test_alignment_never_reflects() -> None:
    """Of a mirrored cloud the best proper rotation is returned, also when points lie on a line or
    in one place."""
    rng = np.random.default_rng(2)
    points = rng.normal(size=(30, 3))
    for target in (points * [1, 1, -1], np.outer(np.arange(30.0), [1, 2, 3]), np.zeros((30, 3))):
        assert np.linalg.det(te.rigid_alignment(points, target)[:3, :3]) == pytest.approx(1.0)


def test_rpe_skips_steps_without_truth() -> None:
    rng = np.random.default_rng(3)
    true = random_walk(rng, 21)
    est = disturbed(true, rng)
    whole = te.rpe_rmse(est[:11], true[:11])
    true[11:] = np.nan
    assert te.rpe_rmse(est, true) == pytest.approx(whole)
    true[::2] = np.nan
    assert te.rpe_rmse(est, true) is None


@pytest.mark.parametrize("seed", range(5))
def test_agrees_with_evo(seed: int) -> None:
    evo_metrics = pytest.importorskip("evo.core.metrics")
    from evo.core.trajectory import PosePath3D

    rng = np.random.default_rng(seed)
    true = random_walk(rng)
    est = disturbed(true, rng)

    def evo(metric: Any, ref: FloatArray, T: FloatArray, *, align: bool = False) -> float:
        path_ref = PosePath3D(poses_se3=list(ref))
        path = PosePath3D(poses_se3=list(T))
        if align:
            path.align(path_ref)
        metric.process_data((path_ref, path))
        return float(metric.get_statistic(evo_metrics.StatisticsType.rmse))

    relation = evo_metrics.PoseRelation
    ape = evo_metrics.APE(relation.translation_part)
    first_true = te.from_first_camera(true)
    first_est = te.from_first_camera(est)
    assert te.ate_rmse(est, true) == pytest.approx(evo(ape, true, est, align=True), abs=1e-9)
    assert te.ate_rmse(est, true, align=False) == pytest.approx(
        evo(ape, first_true, first_est), abs=1e-9
    )
    rpe = [
        evo_metrics.RPE(r, 1, evo_metrics.Unit.frames)
        for r in (relation.translation_part, relation.rotation_angle_deg)
    ]
    assert te.rpe_rmse(est, true) == pytest.approx(
        [evo(metric, true, est) for metric in rpe], abs=1e-9
    )


@pytest.mark.data
@pytest.mark.skipif(not (DATA / "probe_table1").is_dir(), reason="recordings are absent")
@pytest.mark.parametrize(
    ("drive", "expected"),
    [
        ("2011_09_26_drive_0051", [(4.84, 12.6), (3.30, 8.62), (3.48, 8.08)]),
        ("2011_09_29_drive_0071", [(5.45, 30.3), (5.45, 30.4), (3.03, 12.8)]),
        ("2011_09_26_drive_0023", [(1.64, 8.20), (1.77, 8.27), (1.71, 8.13)]),
    ],
)
def test_reproduces_probe_table_1(drive: str, expected: list[tuple[float, float]]) -> None:
    """ARMSE and final error of nominal, aggressive and PROBE agree with the printed ones."""
    runs = np.load(DATA / "probe_table1" / f"{drive}.npz")
    for name, (armse_m, final_m) in zip(("nominal", "aggressive", "probe"), expected, strict=True):
        e = te.position_errors(runs[f"T_w_cam_{name}"], runs["T_w_cam_gt"])
        assert te.armse(e) == pytest.approx(armse_m, abs=0.0051)
        assert np.linalg.norm(e[-1]) == pytest.approx(
            final_m, abs=0.0501 if final_m > 10 else 0.0051
        )

"""The solver alone: motions from matches with their own covariances."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import probevo as pv
from probevo.arrays import FloatArray
from probevo.camera.rig_jitter import jitter_offsets
from probevo.errors import InputError
from probevo.geometry import se3
from probevo.geometry.uncertainty import normalized_error_squared
from probevo.output.motions_file import read_motions
from probevo.runs.runner import run_sequence

CAMERA = pv.StereoCamera(400.0, 400.0, 319.5, cv_px=239.5, baseline_m=0.3, size_px=(640, 480))
T_TRUE = se3.exp(np.array([0.05, -0.02, -0.4, 0.01, -0.03, 0.005]))


class Untyped:
    """A noise model of the user's own that returns an array."""

    columns = ()

    def predict(self, predictors: FloatArray) -> FloatArray:
        return np.zeros((len(predictors), 4, 4))

    def check_camera(self, camera: pv.StereoCamera) -> None:
        pass


def test_a_noise_model_that_returns_an_array_is_refused() -> None:
    prev, curr = matches(np.random.default_rng(0), 20, np.tile(0.01 * np.eye(4), (20, 1, 1)))
    noise: Any = Untyped()
    with pytest.raises(InputError, match="its predict returns a ndarray"):
        pv.estimate_motion(prev, curr, noise, CAMERA)


def matches(rng: np.random.Generator, count: int, cov_px2: FloatArray) -> tuple[FloatArray, ...]:
    """Observations of points with Gaussian errors of those covariances, [N, 4, 4]."""
    points = rng.uniform([-4.0, -3.0, 4.0], [4.0, 3.0, 15.0], (count, 3))
    root = np.linalg.cholesky(cov_px2)
    noisy = [
        CAMERA.project(seen) + (root @ rng.normal(size=(count, 4, 1)))[..., 0]
        for seen in (points, se3.transform(T_TRUE, points))
    ]
    return noisy[0], noisy[1]


def covariances(rng: np.random.Generator, count: int) -> FloatArray:
    """Covariances from good to bad, with correlations."""
    mixing = rng.normal(size=(count, 4, 4)) * rng.uniform(0.05, 0.3, (count, 1, 1))
    return mixing @ mixing.mT + 0.05**2 * np.eye(4)


@pytest.mark.parametrize("yaw_rad", [0.0, 1e-3, 3e-3])
def test_a_rig_that_flexes_makes_no_match_an_outlier(yaw_rad: float) -> None:
    """All u_r of a frame are off by the same half of a pixel or one and a half, as the noise says
    that they may be."""
    rng = np.random.default_rng(2)
    sigma_px = 0.1
    noise = pv.noise.StereoNoise(
        scale=np.tile(sigma_px**2 * np.eye(4), (80, 1, 1)),
        dof=np.full(80, np.inf),
        bias=np.zeros((80, 4)),
        refers_to="observation",
        jitter_cov=np.diag([1e-4, 1e-3, 1e-4]) ** 2,
    )
    prev, curr = matches(rng, 80, noise.scale)
    curr[:, 2:] += jitter_offsets(curr, CAMERA) @ np.array([0.0, yaw_rad, 0.0])
    motion = pv.estimate_motion(prev, curr, noise, CAMERA)
    assert motion.status is pv.Status.OK
    assert motion.num_used >= 78
    assert normalized_error_squared(T_TRUE, motion.T_curr_prev, motion.cov) < 22.5


def test_the_covariance_is_consistent() -> None:
    """The average NEES of 200 motions lies in the 99.9 % interval of χ²(6) / 200."""
    rng = np.random.default_rng(0)
    squared = []
    for _ in range(200):
        cov = covariances(rng, 80)
        prev, curr = matches(rng, 80, cov)
        motion = pv.estimate_motion(prev, curr, cov, CAMERA)
        assert motion.status is pv.Status.OK
        squared.append(
            normalized_error_squared(T_TRUE[None], motion.T_curr_prev[None], motion.cov[None])
        )
    assert 5.25 < np.mean(squared) < 6.85


@pytest.mark.parametrize("step_m", [0.8, 3.0])
@pytest.mark.parametrize("sigma_px", [0.2, 1.0, 2.0])
def test_noisy_matches_are_no_outliers(sigma_px: float, step_m: float) -> None:
    """A front end whose matches are a pixel off gets a covariance that says so."""
    rng = np.random.default_rng(5)
    T_curr_prev = se3.exp(np.array([0.0, 0.0, -step_m, 0.0, 0.0, 0.0]))
    squared = []
    for _ in range(100):
        points = rng.uniform([-8.0, -2.0, 6.0], [8.0, 2.0, 30.0], (80, 3))
        prev, curr = (
            CAMERA.project(seen) + sigma_px * rng.normal(size=(80, 4))
            for seen in (points, se3.transform(T_curr_prev, points))
        )
        motion = pv.estimate_motion(prev, curr, sigma_px**2 * np.eye(4), CAMERA)
        assert motion.status is pv.Status.OK
        assert motion.num_used >= 77
        squared.append(
            normalized_error_squared(T_curr_prev[None], motion.T_curr_prev[None], motion.cov[None])
        )
    assert 4.9 < np.mean(squared) < 7.2


@pytest.mark.parametrize("rotation", [np.diag([-1.0, 1.0, 1.0]), np.triu(np.ones((3, 3)))])
def test_a_guess_that_is_no_rigid_motion_is_refused(rotation: FloatArray) -> None:
    guess = np.eye(4)
    guess[:3, :3] = rotation
    with pytest.raises(InputError, match=r"^guess: "):
        pv.estimate_motion(SEEN, SEEN, np.eye(4), CAMERA, guess=guess)


def test_outliers_are_left_out() -> None:
    rng = np.random.default_rng(1)
    cov = np.tile(0.1**2 * np.eye(4), (100, 1, 1))
    prev, curr = matches(rng, 100, cov)
    curr[:30, [0, 2]] += rng.uniform(10.0, 40.0, (30, 1))
    motion = pv.estimate_motion(prev, curr, 0.1**2 * np.eye(4), CAMERA)
    assert motion.num_used <= 70
    np.testing.assert_allclose(motion.T_curr_prev, T_TRUE, atol=0.02)


def test_a_noise_model_may_be_named() -> None:
    prev, curr = matches(np.random.default_rng(2), 60, np.tile(0.01 * np.eye(4), (60, 1, 1)))
    motion = pv.estimate_motion(prev.tolist(), curr.tolist(), "student-t", CAMERA)
    expected = pv.estimate_motion(prev, curr, pv.noise.StudentT(), CAMERA)
    np.testing.assert_array_equal(motion.T_curr_prev, expected.T_curr_prev)
    np.testing.assert_allclose(motion.T_curr_prev, T_TRUE, atol=0.05)


def test_predicted_noise_is_taken_as_it_is() -> None:
    prev, curr = matches(np.random.default_rng(2), 60, np.tile(0.01 * np.eye(4), (60, 1, 1)))
    absolute = pv.noise.StudentT(scale_is_relative=False)
    motion = pv.estimate_motion(prev, curr, absolute.predict(np.zeros((60, 0))), CAMERA)
    expected = pv.estimate_motion(prev, curr, absolute, CAMERA)
    np.testing.assert_array_equal(motion.cov, expected.cov)
    assert motion.noise_factor == 1.0


@pytest.mark.parametrize("sigma_px", [0.05, 0.5, 1.0])
def test_noise_of_a_relative_scale_is_scaled_to_the_matches(sigma_px: float) -> None:
    """The size of the errors is not known before; the covariance is consistent all the same."""
    rng = np.random.default_rng(4)
    squared = []
    for _ in range(60):
        prev, curr = matches(rng, 60, np.tile(sigma_px**2 * np.eye(4), (60, 1, 1)))
        motion = pv.estimate_motion(prev, curr, "student-t", CAMERA)
        assert motion.status is pv.Status.OK
        assert motion.num_inliers > 30
        squared.append(
            normalized_error_squared(T_TRUE[None], motion.T_curr_prev[None], motion.cov[None])
        )
    assert 4.0 < np.mean(squared) < 9.0


@pytest.mark.parametrize("count", [0, 2])
def test_too_few_matches_are_a_status(count: int) -> None:
    prev, curr = matches(np.random.default_rng(3), count, np.tile(np.eye(4), (count, 1, 1)))
    motion = pv.estimate_motion(prev, curr, np.eye(4), CAMERA)
    assert motion.status is pv.Status.TOO_FEW_TRACKS
    np.testing.assert_array_equal(motion.T_curr_prev, np.eye(4))
    assert np.linalg.eigvalsh(motion.cov).min() > 0.0


SEEN = np.tile([320.0, 240.0, 300.0, 240.0], (5, 1))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((SEEN[:, :3], SEEN, np.eye(4), CAMERA), r"prev_px: has shape \(5, 3\)"),
        ((SEEN, SEEN[:4], np.eye(4), CAMERA), r"curr_px: has shape \(4, 4\)"),
        ((np.full((5, 4), np.nan), SEEN, np.eye(4), CAMERA), "not finite"),
        ((SEEN, SEEN, -np.eye(4), CAMERA), "positive definite"),
        ((SEEN, SEEN, np.triu(np.ones((4, 4))), CAMERA), "not symmetric"),
        ((SEEN, SEEN, np.eye(3), CAMERA), r"noise: has shape \(3, 3\)"),
        ((SEEN, SEEN, "student", CAMERA), "Did you mean student-t"),
        ((SEEN, SEEN, np.eye(4), "camera"), "Give a StereoCamera"),
        ((SEEN, "pixels", np.eye(4), CAMERA), "not an array of numbers"),
    ],
)
def test_wrong_arguments_are_input_errors(arguments: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        pv.estimate_motion(*arguments)


@pytest.mark.parametrize("seed", [-1, 0.5, None])
def test_a_seed_is_a_whole_number(seed: Any) -> None:
    with pytest.raises(InputError, match=r"^seed: is (?s:.*)Give a whole number"):
        pv.estimate_motion(SEEN, SEEN, np.eye(4), CAMERA, seed=seed)


def test_compounded_motions_are_the_path_of_the_odometry(tmp_path: Path) -> None:
    """``compound`` of what ``step`` returned gives the pose and covariance that it returned."""
    from cli.rendering import write_wall

    sequence = pv.open_sequence(str(write_wall(tmp_path / "wall", 5)))
    odometry = pv.StereoOdometry(sequence.camera, "student-t", config={"seed": 3})
    motions = [odometry.step(frame) for frame in sequence]
    T_world_cam, cov = pv.compound(motions)
    assert T_world_cam.shape == (5, 4, 4)
    np.testing.assert_allclose(T_world_cam[-1], motions[-1].T_world_cam, atol=1e-12)
    np.testing.assert_allclose(cov[-1], motions[-1].cov_cam_world, rtol=1e-9, atol=1e-13)
    with pytest.raises(InputError, match="not a MotionEstimate"):
        pv.compound([np.eye(4)])  # type: ignore[list-item]
    with pytest.raises(InputError, match=r"^motions: is MotionEstimate\(.*\n *Give a list"):
        pv.compound(motions[1])  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"noise": 3}, "noise: is 3"),
        ({"noise": pv.noise.StudentT}, "Give a noise model"),
        ({"noise": "missing.safetensors"}, "no such file"),
        ({"config": 3}, "config: is 3"),
        ({"config": {"tracking": {"features": 800}}}, "tracking.features"),
        ({"config": {"seed": "many"}}, "seed is 'many'"),
        ({"camera": {"fu_px": 400.0}}, "Give a StereoCamera"),
        ({"imu": {"gyro_noise": 1e-3}}, "Give an ImuCalibration"),
    ],
)
def test_wrong_arguments_of_the_odometry_are_input_errors(keywords: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        pv.StereoOdometry(**{"camera": CAMERA, **keywords})


def test_run_sequence_takes_strings_and_a_dictionary(tmp_path: Path) -> None:
    from cli.rendering import write_wall

    sequence = pv.open_sequence(str(write_wall(tmp_path / "wall", 4)))
    run = run_sequence(sequence, {"noise": "fixed"}, str(tmp_path / "out"))
    again = read_motions(str(tmp_path / "out"))
    np.testing.assert_array_equal(again.T_curr_prev, run.result.T_curr_prev)
    for config in (3, {"noises": "fixed"}):
        with pytest.raises(InputError, match="config"):
            run_sequence(sequence, config, tmp_path / "out")
    with pytest.raises(InputError, match="Give a path"):
        run_sequence(sequence, None, 3)


def test_reprs_are_short(tmp_path: Path) -> None:
    from cli.rendering import write_wall

    sequence = pv.open_sequence(write_wall(tmp_path / "wall", 4))
    odometry = pv.StereoOdometry(sequence.camera)
    frames = list(sequence)
    motions = [odometry.step(frame) for frame in frames]
    assert len(repr(motions[1])) < 120
    assert re.match(r"MotionEstimate\(OK, 0\.1\d+ ± 0\.\d+ m, 0\.\d+ ± ", repr(motions[1]))
    assert repr(frames[0]) == (
        "Frame(index=0, stamp_ns=1000000000000000000, left: 320×160 px, right: 320×160 px)"
    )
    assert "wall: 4 frames, 320×160 px, baseline 0.3 m, with truth>" in repr(sequence)


@pytest.mark.usefixtures("undrawn")
def test_a_run_as_a_data_frame_and_in_a_notebook(tmp_path: Path) -> None:
    pd = pytest.importorskip("pandas")
    from cli.rendering import write_wall

    sequence = pv.open_sequence(write_wall(tmp_path / "wall", 4))
    result = run_sequence(sequence, None, tmp_path / "out").result
    table = result.to_dataframe()
    assert isinstance(table, pd.DataFrame)
    assert list(table["status"]) == ["FIRST", "OK", "OK", "OK"]
    np.testing.assert_array_equal(table["z_m"], result.T_world_cam[:, 2, 3])
    np.testing.assert_array_equal(table["sigma_x_m"][1:], np.sqrt(result.cov[:, 0, 0]))
    np.testing.assert_array_equal(table.index, result.stamps_ns)
    assert repr(result) == f"RunResult({', '.join(f'{n} {t}' for n, t in result.facts())})"
    assert "<th>steps</th><td>3 OK</td>" in result._repr_html_()

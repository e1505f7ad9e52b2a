"""The examples run, stay short, and convert covariances rightly."""

import importlib.util
import itertools
import runpy
import subprocess
import sys
from functools import cache
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import probevo as pv
from cli.rendering import write_wall
from geometry.samples import sample_poses
from probevo.arrays import FloatArray
from probevo.cli.main import main
from probevo.geometry import se3
from probevo_sim.point_config import PointConfig, PointNoise, PointOutliers
from probevo_sim.point_world import simulate_points, write_points
from probevo_sim.scene.config import Effects, RigConfig, SceneConfig
from probevo_sim.scene.recording import SceneRecording, open_scene

EXAMPLES = Path(__file__).parents[1] / "examples"
BENCHMARKS = Path(__file__).parents[1] / "benchmarks"


@pytest.fixture(scope="module")
def wall(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_wall(tmp_path_factory.mktemp("wall"), frames=4)


def load(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location("example", EXAMPLES / name)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.name)
def test_examples_stay_short(path: Path) -> None:
    assert len(path.read_text().splitlines()) <= 120


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.name)
def test_examples_say_what_they_need(
    path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", [str(path)])
    with pytest.raises(SystemExit) as caught:
        runpy.run_path(str(path), run_name="__main__")
    shown = capsys.readouterr()
    assert (caught.value.code, shown.out) == (2, "")
    assert shown.err.startswith(f"usage: python examples/{path.name} ")
    assert len(shown.err.splitlines()) == 1


def test_run_and_plot(
    wall: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [EXAMPLES / "01_run_and_plot.py", wall, tmp_path / "path.png"]
    monkeypatch.setattr(sys, "argv", [str(word) for word in words])
    runpy.run_path(str(words[0]), run_name="__main__")
    assert capsys.readouterr().out.count(" OK ") == 3
    assert (tmp_path / "path.png").stat().st_size > 1000


@pytest.mark.usefixtures("undrawn")
def test_use_the_covariance(wall: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", str(wall), "--out", str(tmp_path)]) == 0
    capsys.readouterr()
    load("02_use_the_covariance.py").main(tmp_path)
    assert "GTSAM" in capsys.readouterr().out


def test_conversions_against_samples() -> None:
    """Monte Carlo: sampled motions, seen as GTSAM and as ROS see them, have the covariance that was
    converted."""
    example = load("02_use_the_covariance.py")
    rng = np.random.default_rng(0)
    T = se3.exp(np.array([2.0, -1.0, 3.0, 0.3, -0.5, 0.2]))
    half = rng.normal(size=(6, 6)) * 1e-3
    cov = half @ half.T
    samples = se3.inverse(sample_poses(T, cov, 200_000, rng))

    pose, converted = example.to_gtsam(T, cov)
    right = se3.log(se3.inverse(pose) @ samples)[:, [3, 4, 5, 0, 1, 2]]
    np.testing.assert_allclose(np.cov(right.T), converted, atol=0.02 * np.abs(converted).max())

    pose, converted = example.to_ros(T, cov)
    turns = Rotation.from_matrix(samples[:, :3, :3] @ pose[:3, :3].T).as_rotvec()
    errors = np.concatenate([samples[:, :3, 3] - pose[:3, 3], turns], axis=1)
    np.testing.assert_allclose(np.cov(errors.T), converted, atol=0.02 * np.abs(converted).max())


@pytest.mark.usefixtures("coarsely_rendered")
def test_how_wrong_features_are(capsys: pytest.CaptureFixture[str]) -> None:
    """The solver trusts what stands still."""
    load("03_how_wrong_features_are.py").main("city", Effects(traffic=1.0))
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert [line[1] for line in lines] == ["trusted", "distrusted"]
    assert int(lines[0][2]) < int(lines[1][2])


@cache
def rendered_once(config: SceneConfig) -> SceneRecording:
    """In place of ``open_scene``: each image is rendered once, however often the scene is driven
    through."""
    scene = open_scene(config)
    scene.renderer.pair = cache(scene.renderer.pair)  # type: ignore[method-assign]
    return scene


@pytest.mark.slow
@pytest.mark.usefixtures("coarsely_rendered")
def test_learn_whom_to_trust(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """What was learned in one street serves in another; here with smaller images.

    Of one pair of streets the gain over ``student-t`` is chance: over 48 pairs, the error is 0.8 to
    1.1 times as large (``benchmarks/probe_streets.py``).
    """
    example = load("04_learn_whom_to_trust.py")
    rig = RigConfig(width_px=414, height_px=126, focal_px=240.0)
    monkeypatch.setattr(
        example, "open_scene", lambda config: rendered_once(config.model_copy(update={"rig": rig}))
    )
    example.main(12.0)
    lines = capsys.readouterr().out.splitlines()
    mean_mm = {line.split()[0]: float(line.split()[1]) for line in lines[1:]}
    assert list(mean_mm) == ["fixed", "student-t", "learned"]
    assert mean_mm["learned"] < 1.2 * mean_mm["student-t"]
    assert mean_mm["learned"] < 0.2 * mean_mm["fixed"]


def test_merge_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is merged, its scale and s tell the same of any (u_l, u_r, v) as all four numbers do."""
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    benchmark = importlib.import_module("gtsam_agreement")
    rng = np.random.default_rng(0)
    half = rng.normal(size=(20, 4, 4))
    scale = half @ half.mT + 0.1 * np.eye(4)
    pixels = rng.normal(size=(20, 4))
    u_l, u_r, v = rng.normal(size=3)
    merged, merged_scale, squared = benchmark.merge_rows(pixels, scale)

    def length(error: FloatArray, scale: FloatArray) -> FloatArray:
        return np.asarray(np.vecdot(error, np.linalg.solve(scale, error[..., None])[..., 0]))

    whole = length(pixels - np.array([u_l, v, u_r, v]), scale)
    np.testing.assert_allclose(
        squared + length(merged - np.array([u_l, u_r, v]), merged_scale), whole
    )

    equal, _, _ = benchmark.merge_rows(np.array([[5.0, 1.0, 3.0, 2.0]]), np.eye(4)[None])
    np.testing.assert_allclose(equal, [[5.0, 3.0, 1.5]])


@pytest.mark.parametrize(("noise", "within_sigma"), [("fixed", 0.01), ("student-t", 0.05)])
def test_noise_for_gtsam(noise: str, within_sigma: float, tmp_path: Path) -> None:
    """GTSAM finds probevo's motions; with a Student-t, from the history of each track as well."""
    pytest.importorskip("gtsam", reason="gtsam is missing: pip install 'probevo[gtsam]'")
    gaussian = PointNoise(law="constant", sigma_low_px=0.2, sigma_high_px=0.2)
    config = PointConfig(noise=gaussian, outliers=PointOutliers(fraction=0.0))
    write_points(simulate_points(config, 1.0, np.random.default_rng(0)), tmp_path / "points.npz")
    words = [EXAMPLES / "05_noise_for_gtsam.py", tmp_path / "points.npz", noise]
    done = subprocess.run(
        [sys.executable, *map(str, words)], capture_output=True, text=True, check=True
    )
    lines = done.stdout.splitlines()
    assert [line.split()[0] for line in lines] == ["probevo", "GTSAM"] * 10
    apart = np.array([line.split("[")[-1].split("]")[0].split() for line in lines], np.float64)
    assert np.abs(apart).max() < within_sigma


@pytest.mark.slow
@pytest.mark.data
def test_gtsam_agrees_on_a_recording(data_root: Path) -> None:
    """Ten steps of KITTI: rig calibration, history, common mode, outliers, points at infinity."""
    pytest.importorskip("gtsam", reason="gtsam is missing: pip install 'probevo[gtsam]'")
    example = load("05_noise_for_gtsam.py")
    sequence = pv.open_sequence(data_root / "kitti_odometry" / "sequences" / "06")
    odometry = pv.StereoOdometry(sequence.camera, config={"estimator": "two-frame"})
    for frame in itertools.islice(sequence, 11):
        before = odometry.state
        motion = odometry.step(frame)
        if frame.index == 0:
            continue
        assert motion.status is pv.Status.OK
        T, _ = example.solve(example.factors_of(odometry, before), np.eye(4))
        cov = motion.cov - motion.common_mode @ motion.common_mode.T
        apart = se3.log(T @ se3.inverse(motion.T_curr_prev)) / np.sqrt(np.diagonal(cov))
        assert np.abs(apart).max() < 0.1


@pytest.mark.parametrize("speed", [2.0, 50.0])
def test_live(
    speed: float, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each frame is processed or counted as dropped, the last one is never dropped, and the path
    holds together. A busy machine may drop any other, the first one included."""
    example = load("06_live.py")
    monkeypatch.setattr(example, "open_scene", rendered_once)
    example.main(speed)
    *estimates, summary = capsys.readouterr().out.splitlines()
    frames, processed, dropped = (
        int(part.split()[0]) for part in summary.split(";")[0].split(", ")
    )
    assert processed == len(estimates)
    assert processed + dropped == frames
    assert int(estimates[-1].split()[0]) == frames - 1
    assert dropped or int(estimates[0].split()[0]) == 0
    assert dropped or float(summary.split()[-3]) < 50.0


@pytest.mark.parametrize("dof", [5.0, np.inf])
def test_noise_of_residuals_for_gtsam(dof: float) -> None:
    """With the points held where they were seen, GTSAM minimises probevo's own cost, of a Student-t
    as well."""
    pytest.importorskip("gtsam", reason="gtsam is missing: pip install 'probevo[gtsam]'")
    config = PointConfig(outliers=PointOutliers(fraction=0.0), noise=PointNoise(sigma_high_px=0.3))
    world = simulate_points(config, 0.5, np.random.default_rng(0))
    odometry = pv.StereoOdometry(
        world.camera,
        NoiseOfResiduals(dof),
        config={"estimator": "two-frame", "self_calibration": False},
    )
    example = load("05_noise_for_gtsam.py")
    for frame in world.frames():
        before = odometry.state
        motion = odometry.step(frame)
        if frame.index == 0:
            continue
        assert motion.status is pv.Status.OK
        T, cov = example.solve(example.factors_of(odometry, before), np.eye(4))
        apart = se3.log(T @ se3.inverse(motion.T_curr_prev)) / np.sqrt(np.diagonal(motion.cov))
        assert np.abs(apart).max() < 0.02
        own_cov = motion.cov - motion.common_mode @ motion.common_mode.T
        ratios = np.linalg.eigvals(np.linalg.solve(own_cov, cov)).real
        # probevo scales by what residuals show, and weighs features by their curvature; Gaussian
        # ones have the same.
        assert ratios.max() < (1.01 if np.isinf(dof) else 2.0) * ratios.min()


class NoiseOfResiduals:
    """Correlated, biased noise of y' − f(T g(y)), the same for all features."""

    columns: tuple[str, ...] = ()

    def __init__(self, dof: float) -> None:
        self.dof = dof

    def predict(self, predictors: FloatArray) -> pv.noise.StereoNoise:
        count = len(predictors)
        scale = 0.08 * (np.eye(4) + 0.3 * np.ones((4, 4)))
        bias = np.tile([0.05, -0.03, 0.02, 0.04], (count, 1))
        return pv.noise.StereoNoise(
            np.tile(scale, (count, 1, 1)), np.full(count, self.dof), bias, "residual"
        )

    def check_camera(self, camera: pv.StereoCamera) -> None:
        """Any will do."""


def test_own_sensors(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Both sensors are used, the dropouts are counted, and the heading is known better."""
    config = PointConfig(landmarks=400, noise=PointNoise(law="constant"))
    write_points(simulate_points(config, 6.0, np.random.default_rng(0)), tmp_path / "points.npz")
    load("07_own_sensors.py").main(str(tmp_path / "points.npz"))
    alone, together, gps, wheels = capsys.readouterr().out.splitlines()
    assert alone.startswith("no sensor: heading off by ")
    assert together.startswith("gps and wheels: heading off by ")
    claimed = [float(line.split("±")[1].rstrip("°")) for line in (alone, together)]
    assert claimed[1] < claimed[0]
    assert gps == "  gps: 41 steps used it, 19 without: no fix"
    assert wheels == "  wheels: 60 steps used it"

"""The examples run, stay short, and convert covariances rightly."""

import importlib.util
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cli.rendering import write_wall
from probevo.cli.main import main
from probevo.geometry import se3
from probevo.geometry.uncertainty import sample_poses

EXAMPLES = Path(__file__).parents[1] / "examples"


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
    assert len(path.read_text().splitlines()) <= 60


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.name)
def test_examples_say_what_they_need(path: Path) -> None:
    done = subprocess.run([sys.executable, str(path)], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith(f"usage: python examples/{path.name} ")
    assert len(done.stderr.splitlines()) == 1


def test_run_and_plot(wall: Path, tmp_path: Path) -> None:
    words = [EXAMPLES / "01_run_and_plot.py", wall, tmp_path / "path.png"]
    done = subprocess.run([sys.executable, *map(str, words)], capture_output=True, text=True, check=True)
    assert done.stdout.count(" OK ") == 3
    assert (tmp_path / "path.png").stat().st_size > 1000


def test_use_the_covariance(wall: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", str(wall), "--out", str(tmp_path)]) == 0
    capsys.readouterr()
    load("02_use_the_covariance.py").main(tmp_path)
    assert "GTSAM" in capsys.readouterr().out


def test_conversions_against_samples() -> None:
    """Monte Carlo: sampled motions, seen as GTSAM and as ROS see them, have the covariance that was converted."""
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


def test_how_wrong_features_are() -> None:
    """The solver trusts what stands still."""
    words = [EXAMPLES / "03_how_wrong_features_are.py", "city", "traffic=1"]
    done = subprocess.run([sys.executable, *map(str, words)], capture_output=True, text=True, check=True)
    lines = [line.split() for line in done.stdout.splitlines()]
    assert [line[1] for line in lines] == ["trusted", "distrusted"]
    assert int(lines[0][2]) < int(lines[1][2])


@pytest.mark.slow
def test_learn_whom_to_trust() -> None:
    """What was learned in one street makes steps in another better."""
    words = [EXAMPLES / "04_learn_whom_to_trust.py", "15"]
    done = subprocess.run([sys.executable, *map(str, words)], capture_output=True, text=True, check=True)
    mean_mm = {line.split()[0]: float(line.split()[1]) for line in done.stdout.splitlines()[1:]}
    assert list(mean_mm) == ["fixed", "student-t", "learned"]
    assert mean_mm["learned"] < 0.9 * mean_mm["student-t"]

"""Networks of rotations from recordings: trained, stopped, resumed, calibrated, and as sensors."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

jax = pytest.importorskip("jax", reason="jax is missing: pip install 'probevo[nets]'")
eqx = pytest.importorskip("equinox")

from cli.rendering import write_wall  # noqa: E402
from nets.small_pairs import NOISE, small_pairs  # noqa: E402
from probevo.cli.main import main  # noqa: E402
from probevo.config.networks import NetworkSettings  # noqa: E402
from probevo.errors import InputError  # noqa: E402
from probevo.geometry import so3  # noqa: E402
from probevo.measurements.sensor import NoMeasurement  # noqa: E402
from probevo.nets import methods, quaternions  # noqa: E402
from probevo.nets.calibration import BLOCK  # noqa: E402
from probevo.nets.image_pairs import ImagePairs  # noqa: E402
from probevo.nets.rotation_network import SPACE, RotationNetwork  # noqa: E402
from probevo.nets.rotation_sensor import RotationSensor  # noqa: E402
from probevo.nets.rotation_training import calibrated, errors_of, train_rotation  # noqa: E402
from probevo.nets.trained_network import saliency  # noqa: E402
from probevo.sensor_kinds import load_sensors  # noqa: E402
from probevo.sequences import open_sequence  # noqa: E402
from probevo.sequences.frame import GroundTruth  # noqa: E402

PAIRS = BLOCK
"""Pairs of a recording. With as many, what the training has compiled serves the tests, too."""
FRAMES = PAIRS + 1
SETTINGS = NetworkSettings(epochs=3, copies=3, batch=16, heads=4)


@pytest.fixture(scope="module")
def walls(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two recordings of the same wall."""
    root = tmp_path_factory.mktemp("walls")
    return [write_wall(root / name, frames=FRAMES) for name in ("one", "other")]


@pytest.fixture(scope="module")
def model(walls: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("model") / "rotation.safetensors"
    train_rotation([open_sequence(wall) for wall in walls], SETTINGS, out)
    return out


def test_the_file_gives_the_network_back(model: Path, tmp_path: Path) -> None:
    network = RotationNetwork.load(model)
    pairs = small_pairs(PAIRS)
    copy = tmp_path / "copy.safetensors"
    network.save(copy)
    assert copy.read_bytes() == model.read_bytes()
    again = RotationNetwork.load(copy).estimate(pairs.fields)
    np.testing.assert_array_equal(network.estimate(pairs.fields).q_curr_prev, again.q_curr_prev)
    assert network.facts["learned_from"] == ["one"]
    assert network.facts["left_out"] == ["other"]
    assert not model.with_name(model.name + ".work").exists()


@pytest.mark.parametrize("stop_at", [5, 2 * FRAMES, 3 * FRAMES + 1])
def test_a_training_that_was_stopped_ends_with_the_same_bytes(
    walls: list[Path], model: Path, tmp_path: Path, stop_at: int
) -> None:
    """Stopped while it reads, before the first epoch, and after the second."""

    def stop(done: int, total: int) -> None:
        assert total == 2 * FRAMES * (1 + SETTINGS.epochs)
        if done >= stop_at:
            raise KeyboardInterrupt

    out = tmp_path / "rotation.safetensors"
    recordings = [open_sequence(wall) for wall in walls]
    with pytest.raises(KeyboardInterrupt):
        train_rotation(recordings, SETTINGS, out, on_progress=stop)
    assert not out.exists()
    train_rotation(recordings, SETTINGS, out)
    assert out.read_bytes() == model.read_bytes()


@pytest.mark.parametrize(
    ("sparse", "complaint"),
    [
        (0, f"SEQUENCE: 4 of {FRAMES} frames can be learned from"),
        (1, "other: it is left out, and 4 of"),
    ],
)
def test_truth_that_is_known_too_seldom_is_refused_before_the_training(
    walls: list[Path], tmp_path: Path, sparse: int, complaint: str
) -> None:
    """A covariance cannot be calibrated by nothing; that was found at the very end."""
    recordings = [open_sequence(wall) for wall in walls]
    truth = recordings[sparse].truth
    assert truth is not None
    T_world_cam = truth.T_world_cam.copy()
    T_world_cam[5:] = np.nan
    known_seldom = GroundTruth(recordings[sparse].stamps_ns, T_world_cam)
    recordings[sparse] = replace(recordings[sparse], truth=known_seldom)
    with pytest.raises(InputError, match=complaint):
        train_rotation(recordings, SETTINGS, tmp_path / "rotation.safetensors")


def test_the_covariance_is_scaled_to_errors_in_blocks(model: Path) -> None:
    """Errors that are the same for ten pairs need ten times the variance of independent ones."""
    network = RotationNetwork.load(model)
    plain = RotationNetwork(network.networks, network.domain, {**network.facts, "scale": 1.0})
    rng = np.random.default_rng(0)
    left_out = []
    for fields in np.split(small_pairs(20 * PAIRS, seed=5, turn_rad=0.002).fields, 20):
        estimated = plain.estimate(fields)
        C = so3.exp(_rotation_vectors(estimated.q_curr_prev))
        errors = np.linalg.cholesky(estimated.covariance) @ rng.normal(size=3)
        left_out.append(ImagePairs(fields, so3.log(so3.exp(-errors) @ C)))
    found = calibrated(plain, left_out)
    assert found.facts["scale_single"] == pytest.approx(1.0, abs=0.5)
    ratio = found.facts["scale_blocks"] / found.facts["scale_single"]
    assert 6.0 < ratio < 12.0
    assert found.facts["scale"] == found.facts["scale_blocks"]


def test_what_it_has_not_seen_is_widened_and_in_the_end_not_measured(
    model: Path, walls: list[Path]
) -> None:
    network = RotationNetwork.load(model)
    sequence = open_sequence(walls[0])
    sensor = RotationSensor(network, sequence.camera, "rotation")
    frames = list(sequence)
    (measured,) = list(sensor(frames[3], frames[4]))
    assert measured.variables[1].frame == 4
    rng = np.random.default_rng(0)
    noise = rng.integers(0, 256, (2, *frames[0].left.shape), dtype=np.uint8)
    strange = [_with_left(frames[k], noise[k]) for k in (0, 1)]
    answer = sensor(*strange)
    if isinstance(answer, NoMeasurement):
        assert answer.reason == "out of its domain"
    else:
        claimed = np.trace(answer[0].covariance)
        assert claimed > 4.0 * np.trace(measured.covariance)


def test_a_frame_without_an_image_gives_no_measurement(model: Path, walls: list[Path]) -> None:
    sequence = open_sequence(walls[0])
    sensor = RotationSensor.load(model, sequence.camera)
    frame = next(iter(sequence))
    answer = sensor(frame, _with_left(frame, None))
    assert isinstance(answer, NoMeasurement)
    assert answer.reason == "no image"


@pytest.mark.usefixtures("undrawn")
def test_train_run_and_compare_with_the_sensor(
    walls: list[Path], model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The command trains the same bytes; a run uses the sensor, and its config repeats the run."""
    out = tmp_path / "rotation.safetensors"
    options = ["--nets.epochs", "3", "--nets.copies", "3", "--nets.batch", "16"]
    words = ["--kind", "rotation", "--nets.heads", "4", *options, "--out", str(out)]
    assert main(["train", *map(str, walls), *words]) == 0
    shown = capsys.readouterr().out
    assert "left out:     other" in shown
    assert "kept:         the network after " in shown
    assert shown.splitlines()[-1] == f"next: probevo run SEQUENCE --sensor {out} --out DIR"
    assert out.read_bytes() == model.read_bytes()

    run = tmp_path / "run"
    assert main(["run", str(walls[0]), "--sensor", str(out), "--out", str(run)]) == 0
    assert json.loads((run / "metrics.json").read_text())["faults"] == {}
    shown = (run / "report.html").read_text()
    assert re.search(rf"Sensor rotation.{{0,80}}{PAIRS} steps used it", shown, re.DOTALL)
    again = tmp_path / "again"
    assert main(["run", "--config", str(run / "config.yaml"), "--out", str(again)]) == 0
    assert (again / "trajectory.tum").read_bytes() == (run / "trajectory.tum").read_bytes()

    seen = tmp_path / "seen"
    assert main(["inspect", str(walls[1]), "--model", str(out), "--out", str(seen)]) == 0
    assert "Errors within their regions" in (seen / "inspection.html").read_text()
    shown = capsys.readouterr().out
    assert f"Measurements: {PAIRS}" in shown
    assert "Kept: the network after " in shown
    assert "Learned: from this recording" in shown
    assert main(["inspect", "--model", str(out), "--out", str(seen)]) == 2
    assert "a sensor is inspected on a recording" in capsys.readouterr().err

    compared = tmp_path / "compared"
    words = ["--noise", "student-t", "--sensor", str(out), "--out", str(compared)]
    assert main(["compare", str(walls[0]), *words]) == 0
    shown = capsys.readouterr().out
    assert re.search(r"^ +student-t \+ rotation † ", shown, re.MULTILINE)
    assert re.search(r"^ +student-t  ", shown, re.MULTILINE)


def test_errors_are_those_of_left_perturbations(model: Path) -> None:
    """An estimate that is C_true turned by φ has the error φ."""
    network = RotationNetwork.load(model)
    pairs = small_pairs(PAIRS)
    C = so3.exp(_rotation_vectors(network.estimate(pairs.fields).q_curr_prev))
    phi = np.array([0.01, -0.02, 0.015])
    truth = so3.log(so3.exp(-phi) @ C)
    errors = errors_of(network, ImagePairs(pairs.fields, truth)).errors
    np.testing.assert_allclose(errors, np.tile(phi, (PAIRS, 1)), atol=1e-5)
    assert NOISE > 0.0


def test_saliency_is_the_derivative_of_the_loss_by_a_cell(model: Path) -> None:
    network = RotationNetwork.load(model)
    pairs = small_pairs(1)
    q_true = np.asarray(quaternions.exp(jax.numpy.asarray(pairs.rotations, jax.numpy.float32)))
    found = saliency(
        network,
        SPACE,
        np.repeat(pairs.fields, PAIRS, axis=0),
        np.repeat(q_true, PAIRS, axis=0),
    )
    assert found.shape == pairs.fields.shape[2:]
    loss = eqx.filter_jit(methods.loss)
    first = jax.tree.map(lambda array: array[0], network.networks)
    row, column = np.unravel_index(np.argmax(found), found.shape)
    spread = pairs.fields.std(axis=(0, 2, 3))
    expected = 0.0
    for channel in range(4):
        losses = []
        for sign in (1.0, -1.0):
            moved = pairs.fields.copy()
            moved[0, channel, row, column] += 0.03 * sign * spread[channel]
            one = loss(SPACE, first, moved, q_true[:, None], key=jax.random.key(0))
            losses.append(float(one))
        expected += abs(losses[0] - losses[1]) / 0.06
    assert found[row, column] == pytest.approx(expected, rel=0.1)


@pytest.mark.parametrize(
    ("recordings", "settings", "message"),
    [
        ([0], {}, "the last 1 would be left out"),
        ([0, 1], {"left_out": 2}, "the last 2 would be left out"),
        ([0, 0], {}, "named twice"),
    ],
)
def test_recordings_that_do_not_suffice_are_refused(
    walls: list[Path],
    tmp_path: Path,
    recordings: list[int],
    settings: dict[str, int],
    message: str,
) -> None:
    opened = [open_sequence(walls[k]) for k in recordings]
    with pytest.raises(InputError, match=message):
        train_rotation(opened, NetworkSettings(**settings), tmp_path / "model.safetensors")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("words", "flag"),
    [
        (["--contrast", "1"], "--contrast"),
        (["--supervision", "none"], "--supervision"),
        (["--jobs", "2"], "--jobs"),
        (["--gk.centers", "7"], "--gk"),
    ],
)
def test_settings_of_noise_models_are_refused(
    walls: list[Path],
    tmp_path: Path,
    words: list[str],
    flag: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = str(tmp_path / "model.safetensors")
    assert main(["train", *map(str, walls), "--kind", "rotation", *words, "--out", out]) == 2
    assert flag in capsys.readouterr().err


def test_settings_of_networks_are_refused_by_noise_models(
    walls: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = str(tmp_path / "model.safetensors")
    assert main(["train", *map(str, walls), "--nets.heads", "7", "--out", out]) == 2
    assert "--nets: --kind knn is not a network" in capsys.readouterr().err


def test_files_that_are_no_sensors_are_refused(
    walls: list[Path], model: Path, tmp_path: Path
) -> None:
    wall = open_sequence(walls[0])
    with pytest.raises(InputError, match="given twice"):
        load_sensors([model, model], wall)
    with pytest.raises(InputError, match=r"missing\.safetensors"):
        load_sensors([tmp_path / "missing.safetensors"], wall)
    damaged = tmp_path / "damaged.safetensors"
    content = bytearray(model.read_bytes())
    content[-5] ^= 1
    damaged.write_bytes(content)
    with pytest.raises(InputError, match="checksum"):
        load_sensors([damaged], wall)


def _rotation_vectors(q: np.ndarray) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return Rotation.from_quat(q, scalar_first=True).as_rotvec()


def _with_left(frame: object, left: object) -> object:
    from dataclasses import replace

    return replace(frame, left=left, prepared=None)

"""Networks of corrections from recordings: trained, resumed, calibrated, and in the odometry."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

jax = pytest.importorskip("jax", reason="jax is missing: pip install 'probevo[nets]'")
pytest.importorskip("equinox")

import probevo as pv  # noqa: E402
from cli.rendering import write_wall  # noqa: E402
from probevo.cli.main import main  # noqa: E402
from probevo.config.networks import NetworkSettings  # noqa: E402
from probevo.errors import InputError  # noqa: E402
from probevo.geometry import se3  # noqa: E402
from probevo.measurements.relative_pose import RelativePose  # noqa: E402
from probevo.measurements.sensor import NoMeasurement  # noqa: E402
from probevo.nets.correction_network import CorrectionNetwork, inputs_of  # noqa: E402
from probevo.nets.correction_sensor import CorrectionSensor  # noqa: E402
from probevo.nets.correction_training import calibrated, errors_of, train_correction  # noqa: E402
from probevo.nets.estimated_steps import EstimatedSteps, read_steps  # noqa: E402
from probevo.sequences import open_sequence  # noqa: E402
from probevo_paper import dpc_net  # noqa: E402
from worlds import TWO_FRAMES  # noqa: E402

FRAMES = 13
SETTINGS = NetworkSettings(epochs=2, batch=8, heads=3)
FLAGS = ["--nets.epochs", "2", "--nets.batch", "8", "--nets.heads", "3"]
LONGER = 1.04
"""Factor on the true translations of the walls: as the calibration of a rig may be wrong."""


@pytest.fixture(scope="module")
def walls(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Three recordings of the same wall, whose truth is 4 % longer than what is seen."""
    root = tmp_path_factory.mktemp("walls")
    folders = [write_wall(root / name, frames=FRAMES) for name in ("one", "two", "other")]
    for folder in folders:
        poses = np.loadtxt(folder / "poses.txt").reshape(-1, 3, 4)
        poses[:, :, 3] *= LONGER
        np.savetxt(folder / "poses.txt", poses.reshape(-1, 12), fmt="%.17g")
    return folders


@pytest.fixture(scope="module")
def model(walls: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("model") / "correction.safetensors"
    train_correction([open_sequence(wall) for wall in walls], SETTINGS, out)
    return out


@pytest.fixture(scope="module")
def steps(walls: list[Path]) -> EstimatedSteps:
    return read_steps(open_sequence(walls[2]), FRAMES, config=pv.OdometryConfig())


def test_the_corrections_lead_from_the_estimate_to_the_truth(steps: EstimatedSteps) -> None:
    assert len(steps) == FRAMES - 1
    corrected = se3.exp(steps.corrections) @ se3.exp(steps.motions)
    distances = np.linalg.norm(corrected[:, :3, 3], axis=1)
    np.testing.assert_allclose(distances, LONGER * 0.15, rtol=0.01)
    assert steps.fields.shape == (FRAMES - 1, 6, 20, 72)


def test_the_file_gives_the_network_back(
    model: Path, steps: EstimatedSteps, tmp_path: Path
) -> None:
    network = CorrectionNetwork.load(model)
    copy = tmp_path / "copy.safetensors"
    network.save(copy)
    assert copy.read_bytes() == model.read_bytes()
    inputs = inputs_of(steps.fields, steps.motions, steps.covariances)
    again = CorrectionNetwork.load(copy).estimate(inputs)
    np.testing.assert_array_equal(network.estimate(inputs).xi, again.xi)
    assert network.facts["left_out"] == ["other"]
    rms = network.facts["left_out_rms"]
    assert set(rms) == {"uncorrected", "constant", "linear regression", "network"}
    assert rms["network"][0] < 0.3 * rms["uncorrected"][0]
    linear = np.abs(network.linear(inputs) - steps.corrections)[:, 2]
    assert (linear < 0.3 * np.abs(steps.corrections[:, 2])).all()


def test_a_training_that_was_stopped_ends_with_the_same_bytes(
    walls: list[Path], model: Path, tmp_path: Path
) -> None:
    """Stopped while it reads the second recording, and after the first epoch."""
    recordings = [open_sequence(wall) for wall in walls]
    out = tmp_path / "correction.safetensors"
    for stop_at in (FRAMES + 2, 3 * FRAMES * 2):

        def stop(done: int, total: int, at: int = stop_at) -> None:
            assert total == 3 * FRAMES * (1 + SETTINGS.epochs)
            if done >= at:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            train_correction(recordings, SETTINGS, out, on_progress=stop)
        assert not out.exists()
    train_correction(recordings, SETTINGS, out)
    assert out.read_bytes() == model.read_bytes()


def test_what_does_not_hold_on_other_recordings_is_taken_back(
    model: Path, steps: EstimatedSteps
) -> None:
    network = CorrectionNetwork.load(model)
    plain = CorrectionNetwork(
        network.networks, network.domain, {**network.facts, "gain": 1.0, "scale": 1.0}
    )
    inputs = inputs_of(steps.fields, steps.motions, steps.covariances)
    estimated = plain.estimate(inputs).xi
    half = calibrated(plain, [replace(steps, corrections=0.5 * estimated)])
    assert half.facts["gain"] == pytest.approx(0.5, abs=1e-4)
    against = calibrated(plain, [replace(steps, corrections=-estimated)])
    assert against.facts["gain"] == 0.0
    assert (against.estimate(inputs).xi == 0.0).all()
    claimed = errors_of(half, replace(steps, corrections=0.5 * estimated))
    assert np.abs(claimed.errors).max() < 1e-5


def test_the_odometry_takes_the_corrected_motion_with_its_covariance(
    walls: list[Path], model: Path
) -> None:
    """It is T_corr T_est with the covariance of the network, not a mean of both."""
    sequence = open_sequence(walls[2])
    sensor = CorrectionSensor.load(model, sequence.camera)
    frames = list(sequence)[:4]
    plain = pv.StereoOdometry(sequence.camera, config=TWO_FRAMES)
    fused = pv.StereoOdometry(sequence.camera, config=TWO_FRAMES, sensors=[sensor])
    for k, frame in enumerate(frames):
        before = plain.step(frame)
        after = fused.step(frame)
        if k == 0:
            continue
        expected = sensor.correct(frames[k - 1], frame, before.T_curr_prev, cov=before.cov)
        assert isinstance(expected, RelativePose)
        np.testing.assert_array_equal(after.T_curr_prev, expected.T_curr_prev)
        np.testing.assert_array_equal(after.cov, expected.covariance)
        assert [each.state for each in after.sensors] == ["used"]
    longer = np.linalg.norm(after.T_world_cam[:3, 3]) / np.linalg.norm(before.T_world_cam[:3, 3])
    assert longer == pytest.approx(LONGER, abs=0.01)


def test_every_method_of_the_paper_drifts_as_it_should(walls: list[Path], model: Path) -> None:
    networks = {dpc_net.NETWORK: model, dpc_net.ROTATION: model}
    found = dpc_net.drifts(
        open_sequence(walls[2]), networks, pv.OdometryConfig(estimator="two-frame")
    )
    assert tuple(found) == dpc_net.METHODS
    nees = {name: float(drift.anees or 0.0) for name, drift in found.items()}
    assert nees[dpc_net.UNCORRECTED] > 2.0 * nees[dpc_net.CONSTANT] > 0.0
    assert nees[dpc_net.UNCORRECTED] > 2.0 * nees[dpc_net.LINEAR] > 0.0
    assert found[dpc_net.ROTATION] == found[dpc_net.NETWORK]


def test_what_it_cannot_see_it_does_not_correct(walls: list[Path], model: Path) -> None:
    sequence = open_sequence(walls[0])
    sensor = CorrectionSensor.load(model, sequence.camera)
    frame = next(iter(sequence))
    blind = replace(frame, right=None, prepared=None)
    answer = sensor.correct(frame, blind, np.eye(4), cov=np.eye(6))
    assert answer == NoMeasurement("no image")
    far = se3.exp(np.array([0.0, 0.0, 50.0, 0.0, 0.5, 0.0]))
    answer = sensor.correct(frame, frame, far, cov=np.eye(6))
    assert answer == NoMeasurement("out of its domain")


def test_there_is_one_correction_at_most(walls: list[Path], model: Path) -> None:
    camera = open_sequence(walls[0]).camera
    sensor = CorrectionSensor.load(model, camera)
    with pytest.raises(InputError, match="2 of them correct"):
        pv.StereoOdometry(camera, sensors=[sensor, sensor])


def test_a_window_learns_from_the_motions_of_two_frames_and_is_corrected(
    walls: list[Path], tmp_path: Path
) -> None:
    """Those that its own odometry solves from the images of a step: not the steps of its path."""
    sequence = open_sequence(walls[2])
    config = pv.OdometryConfig(estimator="window")
    motions = read_steps(sequence, FRAMES, config=config).motions
    odometry = pv.StereoOdometry(sequence.camera, config=config)
    of_images = []
    of_path = []
    for frame in sequence:
        of_path.append(se3.log(odometry.step(frame).T_curr_prev))
        of_images.append(se3.log(odometry.T_curr_prev_before_window))
    np.testing.assert_array_equal(motions, of_images[1:])
    assert np.abs(motions - of_path[1:]).max() > 1e-5

    out = tmp_path / "window.safetensors"
    train_correction([open_sequence(wall) for wall in walls], SETTINGS, out, odometry=config)
    assert CorrectionNetwork.load(out).facts["odometry"]["estimator"] == "window"
    paths = []
    for sensors in ([], [CorrectionSensor.load(out, sequence.camera)]):
        odometry = pv.StereoOdometry(sequence.camera, config=config, sensors=sensors)
        path = [odometry.step(frame).T_world_cam[:3, 3] for frame in sequence]
        paths.append(np.linalg.norm(path[-1]))
    assert paths[1] / paths[0] == pytest.approx(LONGER, abs=0.01)


@pytest.mark.usefixtures("undrawn")
def test_train_run_inspect_and_compare(
    walls: list[Path], model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The command trains the same bytes; a run uses the correction, and says so."""
    out = tmp_path / "correction.safetensors"
    words = [*map(str, walls), "--kind", "correction", *FLAGS, "--out", str(out)]
    assert main(["train", *words]) == 0
    shown = capsys.readouterr().out
    assert re.search(r"linear regression +\d", shown)
    following = f"next: probevo run SEQUENCE --sensor {out} --estimator two-frame --out DIR"
    assert shown.splitlines()[-1] == following
    assert out.read_bytes() == model.read_bytes()

    run = tmp_path / "run"
    assert main(["run", str(walls[2]), "--sensor", str(out), "--out", str(run)]) == 0
    assert json.loads((run / "metrics.json").read_text())["faults"] == {}
    shown = (run / "report.html").read_text()
    assert re.search(r"Sensor correction.{0,80}12 steps used it", shown, re.DOTALL)
    capsys.readouterr()
    seen = tmp_path / "seen"
    assert main(["inspect", str(walls[2]), "--model", str(out), "--out", str(seen)]) == 0
    assert "RMS error along x, y, z" in capsys.readouterr().out
    words = ["--noise", "student-t", "--sensor", str(out), "--out", str(tmp_path / "compared")]
    assert main(["compare", str(walls[2]), *words]) == 0
    # The one left out has calibrated it, and is recognised under any name. Of images that it has
    # not seen, nothing is marked.
    assert "student-t + correction †" in capsys.readouterr().out
    copied = shutil.copytree(walls[2], tmp_path / "copied")
    assert main(["compare", str(copied), *words]) == 0
    assert "student-t + correction †" in capsys.readouterr().out
    first = min((copied / "left").iterdir())
    image = cv2.imread(str(first), cv2.IMREAD_GRAYSCALE)
    image[0, 0] ^= 1
    cv2.imwrite(str(first), image)
    assert main(["compare", str(copied), *words]) == 0
    shown = capsys.readouterr().out
    assert "student-t + correction" in shown
    assert "†" not in shown


def test_the_ablations_of_the_thesis(
    walls: list[Path], steps: EstimatedSteps, tmp_path: Path
) -> None:
    """Rotation alone, with the covariance of the training data."""
    out = tmp_path / "model.safetensors"
    changes = {"epochs": 1, "rotation_only": True, "constant_covariance": True}
    settings = SETTINGS.model_copy(update=changes)
    train_correction([open_sequence(wall) for wall in walls], settings, out)
    network = CorrectionNetwork.load(out)
    inputs = inputs_of(steps.fields, steps.motions, steps.covariances)
    found = network.estimate(inputs)
    np.linalg.cholesky(found.covariance)
    assert (found.xi[:, :3] == 0.0).all()
    assert (network.linear(inputs)[:, :3] == 0.0).all()
    assert found.covariance.shape[1:] == (3, 3)
    assert network.method.learns_covariance is False
    root = np.asarray(network.space.root)
    spread = found.covariance - network.facts["scale"] * root @ root.T
    assert np.linalg.eigvalsh(spread).min() > -1e-12


def test_settings_of_other_kinds_are_refused(
    walls: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = str(tmp_path / "model.safetensors")
    for kind, flag in (
        ("correction", ["--nets.copies", "2"]),
        ("rotation", ["--nets.rotation-only"]),
        ("rotation", ["--odometry.seed", "3"]),
        ("rotation", ["--nets.method", "dropout"]),
        ("sun", ["--nets.passes", "3"]),
        ("sun", ["--nets.method", "dropout", "--nets.heads", "3"]),
        ("sun", ["--nets.networks", "1", "--nets.method", "ensemble"]),
        ("correction", ["--nets.networks", "2"]),
    ):
        assert main(["train", *map(str, walls), "--kind", kind, *flag, "--out", out]) == 2
        assert flag[0].split(".")[0] in capsys.readouterr().err

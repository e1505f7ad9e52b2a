"""Networks of the sun from recordings: trained, resumed, calibrated, and as sensors."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

jax = pytest.importorskip("jax", reason="jax is missing: pip install 'probevo[nets]'")
pytest.importorskip("equinox")

from cli.rendering import write_wall  # noqa: E402
from probevo.cli.main import main  # noqa: E402
from probevo.config.networks import NetworkSettings  # noqa: E402
from probevo.errors import InputError  # noqa: E402
from probevo.measurements.direction import Direction  # noqa: E402
from probevo.measurements.north import NORTH  # noqa: E402
from probevo.measurements.sensor import NoMeasurement  # noqa: E402
from probevo.nets.recorded_training import _origin  # noqa: E402
from probevo.nets.sun_network import SPACE, SunNetwork  # noqa: E402
from probevo.nets.sun_sensor import SunFromImages  # noqa: E402
from probevo.nets.sun_training import calibrated, errors_of, errors_on, train_sun  # noqa: E402
from probevo.nets.sun_views import (  # noqa: E402
    SunViews,
    check_sun_recording,
    read_sun,
    read_views,
    sun_field,
)
from probevo.sequences import open_sequence  # noqa: E402

FRAMES = 13
SETTINGS = NetworkSettings(epochs=2, batch=8, networks=2, heads=3)
FLAGS = ["--nets.epochs", "2", "--nets.batch", "8", "--nets.networks", "2", "--nets.heads", "3"]
SUN = np.array([0.6, -0.64, 0.48])


@pytest.fixture(scope="module")
def walls(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two recordings of the same wall under the same sun."""
    root = tmp_path_factory.mktemp("walls")
    folders = [write_wall(root / name, frames=FRAMES) for name in ("one", "other")]
    for folder in folders:
        (folder / "sun.txt").write_text("1.2 -1.28 0.96\n")
    return folders


@pytest.fixture(scope="module")
def model(walls: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("model") / "sun.safetensors"
    train_sun([open_sequence(wall) for wall in walls], SETTINGS, out)
    return out


def test_work_of_one_recording_is_not_taken_for_that_of_another(
    walls: list[Path], tmp_path: Path
) -> None:
    """Rendered alike, but for the light: names, stamps, camera and truth are the same."""
    brighter = shutil.copytree(walls[0], tmp_path / walls[0].name)
    (brighter / "sun.txt").write_text("1.2 1.28 0.96\n")
    origins = {_origin(open_sequence(path)) for path in (walls[0], brighter, walls[0])}
    assert len(origins) == 2


def test_the_directions_are_those_of_the_sun_in_each_camera(walls: list[Path]) -> None:
    sequence = open_sequence(walls[0])
    views = read_views(sequence, 5)
    assert sequence.truth is not None
    expected = np.swapaxes(sequence.truth.T_world_cam[:5, :3, :3], 1, 2) @ SUN
    np.testing.assert_allclose(views.directions, expected, atol=1e-12)


def test_the_exposure_does_not_matter(walls: list[Path]) -> None:
    sequence = open_sequence(walls[0])
    image = next(iter(sequence)).left
    assert image is not None
    darker = np.rint(0.5 * image).astype(np.uint8)
    before = sun_field(image, sequence.camera)
    after = sun_field(darker, sequence.camera)
    assert np.abs(after - before).mean() < 0.05 * before.std()


@pytest.mark.parametrize("content", [None, "", "1 2", "0 0 0", "1 2 nan", "east"])
def test_a_recording_without_a_direction_is_refused(
    walls: list[Path], tmp_path: Path, content: str | None
) -> None:
    if content is not None:
        (tmp_path / "sun.txt").write_text(content)
    with pytest.raises(InputError, match=r"sun\.txt"):
        read_sun(tmp_path)


def test_a_training_that_was_stopped_ends_with_the_same_bytes(
    walls: list[Path], model: Path, tmp_path: Path
) -> None:
    def stop(done: int, total: int) -> None:
        if done >= 2 * FRAMES + 1:
            raise KeyboardInterrupt

    recordings = [open_sequence(wall) for wall in walls]
    out = tmp_path / "sun.safetensors"
    with pytest.raises(KeyboardInterrupt):
        train_sun(recordings, SETTINGS, out, on_progress=stop)
    train_sun(recordings, SETTINGS, out)
    assert out.read_bytes() == model.read_bytes()
    network = SunNetwork.load(out)
    network.save(tmp_path / "copy.safetensors")
    assert (tmp_path / "copy.safetensors").read_bytes() == model.read_bytes()


def test_dropout_that_was_stopped_ends_with_the_same_bytes(
    walls: list[Path], tmp_path: Path
) -> None:
    def stop(done: int, total: int) -> None:
        if done >= 2 * FRAMES * 2:
            raise KeyboardInterrupt

    recordings = [open_sequence(wall) for wall in walls]
    settings = NetworkSettings(epochs=2, batch=8, copies=1, method="dropout", passes=4)
    whole = tmp_path / "whole.safetensors"
    parts = tmp_path / "parts.safetensors"
    lines = train_sun(recordings, settings, whole)
    assert lines[0] == "method:       dropout of 50 %, 4 passes"
    with pytest.raises(KeyboardInterrupt):
        train_sun(recordings, settings, parts, on_progress=stop)
    train_sun(recordings, settings, parts)
    assert parts.read_bytes() == whole.read_bytes()
    claimed = errors_of(SunNetwork.load(parts), read_views(recordings[1], FRAMES))
    np.linalg.cholesky(claimed.covariances)
    # The factor on the spread makes the errors of what was left out consistent.
    squared = np.einsum(
        "ni,nij,nj->n", claimed.errors, np.linalg.inv(claimed.covariances), claimed.errors
    )
    assert squared.mean() == pytest.approx(2.0, rel=0.05)


def test_single_errors_and_sums_of_ten_have_factors_of_their_own(
    model: Path, walls: list[Path]
) -> None:
    """Errors that are the same in ten images ask for ten times the variance in their sum."""
    trained = SunNetwork.load(model)
    plain = SunNetwork(trained.networks, trained.domain, {**trained.facts, "scale": 1.0})
    views = read_views(open_sequence(walls[0]), FRAMES)
    found = plain.estimate(views.fields)
    root = np.linalg.cholesky(found.covariance)
    left_out = []
    for errors in np.random.default_rng(0).normal(0.0, 0.1, (40, 2)):
        moved = SPACE.perturb(
            jax.numpy.asarray(found.directions), -jax.numpy.asarray(root @ errors)
        )
        left_out.append(SunViews(views.fields, np.asarray(moved, np.float64)))
    again = calibrated(plain, left_out)
    assert again.facts["scale"] == pytest.approx(0.01, rel=0.3)
    assert again.facts["correlation"] == pytest.approx(10.0, rel=0.2)
    claimed = errors_of(again, left_out[0])
    np.testing.assert_allclose(
        claimed.covariances, again.facts["scale"] * found.covariance, rtol=1e-5
    )


def test_it_measures_twice_a_second_and_not_without_an_image(
    model: Path, walls: list[Path]
) -> None:
    sequence = open_sequence(walls[0])
    sensor = SunFromImages.load(model, sequence)
    frames = list(sequence)
    answers = [sensor(frames[k - 1], frames[k]) for k in range(1, FRAMES)]
    measured = [answer for answer in answers if not isinstance(answer, NoMeasurement)]
    assert len(measured) == 2
    assert isinstance(measured[0][0], Direction)
    np.testing.assert_allclose(measured[0][0].known, SUN, atol=1e-12)
    blind = replace(frames[5], left=None, prepared=None)
    assert sensor(frames[4], blind) == NoMeasurement("no image")
    frozen = replace(frames[5], left=frames[4].left)
    assert sensor(frames[4], frozen) == NoMeasurement("repeated image")
    behind = replace(frames[4], left=None)  # as the odometry hands on what was frozen
    assert sensor(behind, frames[5]) == NoMeasurement("repeated image")
    network = SunNetwork.load(model)
    in_enu = SunFromImages(network, sequence.camera, lambda _: SUN, north=NORTH)
    (direction,) = list(in_enu(frames[4], frames[5]))
    assert NORTH in direction.variables


def test_errors_are_those_of_the_measurements_of_a_run(model: Path, walls: list[Path]) -> None:
    sequence = open_sequence(walls[1])
    network = SunNetwork.load(model)
    network = replace(network, facts={**network.facts, "correlation": 4.0})
    path = walls[1].with_name("correlated.safetensors")
    network.save(path)
    sensor = SunFromImages.load(path, sequence)
    frames = list(sequence)
    answers = [sensor(frames[k - 1], frames[k]) for k in range(1, FRAMES)]
    measured = [answer[0] for answer in answers if not isinstance(answer, NoMeasurement)]
    found = errors_on(path, sequence)
    assert sequence.truth is not None
    expected = [
        each.residual({each.pose: np.linalg.inv(sequence.truth.T_world_cam[each.pose.frame])})
        for each in measured
    ]
    np.testing.assert_allclose(found.errors, expected, atol=1e-5)
    covariances = [each.covariance for each in measured]
    np.testing.assert_allclose(found.covariances, covariances, rtol=1e-5)


@pytest.mark.usefixtures("undrawn")
def test_train_run_and_inspect(
    walls: list[Path], model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "sun.safetensors"
    words = [*map(str, walls), "--kind", "sun", *FLAGS, "--out", str(out)]
    assert main(["train", *words]) == 0
    shown = capsys.readouterr().out
    assert "of the mean direction" in shown
    kept = SunNetwork.load(out).facts["kept_epoch"]
    assert f"kept:         the network after {kept} epoch" in shown
    assert out.read_bytes() == model.read_bytes()
    run = tmp_path / "run"
    assert main(["run", str(walls[0]), "--sensor", str(out), "--out", str(run)]) == 0
    shown = (run / "report.html").read_text()
    assert re.search(r"Sensor sun.{0,80}2 steps used it", shown, re.DOTALL)
    capsys.readouterr()
    seen = tmp_path / "seen"
    assert main(["inspect", str(walls[1]), "--model", str(out), "--out", str(seen)]) == 0
    shown = capsys.readouterr().out
    assert "RMS error of both angles" in shown
    assert f"Kept: the network after {kept} epoch" in shown
    assert "Saliency" in (seen / "inspection.html").read_text()


def test_a_recording_whose_truth_begins_late_is_refused(walls: list[Path], tmp_path: Path) -> None:
    """Its truth is relative to the first known pose, and ``sun.txt`` to the first frame."""
    late = shutil.copytree(walls[0], tmp_path / "late")
    poses = (late / "poses.txt").read_text().splitlines()
    unknown = " ".join(["nan"] * len(poses[0].split()))
    (late / "poses.txt").write_text("\n".join([unknown] * 5 + poses[5:]) + "\n")
    sequence = open_sequence(late)
    for refuses in (check_sun_recording, lambda recording: read_views(recording, FRAMES)):
        with pytest.raises(InputError, match="true pose of its first frame is unknown"):
            refuses(sequence)


def test_repeated_images_are_left_out(walls: list[Path], tmp_path: Path) -> None:
    """They are of an earlier pose than the one that the truth has for them."""
    frozen = shutil.copytree(walls[0], tmp_path / "frozen")
    images = sorted((frozen / "left").iterdir())
    shutil.copy(images[3], images[4])
    assert len(read_views(open_sequence(frozen), FRAMES)) == FRAMES - 1


@pytest.mark.parametrize("value", [None, -1.0, "nan", "many"])
def test_a_file_without_its_factor_is_refused(value: object, model: Path, tmp_path: Path) -> None:
    network = SunNetwork.load(model)
    facts = {**network.facts, "correlation": value}
    replace(network, facts=facts).save(tmp_path / "other.safetensors")
    with pytest.raises(InputError, match=r"other\.safetensors: it is not a complete network"):
        SunNetwork.load(tmp_path / "other.safetensors")

"""``probevo paper hydranet``: its data, its tables, and that the same settings give the same."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from probevo.cli.main import main

jax = pytest.importorskip("jax", reason="jax is missing: pip install 'probevo[nets]'")
pytest.importorskip("equinox")

from probevo_paper import hydranet_numbers, hydranet_orbit  # noqa: E402
from probevo_paper.hydranet_config import HydranetConfig  # noqa: E402

SMALL = ["--repetitions", "2", "--epochs", "3", "--poses", "100", "--orbit-epochs", "2"]
SMALLER_NETWORKS = ["--heads", "3", "--networks", "2"]


@pytest.fixture
def compiled_quickly() -> Iterator[None]:
    """Compile without optimisations: in a fifth of the time."""
    jax.config.update("jax_disable_most_optimizations", True)
    yield
    jax.config.update("jax_disable_most_optimizations", False)


@pytest.mark.slow
@pytest.mark.usefixtures("compiled_quickly")
def test_it_writes_both_tables_and_resumes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of one method for each experiment, since each is compiled for seconds."""
    of_numbers = "dropout"
    of_orbit = "hydra-sigma"
    numbers = tuple(each for each in hydranet_numbers.METHODS if each.name == of_numbers)
    all_in_orbit = hydranet_orbit.orbit_methods
    monkeypatch.setattr(hydranet_numbers, "METHODS", numbers)
    monkeypatch.setattr(
        hydranet_orbit,
        "orbit_methods",
        lambda settings: tuple(each for each in all_in_orbit(settings) if each.name == of_orbit),
    )
    out = tmp_path / "out"
    words = ["paper", "hydranet", "--out", str(out), *SMALL, *SMALLER_NETWORKS]
    assert main(words) == 0
    text = capsys.readouterr().out
    files = {path.name for path in out.iterdir()}
    assert files == {"hydranet.txt", "hydranet.csv", "hydranet.json", "models"}
    rows = [line.split()[0] for line in text.splitlines() if line.split()[:1]]
    assert [row for row in rows if row in (of_numbers, of_orbit)] == [of_numbers, of_orbit]
    models = sorted(path.name.rsplit("-", 1)[0] for path in (out / "models").iterdir())
    assert models == [f"numbers-{of_numbers}", f"orbit-{of_orbit}"]
    with (out / "hydranet.csv").open(encoding="utf-8") as file:
        records = list(csv.DictReader(file))
    assert len(records) == 2 + 1  # in domain; in and out of it
    document = json.loads((out / "hydranet.json").read_text("utf-8"))
    assert document["results"][-1]["method"] == of_orbit

    # A second call trains nothing, and an own run gives the same bytes.
    before = {path.name: path.stat().st_mtime_ns for path in (out / "models").iterdir()}
    results = (out / "hydranet.json").read_bytes()
    assert main(words) == 0
    assert {path.name: path.stat().st_mtime_ns for path in (out / "models").iterdir()} == before
    assert (out / "hydranet.json").read_bytes() == results
    only = tmp_path / "only"
    words[3] = str(only)
    assert main([*words, "--experiments", "orbit"]) == 0
    for path in sorted((only / "models").iterdir(), reverse=True):
        assert path.read_bytes() == (out / "models" / path.name).read_bytes()

    # A damaged file is refused by its name.
    capsys.readouterr()
    path.write_bytes(path.read_bytes()[:-8])
    assert main([*words, "--experiments", "orbit"]) == 2
    assert path.name in capsys.readouterr().err


def test_a_wrong_setting_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["paper", "hydranet", "--out", str(tmp_path / "out"), "--heads", "1"]) == 2
    assert "--heads" in capsys.readouterr().err


def test_the_published_figures_are_those_of_the_thesis() -> None:
    assert sum(hydranet_numbers.PUBLISHED_NLL.values()) == pytest.approx(25.53)
    assert list(hydranet_numbers.PUBLISHED_NLL) == [
        method.name for method in hydranet_numbers.METHODS
    ]


def test_the_data_of_the_regression_have_the_published_domain_and_noise() -> None:
    method = hydranet_numbers.METHODS[2]
    data = hydranet_numbers.training_data(method, HydranetConfig(repetitions=3))
    x = np.asarray(data.inputs, np.float64)
    assert x.shape == (3, 1000, 1)
    assert (((x >= 0.0) & (x <= 0.6)) | ((x >= 0.8) & (x <= 1.0))).all()
    assert not np.array_equal(x[0], x[1])
    # To first order the noise of y is y'(x) w, with y' = 1 + 4 cos 4x + 13 cos 13x.
    slope = 1.0 + 4.0 * np.cos(4.0 * x) + 13.0 * np.cos(13.0 * x)
    noise = np.asarray(data.targets)[:, 0, :, 0] - hydranet_numbers.curve(x, np.zeros_like(x))
    steep = np.abs(slope) > 8.0
    assert np.std(noise[steep] / slope[steep]) == pytest.approx(0.03, rel=0.1)


def test_a_frontal_view_shows_the_grid() -> None:
    """At angles of zero, points 3 m apart at 25 m are 60 px apart around the principal point."""
    rng = np.random.default_rng(0)
    views = hydranet_orbit.views_at(np.zeros((400, 3)), rng)
    pixels_px = 250.0 * views.inputs.mean(axis=0).reshape(6, 6, 2)
    line_px = 250.0 + 60.0 * (np.arange(6) - 2.5)
    assert pixels_px[..., 0] == pytest.approx(np.tile(line_px, (6, 1)), abs=0.3)
    # The camera looks down on the plane: y of the world is −y of the image.
    assert pixels_px[..., 1] == pytest.approx(np.tile(line_px[::-1, None], (1, 6)), abs=0.3)
    assert 250.0 * views.inputs.std(axis=0) == pytest.approx(np.full(72, 1.0), rel=0.2)


def test_the_pixels_are_those_of_the_rotation() -> None:
    """The points, turned by the quaternion and 25 m away, project to the inputs."""
    angles_rad = np.radians([[50.0, 20.0, -30.0], [-75.0, 10.0, 15.0]])
    views = hydranet_orbit.views_at(angles_rad, np.random.default_rng(1))
    line_m = np.linspace(-7.5, 7.5, 6)
    for k in range(2):
        C = Rotation.from_quat(views.quaternions[k], scalar_first=True)
        for index in (0, 8, 35):
            row, column = divmod(index, 6)
            turned = C.apply([line_m[column], line_m[row], 0.0])
            in_camera = turned + np.array([0.0, 0.0, 25.0])
            expected_px = 500.0 * in_camera[:2] / in_camera[2] + 250.0
            found_px = 250.0 * views.inputs[k, 2 * index : 2 * index + 2]
            assert found_px == pytest.approx(expected_px, abs=5.0)


def test_the_sweep_leaves_the_domain_at_both_ends() -> None:
    polar_rad, views = hydranet_orbit.sweep(np.random.default_rng(0))
    assert len(views.inputs) == len(polar_rad) == 500
    assert np.degrees(polar_rad[[0, -1]]) == pytest.approx([-81.0, 81.0])
    share = np.mean(np.abs(np.degrees(polar_rad)) > 60.0)
    assert share == pytest.approx(21.0 / 81.0, abs=0.01)


def test_domain_results_are_of_the_chosen_rows() -> None:
    errors = np.array([[0.1, 0.0, 0.0], [0.0, 2.0, 0.0]])
    covariances = np.tile(0.01 * np.eye(3), (2, 1, 1))
    rows = np.array([True, False])
    near = hydranet_orbit.domain_result(errors, covariances, rows, scale=4.0)
    far = hydranet_orbit.domain_result(errors, covariances, ~rows, scale=1e4)
    assert near.error_deg == pytest.approx(np.degrees(0.1))
    assert near.nll == pytest.approx(0.5 + 1.5 * np.log(0.01))
    assert near.calibrated_nll == pytest.approx(0.125 + 1.5 * np.log(0.04))
    assert (near.coverage, far.coverage, far.calibrated_coverage) == (1.0, 0.0, 1.0)

"""Errors on spoiled versions of a recording: their comparison, their figures, and the command."""

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from cli.rendering import write_wall
from probevo.arrays import FloatArray
from probevo.cli.main import main
from probevo.estimation.motion_estimate import Status
from probevo.geometry import se3
from probevo.output.run_result import RunResult
from probevo_sim.spoiling.config import StressConfig
from probevo_sim.spoiling.stress import Figures, StepErrors, Stress, figures_of, step_errors
from probevo_sim.spoiling.stress_page import TRANSLATION, errors_figure

SMALL = ("--presets", "blur", "frames", "--severities", "0.5", "1")


def run_of(T_curr_prev: FloatArray, cov: FloatArray) -> RunResult:
    """A run whose steps are all OK."""
    count = len(T_curr_prev)
    return RunResult(
        stamps_ns=np.arange(count + 1),
        T_world_cam=se3.chain_motions(T_curr_prev),
        T_curr_prev=T_curr_prev,
        cov=cov,
        common_mode=np.zeros((count, 6, 3)),
        path_cross_cov=np.zeros((count, 6, 6)),
        status=np.full(count, Status.OK),
        num_tracks=np.full(count, 50),
        num_inliers=np.full(count, 50),
        stage_ms={},
        total_ms=np.zeros(count),
    )


def noisy(motions: FloatArray, sigma: float, rng: np.random.Generator) -> RunResult:
    """A run with white errors of one standard deviation in all six components."""
    errors = sigma * rng.normal(size=(len(motions), 6))
    cov = np.tile(sigma**2 * np.eye(6), (len(motions), 1, 1))
    return run_of(se3.exp(errors) @ motions, cov)


def motions_of(count: int, rng: np.random.Generator) -> FloatArray:
    return se3.exp(np.array([0.0, 0.0, -1.0, 0.0, 0.02, 0.0]) + 0.02 * rng.normal(size=(count, 6)))


def test_errors_of_two_runs_agree_with_the_sum_of_their_covariances() -> None:
    """NEES has the mean of χ²(6), and 0.27 % of the steps lie outside of the region."""
    rng = np.random.default_rng(0)
    motions = motions_of(4000, rng)
    found = step_errors(noisy(motions, 2e-3, rng), noisy(motions, 4e-3, rng), np.arange(4001))
    assert np.mean(found.nees) == pytest.approx(6.0, abs=4.0 * np.sqrt(12.0 / 4000))
    figures = figures_of("blur", 1.0, [found])
    assert figures.translation_sigma_m == pytest.approx(np.sqrt(3 * 20e-6), rel=1e-9)
    assert figures.translation_m == pytest.approx(figures.translation_sigma_m, rel=0.03)
    assert figures.rotation_rad == pytest.approx(figures.rotation_sigma_rad, rel=0.03)
    assert figures.outside == pytest.approx(0.0027, abs=4.0 * np.sqrt(0.0027 / 4000))


def test_a_step_over_dropped_frames_is_that_of_all_clean_steps_below_it() -> None:
    rng = np.random.default_rng(1)
    motions = motions_of(5, rng)
    clean = noisy(motions, 0.0, rng)
    clean = replace(clean, cov=np.tile(1e-6 * np.eye(6), (5, 1, 1)))
    kept = np.array([0, 1, 4, 5])
    across = np.array([motions[0], motions[3] @ motions[2] @ motions[1], motions[4]])
    found = step_errors(clean, run_of(across, np.tile(1e-6 * np.eye(6), (3, 1, 1))), kept)
    np.testing.assert_allclose(found.translation_m, 0.0, atol=1e-12)
    np.testing.assert_allclose(found.rotation_rad, 0.0, atol=1e-12)
    # Three independent steps and that of the other run; the lever of a step of 1 m adds to them.
    assert found.rotation_sigma_rad[1] == pytest.approx(np.sqrt(3 * 4e-6), rel=1e-6)
    assert found.translation_sigma_m[1] > np.sqrt(3 * 4e-6)


def test_steps_that_the_clean_run_has_not_solved_are_left_out() -> None:
    rng = np.random.default_rng(2)
    motions = motions_of(5, rng)
    clean = noisy(motions, 1e-3, rng)
    clean.status[2] = Status.TOO_FEW_TRACKS
    spoiled = noisy(motions, 1e-3, rng)
    spoiled.status[4] = Status.NOT_CONVERGED
    found = step_errors(clean, spoiled, np.arange(6))
    assert found.is_ok == (True, True, True, False)


def test_steps_that_are_not_ok_count_by_themselves() -> None:
    steps = StepErrors(
        is_ok=(True, False),
        translation_m=(0.3, 4.0),
        rotation_rad=(0.01, 0.1),
        translation_sigma_m=(0.1, 8.0),
        rotation_sigma_rad=(0.02, 0.2),
        nees=(30.0, 3.0),
    )
    figures = figures_of("mixed", 0.5, [steps])
    assert (figures.steps, figures.ok, figures.num_ok) == (2, 0.5, 1)
    assert figures.translation_m == pytest.approx(0.3)
    assert figures.outside == 1.0
    assert figures.not_ok_m == pytest.approx(4.0)
    assert figures.not_ok_sigma_m == pytest.approx(8.0)
    lost = figures_of("mixed", 0.5, [replace(steps, is_ok=(False, False))])
    assert lost.translation_m is None
    assert lost.outside is None


def test_more_severe_is_more_of_it() -> None:
    settings = StressConfig(clean=0.2)
    assert settings.spoiling("blur", 0.5, 3).severity == 0.5
    assert settings.spoiling("frames", 0.25, 3).severity == 0.25
    assert settings.spoiling("frames", 0.25, 3).clean == 0.2
    assert settings.spoiling("frames", 0.25, 3).seed == 3


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_wall(tmp_path_factory.mktemp("wall"), 9)


@pytest.mark.slow
def test_the_command_writes_figures_page_and_picture_and_goes_on(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The same seed gives the same bytes, whether all is run at once or half of it before."""
    for name in ("whole", "halved"):
        out = tmp_path / name
        if name == "halved":
            first = ("stress", str(recording), "--out", str(out), "--presets", "blur")
            assert main([*first, "--severities", "0.5", "1"]) == 0
            (out / "runs" / "blur-1-0.json").write_text("{")  # as of another version
            assert "already" not in capsys.readouterr().out
        assert main(["stress", str(recording), "--out", str(out), *SMALL]) == 0
    text = capsys.readouterr().out
    assert "1 of 4 runs were there already" in text
    files = sorted(path.relative_to(out) for path in out.rglob("*.*"))
    assert {"metrics.json", "stress.html", "stress.png"} <= {str(file) for file in files}
    for file in files:
        assert (out / file).read_bytes() == (tmp_path / "whole" / file).read_bytes(), file
    metrics = json.loads((out / "metrics.json").read_text())
    places = [(each["preset"], each["severity"]) for each in metrics["spoiled"]]
    assert places == [("blur", 0.5), ("blur", 1.0), ("frames", 0.5), ("frames", 1.0)]
    assert metrics["clean"]["ok"] == 1.0
    assert metrics["spoiled"][0]["steps"] == 8
    assert metrics["spoiled"][0]["translation_m"] > 0.0
    page = (out / "stress.html").read_text()
    assert page.count("<svg") == 4  # two panels, each of two figures
    assert page.count("data:image/jpeg") == 1  # dropped and frozen frames look like any


@pytest.mark.parametrize("largest_m", [3e-3, 10.0])
def test_values_of_the_logarithmic_axis_do_not_overlap(largest_m: float) -> None:
    """Errors from 1 mm to a few mm, or over four decades: no two labels of an axis touch."""
    figures = tuple(
        Figures(
            preset="blur",
            severity=severity,
            steps=10,
            ok=1.0,
            translation_m=error_m,
            translation_sigma_m=error_m,
            rotation_rad=1e-3,
            rotation_sigma_rad=1e-3,
            outside=0.0,
            not_ok_m=None,
            not_ok_sigma_m=None,
        )
        for severity, error_m in ((0.5, 1e-3), (1.0, largest_m))
    )
    stress = Stress(
        figures=figures,
        clean_ok=1.0,
        clean_sigma_m=1e-3,
        clean_sigma_rad=1e-3,
        num_runs=2,
        num_resumed=0,
        pictures=(),
    )
    figure = errors_figure(stress, [TRANSLATION])
    figure.canvas.draw()
    (axes,) = figure.axes
    shown = axes.get_window_extent()
    boxes = [label.get_window_extent() for label in axes.get_yticklabels()]
    visible = [box for box in boxes if shown.y0 <= (box.y0 + box.y1) / 2 <= shown.y1]
    assert len(visible) >= 2
    for lower, upper in pairwise(sorted(visible, key=lambda box: float(box.y0))):
        assert lower.y1 < upper.y0


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (("--severities", "1.5"), ("--severities", "1")),
        (("--severities", "0.5", "0.5"), ("--severities", "once")),
        (("--repeats", "0"), ("--repeats", "1")),
        (("--clean", "1"), ("--clean", "1")),
        (("--noise", "nothing"), ("nothing",)),
    ],
)
def test_wrong_settings_are_refused(
    flags: tuple[str, ...],
    words: tuple[str, ...],
    recording: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["stress", str(recording), "--out", str(tmp_path / "out"), *flags]) == 2
    text = capsys.readouterr().err
    assert all(word in text for word in words)
    assert "at least 1 item" not in text  # an empty list, where an item is wrong
    assert not (tmp_path / "out").exists()


def test_recordings_that_say_nothing_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from sequences.recordings import write_tracks

    tracks = write_tracks(tmp_path)
    for path in (tracks, write_wall(tmp_path / "two", 2)):
        assert main(["stress", str(path), "--out", str(tmp_path / "out")]) == 2
        text = capsys.readouterr().err
        assert path.name in text or str(path) in text

import re
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from matplotlib.patches import StepPatch

from output.pages import Balance
from probevo.estimation.motion_estimate import Status
from probevo.evaluation.consistency import Consistency
from probevo.evaluation.metrics import evaluate
from probevo.output.drawing import draw_tracks
from probevo.output.report import report
from probevo.output.report.report import RunDescription, write_report
from probevo.output.report.report_calibration import calibration_figure
from probevo.output.report.report_data import Drift, drift_of
from probevo.output.report.report_plots import trajectory_figure
from probevo.output.report.report_timelines import domain_figure, stages_figure
from probevo.output.run_result import RunResult
from probevo.output.table import readable


def page_of(
    run: RunResult,
    folder: Path,
    truth: np.ndarray | None = None,
    thumbnails: Sequence[tuple[str, bytes]] = (),
    config: str = "",
) -> str:
    metrics = (
        None if truth is None else evaluate(run.T_world_cam, truth, run.T_curr_prev, cov=run.cov)
    )
    write_report(
        folder / "report.html",
        run,
        RunDescription("A <run>", {"noise": "student-t & co"}, config),
        truth=truth,
        metrics=metrics,
        thumbnails=thumbnails,
    )
    assert [path.name for path in folder.iterdir()] == ["report.html"]
    return (folder / "report.html").read_text()


@pytest.mark.parametrize(
    ("count", "known"),
    [
        *((2, "all"), (2, "none"), (2, "some")),
        *((3, "all"), (3, "some"), (3, "one")),
        *((60, "all"), (60, "none"), (60, "some"), (60, "one")),
    ],
)
def test_page_is_whole_and_self_contained(
    make_run: Callable[..., RunResult], tmp_path: Path, count: int, known: str
) -> None:
    run = make_run(count)
    truth = run.T_world_cam.copy()
    truth[
        {"all": 0, "none": count, "some": count // 3, "one": 1}[known] :: 2
        if known == "some"
        else 1
    ] = np.nan
    if known == "all":
        truth = run.T_world_cam
    jpeg = draw_tracks(
        np.zeros((60, 200), dtype=np.uint8), np.empty((0, 4)), np.empty((0, 4)), weights=np.empty(0)
    )
    page = page_of(
        run,
        tmp_path,
        None if known == "none" else truth,
        thumbnails=[("Frame 1", jpeg)],
        config="a: <1>",
    )

    parsed = Balance()
    parsed.feed(page)
    assert not parsed.open
    assert len(parsed.ids) == len(set(parsed.ids))
    assert all(link.startswith(("data:", "#")) for link in parsed.links)
    assert {link[1:] for link in parsed.links if link.startswith("#")} <= set(parsed.ids)
    assert {*re.findall(r"url\(#(.*?)\)", page)} <= set(parsed.ids)
    assert "http" not in page
    assert "<script" not in page
    assert "@import" not in page
    assert "A &lt;run&gt;" in page
    assert "student-t &amp; co" in page
    assert "a: &lt;1&gt;" in page
    assert not re.search(r"\bnan\b", page)


def test_at_rest_lengths_are_in_mm(make_run: Callable[..., RunResult], tmp_path: Path) -> None:
    run = make_run(30, speed=0.0)
    page = page_of(run, tmp_path, np.tile(np.eye(4), (30, 1, 1)))
    assert "forward z, mm" in page
    assert "time, s" in page
    assert "distance travelled" not in page


@pytest.mark.layout
def test_long_run_stays_small(make_run: Callable[..., RunResult], tmp_path: Path) -> None:
    run = make_run(5000)
    assert len(page_of(run, tmp_path, run.T_world_cam)) < 3_000_000


@pytest.mark.layout
def test_same_run_gives_the_same_bytes(make_run: Callable[..., RunResult], tmp_path: Path) -> None:
    pages = []
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        pages.append(page_of(make_run(20), tmp_path / name))
    assert pages[0] == pages[1]


def test_matplotlib_is_left_as_it_was(make_run: Callable[..., RunResult], tmp_path: Path) -> None:
    # Merely reading "backend" resolves it.
    before = {key: matplotlib.rcParams[key] for key in matplotlib.rcParams if key != "backend"}
    page_of(make_run(5), tmp_path)
    assert {key: matplotlib.rcParams[key] for key in before} == before


@pytest.mark.parametrize("has_truth", [True, False])
def test_the_legend_has_the_colour_of_the_end(
    make_run: Callable[..., RunResult], has_truth: bool
) -> None:
    """With truth, both paths have an end; without, the one end is that of the estimate."""
    run = make_run(10)
    drift = drift_of(run, run.T_world_cam if has_truth else None)
    lines = trajectory_figure(drift).axes[0].lines
    shown = {
        line.get_color() for line in lines if line.get_marker() == "s" and len(line.get_xdata())
    }
    (legend,) = [line for line in lines if line.get_label() == "end"]
    assert legend.get_color() in shown


def test_decoding_is_no_part_of_the_stack(make_run: Callable[..., RunResult]) -> None:
    run = make_run(20)
    slow = replace(run, stage_ms={"decode": np.full(19, 50.0)} | run.stage_ms)
    axes = stages_figure(slow).axes[0]
    stack = [patch for patch in axes.patches if patch.get_fill()]
    assert len(stack) == len(run.stage_ms)
    top = stack[-1]
    assert isinstance(top, StepPatch)
    np.testing.assert_allclose(top.get_data()[0], run.total_ms)
    assert "decode 50, beside the total" in [
        text.get_text() for text in axes.get_legend().get_texts()
    ]


def test_a_stage_has_the_same_colour_whatever_came_first(
    make_run: Callable[..., RunResult],
) -> None:
    """In a run whose first step was not solved, the solve is timed later than what is learned."""
    run = make_run(5)
    one = {}
    ms = np.ones(4)
    for names in (
        ("track", "consensus", "solve", "learn"),
        ("track", "consensus", "learn", "solve", "own"),
    ):
        stages = stages_figure(replace(run, stage_ms=dict.fromkeys(names, ms))).axes[0].patches
        colors = {str(patch.get_label()).split()[0]: patch.get_facecolor() for patch in stages}
        assert all(colors[name] == color for name, color in one.items())
        one = {name: color for name, color in colors.items() if name in names}
    assert set(one) == {"track", "consensus", "learn", "solve", "own"}


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize(
    ("outside", "timeline", "warned"),
    [(None, False, False), (0, False, False), (10, True, False), (11, True, True)],
)
def test_the_page_warns_of_more_than_a_tenth_out_of_domain(
    make_run: Callable[..., RunResult],
    tmp_path: Path,
    outside: int | None,
    timeline: bool,
    warned: bool,
) -> None:
    page = page_of(make_run(30, outside=outside), tmp_path)
    assert ('aria-label="Out of domain"' in page) is timeline
    assert ("11.0 % of the features solved with lie outside" in page) is warned
    assert ("Train it on recordings like this one" in page) is warned
    parsed = Balance()
    parsed.feed(page)
    assert not parsed.open


def test_the_share_out_of_domain_over_time(make_run: Callable[..., RunResult]) -> None:
    """1200 steps in 400 groups of three; the share is that of all features of a group, 0 where none
    was used."""
    used = np.tile([100, 300, 0], 400)
    outside = np.tile([10, 70, 0], 400)
    used[:3] = outside[:3] = 0
    patch = domain_figure(used, outside, make_run(1201)).axes[0].patches[0]
    assert isinstance(patch, StepPatch)
    np.testing.assert_allclose(patch.get_data()[0], [0.0, *[20.0] * 399])


def test_the_calibration_of_an_honest_run_lies_on_the_diagonal_and_that_of_a_bold_one_below() -> (
    None
):
    nees = np.random.default_rng(0).chisquare(6, 4000)
    for factor, low, high in ((1.0, -3.0, 3.0), (2.0, -60.0, -1.0)):
        claimed, inside = (
            calibration_figure(Consistency(factor * nees)).axes[0].lines[-1].get_data()
        )
        off = (np.asarray(inside) - np.asarray(claimed))[9:90]
        assert ((low < off) & (off < high)).all()


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("known", ["all", "none", "one"])
def test_calibration_is_shown_where_a_step_has_truth(
    make_run: Callable[..., RunResult], tmp_path: Path, known: str
) -> None:
    run = make_run(30)
    truth = np.where(
        (known == "all") | (np.arange(30) == 5)[:, None, None], run.T_world_cam, np.nan
    )
    page = page_of(run, tmp_path, None if known == "none" else truth)
    assert ("Claim and truth, step by step" in page) is (known == "all")


def test_recovered_steps_are_told_from_dead_reckoned_ones(
    make_run: Callable[..., RunResult],
) -> None:
    run = replace(make_run(10), num_tracks=np.full(9, 250), num_inliers=np.full(9, 240))
    status = np.zeros_like(run.status) + Status.OK
    counts = "250 tracks in the median, 240 of them inliers."
    note = report._status_note(replace(run, status=status))
    assert note == f"Every step is OK; {counts}"
    status[1] = Status.RECOVERED
    recovered = report._status_note(replace(run, status=status))
    assert recovered.startswith("Recovered ones")
    assert recovered.endswith(counts)
    assert "dead-reckoned" not in recovered
    status[0] = Status.GAP
    both = report._status_note(replace(run, status=status))
    assert "(gap) are dead-reckoned" in both
    assert "Recovered ones" in both


def test_pyplot_is_never_imported() -> None:
    code = "import sys, probevo.output.report.report; sys.exit('matplotlib.pyplot' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_one_frame_is_no_run(make_run: Callable[..., RunResult], tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="two frames"):
        page_of(make_run(1), tmp_path)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"),
        (51, "51"),
        (4999.0, "4,999"),
        (9.756, "9.76"),
        (0.00586, "0.00586"),
        (-123.4, "-123"),
        (99.96, "100"),
        (np.inf, "inf"),
    ],
)
def test_readable_numbers(value: float, text: str) -> None:
    assert readable(value) == text


@pytest.mark.parametrize(
    ("anees", "truth_noise", "text"),
    [
        (7.0, 0.3, "6 is consistent"),
        (7.0, None, "6 is consistent"),
        (1885.0, 0.4, "truth or calibration may be coarser"),
        (8200.0, 5.8, "the truth’s noise is at least 5.80 times the claimed σ"),
    ],
)
def test_an_anees_that_is_no_test_says_so(
    anees: float, truth_noise: float | None, text: str
) -> None:
    figure = report._consistency_figure(anees, truth_noise)
    assert text in str(figure.aside)
    assert (figure.value == "no test") == (truth_noise is not None and truth_noise > 1.0)


@pytest.mark.parametrize(
    ("error_m", "known", "text"),
    [
        (0.05, 3, ""),
        (0.65, 3, "; the end error is 6.50 times this"),
        (0.65, 2, "; at frame 1, the last with truth, the error is 6.50 times its claim"),
        (None, 3, ""),
    ],
)
def test_an_end_beyond_the_claim_says_so(error_m: float | None, known: int, text: str) -> None:
    """The claim at the last frame is ten times that at the one before: it says nothing of that."""
    error = None
    if error_m is not None:
        error = np.zeros((3, 6))
        error[1:, 0] = error_m
        error[known:] = np.nan
    claimed_m = np.array([0.0, 0.1, 1.0 if known == 2 else 0.1])
    cov = np.zeros((3, 6, 6))
    cov[:, 0, 0] = (claimed_m / 3.0) ** 2
    at_rest = np.tile(np.eye(4), (3, 1, 1))
    drift = Drift(np.arange(3.0), np.zeros(3), at_rest, None, error, cov)
    assert report._claim_aside(drift) == f"end position, worst axis{text}"

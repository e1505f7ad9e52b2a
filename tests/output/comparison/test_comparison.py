import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from output.pages import Balance
from probevo.arrays import FloatArray
from probevo.estimation.motion_estimate import Status
from probevo.evaluation.metrics import Metrics, evaluate
from probevo.evaluation.trajectory_errors import position_errors
from probevo.geometry import se3
from probevo.output.comparison.comparison import (
    FIGURES,
    Comparison,
    Entry,
    column_notes,
    comparison_table,
    distinct_labels,
    numbered,
    truth_note,
    verdicts,
)
from probevo.output.comparison.comparison_page import write_comparison
from probevo.output.comparison.comparison_plots import (
    axes_errors_figures,
    errors_figure,
    paths_figure,
)
from probevo.output.report.report_data import drift_of
from probevo.output.run_result import RunResult
from probevo.output.table import reads_least
from probevo.output.trial_table import trial_table

HEADS = tuple(column.head for column in FIGURES)
COLORS = {"fixed": "#111111", "student-t": "#222222"}
JPEGS = {name: [f"{name}{k}".encode() for k in range(4)] for name in COLORS}


@pytest.fixture
def entries(make_run: Callable[..., RunResult]) -> tuple[Entry, Entry]:
    """Two estimators on one sequence; the first is right, the second turns 1 mrad too far at each
    step."""
    right = make_run(30)
    wrong_motions = se3.exp(np.array([0, 0, 0, 0, 0.001, 0])) @ right.T_curr_prev
    wrong = replace(right, T_curr_prev=wrong_motions, T_world_cam=se3.chain_motions(wrong_motions))
    truth = se3.exp(np.array([5.0, -3.0, 2.0, 0.4, 1.0, -0.2])) @ right.T_world_cam
    return entry("fixed", right, truth), entry("student-t", wrong, truth)


def entry(name: str, run: RunResult, truth: FloatArray | None) -> Entry:
    metrics = None if truth is None else evaluate(run.T_world_cam, truth)
    pictures = tuple((f"Frame {k}", jpeg) for k, jpeg in enumerate(JPEGS[name]))
    return Entry(
        "hill",
        name,
        run,
        truth=truth,
        metrics=metrics,
        pictures=pictures,
        report=Path("runs") / name / "report.html",
    )


def page_of(comparison: Comparison, folder: Path) -> str:
    entries = tuple(replace(e, report=e.report and folder / e.report) for e in comparison.entries)
    write_comparison(
        folder / "report.html", Comparison(entries), "A <title>", facts={"place & time": "<here>"}
    )
    assert [path.name for path in folder.iterdir()] == ["report.html"]
    return (folder / "report.html").read_text()


def cells_of(page: str) -> list[list[tuple[str, bool]]]:
    """Text of each figure of each estimator, and whether it is marked as the best."""
    rows = re.findall(r"<tr><th><i.*?</tr>", page)
    return [
        [(text, bool(best)) for best, text in re.findall(r"<td( class=\"best\")?>([^<]+)</td>", r)]
        for r in rows
    ]


def test_estimators_are_grouped_by_sequence_in_one_order(entries: tuple[Entry, Entry]) -> None:
    first, second = entries
    comparison = Comparison(
        (first, second, replace(second, sequence="dale"), replace(first, sequence="dale"))
    )
    names = [row[0] for row in comparison_table(comparison).text_rows()]
    assert names == [
        "estimator",
        "hill",
        "  fixed",
        "  student-t",
        "dale",
        "  fixed",
        "  student-t",
    ]


def test_rows_hold_the_metrics_and_the_median_time(make_run: Callable[..., RunResult]) -> None:
    metrics = Metrics(
        30, armse_m=0.12345, final_error_m=2.0, short_t_percent=1.5, short_r_deg_per_m=0.01
    )
    run = replace(make_run(4), total_ms=np.array([7.0, 8.0, 100.0]))
    rows = comparison_table(Comparison((Entry("hill", "fixed", run, metrics=metrics),))).text_rows()
    assert rows[0] == ("estimator", *HEADS, "solved %")
    assert rows[2] == ("  fixed", "0.123", "2.00", "1.50", "0.0100", "8.00", "100")


def test_what_is_not_known_is_a_dash(make_run: Callable[..., RunResult]) -> None:
    rows = comparison_table(Comparison((Entry("hill", "fixed", make_run(1)),))).text_rows()
    assert rows[2] == ("  fixed", "–", "–", "–", "–", "–")


@pytest.mark.usefixtures("undrawn")
def test_out_of_domain_features_have_a_column_where_a_model_has_a_domain(
    entries: tuple[Entry, Entry], make_run: Callable[..., RunResult], tmp_path: Path
) -> None:
    home = entries[0]
    abroad = replace(entries[1], result=make_run(30, outside=25))
    head, _, first, second = comparison_table(Comparison((home, abroad))).text_rows()
    assert head == ("estimator", *HEADS, "solved %", "out of domain %")
    assert (first[-1], second[-1]) == ("–", "25.0")
    assert "Out of domain" in column_notes(Comparison((home, abroad)))[-1]
    assert "Out of domain" not in " ".join(column_notes(Comparison(entries)))
    page = page_of(Comparison((home, abroad)), tmp_path)
    assert "<th>out of domain %</th>" in page
    assert [row[-1] for row in cells_of(page)] == [("–", False), ("25.0", False)]


@pytest.mark.parametrize(
    ("count", "known"),
    [(2, "all"), (2, "none"), (2, "late"), (30, "all"), (30, "some"), (30, "late")],
)
def test_page_is_whole_and_self_contained(
    make_run: Callable[..., RunResult], tmp_path: Path, count: int, known: str
) -> None:
    run = make_run(count)
    truth = run.T_world_cam.copy()
    truth[{"all": count, "none": 0, "some": 1, "late": 0}[known] :: 2 if known == "some" else 1][
        : count - 1
    ] = np.nan
    compared = [entry(name, run, None if known == "none" else truth) for name in COLORS]
    page = page_of(Comparison((*compared, replace(compared[0], sequence="<dale>"))), tmp_path)

    parsed = Balance()
    parsed.feed(page)
    assert not parsed.open
    assert len(parsed.ids) == len(set(parsed.ids))
    assert {*re.findall(r"url\(#(.*?)\)", page)} <= set(parsed.ids)
    reports = [link for link in parsed.links if not link.startswith(("data:", "#"))]
    assert reports == [
        "runs/fixed/report.html",
        "runs/student-t/report.html",
        "runs/fixed/report.html",
    ]
    assert "http" not in page
    assert "<script" not in page
    assert "A &lt;title&gt;" in page
    assert "place &amp; time" in page
    assert "&lt;here&gt;" in page
    assert "&lt;dale&gt;" in page
    assert not re.search(r"\bnan\b", page)


def test_the_same_runs_give_the_same_bytes(entries: tuple[Entry, Entry], tmp_path: Path) -> None:
    pages = []
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        pages.append(page_of(Comparison(entries), tmp_path / name))
    assert pages[0] == pages[1]


@pytest.mark.usefixtures("undrawn")
def test_the_least_error_of_a_sequence_is_marked(
    entries: tuple[Entry, Entry], tmp_path: Path
) -> None:
    """Each of the four errors, and the time of none."""
    fixed, student_t = cells_of(page_of(Comparison(entries), tmp_path))
    assert [best for _, best in fixed] == [True, True, True, True, False, False]
    assert [best for _, best in student_t] == [False] * 6


@pytest.mark.usefixtures("undrawn")
def test_who_has_seen_the_recording_is_marked_and_never_the_best(
    entries: tuple[Entry, Entry], tmp_path: Path
) -> None:
    seen = Comparison(
        (
            replace(entries[0], learned_from_it=True),
            entries[1],
            replace(entries[0], estimator="third"),
        )
    )
    page = page_of(seen, tmp_path)
    assert "fixed †</th>" in page
    assert [any(best for _, best in row) for row in cells_of(page)] == [False, False, True]
    assert [row[0] for row in comparison_table(seen).text_rows()] == [
        "estimator",
        "hill",
        "  fixed †",
        "  student-t",
        "  third",
    ]
    assert column_notes(seen)[-1].startswith("†: learned from this recording")
    assert "fixed from hill" in trial_table(seen).notes[-1]


def test_steps_that_were_not_solved_and_honesty_are_seen(
    make_run: Callable[..., RunResult],
) -> None:
    run = make_run(5)
    status = np.array([Status.NOT_CONVERGED, Status.OK, Status.OK, Status.GAP])  # of its four steps
    blind = Entry("hill", "fixed", replace(run, status=status), metrics=Metrics(5, anees=7.25))
    head, _, row = comparison_table(Comparison((blind,))).text_rows()
    assert head[-2:] == ("solved %", "ANEES")
    assert row[-2:] == ("50.0", "7.25")


@pytest.mark.usefixtures("undrawn")
def test_what_cannot_be_distinguished_from_the_best_is_marked_with_it(
    entries: tuple[Entry, Entry], tmp_path: Path
) -> None:
    same = replace(entries[0], estimator="third")
    comparison = Comparison((*entries, same))
    rows = cells_of(page_of(comparison, tmp_path))
    assert [row[0][1] for row in rows] == [True, False, True]
    # In the form of PROBE Table I, too: ARMSE and final error of each estimator.
    (trial,) = trial_table(comparison).as_table().rows
    assert [cell.is_best for cell in trial.cells[2:]] == [True, True, False, False, True, True]


@pytest.mark.usefixtures("undrawn")
def test_nothing_is_marked_and_the_verdict_says_so_where_no_difference_exceeds_noise(
    entries: tuple[Entry, Entry], tmp_path: Path
) -> None:
    alike = Comparison((entries[1], replace(entries[1], estimator="third")))
    page = page_of(alike, tmp_path)
    assert not any(best for row in cells_of(page) for _, best in row)
    sentence = (
        "hill: in translation and rotation, student-t and third cannot be distinguished on this"
        " recording."
    )
    assert verdicts(alike) == (sentence,)
    assert sentence in page


def test_the_verdict_names_the_better_one_and_by_how_much(entries: tuple[Entry, Entry]) -> None:
    """The first run has no error, so that its drift is less by 100 %; the interval ends there."""
    (sentence,) = verdicts(Comparison(entries))
    number = r"\d+(\.\d)?"
    clause = (
        r"fixed drifts less in {} on this recording than student-t by 100 %"
        rf" \(95 %: {number} to 100 %\)"
    )
    pattern = rf"hill: {clause.format('translation')}; {clause.format('rotation')}\."
    assert re.fullmatch(pattern, sentence), sentence


@pytest.mark.usefixtures("undrawn")
def test_a_difference_is_said_to_hold_for_the_recording(
    entries: tuple[Entry, Entry], tmp_path: Path
) -> None:
    note = "What differs on a recording need not on the next"
    assert note in page_of(Comparison(entries), tmp_path)
    alike = Comparison((entries[1], replace(entries[1], estimator="third")))
    assert note not in page_of(alike, tmp_path)


@pytest.mark.parametrize(("frames", "speed"), [(20, 1.0), (40, 0.1)])
def test_a_recording_that_is_too_short_for_a_verdict_is_said_to_be(
    make_run: Callable[..., RunResult], frames: int, speed: float
) -> None:
    """Of too few steps, or of less than 10 m."""
    run = make_run(frames, speed)
    short = tuple(entry(name, run, run.T_world_cam) for name in ("fixed", "student-t"))
    sentence = (
        "hill: too short to tell who drifts less, which takes 25 steps and 10 m between true poses."
    )
    assert verdicts(Comparison(short)) == (sentence,)
    assert verdicts(Comparison(short[:1])) == ()


def test_a_run_that_was_stopped_takes_no_part(
    entries: tuple[Entry, Entry], make_run: Callable[..., RunResult]
) -> None:
    short = make_run(20)
    stopped = entry("student-t", short, short.T_world_cam)
    assert Comparison((entries[0], stopped)).rankings == {"hill": {}}


@pytest.mark.usefixtures("undrawn")
def test_one_estimator_alone_is_not_the_best(entries: tuple[Entry, Entry], tmp_path: Path) -> None:
    (row,) = cells_of(page_of(Comparison(entries[:1]), tmp_path))
    assert not any(best for _, best in row)


@pytest.mark.usefixtures("undrawn")
def test_pictures_of_the_same_frame_stand_beside_each_other(
    entries: tuple[Entry, Entry], tmp_path: Path
) -> None:
    captions = re.findall(r"<figcaption>(.*?)</figcaption>", page_of(Comparison(entries), tmp_path))
    assert captions == [
        "fixed · Frame 1",
        "student-t · Frame 1",
        "fixed · Frame 3",
        "student-t · Frame 3",
    ]


@pytest.mark.usefixtures("undrawn")
def test_link_to_a_name_that_a_browser_would_misread(
    entries: tuple[Entry, Entry], tmp_path: Path
) -> None:
    page = page_of(Comparison((replace(entries[0], report=Path("50% #1/report.html")),)), tmp_path)
    assert 'href="50%25%20%231/report.html"' in page


def test_nothing_to_compare_is_refused(make_run: Callable[..., RunResult], tmp_path: Path) -> None:
    for runs in ((), (Entry("hill", "fixed", make_run(1)),)):
        with pytest.raises(ValueError, match="needs one run at least, and each run two frames"):
            write_comparison(tmp_path / "report.html", Comparison(runs), "", facts={})


def test_paths_start_together_wherever_the_truth_has_its_world(
    entries: tuple[Entry, Entry],
) -> None:
    """The truth lies in a frame of its own; it is drawn on the run that has no error."""
    lines = {
        line.get_label(): line.get_xydata() for line in paths_figure(entries, COLORS).axes[0].lines
    }
    np.testing.assert_allclose(lines["truth"], lines["fixed"], atol=1e-12)
    np.testing.assert_array_equal(lines["fixed"], entries[0].result.T_world_cam[:, [0, 2], 3])
    np.testing.assert_allclose(lines["student-t"][0], 0.0, atol=1e-12)


def test_errors_are_those_of_the_positions(entries: tuple[Entry, Entry]) -> None:
    """Lines of the figure: of each estimator its claim, then its error."""
    lines = errors_figure(entries, COLORS).axes[0].lines
    assert [line.get_color() for line in lines] == ["#111111"] * 2 + ["#222222"] * 2
    for compared, line in zip(entries, lines[1::2], strict=True):
        error_m = np.linalg.norm(
            position_errors(compared.result.T_world_cam, compared.truth), axis=1
        )
        np.testing.assert_allclose(line.get_ydata(), error_m, atol=1e-9)


def test_errors_by_axis_are_those_of_each_run(entries: tuple[Entry, Entry]) -> None:
    """Six axes in two figures, each with the line of zero and one of each estimator."""
    translation, rotation = axes_errors_figures(entries, COLORS)
    six = [*translation.axes, *rotation.axes]
    assert len(six) == 6
    for i, axes in enumerate(six):
        assert [line.get_color() for line in axes.lines[1:]] == ["#111111", "#222222"]
        for compared, line in zip(entries, axes.lines[1:], strict=True):
            error = drift_of(compared.result, compared.truth).error
            assert error is not None
            shown = np.asarray(line.get_ydata())
            factor = 1000.0 if axes.get_title().endswith(", mm") else 1.0
            factor = factor if i < 3 else np.rad2deg(1.0)
            np.testing.assert_allclose(shown, factor * error[:, i], atol=1e-12)


@pytest.mark.parametrize("is_longer_first", [True, False])
def test_the_axis_along_the_path_is_as_long_as_the_longest_run(
    entries: tuple[Entry, Entry], is_longer_first: bool
) -> None:
    """Runs that were stopped, or that hardly moved, are drawn on the same axis, over distances."""
    longer, other = entries
    T_world_cam = se3.chain_motions(np.tile(np.eye(4), (4, 1, 1)))
    at_rest = replace(other.result, T_world_cam=T_world_cam, **first_steps(other.result, 4))
    assert other.truth is not None
    shorter = replace(other, result=at_rest, truth=other.truth[:5])
    both = (longer, shorter) if is_longer_first else (shorter, longer)
    length_m = drift_of(longer.result, longer.truth).distance_m[-1]
    translation, rotation = axes_errors_figures(both, COLORS)
    for axes in (*errors_figure(both, COLORS).axes, *translation.axes, *rotation.axes):
        assert axes.get_xlim() == pytest.approx((0.0, length_m))
        ends_m = {float(np.asarray(line.get_xdata())[-1]) for line in axes.lines[1:]}
        assert ends_m == {0.0, length_m}
    assert translation.axes[2].get_xlabel() == "distance travelled, m"


def first_steps(run: RunResult, steps: int) -> dict[str, Any]:
    """Return the arrays of a run of that many steps."""
    of_steps = ("T_curr_prev", "cov", "common_mode", "path_cross_cov", "status")
    cut = {name: getattr(run, name)[:steps] for name in of_steps}
    return cut | {"stamps_ns": run.stamps_ns[: steps + 1]}


def test_a_name_with_dollars_is_no_mathematics(
    entries: tuple[Entry, Entry], tmp_path: Path
) -> None:
    page = page_of(Comparison((replace(entries[0], estimator="$x_1$"),)), tmp_path)
    assert "$x_1$</text>" in page


@pytest.mark.usefixtures("undrawn")
def test_the_table_of_trials_is_shown_where_there_is_one(
    entries: tuple[Entry, Entry], tmp_path: Path
) -> None:
    comparison = Comparison(tuple(replace(e, report=None) for e in entries))
    write_comparison(
        tmp_path / "with.html", comparison, "", facts={}, trials=trial_table(comparison)
    )
    write_comparison(tmp_path / "without.html", comparison, "", facts={})
    shown = [(tmp_path / name).read_text() for name in ("with.html", "without.html")]
    assert [page.count("In the form of PROBE Table I") for page in shown] == [1, 0]


@pytest.mark.parametrize(
    ("values", "least"),
    [
        ([2.0, 1.0, 3.0], [False, True, False]),
        ([1.0001, 1.0002], [True, True]),
        ([1.0], [False]),
        ([1.0, None], [False, False]),
        ([2.0, None, 1.0], [False, False, True]),
        ([None, None], [False, False]),
        ([], []),
    ],
)
def test_what_reads_as_the_least(values: list[float | None], least: list[bool]) -> None:
    assert reads_least(values) == least


def test_recordings_without_truth_are_named(make_run: Callable[..., RunResult]) -> None:
    with_truth = Entry("hill", "fixed", make_run(3), metrics=Metrics(3, armse_m=1.0))
    without = [
        Entry("dale", "fixed", make_run(3)),
        Entry("moor", "fixed", make_run(3), metrics=Metrics(0)),
    ]
    assert truth_note(Comparison((with_truth,))) == ()
    assert truth_note(Comparison((with_truth, *without))) == (
        "No truth is known, and so no error: dale, moor.",
    )


@pytest.mark.parametrize(
    ("paths", "labels"),
    [
        (["a/x", "a/y"], ["x", "y"]),
        (["a/x", "b/x", "b/y"], ["a-x", "b-x", "y"]),
        (["a/x/t", "b/x/t"], ["a-x-t", "b-x-t"]),
        (["a/b-x", "a/b/x"], ["b-x", "x"]),
        (["a/fixed"], ["a-fixed"]),
        (["v1.0"], ["v1.0"]),
    ],
)
def test_labels_are_short_and_distinct(paths: list[str], labels: list[str], tmp_path: Path) -> None:
    assert distinct_labels([tmp_path / path for path in paths], taken=["fixed"]) == labels


def test_labels_differ_in_more_than_their_case(tmp_path: Path) -> None:
    labels = distinct_labels([tmp_path / "x", tmp_path / "X"])
    assert len({label.casefold() for label in labels}) == 2
    assert all(len(label) < 2 * len(str(tmp_path)) for label in labels)


def test_a_file_is_called_without_its_suffix(tmp_path: Path) -> None:
    (tmp_path / "test.v1.npz").touch()
    assert distinct_labels([tmp_path / "test.v1.npz"]) == ["test.v1"]


def test_names_that_come_again_are_numbered() -> None:
    assert numbered(["a", "b", "A", "a-2", "a"], taken=["B"]) == ["a", "b-2", "A-2", "a-2-2", "a-3"]


def test_the_best_of_many_is_found(make_run: Callable[..., RunResult]) -> None:
    """Of eleven, 55 pairs are compared, and p-values have to be as small as that asks for."""
    right = make_run(70, speed=0.1)  # shorter than any segment
    entries = []
    for k in range(11):
        motions = se3.exp(np.array([0, 0, 0, 0, 1e-3 * k, 0])) @ right.T_curr_prev
        run = replace(right, T_curr_prev=motions, T_world_cam=se3.chain_motions(motions))
        entries.append(replace(entry("fixed", run, right.T_world_cam), estimator=f"number {k}"))
    ranking = Comparison(tuple(entries)).rankings["hill"]["final_error_m"]
    assert ranking.leaders == {"number 0"}


def test_paths_that_sensors_corrected_are_compared_as_they_are(
    make_run: Callable[..., RunResult],
) -> None:
    """A sensor of poses changes the path, and leaves the motions as they were."""
    right = make_run(30)
    motions = se3.exp(np.array([0, 0, 0, 0, 0.002, 0])) @ right.T_curr_prev
    alone = replace(right, T_curr_prev=motions, T_world_cam=se3.chain_motions(motions))
    corrected = replace(alone, T_world_cam=right.T_world_cam)
    entries = (
        entry("fixed", alone, right.T_world_cam),
        entry("student-t", corrected, right.T_world_cam),
    )
    ranking = Comparison(entries).rankings["hill"]["final_error_m"]
    assert ranking.leaders == {"student-t"}

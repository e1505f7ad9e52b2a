"""The form of PROBE Table I, as text, HTML and LaTeX."""

import re
from collections.abc import Callable
from dataclasses import replace

import pytest

from output.pages import Balance
from probevo.evaluation.metrics import Metrics
from probevo.output.comparison.comparison import Comparison, Entry
from probevo.output.run_result import RunResult
from probevo.output.table import latex
from probevo.output.trial_table import (
    UNKNOWN,
    TrialRow,
    TrialTable,
    trial_table,
    trials_latex,
    trials_section,
)

TABLE = TrialTable(
    ("fixed", "a_b"),
    (
        TrialRow("city_1", ((4.84, 12.6), (3.3, 12.6)), 1251.12, kind="City"),
        TrialRow("published", ((4.0, 1.0), UNKNOWN), is_aside=True),
    ),
    ("50 % is\nmissing.",),
)


def tabular(source: str) -> tuple[str, list[list[str]]]:
    """The column specification, and the cells of each row of a ``tabular``; checks that it is well
    formed."""
    lines = [line for line in source.splitlines() if not line.startswith("%")]
    begin = re.fullmatch(r"\\begin\{tabular\}\{([lrc]+)\}", lines[0])
    assert begin
    assert lines[-1] == r"\end{tabular}"
    rows = [line for line in lines[1:-1] if line != r"\hline"]
    assert all(row.endswith(r" \\") for row in rows)
    depth = 0
    for sign in re.sub(r"\\[\\{}&%$#_]", "", "".join(rows)):
        depth += {"{": 1, "}": -1}.get(sign, 0)
        assert depth >= 0
    assert depth == 0
    return begin[1], [[cell.strip() for cell in re.split(r"(?<!\\)&", row[:-3])] for row in rows]


def width(cells: list[str]) -> int:
    return sum(
        int(m[1]) if (m := re.match(r"\\multicolumn\{(\d+)\}", cell)) else 1 for cell in cells
    )


def test_text_has_both_errors_of_an_estimator_in_one_column() -> None:
    assert TABLE.as_table().text_rows() == [
        ("trial", "type", "length m", "fixed", "a_b"),
        ("city_1", "City", "1,251.1", "4.84 / 12.6", "3.30 / 12.6"),
        ("  published", "", "–", "4.00 / 1.00", "   – /    –"),
    ]


def test_latex_is_well_formed_and_marks_the_least() -> None:
    source = trials_latex(TABLE)
    columns, rows = tabular(source)
    assert columns == "llrrrrr"
    assert {width(row) for row in rows} == {7}
    assert rows[0][3:] == [r"\multicolumn{2}{c}{fixed}", r"\multicolumn{2}{c}{a\_b}"]
    assert rows[2] == [
        r"city\_1",
        "City",
        "1,251.1",
        "4.84",
        r"\textbf{12.6}",
        r"\textbf{3.30}",
        r"\textbf{12.6}",
    ]
    assert rows[3] == [r"\quad published", "", "--", "4.00", "1.00", "--", "--"]
    assert source.splitlines()[0] == "% 50 % is missing."


def test_without_kinds_there_is_no_column_for_them() -> None:
    plain = replace(TABLE, rows=(replace(TABLE.rows[0], kind=""),))
    columns, rows = tabular(trials_latex(plain))
    assert columns == "lrrrrr"
    assert {width(row) for row in rows} == {6}
    assert plain.as_table().text_rows()[0] == ("trial", "length m", "fixed", "a_b")
    assert "type" not in trials_section(plain)


@pytest.mark.parametrize(
    ("text", "source"),
    [
        (r"a_b & 50% #1 $x$ {y}", r"a\_b \& 50\% \#1 \$x\$ \{y\}"),
        ("\\~^", r"\textbackslash{}\textasciitilde{}\textasciicircum{}"),
        ("[1]*", "{[}1]{*}"),
        ("<a|b>", r"\textless{}a\textbar{}b\textgreater{}"),
        ("a\nb", "a b"),
        ("ü", "ü"),
    ],
)
def test_signs_that_latex_takes_for_commands(text: str, source: str) -> None:
    assert latex(text) == source


def test_a_hostile_name_keeps_the_table_whole() -> None:
    name = r"[a]\\ & b% {c} <d>"
    hostile = TrialTable((name,), (TrialRow(name, ((1.0, 2.0),)),))
    columns, rows = tabular(trials_latex(hostile))
    assert columns == "lrrr"
    assert [width(row) for row in rows] == [4, 4, 4]
    page = Balance()
    page.feed(trials_section(hostile))
    assert not page.open
    assert "&lt;d&gt;" in trials_section(hostile)


def test_html_marks_the_least_and_says_the_notes() -> None:
    section = trials_section(TABLE)
    parsed = Balance()
    parsed.feed(section)
    assert not parsed.open
    assert re.findall(r'<td class="best">(.*?)</td>', section) == ["12.6", "3.30", "12.6"]
    assert '<th colspan="2">a_b</th>' in section
    assert "50 % is\nmissing." in section


def test_rows_are_recordings_and_columns_estimators(make_run: Callable[..., RunResult]) -> None:
    run = make_run(3)
    metrics = Metrics(3, armse_m=1.0, final_error_m=2.0, path_length_m=30.0)
    entries = (
        Entry("hill", "fixed", run, metrics=metrics),
        Entry("dale", "student-t", run, metrics=replace(metrics, armse_m=3.0)),
        Entry("moor", "fixed", run),
    )
    table = trial_table(Comparison(entries))
    assert table.estimators == ("fixed", "student-t")
    assert [(row.name, row.errors, row.path_length_m) for row in table.rows] == [
        ("hill", ((1.0, 2.0), UNKNOWN), 30.0),
        ("dale", (UNKNOWN, (3.0, 2.0)), 30.0),
        ("moor", (UNKNOWN, UNKNOWN), None),
    ]
    assert table.notes == ("No truth is known, and so no error: moor.",)


def test_other_measures_have_columns_of_their_own() -> None:
    """One measure as well as three; the text has those of an estimator in one column."""
    for measures in ((("loop error", "m"),), (("a", "m"), ("b", "rad"), ("c", "s"))):
        errors = tuple(tuple(float(k + e) for k in range(len(measures))) for e in range(2))
        other = TrialTable(
            ("x", "y"), (TrialRow("hill", errors),), (), measures=measures, form="thesis Table 0"
        )
        columns, rows = tabular(trials_latex(other))
        assert columns == "lr" + "r" * 2 * len(measures)
        assert {width(row) for row in rows} == {len(columns)}
        assert rows[1][2] == f"{measures[0][0].capitalize()} [m]"
        assert rows[2][2] == (r"\textbf{0}")
        assert other.as_table().text_rows()[1][2] == " / ".join(
            ["0", "1.00", "2.00"][: len(measures)]
        )
        section = trials_section(other)
        assert f'<th colspan="{len(measures)}">x</th>' in section
        assert "In the form of thesis Table 0" in section

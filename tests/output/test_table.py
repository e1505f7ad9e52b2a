"""One table as text, LaTeX, HTML and CSV."""

import csv
import io
import re

import pytest

from output.pages import Balance
from probevo.output.table import (
    Cell,
    Column,
    Row,
    Table,
    figure_text,
    records_table,
    text_table,
)

TABLE = Table(
    columns=(
        Column("name", format=str, align="left"),
        Column("error", "m", group="a & b"),
        Column("angle", "°", group="a & b"),
        Column("time", "%"),
    ),
    rows=(
        Row((Cell("<x>", color="#123456"), Cell(1.0, is_best=True), Cell(22.5), Cell(None))),
        Row.of("beside", 10.25, None, 0.1 + 0.2, is_aside=True),
    ),
    notes=("50 % of\nthem.",),
)


def test_text_is_aligned_and_merges_groups() -> None:
    assert TABLE.as_text().splitlines() == [
        "name            a & b  time %",
        "────────  ───────────  ──────",
        "<x>       1.00 / 22.5       –",
        "  beside  10.2 /    –   0.300",
    ]


def test_a_section_has_a_row_of_its_own_in_text_latex_and_html() -> None:
    rows = (Row.of("a", 1.0, section="s1"), Row.of("b", 2.0, section="s2"))
    table = Table((Column("name", format=str, align="left"), Column("error")), rows)
    assert [row[0] for row in table.text_rows()] == ["name", "s1", "  a", "s2", "  b"]
    assert table.as_latex().count(r"\multicolumn{2}{l}{s") == 2
    assert re.findall(r'<tr class="group"><th colspan="2">(.*?)</th>', table.as_html()) == [
        "s1",
        "s2",
    ]


def test_latex_marks_the_best_and_escapes() -> None:
    lines = TABLE.as_latex().splitlines()
    assert lines[0] == "% 50 % of them."
    assert lines[1] == r"\begin{tabular}{lrrr}"
    assert lines[3] == r"& \multicolumn{2}{c}{a \& b} & \\"
    assert lines[4] == r"Name & Error [m] & Angle [°] & Time [\%] \\"
    assert lines[6] == r"\textless{}x\textgreater{} & \textbf{1.00} & 22.5 & -- \\"
    assert lines[7] == r"\quad beside & 10.2 & -- & 0.300 \\"


def test_html_is_balanced_and_escapes() -> None:
    html = TABLE.as_html()
    page = Balance()
    page.feed(html)
    assert not page.open
    assert "&lt;x&gt;" in html
    assert "<x>" not in html
    assert '<th colspan="2">a &amp; b</th>' in html
    assert re.findall(r'<td class="best">(.*?)</td>', html) == ["1.00"]
    assert "<small>beside</small>" in html


@pytest.mark.parametrize("field", ["color", "href", "unit"])
def test_hostile_values_stay_inside_their_attributes(field: str) -> None:
    hostile = '"><script>alert(1)</script>'
    cell = Cell("x", **{field: hostile})
    html = Table((Column("a", format=str),), (Row((cell,)),)).as_html()
    assert "<script" not in html
    page = Balance()
    page.feed(html)
    assert not page.open


def test_csv_has_full_precision_and_nothing_where_unknown() -> None:
    head, first, second = csv.reader(io.StringIO(TABLE.as_csv()))
    assert head == ["name", "a & b error m", "a & b angle °", "time %"]
    assert first == ["<x>", "1.0", "22.5", ""]
    assert float(second[3]) == 0.1 + 0.2


def test_columns_can_be_left_out() -> None:
    assert TABLE.without("time", "angle").text_rows()[1] == ("<x>", "1.00")


def test_records_become_rows() -> None:
    table = records_table([{"a": 1, "b": None}, {"b": "x,y", "a": 2.5}])
    assert table.as_csv() == 'a,b\n1,\n2.5,"x,y"\n'


def test_a_table_without_rows_still_has_a_head() -> None:
    empty = text_table(("a", "b"), [])
    assert empty.as_text().splitlines() == ["a  b", "─  ─"]
    assert "<th>a</th>" in empty.as_html()


def test_a_figure_that_is_not_known_is_a_dash() -> None:
    assert (figure_text(None), figure_text(0.12345)) == ("–", "0.123")

"""The notebooks run from top to bottom, show something, and hold what they say."""

from __future__ import annotations

import ast
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

EXAMPLES = Path(__file__).parents[1] / "examples"
NOTEBOOKS = sorted(EXAMPLES.glob("*.ipynb"))


def cells(path: Path, kind: str) -> list[str]:
    notebook = json.loads(path.read_text("utf-8"))
    assert notebook["nbformat"] == 4
    return ["".join(cell["source"]) for cell in notebook["cells"] if cell["cell_type"] == kind]


def executed(path: Path) -> tuple[dict[str, Any], list[Any]]:
    """Run the cells as Jupyter does, in one namespace; return it, and what the cells show.

    It does without Jupyter, and so without its magic commands.
    """
    names: dict[str, Any] = {"__name__": "__main__"}
    shown = []
    for number, source in enumerate(cells(path, "code")):
        tree = ast.parse(source)
        last = tree.body[-1]
        where = f"{path.name}, code cell {number}"
        if isinstance(last, ast.Expr):
            tree.body.pop()
            exec(compile(tree, where, "exec"), names)
            value = eval(compile(ast.Expression(last.value), where, "eval"), names)
            shown += [value] if value is not None else []
        else:
            exec(compile(tree, where, "exec"), names)
    return names, shown


def test_there_are_two() -> None:
    assert [path.name for path in NOTEBOOKS] == ["08_first_run.ipynb", "09_own_matches.ipynb"]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.name)
def test_a_notebook_is_short_and_without_outputs(path: Path) -> None:
    """What is committed is its source: outputs are those of the reader."""
    assert sum(len(source.splitlines()) for source in cells(path, "code")) <= 80
    notebook = json.loads(path.read_text("utf-8"))
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            assert (cell["outputs"], cell["execution_count"]) == ([], None)
    assert len(cells(path, "markdown")) >= 4


@pytest.mark.usefixtures("undrawn")
def test_first_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    names, shown = executed(EXAMPLES / "08_first_run.ipynb")
    assert (tmp_path / "out" / "first_run" / "report.html").exists()
    run, path, error, statuses = shown
    table = run._repr_html_()
    assert "<table>" in table
    assert "drift" in table
    assert len(repr(run)) < 300
    assert isinstance(path, Figure)
    assert isinstance(error, Figure)
    assert statuses["OK"] == len(names["run"].result) - 1
    assert "NEES" in capsys.readouterr().out


def test_own_matches(capsys: pytest.CaptureFixture[str]) -> None:
    """Own covariances are consistent, within the 99.9 % interval of χ²(360)/60, and halve the
    error."""
    names, shown = executed(EXAMPLES / "09_own_matches.ipynb")
    assert shown[0].status.name == "OK"
    assert 4.6 < names["own"][:, 1].mean() < 7.6
    assert names["own"][:, 0].mean() < 0.5 * names["equal"][:, 0].mean()
    np.testing.assert_allclose(names["T_world_cam"][-1, 2, 3], 16.0, atol=1.0)
    assert "after 20 steps" in capsys.readouterr().out

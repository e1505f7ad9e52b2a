"""``benchmarks/recompute.py``: every figure of the pages has a command, failures are named."""

import importlib.util
import re
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

ROOT = Path(__file__).parents[1]
BENCHMARKS = ROOT / "benchmarks"
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
SCRIPTS = {
    path.name for path in BENCHMARKS.glob("*.py") if '__name__ == "__main__"' in path.read_text()
}
"""Benchmarks that are run; the other files are imported by them."""


def load_recompute() -> ModuleType:
    spec = importlib.util.spec_from_file_location("recompute", BENCHMARKS / "recompute.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["recompute"] = module  # where dataclasses look up annotations
    spec.loader.exec_module(module)
    return module


recompute = load_recompute()


def script_of(command: str) -> str | None:
    """Return the name of the script that a command runs; None for a command of probevo."""
    found = re.match(r"python benchmarks/(\w+\.py)", command)
    return found[1] if found else None


def test_every_script_that_the_pages_name_is_listed() -> None:
    named = {name for page in PAGES for name in re.findall(r"\b\w+\.py\b", page.read_text())}
    listed = {script_of(figure.command) for figure in recompute.FIGURES}
    assert named & SCRIPTS - {"recompute.py"} <= listed


@pytest.mark.parametrize("figure", recompute.FIGURES, ids=lambda figure: figure.name)
def test_every_listed_figure_is_on_its_pages(figure: Any) -> None:
    """Each page names the script or the experiment, or shows a picture that the command writes."""
    script = script_of(figure.command)
    if script is None:
        name = " ".join(figure.command.split()[:3])
        assert name.startswith("probevo paper ")
    else:
        name = script
        assert script in SCRIPTS
    for page in figure.pages:
        text = (ROOT / page).read_text()
        assert name in text or any(f"images/{picture}" in text for picture in figure.pictures)


def test_names_are_unique() -> None:
    names = [figure.name for figure in recompute.FIGURES]
    assert len(set(names)) == len(names)


def test_the_list_has_every_command_below_its_page(capsys: pytest.CaptureFixture[str]) -> None:
    assert recompute.main(["--list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert {line for line in lines if not line.startswith(" ")} == {
        page for figure in recompute.FIGURES for page in figure.pages
    }
    for figure in recompute.FIGURES:
        shown = [line for line in lines if line.startswith(f"  {figure.name} ")]
        assert len(shown) == len(figure.pages)
        assert all(figure.command in line for line in shown)


def figure(name: str, code: str, needs_data: bool = False) -> Any:
    """Return a figure that is computed by a line of Python."""
    return recompute.Figure(name, (), f'python -c "{code}"', minutes=0, needs_data=needs_data)


def test_output_goes_below_the_folder_and_the_first_failure_ends_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    good = figure("good", "print(1); open('made', 'w')")
    bad = figure("bad", "print(2); raise SystemExit(3)")
    monkeypatch.setattr(recompute, "FIGURES", (good, bad, figure("never", "print(3)")))
    assert recompute.main(["--out", str(tmp_path / "out")]) == 1
    made = {path.name for path in (tmp_path / "out").iterdir()}
    assert made == {"good.txt", "made", "bad.txt"}
    assert (tmp_path / "out" / "good.txt").read_text() == "1\n"
    assert (tmp_path / "out" / "bad.txt").read_text() == "2\n"
    error = capsys.readouterr().err
    assert error.startswith(f"bad failed with exit code 3: {bad.command}\n")
    assert recompute.main(["--out", str(tmp_path / "only"), "--only", "never"]) == 0
    assert [path.name for path in (tmp_path / "only").iterdir()] == ["never.txt"]


def test_figures_of_real_recordings_are_skipped_without_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    real = figure("real", "import os; print(os.environ['PROBEVO_DATA'])", needs_data=True)
    monkeypatch.setattr(recompute, "FIGURES", (real,))
    monkeypatch.setenv("PROBEVO_DATA", str(tmp_path / "none"))
    assert recompute.main(["--out", str(tmp_path / "out")]) == 0
    assert "real: skipped, as it needs real recordings: set PROBEVO_DATA" in capsys.readouterr().out
    assert not list((tmp_path / "out").iterdir())
    monkeypatch.setenv("PROBEVO_DATA", str(tmp_path))
    assert recompute.main(["--out", str(tmp_path / "out")]) == 0
    assert (tmp_path / "out" / "real.txt").read_text() == f"{tmp_path}\n"


def test_the_readme_has_a_row_for_each_script() -> None:
    rows = re.findall(r"^\| `(\w+\.py)` \|", (BENCHMARKS / "README.md").read_text(), re.MULTILINE)
    assert sorted(rows) == sorted(SCRIPTS)

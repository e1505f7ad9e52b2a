"""The dispatcher: what it imports, and how it turns errors into messages."""

import os
import subprocess
import sys
from types import SimpleNamespace

import pytest

from probevo import __version__
from probevo.cli import main as cli

HEAVY = ("scipy", "cv2", "numba", "matplotlib", "numpy", "tyro", "pydantic")


@pytest.mark.parametrize("words", [["--help"], ["--version"]])
def test_help_imports_nothing_heavy(words: list[str]) -> None:
    script = "import sys; from probevo.cli.main import main; code = main(sys.argv[1:]); "
    script += f"print([name for name in {HEAVY!r} if name in sys.modules]); sys.exit(code)"
    done = subprocess.run(
        [sys.executable, "-c", script, *words], capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines()[-1] == "[]"


@pytest.mark.parametrize("command", cli.COMMANDS)
def test_help_of_a_command_needs_neither_scipy_nor_opencv(command: str) -> None:
    script = (
        "import sys; from probevo.cli.main import main\ntry: main(sys.argv[1:])\nexcept SystemExit"
        " as end: "
    )
    script += f"print([name for name in {HEAVY[:5]!r} if name in sys.modules]); sys.exit(end.code)"
    words = [sys.executable, "-c", script, command, "--help"]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    assert f"usage: probevo {command}" in done.stdout
    assert done.stdout.splitlines()[-1] == "[]"


@pytest.mark.parametrize(("given", "expected"), [(None, "1"), ("4", "4")])
def test_blas_gets_one_thread_unless_set_otherwise(
    given: str | None, expected: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = []
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "")  # so that it is put back
    monkeypatch.delenv("OPENBLAS_NUM_THREADS")
    if given:
        monkeypatch.setenv("OPENBLAS_NUM_THREADS", given)
    command = SimpleNamespace(main=lambda words: seen.append(os.environ["OPENBLAS_NUM_THREADS"]))
    monkeypatch.setattr(cli, "import_module", lambda name: command)
    assert cli.main(["run"]) == 0
    assert seen == [expected]


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["--version"]) == 0
    assert capsys.readouterr().out == f"probevo {__version__}\n"


def test_python_runs_it_as_a_module() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "probevo", "--version"], capture_output=True, text=True, check=True
    )
    assert done.stdout == f"probevo {__version__}\n"


@pytest.mark.parametrize(
    "command", [["run", "x"], ["train", "x"], ["compare", "x"], ["inspect", "x"], ["demo"]]
)
@pytest.mark.parametrize("out", [["--out", ""], ["--out="]])
def test_an_empty_out_is_not_the_current_directory(
    command: list[str], out: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main([*command, *out]) == 2
    assert capsys.readouterr().err.startswith("probevo: --out: is empty.")


@pytest.mark.parametrize("world", [["simulate", "point"], ["simulate", "scene"], ["paper", "blur"]])
def test_an_empty_out_of_a_part_is_refused_too(
    world: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main([*world, "--out", ""]) == 2
    assert capsys.readouterr().err.startswith("probevo: --out: is empty.")


@pytest.mark.parametrize(
    ("word", "cure"), [("rnu", "Did you mean run?"), ("fly", "Commands are run, train, compare")]
)
def test_unknown_command(word: str, cure: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main([word]) == 2
    shown = capsys.readouterr().err
    assert shown.startswith(f"probevo: {word}: this is not a command.\n         ")
    assert cure in shown


def test_without_a_command_the_help_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main([]) == 2
    assert "probevo run SEQUENCE" in capsys.readouterr().err


def test_ctrl_c_gives_130_and_says_where_the_results_are(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(words: list[str]) -> int:
        stop = KeyboardInterrupt()
        stop.add_note("The results of the first 7 frames are in out.")
        raise stop

    monkeypatch.setattr(cli, "_dispatch", interrupted)
    assert cli.main(["run"]) == 130
    assert (
        capsys.readouterr().err
        == "probevo: stopped.\n         The results of the first 7 frames are in out.\n"
    )

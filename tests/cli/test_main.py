"""The dispatcher: what it imports, and how it turns errors into messages."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from types import SimpleNamespace

import pytest

from probevo import __version__
from probevo.cli import main as cli

HEAVY = ("scipy", "cv2", "numba", "matplotlib", "numpy", "tyro", "pydantic")
EXTRAS = ("rosbags", "jax", "equinox", "optax", "dask", "distributed", "rerun", "ephem", "gtsam")
"""What the optional dependencies of pyproject.toml install for the package itself."""


@pytest.mark.parametrize("words", [["--help"], ["--version"]])
def test_help_imports_nothing_heavy(words: list[str]) -> None:
    script = "import sys; from probevo.cli.main import main; code = main(sys.argv[1:]); "
    script += f"print([name for name in {HEAVY + EXTRAS!r} if name in sys.modules]); sys.exit(code)"
    done = subprocess.run(
        [sys.executable, "-c", script, *words], capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines()[-1] == "[]"


HELP_OF_COMMANDS = """
import io, sys
from contextlib import redirect_stdout
from probevo.cli.main import main

unwanted, *commands = sys.argv[1:]
for command in commands:
    out = io.StringIO()
    with redirect_stdout(out):
        try:
            main([command, "--help"])
        except SystemExit as end:
            assert not end.code, command
    assert f"usage: probevo {command}" in out.getvalue(), command
    found = [name for name in unwanted.split(",") if name in sys.modules]
    assert not found, (command, found)
"""


def test_help_of_a_command_needs_neither_scipy_nor_opencv_nor_an_extra() -> None:
    unwanted = ",".join(HEAVY[:5] + EXTRAS)
    words = [sys.executable, "-c", HELP_OF_COMMANDS, unwanted, *cli.COMMANDS]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("command", ["compare", "stress"])
def test_the_help_says_what_of_a_config_is_ignored(
    command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        cli.main([command, "--help"])
    shown = " ".join(capsys.readouterr().out.split())
    assert "whose recording, noise model and learned sensors are ignored" in shown


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


@pytest.mark.parametrize(
    "words",
    [["run", "--config", "x" * 300, "--out", "o"], ["eval", "x" * 300, "--gt", "y"]],
)
def test_a_name_that_is_too_long_is_said_to_be(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(words) == 2
    err = capsys.readouterr().err
    assert "x" * 300 in err
    assert "too long" in err


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no device that is full")  # noqa: PTH110
def test_a_full_disk_behind_stdout_is_said_to_be() -> None:
    script = "import sys; from probevo.cli.main import main; sys.exit(main(['--version']))"
    with open("/dev/full", "w") as full:  # noqa: PTH123
        done = subprocess.run(
            [sys.executable, "-u", "-c", script], stdout=full, stderr=subprocess.PIPE, check=False
        )
    assert done.returncode == 2
    assert b"stdout: No space left on device" in done.stderr
    assert b"Traceback" not in done.stderr


@pytest.mark.skipif(sys.platform == "win32", reason="a shell closes the streams")
def test_closed_streams_lead_nowhere() -> None:
    """Number 1 is not free for the next file that is opened, here and in other processes."""
    script = (
        "import os, sys; from probevo.cli import main as cli; cli.main(['--version']);"
        " sys.stdout.flush(); sys.stderr.flush();"
        " sys.exit(0 if os.open(os.devnull, os.O_RDONLY) > 2 and os.get_inheritable(1) else 1)"
    )
    command = '"$0" -c "$1" <&- >&- 2>&-'
    assert (
        subprocess.run(["sh", "-c", command, sys.executable, script], check=False).returncode == 0
    )


def test_in_a_locale_without_the_letters_of_a_result_they_are_question_marks() -> None:
    script = (
        "from probevo.cli import main as cli; cli._dispatch = lambda words: print('2 \\xb0/m');"
        " cli.main([])"
    )
    locale = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    done = subprocess.run(
        [sys.executable, "-c", script],
        env=os.environ | locale | {"PYTHONIOENCODING": "ascii"},
        capture_output=True,
        check=False,
    )
    assert done.stdout.split() == [b"2", b"?/m"], done.stderr


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


@pytest.fixture
def default_signals() -> Iterator[None]:
    """The handlers of a program in the foreground: a shell lets its background jobs ignore Ctrl-C,
    and so does the command."""
    defaults = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL}
    before = {number: signal.signal(number, handler) for number, handler in defaults.items()}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.usefixtures("default_signals")
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_ends_a_command_like_an_interrupt(
    number: signal.Signals,
    code: int,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def killed(words: list[str]) -> None:
        try:
            os.kill(os.getpid(), number)
        except KeyboardInterrupt as stop:
            stop.add_note("The results are in out.")
            raise

    monkeypatch.setattr(cli, "import_module", lambda name: SimpleNamespace(main=killed))
    before = signal.getsignal(number)
    assert cli.main(["run"]) == code
    assert signal.getsignal(number) == before
    assert capsys.readouterr().err == "probevo: stopped.\n         The results are in out.\n"


@pytest.mark.usefixtures("default_signals")
@pytest.mark.parametrize("during", ["import", "command"])
def test_an_interrupt_that_an_import_swallows_is_none_the_less_one(
    during: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = []

    def swallowing(*_: object) -> SimpleNamespace:
        with suppress(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
        return command

    command = SimpleNamespace(main=swallowing if during == "command" else calls.append)
    find = swallowing if during == "import" else lambda name: command
    monkeypatch.setattr(cli, "import_module", find)
    assert cli.main(["run"]) == 130
    assert not calls
    monkeypatch.setattr(cli, "import_module", lambda name: SimpleNamespace(main=calls.append))
    assert cli.main(["run"]) == 0  # the next call knows nothing of it


def test_handlers_of_the_caller_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[int] = []
    before = signal.signal(signal.SIGTERM, lambda number, frame: seen.append(number))
    try:
        kill = SimpleNamespace(main=lambda words: os.kill(os.getpid(), signal.SIGTERM))
        monkeypatch.setattr(cli, "import_module", lambda name: kill)
        assert cli.main(["run"]) == 0
    finally:
        signal.signal(signal.SIGTERM, before)
    assert seen == [signal.SIGTERM]


def test_it_runs_in_another_thread_too() -> None:
    """Where no handler of a signal can be set."""
    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(cli.main, ["--version"]).result() == 0

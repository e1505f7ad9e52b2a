"""A folder is written by one process at a time, and whoever comes second is told who has it."""

import errno
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from probevo.cli.main import main
from probevo.errors import InputError
from probevo.storage.lock import LOCK, locked
from probevo_sim.point_config import PointConfig
from probevo_sim.point_world import simulate_points, write_points

HOLD = """
import sys
from pathlib import Path
from probevo.errors import InputError
from probevo.storage.lock import locked

try:
    with locked(Path(sys.argv[1])):
        print("held", flush=True)
        sys.stdin.read(1)
except InputError as error:
    print(error, flush=True)
    sys.exit(2)
"""


def holder(folder: Path) -> subprocess.Popen[str]:
    """Start a process that holds the lock until its stdin ends."""
    source = str(Path(__file__).parents[2] / "src")
    return subprocess.Popen(
        [sys.executable, "-c", HOLD, str(folder)],
        env=os.environ | {"PYTHONPATH": source},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )


@pytest.fixture
def held(tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """Another process that holds the lock of ``out``."""
    process = holder(tmp_path / "out")
    assert process.stdout is not None
    assert process.stdout.readline() == "held\n"
    with process:
        yield process
        process.kill()


def test_the_second_is_told_who_has_it(held: subprocess.Popen[str], tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught, locked(tmp_path / "out"):
        pass
    assert caught.value.where == str(tmp_path / "out")
    pattern = rf"is in use by process {held.pid} on \S+, since 20\d\d-\d\d-\d\d .* UTC\."
    assert re.fullmatch(pattern, caught.value.what)
    assert (tmp_path / "out" / LOCK).exists()


def test_another_thread_of_the_same_process_is_refused_too(tmp_path: Path) -> None:
    with (
        locked(tmp_path),
        pytest.raises(InputError, match=f"process {os.getpid()} on"),
        locked(tmp_path),
    ):
        pass
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_the_lock_of_a_killed_process_is_free(held: subprocess.Popen[str], tmp_path: Path) -> None:
    held.send_signal(signal.SIGKILL)
    held.wait()
    assert (tmp_path / "out" / LOCK).exists()
    with locked(tmp_path / "out"):
        assert f"process {os.getpid()} on" in (tmp_path / "out" / LOCK).read_text()
    assert list((tmp_path / "out").iterdir()) == []


@pytest.mark.parametrize("number", [2, 8])
def test_of_several_at_once_one_holds_it(number: int, tmp_path: Path) -> None:
    processes = [holder(tmp_path / "out") for _ in range(number)]
    lines = [process.stdout.readline() for process in processes if process.stdout]
    winner = processes[lines.index("held\n")]
    refused = [line for line in lines if line != "held\n"]
    assert len(refused) == number - 1
    assert all(f"is in use by process {winner.pid} on" in line for line in refused)
    winner.communicate("")
    for process in processes:
        process.communicate()
    assert sorted(process.returncode for process in processes) == [0] + [2] * (number - 1)
    # The folder itself may stay, empty, where one that was refused had made it.
    assert [path for path in tmp_path.rglob("*") if path != tmp_path / "out"] == []


def test_folders_that_it_made_and_that_stay_empty_are_removed(tmp_path: Path) -> None:
    with locked(tmp_path / "a" / "b"):
        assert (tmp_path / "a" / "b" / LOCK).exists()
    assert list(tmp_path.iterdir()) == []
    with locked(tmp_path / "a" / "b"):
        (tmp_path / "a" / "file").write_text("kept")
    assert [path.name for path in (tmp_path / "a").iterdir()] == ["file"]
    (tmp_path / "c").mkdir()
    with locked(tmp_path / "c"):
        pass
    assert (tmp_path / "c").is_dir()


@pytest.mark.skipif(os.name != "posix", reason="links and pipes of POSIX")
@pytest.mark.parametrize("kind", ["link", "pipe", "folder"])
def test_what_is_planted_in_place_of_the_lock_is_not_written_to(kind: str, tmp_path: Path) -> None:
    secret = tmp_path / "secret"
    secret.write_text("keep me")
    out = tmp_path / "out"
    out.mkdir()
    if kind == "link":
        (out / LOCK).symlink_to(secret)
    elif kind == "pipe":
        os.mkfifo(out / LOCK)
    else:
        (out / LOCK).mkdir()
    with pytest.raises(InputError, match="cannot be written"), locked(out):
        pass
    assert secret.read_text() == "keep me"


def test_a_folder_that_is_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"--out: .*file is a file"), locked(tmp_path / "file"):
        pass


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A tracks file."""
    path = tmp_path_factory.mktemp("recording") / "drive.npz"
    config = PointConfig(radius_m=3.0, landmarks=400)
    write_points(simulate_points(config, duration_s=1.0, rng=np.random.default_rng(0)), path)
    return path


@pytest.fixture(scope="module")
def finished(drive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run."""
    out = tmp_path_factory.mktemp("finished")
    assert main(["run", str(drive), "--out", str(out)]) == 0
    return out


def words_of(command: str, drive: Path, finished: Path, out: Path | str) -> list[str]:
    places = {"DRIVE": str(drive), "RUN": str(finished), "OUT": str(out)}
    words = []
    for word in COMMANDS[command]:
        for name, place in places.items():
            word = word.replace(name, place)
        words.append(word)
    return words


COMMANDS = {
    "run": ("run", "DRIVE", "--out", "OUT"),
    "compare": ("compare", "DRIVE", "--noise", "fixed", "--out", "OUT"),
    "inspect": ("inspect", "DRIVE", "--out", "OUT"),
    "simulate": ("simulate", "point", "--out", "OUT"),
    "train": ("train", "DRIVE", "--kind", "student-t", "--out", "OUT.safetensors"),
    "convert": ("convert", "RUN", "--out", "OUT.bag"),
}


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_that_finds_its_place_in_use_exits_and_says_by_whom(
    command: str, drive: Path, finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    words = words_of(command, drive, finished, out)
    suffix = {"train": ".safetensors.work", "convert": ".bag.work"}.get(command, "")
    folder = out.with_name(out.name + suffix)
    with locked(folder):
        assert main(words) == 2
        assert [path.name for path in folder.iterdir()] == [LOCK]
    assert f"{folder}: is in use by process {os.getpid()} on" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("command", COMMANDS)
def test_a_name_that_is_too_long_is_refused(
    command: str, drive: Path, finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = words_of(command, drive, finished, tmp_path / ("x" * 300))
    assert main(words) == 2
    assert "too long" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_on_a_full_disk_the_lock_is_refused_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(file: int, data: bytes) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    (tmp_path / "earlier.txt").write_text("a")
    monkeypatch.setattr("probevo.storage.lock.os.write", full)
    with pytest.raises(InputError, match="cannot be written: No space left"), locked(tmp_path):
        pass
    assert [path.name for path in tmp_path.iterdir()] == ["earlier.txt"]

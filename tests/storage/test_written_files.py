"""Writing of files: whole or not at all, and bad places are refused."""

import os
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from probevo.errors import InputError
from probevo.storage import files


def test_writing_replaces_whole_files_and_leaves_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "new" / "config.yaml"
    files.write_atomically(path, "a" * 1000)
    files.write_atomically(path, "b")
    assert path.read_text() == "b"
    assert [p.name for p in path.parent.iterdir()] == ["config.yaml"]


def test_what_is_no_text_is_a_question_mark(tmp_path: Path) -> None:
    """Names of files may hold any bytes; Python has them as lone surrogates."""
    files.write_atomically(tmp_path / "a", "dr" + os.fsdecode(b"\xe4") + "ive")
    assert (tmp_path / "a").read_text("utf-8") == "dr?ive"


def test_a_place_that_is_not_writable_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        files.write_atomically(tmp_path / "file" / "config.yaml", "")
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError, match="cannot be written"):
        files.write_atomically(tmp_path / "folder", "")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "folder"]


def test_check_folder_creates_nothing(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    files.check_folder(tmp_path / "new" / "folder", "--out")
    for path in (tmp_path / "file", tmp_path / "file" / "folder"):
        with pytest.raises(InputError, match=r"--out: .*file is a file"):
            files.check_folder(path, "--out")
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_a_drive_that_is_not_there_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """As of Windows, where no parent of a folder need exist."""
    monkeypatch.setattr(os.path, "lexists", lambda path: False)
    with pytest.raises(InputError, match=r"--out: .* does not exist"):
        files.check_folder(Path("/drive/out"), "--out")


def test_a_folder_of_many_files_is_listed_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    listed = []
    entries = Path.iterdir

    def counted(folder: Path) -> Iterator[Path]:
        listed.append(folder)
        return entries(folder)

    monkeypatch.setattr(Path, "iterdir", counted)
    for k in range(20):
        files.write_atomically(tmp_path / f"{k}.png", b"image")
    assert len(listed) <= 1
    assert len(names(tmp_path)) == 20


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_several_writers_of_one_file_leave_a_whole_one(tmp_path: Path) -> None:
    """Each reads back a whole content at every moment, of whichever writer."""
    path = tmp_path / "file"
    contents = [bytes([letter]) * 200_000 for letter in b"abcd"]
    files.write_atomically(path, contents[0])

    def write_and_read(content: bytes) -> None:
        for _ in range(50):
            files.write_atomically(path, content)
            assert path.read_bytes() in contents

    with ThreadPoolExecutor(len(contents)) as pool:
        list(pool.map(write_and_read, contents))
    assert names(tmp_path) == ["file"]


def test_a_planted_link_is_not_followed(tmp_path: Path) -> None:
    secret = tmp_path / "secret"
    secret.write_text("keep me")
    out = tmp_path / "out"
    out.mkdir()
    for name in ("a.part", "a"):
        (out / name).symlink_to(secret)
    files.write_atomically(out / "a", "new")
    assert secret.read_text() == "keep me"
    assert (out / "a").read_text() == "new"
    assert not (out / "a").is_symlink()


def test_a_temporary_file_of_that_name_is_not_overwritten(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("secrets.token_hex", lambda _: "01234567")
    partial = files._partial(tmp_path / "a")
    partial.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(InputError, match="cannot be written"):
        files.write_atomically(tmp_path / "a", "new")
    assert not (tmp_path / "elsewhere").exists()


KILLED = """
import os, sys
from pathlib import Path
from probevo.storage import files

os.replace = Path.replace = lambda *_: os._exit(1)
if sys.argv[2] == "file":
    files.write_atomically(Path(sys.argv[1]) / "a", "half")
with files.written_together(Path(sys.argv[1])) as folder:
    files.write_atomically(folder / "a", "half")
"""


@pytest.mark.parametrize("kind", ["file", "folder"])
def test_what_a_killed_process_leaves_is_removed_by_the_next(kind: str, tmp_path: Path) -> None:
    source = str(Path(files.__file__).parents[2])
    killed = subprocess.run(
        [sys.executable, "-c", KILLED, str(tmp_path), kind],
        env=os.environ | {"PYTHONPATH": source},
        check=False,
    )
    assert killed.returncode == 1
    assert len(names(tmp_path)) == 1
    (tmp_path / "a.other.part").write_text("of somebody else")
    with files.written_together(tmp_path) as folder:
        files.write_atomically(folder / "b", "new")
    files.write_atomically(tmp_path / "a", "new")
    assert names(tmp_path) == ["a", "a.other.part", "b"]


@pytest.fixture
def earlier(tmp_path: Path) -> Iterator[Path]:
    """A folder with results; afterwards, they must still be there, and nothing else."""
    for name in ("a", "b"):
        (tmp_path / name).write_text("old")
    yield tmp_path
    assert names(tmp_path) == ["a", "b"]


def test_files_written_together_replace_the_earlier_ones(earlier: Path) -> None:
    with files.written_together(earlier) as folder:
        for name in ("a", "b"):
            files.write_atomically(folder / name, "new")
            assert (earlier / name).read_text() == "old"
    assert [(earlier / name).read_text() for name in ("a", "b")] == ["new", "new"]


@pytest.mark.parametrize("stop", [KeyboardInterrupt(), ValueError()])
def test_an_interruption_leaves_the_earlier_files(earlier: Path, stop: BaseException) -> None:
    def interrupted() -> None:
        with files.written_together(earlier) as folder:
            files.write_atomically(folder / "a", "new")
            raise stop

    with pytest.raises(type(stop)):
        interrupted()
    assert [(earlier / name).read_text() for name in ("a", "b")] == ["old", "old"]


def test_a_refusal_names_the_file_where_it_should_be(tmp_path: Path) -> None:
    with pytest.raises(InputError) as raised, files.written_together(tmp_path / "x") as folder:
        raise InputError(folder / "a.txt", "cannot be written: No space left on device")
    assert raised.value.where == str(tmp_path / "x" / "a.txt")
    (tmp_path / "a.txt").mkdir()
    with pytest.raises(InputError) as raised, files.written_together(tmp_path) as folder:
        files.write_atomically(folder / "a.txt", "new")
    assert raised.value.where == str(tmp_path / "a.txt")

"""Writing of files: whole or not at all, and bad places are refused."""

from pathlib import Path

import pytest

from probevo import files
from probevo.errors import InputError


def test_writing_replaces_whole_files_and_leaves_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "new" / "config.yaml"
    files.write_atomically(path, "a" * 1000)
    files.write_atomically(path, "b")
    assert path.read_text() == "b"
    assert [p.name for p in path.parent.iterdir()] == ["config.yaml"]


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

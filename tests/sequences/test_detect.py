"""Paths and formats that lead nowhere. That every format is found stands in test_formats."""

from pathlib import Path

import pytest

from probevo.errors import InputError
from probevo.sequences import open_sequence
from sequences.damage import assert_refused
from sequences.recordings import write_folder_sequence


def test_path_that_does_not_exist(tmp_path: Path) -> None:
    assert_refused(tmp_path / "nowhere", ["nowhere", "nothing is there"])


def test_path_that_is_some_other_file(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("hello")
    assert_refused(tmp_path / "notes.txt", ["notes.txt", "no recording"])


def test_folder_of_no_known_format_says_what_was_looked_for(tmp_path: Path) -> None:
    (tmp_path / "pictures").mkdir()
    assert_refused(
        tmp_path, ["found pictures", "image_00 (kitti-raw)", "calib.yaml or left (folder)"]
    )


@pytest.mark.parametrize(("format", "what"), [("tracks", "an .npz file"), ("kitty", "kitti-raw")])
def test_format_that_does_not_fit(format: str, what: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=what):
        open_sequence(write_folder_sequence(tmp_path), format)


def test_named_format_reports_what_it_misses(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"calib_cam_to_cam\.txt: this file is missing"):
        open_sequence(write_folder_sequence(tmp_path / "drive"), "kitti-raw")

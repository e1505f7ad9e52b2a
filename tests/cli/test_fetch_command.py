"""probevo fetch: the list, the licence, and recordings that are on disk."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from probevo.cli.main import main
from probevo.sequences import open_sequence
from sequences.recordings import write_euroc


def test_without_a_name_it_lists_what_there_is(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fetch"]) == 0
    listed = capsys.readouterr().out
    for word in ("kitti-odometry", "euroc/MH_01_easy", "tum-vi/room1", "tartanair/", "CC BY"):
        assert word in listed


def test_the_licence_is_shown_and_has_to_be_accepted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["fetch", "euroc/V1_01_easy", "--out", str(tmp_path / "out")]) == 2
    shown = capsys.readouterr()
    assert "ETH" in shown.out
    assert "none is published" in shown.out
    assert "--accept-licence" in shown.err
    assert not (tmp_path / "out").exists()


def test_a_recording_on_disk_is_unpacked_and_opens(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = write_euroc(tmp_path / "mine")
    archive = shutil.make_archive(str(tmp_path / "anything"), "zip", recording)
    words = ["fetch", "euroc/V1_01_easy", "--out", str(tmp_path / "out"), "--have", archive]
    assert main([*words, "--accept-licence"]) == 0
    assert "SHA-256" in capsys.readouterr().out
    assert len(open_sequence(tmp_path / "out" / "euroc" / "V1_01_easy")) > 1
    assert Path(archive).exists()


def test_a_place_that_is_not_there_is_named(tmp_path: Path) -> None:
    words = ["fetch", "euroc/V1_01_easy", "--have", str(tmp_path / "none.zip")]
    assert main([*words, "--accept-licence"]) == 2

"""``probevo demo``: runs on what is there, or says what to set."""

from pathlib import Path

import pytest

from probevo.cli.main import main
from sequences.recordings import write_kitti_odometry


def test_each_noise_model_gets_a_row_and_a_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write_kitti_odometry(tmp_path / "data" / "kitti_odometry")
    monkeypatch.setenv("PROBEVO_DATA", str(tmp_path / "data"))
    assert main(["demo", "--out", str(tmp_path / "out")]) == 0
    shown = capsys.readouterr().out
    for noise in ("fixed", "student-t"):
        assert f"07, {noise}" in shown
        assert str(tmp_path / "out" / f"07-{noise}" / "report.html") in shown
        assert (tmp_path / "out" / f"07-{noise}" / "report.html").exists()


def test_without_a_recording_it_says_what_to_set(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PROBEVO_DATA", str(tmp_path))
    assert main(["demo"]) == 2
    shown = capsys.readouterr().err
    assert f"PROBEVO_DATA: no recording to show; looked in {tmp_path}." in shown
    assert "Set PROBEVO_DATA to a folder" in shown

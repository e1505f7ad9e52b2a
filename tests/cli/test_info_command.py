"""``probevo info``: what it says of recordings, and which lines it marks."""

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from cli.rendering import write_wall
from probevo.cli.main import main
from sequences.damage import cut, replace
from sequences.recordings import write_folder_sequence, write_kitti_raw, write_tracks


def info(path: Path, capsys: pytest.CaptureFixture[str]) -> dict[str, str]:
    """Text of each row by its name."""
    assert main(["info", str(path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    column = lines[0].index(str(path)[:10])
    rows: dict[str, str] = {}
    for line in lines:
        name = line[:column].strip() or next(reversed(rows))
        rows[name] = f"{rows.get(name, '')} {line[column:]}".strip()
    return rows


def test_a_sane_recording(wall: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = info(wall, capsys)
    assert rows["format"] == "folder"
    assert rows["frames"] == "8 in 0.7 s (10.00 Hz)"
    assert rows["gaps"].startswith("none")
    assert "320×160 px" in rows["camera"]
    assert rows["truth"] == "8 of 8 frames, 1.1 m"
    assert "not swapped" in rows["matches"]
    assert not [name for name in rows if name.startswith("!")]


def test_imu_rate_and_coverage(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Packets that hold means come as two samples each; only one of them was recorded."""
    rows = info(write_folder_sequence(tmp_path / "folder"), capsys)
    assert "100.0 Hz" in rows["IMU"]
    rows = info(write_kitti_raw(tmp_path / "raw", frames=6, packet_delay_ns=4_000_000), capsys)
    assert rows["IMU"].startswith("6 samples, 10.0 Hz")
    assert "+4.0 to +4.0 ms" in rows["IMU to frames"]


def test_a_tracks_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = info(write_tracks(tmp_path), capsys)
    assert rows["format"] == "tracks"
    assert "6 tracks a frame" in rows["matches"]


def test_what_is_odd_is_marked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    swapped = write_wall(tmp_path / "swapped", 4, swapped=True)
    assert "swapped?" in info(swapped, capsys)["! matches"]
    replace("times.txt", "1000000000300000000", "1000000000900000000")(swapped)
    replace("calib.yaml", "baseline_m: 0.3", "baseline_m: 300.0")(swapped)
    rows = info(swapped, capsys)
    assert "after frame 2" in rows["! gaps"]
    assert "300 m is unusual" in rows["! baseline"]


def test_the_same_picture_twice_is_marked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording = write_wall(tmp_path / "wall", 4)
    shutil.rmtree(recording / "right")
    shutil.copytree(recording / "left", recording / "right")
    assert "left and right are identical" in info(recording, capsys)["! images"]
    rng = np.random.default_rng(0)
    for path in (recording / "right").iterdir():  # and where noise makes them differ
        picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE).astype(float)
        cv2.imwrite(str(path), np.clip(picture + rng.normal(0.0, 1.0, picture.shape), 0, 255).astype(np.uint8))
    assert "the same picture?" in info(recording, capsys)["! disparity"]


def test_a_damaged_image_does_not_hide_the_calibration(
    wall: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = shutil.copytree(wall, tmp_path / "wall")
    cut("left/000000.png", 0.5)(recording)
    assert main(["info", str(recording)]) == 2
    shown = capsys.readouterr()
    assert "320×160 px" in shown.out
    assert "left/000000.png: this image is damaged" in shown.err

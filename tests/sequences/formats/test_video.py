"""Videos: side by side and two files hold the frames that were written, with their times."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from cli.rendering import write_wall
from probevo.arrays import Image
from probevo.cli.main import main
from probevo.errors import InputError
from probevo.sequences import Sequence, open_sequence
from probevo.sequences.formats import video
from probevo.sequences.images import read_gray

FRAMES = 6
RATE_HZ = 12.5


def write_video(path: Path, images: list[Image], codec: str = "FFV1") -> Path:
    """Write grey images as a video; FFV1 loses nothing."""
    height, width = images[0].shape
    code = cv2.VideoWriter.fourcc(*codec)
    writer = cv2.VideoWriter(str(path), code, RATE_HZ, (width, height))
    assert writer.isOpened(), f"this OpenCV has no {codec}"
    for image in images:
        writer.write(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
    writer.release()
    return path


@pytest.fixture
def wall(tmp_path: Path) -> Path:
    return write_wall(tmp_path / "wall", FRAMES)


def sides(wall: Path) -> tuple[list[Image], list[Image]]:
    left, right = (
        [read_gray(file) for file in sorted((wall / side).iterdir())] for side in ("left", "right")
    )
    return left, right


def side_by_side(wall: Path, folder: Path, name: str = "drive.avi", codec: str = "FFV1") -> Path:
    folder.mkdir(exist_ok=True)
    shutil.copy(wall / "calib.yaml", folder)
    left, right = sides(wall)
    both = [np.hstack(pair) for pair in zip(left, right, strict=True)]
    return write_video(folder / name, both, codec)


def two_files(wall: Path, folder: Path, suffix: str = ".mkv") -> Path:
    folder.mkdir(exist_ok=True)
    shutil.copy(wall / "calib.yaml", folder)
    for side, images in zip(("left", "right"), sides(wall), strict=True):
        write_video(folder / f"{side}{suffix}", images)
    return folder


def assert_same_images(sequence: Sequence, wall: Path) -> None:
    left, right = sides(wall)
    frames = list(sequence)
    assert len(frames) == len(sequence) == FRAMES
    for index, frame in enumerate(frames):
        assert frame.index == index
        np.testing.assert_array_equal(frame.left, left[index])
        np.testing.assert_array_equal(frame.right, right[index])


@pytest.mark.parametrize("kind", ["one", "two"])
def test_what_was_written_is_read_back(kind: str, wall: Path, tmp_path: Path) -> None:
    """Images to the last bit, stamps to the nanosecond, and that twice."""
    write = side_by_side if kind == "one" else two_files
    sequence = open_sequence(write(wall, tmp_path / "video"))
    assert sequence.format == "video"
    assert sequence.camera == open_sequence(wall).camera
    expected_ns = np.arange(FRAMES) * 80_000_000
    np.testing.assert_array_equal(sequence.stamps_ns, expected_ns)
    assert_same_images(sequence, wall)
    assert_same_images(sequence, wall)


def test_endings_in_capitals_are_those_of_videos(wall: Path, tmp_path: Path) -> None:
    folder = two_files(wall, tmp_path / "video")
    for side in ("left", "right"):
        (folder / f"{side}.mkv").rename(folder / f"{side}.MKV")
    assert_same_images(open_sequence(folder), wall)


def test_times_that_do_not_ascend_are_reported(
    wall: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    content = video._content

    def repeated(path: Path) -> video._Content:
        found = content(path)
        found.times_ms[3] = found.times_ms[2]
        return found

    monkeypatch.setattr(video, "_content", repeated)
    sequence = open_sequence(side_by_side(wall, tmp_path / "video"))
    np.testing.assert_array_equal(np.diff(sequence.stamps_ns), 80_000_000)
    text = dict(sequence.notes)["! times"]  # type: ignore[attr-defined]
    assert text == "of the container, do not ascend; 12.5 Hz of its header instead"


def test_a_rate_takes_the_place_of_the_containers_times(wall: Path, tmp_path: Path) -> None:
    sequence = open_sequence(two_files(wall, tmp_path / "video"), rate_hz=50.0)
    np.testing.assert_array_equal(np.diff(sequence.stamps_ns), 20_000_000)


@pytest.mark.parametrize(("name", "codec"), [("drive.mp4", "mp4v"), ("drive.avi", "MJPG")])
def test_a_lossy_video_is_close(name: str, codec: str, wall: Path, tmp_path: Path) -> None:
    sequence = open_sequence(side_by_side(wall, tmp_path / "video", name, codec))
    left, _ = sides(wall)
    for frame, image in zip(sequence, left, strict=True):
        assert frame.left is not None
        assert np.abs(frame.left.astype(float) - image).mean() < 8.0


@pytest.mark.usefixtures("undrawn")
def test_it_runs_as_from_images(wall: Path, tmp_path: Path) -> None:
    """The same bytes of the path, where the times are the same."""
    folder = shutil.copytree(wall, tmp_path / "images")
    (folder / "times.txt").unlink()
    (folder / "poses.txt").unlink()
    video = side_by_side(wall, tmp_path / "video")
    paths = []
    for number, source in enumerate((folder, video)):
        out = tmp_path / f"out{number}"
        assert main(["run", str(source), "--rate-hz", "10", "--out", str(out)]) == 0
        paths.append((out / "trajectory.tum").read_bytes())
    assert paths[0] == paths[1]


def test_raw_videos_are_rectified_by_a_calibration_file(wall: Path, tmp_path: Path) -> None:
    """As raw images of a folder are, to the last bit."""
    calibration = tmp_path / "camchain.yaml"
    camera = "{{camera_model: pinhole, intrinsics: [200.0, 200.0, 159.5, 79.5],"
    camera += " distortion_model: radtan, distortion_coeffs: [-0.05, 0.01, 0.0, 0.0],"
    camera += " resolution: [320, 160]{}}}"
    move = ", T_cn_cnm1: [[1, 0, 0, -0.3], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]"
    calibration.write_text(f"cam0: {camera.format('')}\ncam1: {camera.format(move)}\n")
    video = side_by_side(wall, tmp_path / "video")
    (tmp_path / "video" / "calib.yaml").unlink()
    with pytest.raises(InputError, match=r"calib\.yaml"):
        open_sequence(video)
    rectified = open_sequence(video, calibration=calibration)
    expected = open_sequence(wall, calibration=calibration)
    for frame, other in zip(rectified, expected, strict=True):
        np.testing.assert_array_equal(frame.left, other.left)
        np.testing.assert_array_equal(frame.right, other.right)


def test_a_video_that_ends_a_little_earlier_is_reported(wall: Path, tmp_path: Path) -> None:
    folder = two_files(wall, tmp_path / "video")
    _, right = sides(wall)
    write_video(folder / "right.mkv", right[:-1])
    sequence = open_sequence(folder)
    assert len(sequence) == FRAMES - 1
    assert any(name == "! pairs" for name, _ in sequence.notes)  # type: ignore[attr-defined]
    write_video(folder / "right.mkv", right[:-3])
    with pytest.raises(InputError, match="6 frames, the right one 3"):
        open_sequence(folder)


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("empty", "cannot read this as a video"),
        ("text", "cannot read this as a video"),
        ("half", "cannot be decoded|as a video|frames that can be read|frames, the right"),
        ("missing", "called right"),
        ("twice", "left.avi"),
        ("size", "sizes"),
        ("calibration", "for images of 340"),
    ],
)
def test_faults_are_named(fault: str, words: str, wall: Path, tmp_path: Path) -> None:
    folder = two_files(wall, tmp_path / "video")
    if fault == "empty":
        (folder / "right.mkv").write_bytes(b"")
    elif fault == "text":
        (folder / "right.mkv").write_text("no video at all\n" * 100)
    elif fault == "half":
        data = (folder / "right.mkv").read_bytes()
        (folder / "right.mkv").write_bytes(data[: len(data) // 3])
    elif fault == "missing":
        (folder / "right.mkv").unlink()
    elif fault == "twice":
        shutil.copy(folder / "left.mkv", folder / "left.avi")
    elif fault == "size":
        write_video(folder / "right.mkv", [image[:, :-2] for image in sides(wall)[1]])
    else:
        text = (folder / "calib.yaml").read_text()
        (folder / "calib.yaml").write_text(text.replace("width_px: 320", "width_px: 340"))
    with pytest.raises(InputError, match=words):
        list(open_sequence(folder))

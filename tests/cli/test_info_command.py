"""``probevo info``: what it says about recordings, and which lines it marks as warnings."""

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from cli.rendering import write_wall
from probevo.cli.info import MAX_OFF_CENTER, describe
from probevo.cli.main import main
from probevo.sequences import open_sequence
from sequences.calibrations.test_calibration_files import kalibr, write_raw_pair, write_yaml
from sequences.damage import cut, replace
from sequences.recordings import (
    tracks_arrays,
    write_folder_sequence,
    write_image,
    write_kitti_raw,
    write_tracks,
)
from strips import write_strips


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


def test_a_good_recording(wall: Path, capsys: pytest.CaptureFixture[str]) -> None:
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


def test_an_imu_too_slow_for_the_window_is_marked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What info announces is what a run does: packets at the rate of the frames are too few."""
    rows = info(write_kitti_raw(tmp_path / "raw", frames=6), capsys)
    assert "ms, where the window needs 5, or one in each 18 ms" in rows["! IMU"]
    assert rows["use of IMU"].startswith("gyro to start the tracking")
    rows = info(write_folder_sequence(tmp_path / "folder"), capsys)
    assert "! IMU" not in rows
    assert rows["use of IMU"].startswith("in the window, once it agrees")


def test_a_tracks_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = info(write_tracks(tmp_path), capsys)
    assert rows["format"] == "tracks"
    assert "6 tracks per frame" in rows["matches"]


def test_what_is_unusual_is_marked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    swapped = write_wall(tmp_path / "swapped", 4, swapped=True)
    assert "swapped?" in info(swapped, capsys)["! matches"]
    replace("times.txt", "1000000000300000000", "1000000000900000000")(swapped)
    replace("calib.yaml", "baseline_m: 0.3", "baseline_m: 300.0")(swapped)
    rows = info(swapped, capsys)
    assert "after frame 2" in rows["! gaps"]
    assert "300 m is unusual" in rows["! baseline"]


def test_a_calibration_of_another_resolution_is_marked(
    wall: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = shutil.copytree(wall, tmp_path / "wall")
    for old, new in (
        ("cu_px: 159.5", "cu_px: 80.0"),
        ("cv_px: 79.5", "cv_px: 40.0"),
        ("fv_px: 200.0", "fv_px: 100.0"),
    ):
        replace("calib.yaml", old, new)(recording)
    rows = info(recording, capsys)
    assert (
        rows["! center"] == "(80, 40) is the centre of an image of 160×80 px."
        " Was the camera calibrated at another resolution?"
    )
    assert rows["! focal length"].startswith("fu is 200.0 px, fv 100.0 px")


@pytest.mark.parametrize("scale", [1.0, 0.5])
def test_of_a_rectified_recording_the_raw_centers_count(scale: float, tmp_path: Path) -> None:
    """A right camera ahead of the left one: the rectified centre is off, and that of a calibration
    at half the size is, too."""
    content = kalibr(coefficients=(0.0, 0.0, 0.0, 0.0))
    content["cam1"]["T_cn_cnm1"] = [[1, 0, 0, -0.1], [0, 1, 0, 0], [0, 0, 1, -0.015], [0, 0, 0, 1]]
    for camera in content.values():
        fu_px, fv_px, cu_px, cv_px = camera["intrinsics"]
        camera["intrinsics"] = [fu_px, fv_px, scale * cu_px, scale * cv_px]
    write_yaml(write_raw_pair(tmp_path) / "calib.yaml", content)
    sequence = open_sequence(tmp_path)
    assert abs(sequence.camera.cu_px / 64.0 - 0.5) > MAX_OFF_CENTER
    assert ("! center" in dict(describe(sequence))) == (scale < 1.0)


def test_few_matches_and_implausible_distances_are_marked(
    wall: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without rectification, a feature is in another row of the right image."""
    recording = shutil.copytree(wall, tmp_path / "wall")
    replace("calib.yaml", "baseline_m: 0.3", "baseline_m: 300.0")(recording)
    distance = info(recording, capsys)["! disparity"]
    assert distance.endswith("and the focal length in pixels of these images?")
    for path in (recording / "right").iterdir():
        pixels = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        write_image(path, np.roll(pixels, 15, axis=0))
    assert "rectified, sharp and textured?" in info(recording, capsys)["! matches"]


def test_some_matches_are_few(
    wall: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("probevo.cli.info.MIN_TRACKS", 10_000)
    assert "These are few. Are the images rectified" in info(wall, capsys)["! matches"]


@pytest.mark.parametrize(("step_ns", "rate"), [(100_000, "10000 Hz"), (10**11, "0.01 Hz")])
def test_a_rate_that_no_camera_has_is_marked(
    wall: Path, tmp_path: Path, step_ns: int, rate: str, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = shutil.copytree(wall, tmp_path / "wall")
    (recording / "times.txt").write_text("\n".join(str(step_ns * k) for k in range(8)))
    assert info(recording, capsys)["! rate"].startswith(f"{rate} is unusual")


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_features_get_questions_of_their_own(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arrays = tracks_arrays(points=20)
    swapped = write_tracks(tmp_path, **arrays | {"uv": arrays["uv"][:, [2, 3, 0, 1]]})
    assert (
        "Are left and right swapped? Exchange columns 0 and 2" in info(swapped, capsys)["! matches"]
    )
    assert main(["run", str(swapped), "--out", str(tmp_path / "out")]) == 2
    assert "Exchange columns 0 and 2, and 1 and 3, of uv." in capsys.readouterr().err
    fresh = write_tracks(tmp_path, **arrays | {"track": np.arange(80)})
    assert info(fresh, capsys)["! matches"].endswith("Do the ids repeat from frame to frame?")
    same = write_tracks(tmp_path, **arrays | {"uv": arrays["uv"][:, [0, 1, 0, 1]]})
    assert info(same, capsys)["! disparity"].endswith("Are columns 0 and 2 of uv the same?")


def test_the_same_image_twice_is_marked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording = write_wall(tmp_path / "wall", 4)
    shutil.rmtree(recording / "right")
    shutil.copytree(recording / "left", recording / "right")
    assert "left and right are identical" in info(recording, capsys)["! images"]
    rng = np.random.default_rng(0)
    for path in (recording / "right").iterdir():  # and where noise makes them differ
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE).astype(float)
        cv2.imwrite(
            str(path),
            np.clip(image + rng.normal(0.0, 1.0, image.shape), 0, 255).astype(np.uint8),
        )
    assert "the same image?" in info(recording, capsys)["! disparity"]


def test_a_damaged_image_does_not_hide_the_calibration(
    wall: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = shutil.copytree(wall, tmp_path / "wall")
    cut("left/000000.png", 0.5)(recording)
    assert main(["info", str(recording)]) == 2
    shown = capsys.readouterr()
    assert "320×160 px" in shown.out
    assert "left/000000.png: this image is damaged" in shown.err


@pytest.mark.parametrize("rate", ["1e300", "1e18", "-1e5"])
def test_an_implausible_angular_rate_is_marked(
    rate: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = write_folder_sequence(tmp_path)
    replace("imu.csv", ",0.1,", f",{rate},")(recording)
    rows = info(recording, capsys)
    assert "1 of 41 have an angular rate over 2000 rad/s" in rows["! IMU samples"]


@pytest.mark.parametrize("late", [0, 1])
def test_right_images_of_other_frames_are_marked(
    late: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = info(write_strips(tmp_path / "strips", 18, right_late=late), capsys)
    assert ("! timing" in rows) == bool(late)
    if late:
        assert rows["! timing"].startswith("The right images are one frame late")


def test_images_that_repeat_are_marked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As of a video that was stored at twice the camera's rate."""
    recording = write_strips(tmp_path / "strips", 18)
    assert "! repetition" not in info(recording, capsys)
    for side in ("left", "right"):
        for copied in range(1, 18, 2):
            shutil.copy(
                recording / side / f"{copied - 1:06d}.png", recording / side / f"{copied:06d}.png"
            )
    assert info(recording, capsys)["! repetition"].startswith("The images of 9 of 18 frames")


@pytest.mark.parametrize("level", [0, 255])
def test_images_that_show_nothing_do_not_count_as_repeated(
    level: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """They were once called those of a driver that hangs."""
    recording = write_strips(tmp_path / "strips", 18)
    for side in ("left", "right"):
        for index in range(4, 12):
            file = recording / side / f"{index:06d}.png"
            cv2.imwrite(str(file), np.full_like(cv2.imread(str(file), 0), level))
    assert "! repetition" not in info(recording, capsys)


@pytest.mark.parametrize("gain", [1.0, 0.5, 0.1])
def test_cameras_that_are_not_exposed_alike_are_marked(
    gain: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = write_wall(tmp_path / "wall", 4)
    for path in sorted((recording / "right").iterdir()):
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        assert image is not None
        write_image(path, np.round(gain * image).astype(np.uint8))
    rows = info(recording, capsys)
    assert ("! exposure" in rows) == (gain < 1.0)
    if gain < 1.0:
        assert rows["! exposure"].startswith(f"right images have {gain:.2g} times the contrast")


@pytest.mark.parametrize("is_mosaic", [False, True])
def test_raw_images_of_a_colour_camera_are_marked(
    is_mosaic: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = write_wall(tmp_path / "wall", 4)
    if is_mosaic:
        for side in ("left", "right"):
            for path in sorted((recording / side).iterdir()):
                image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
                assert image is not None
                image[::2, ::2] = np.round(0.8 * image[::2, ::2])  # red
                image[1::2, 1::2] = np.round(0.65 * image[1::2, 1::2])  # blue
                write_image(path, image)
    rows = info(recording, capsys)
    assert ("! mosaic" in rows) == is_mosaic
    if is_mosaic:
        assert "differ by 54 %" in rows["! mosaic"]  # 1 / 0.65

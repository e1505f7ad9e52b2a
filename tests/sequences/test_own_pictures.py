"""Folders as people have them: times in file names or at a rate, 16 bits, colour, other formats."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from cli.rendering import write_wall
from probevo.arrays import AnyArray
from probevo.cli.main import main
from probevo.errors import InputError
from probevo.run_config import read_config
from probevo.sequences import open_sequence
from probevo.sequences.gray_range import GrayRange, spread_indices
from probevo.sequences.images import read_gray
from probevo.sequences.recording import StereoRecording
from probevo.sequences.stamps import stamps_of_names
from sequences.recordings import (
    HEIGHT_PX,
    WIDTH_PX,
    image,
    write_euroc,
    write_folder_sequence,
    write_image,
    write_lines,
)


def without_times(root: Path) -> Path:
    path = write_folder_sequence(root, imu=False, truth=False)
    (path / "times.txt").unlink()
    return path


def rename(path: Path, side: str, names: list[str]) -> None:
    for old, new in zip(sorted((path / side).iterdir()), names, strict=True):
        old.rename(old.with_name(f"{new}.png"))


def named_by_stamps(root: Path, steps: tuple[int, ...]) -> Path:
    """Write four pairs named by stamps that are so many tenths of a second apart."""
    path = without_times(root)
    stamps_ns = 1520530308199447626 + 100_000_000 * np.cumsum((0, *steps))
    for side in ("left", "right"):
        rename(path, side, [str(stamp_ns) for stamp_ns in stamps_ns])
    return path


# --- times ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("names", "stamps_ns"),
    [
        (
            ["1520530308199447626", "1520530308249448626"],
            [1520530308199447626, 1520530308249448626],
        ),
        (
            ["left_1520530308199447", "left_1520530308249448"],
            [1520530308199447000, 1520530308249448000],
        ),
        (["1520530308199", "1520530308249"], [1520530308199000000, 1520530308249000000]),
        (["1520530308.199447626", "1520530308.05"], [1520530308199447626, 1520530308050000000]),
        (["1520530308.0", "1520530308.25"], [1520530308000000000, 1520530308250000000]),
        (["000000", "000001"], None),
        (["0000000012.25", "0000000012.75"], None),
        (["12.25", "12.75"], None),
        (["20240131120000.123", "20240131120001.123"], None),
        (["20240131_120059.900", "20240131_120100.000"], None),
        (["0000000000000007", "0000000000000008"], None),
        (["0000000000000007", "1520530308249000"], None),
        (["1520530308199447626", "7"], None),
        (["1520530308199447626", "last"], None),
        ([], None),
    ],
)
def test_stamps_in_file_names(names: list[str], stamps_ns: list[int] | None) -> None:
    found = stamps_of_names([Path(f"{name}.png") for name in names])
    assert (None if found is None else found.tolist()) == stamps_ns


def test_nanoseconds_without_leading_zeros_are_refused(tmp_path: Path) -> None:
    """The frame at 13 ms was once read as one at 130 ms, between two others."""
    path = without_times(tmp_path)
    names = [f"1600000000.{nanoseconds}" for nanoseconds in (13000000, 63000000, 113000000)]
    names.append("1600000000.163000000")
    for side in ("left", "right"):
        rename(path, side, names)
    with pytest.raises(InputError, match="or nanoseconds without leading zeros") as refused:
        open_sequence(path)
    assert "1600000000.113000000.png and 1600000000.13000000.png" in refused.value.what
    assert "to nine digits" in refused.value.cure
    for side in ("left", "right"):
        for file in (path / side).iterdir():
            seconds, nanoseconds = file.stem.split(".")
            file.rename(file.with_stem(f"{seconds}.{int(nanoseconds):09d}"))
    np.testing.assert_array_equal(np.diff(open_sequence(path).stamps_ns), 50_000_000)


def test_a_folder_with_stamps_as_names(tmp_path: Path) -> None:
    path = without_times(tmp_path)
    names = [str(1520530308199447626 + k * 50_000_000) for k in range(4)]
    rename(path, "left", names)
    rename(path, "right", names)
    assert open_sequence(path).stamps_ns.tolist() == [int(name) for name in names]


def test_stamps_as_names_pair_the_images(tmp_path: Path) -> None:
    """The names differ by some microseconds, and one right image is missing."""
    path = without_times(tmp_path)
    start_ns = 1520530308199447626
    rename(path, "left", [str(start_ns + k * 50_000_000) for k in range(4)])
    rename(path, "right", [str(start_ns + k * 50_000_000 + 3_000) for k in range(4)])
    sorted((path / "right").iterdir())[1].unlink()
    sequence = open_sequence(path)
    assert isinstance(sequence, StereoRecording)
    assert ((sequence.stamps_ns - start_ns) // 50_000_000).tolist() == [0, 2, 3]
    np.testing.assert_array_equal(list(sequence)[1].right, image(2, right=True))
    assert "1 left, 0 right" in dict(sequence.notes)["! pairs"]


@pytest.mark.parametrize("is_marked", [False, True])
def test_the_samples_of_euroc_are_read_as_they_are(tmp_path: Path, is_marked: bool) -> None:
    """Behind a byte order mark, too."""
    path = write_folder_sequence(tmp_path)
    before = open_sequence(path)
    lines = (path / "imu.csv").read_text("utf-8").splitlines()
    names = [f"w_RS_S_{axis} [rad s^-1]" for axis in "xyz"]
    names += [f"a_RS_S_{axis} [m s^-2]" for axis in "xyz"]
    mark = "\ufeff" if is_marked else ""
    write_lines(path / "imu.csv", [mark + ",".join(["#timestamp [ns]", *names]), *lines[1:]])
    after = open_sequence(path)
    for frame, expected in zip(after, before, strict=True):
        assert (frame.imu is None) == (expected.imu is None)
        if frame.imu is not None and expected.imu is not None:
            np.testing.assert_array_equal(frame.imu.gyro_rad_s, expected.imu.gyro_rad_s)
            np.testing.assert_array_equal(frame.imu.accel_m_s2, expected.imu.accel_m_s2)
    assert after.imu is not None


def test_what_a_program_of_windows_has_saved_is_read(tmp_path: Path) -> None:
    """Text that begins with a byte order mark."""
    path = write_folder_sequence(tmp_path)
    expected = open_sequence(path).stamps_ns
    for name in ("calib.yaml", "times.txt", "imu.csv", "poses.txt"):
        file = path / name
        file.write_text(file.read_text("utf-8"), "utf-8-sig")
    np.testing.assert_array_equal(open_sequence(path).stamps_ns, expected)


def test_hidden_files_beside_the_images_are_none(tmp_path: Path) -> None:
    """macOS leaves them on disks of other systems."""
    path = write_folder_sequence(tmp_path)
    expected = len(open_sequence(path))
    for side in ("left", "right"):
        names = sorted(image.name for image in (path / side).iterdir())
        for name in names:
            (path / side / f"._{name}").write_bytes(b"\0\5\26\7")
    assert len(list(open_sequence(path))) == expected


def test_whose_the_true_poses_are_is_no_answer_without_any(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"--truth-of: .*--truth"):
        open_sequence(write_folder_sequence(tmp_path), truth_of="imu")


def test_cameras_that_are_not_triggered_together_may_be_given_more_time(tmp_path: Path) -> None:
    path = without_times(tmp_path)
    start_ns = 1520530308199447626
    rename(path, "left", [str(start_ns + k * 50_000_000) for k in range(4)])
    rename(path, "right", [str(start_ns + k * 50_000_000 + 8_000_000) for k in range(4)])
    with pytest.raises(InputError, match=r"within 2 ms(?s:.*)--pair-tolerance-ms"):
        open_sequence(path)
    assert len(open_sequence(path, pair_tolerance_ms=10.0)) == 4


def test_a_rate_gives_the_times(tmp_path: Path) -> None:
    path = without_times(tmp_path)
    with pytest.raises(InputError, match=r"times\.txt: this file is missing(?s:.*)--rate-hz"):
        open_sequence(path)
    stamps_ns = open_sequence(path, rate_hz=30.0).stamps_ns
    assert stamps_ns.tolist() == [0, 33_333_333, 66_666_667, 100_000_000]


def test_a_rate_beside_times_has_to_agree_with_them(tmp_path: Path) -> None:
    path = write_folder_sequence(tmp_path / "recording")
    assert len(open_sequence(path, rate_hz=10.0)) == len(open_sequence(path))
    with pytest.raises(InputError, match=r"times\.txt: the rate of 20 Hz contradicts its stamps"):
        open_sequence(path, rate_hz=20.0)
    with pytest.raises(InputError, match="rate_hz"):
        open_sequence(path, rate_hz=-1.0)


@pytest.mark.parametrize(
    ("numbers", "counted"),
    [
        ((3, 4, 5, 8), (0, 1, 2, 5)),
        ((0, 10, 20, 30), (0, 1, 2, 3)),
    ],
    ids=["two lost frames", "every tenth frame"],
)
def test_a_number_that_is_left_out_is_a_lost_frame(
    numbers: tuple[int, ...], counted: tuple[int, ...], tmp_path: Path
) -> None:
    path = without_times(tmp_path)
    for side in ("left", "right"):
        for index, number in reversed(list(enumerate(numbers))):
            (path / side / f"{index:06d}.png").rename(path / side / f"{number:06d}.png")
    stamps_ns = open_sequence(path, rate_hz=10.0).stamps_ns
    np.testing.assert_array_equal(stamps_ns, 100_000_000 * np.array(counted))


@pytest.mark.parametrize(
    ("steps", "rate_hz", "fragment"),
    [
        ((1, 1, 1), 20.0, r"are 0\.1 s apart \(10 Hz\)\.(?s:.*)Leave out --rate-hz"),
        ((1, 1, 1), 8.9, r"\(10 Hz\)"),
        ((1, 3, 1), 10.0, r"have a gap of 0\.300 s after frame 1\."),
    ],
)
def test_a_rate_that_contradicts_the_names_is_refused(
    steps: tuple[int, ...], rate_hz: float, fragment: str, tmp_path: Path
) -> None:
    path = named_by_stamps(tmp_path, steps)
    with pytest.raises(InputError, match=fragment):
        open_sequence(path, rate_hz=rate_hz)


def test_beside_a_rate_that_agrees_the_times_are_those_of_the_names(tmp_path: Path) -> None:
    path = named_by_stamps(tmp_path, (1, 1, 1))
    expected = open_sequence(path).stamps_ns
    np.testing.assert_array_equal(open_sequence(path, rate_hz=10.5).stamps_ns, expected)


def test_the_command_line_gives_rate_and_calibration(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = without_times(tmp_path)
    assert main(["info", str(path), "--rate-hz", "20"]) == 0
    assert "20.00 Hz" in capsys.readouterr().out
    assert main(["info", str(path), "--rate-hz", "20", "--calibration", str(path / "none")]) == 2
    assert "none: this file is missing" in capsys.readouterr().err


# --- pictures ------------------------------------------------------------------------------------


def convert(path: Path, suffix: str, change: Any = lambda pixels: pixels) -> None:
    for file in [*(path / "left").iterdir(), *(path / "right").iterdir()]:
        pixels = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
        file.unlink()
        write_image(file.with_suffix(suffix), change(pixels))


@pytest.mark.parametrize("suffix", [".png", ".pgm", ".tif", ".tiff", ".bmp"])
def test_lossless_formats(suffix: str, tmp_path: Path) -> None:
    path = write_folder_sequence(tmp_path, imu=False)
    convert(path, suffix)
    for frame in open_sequence(path):
        np.testing.assert_array_equal(frame.left, image(frame.index))
        np.testing.assert_array_equal(frame.right, image(frame.index, right=True))


@pytest.mark.parametrize("suffix", [".jpg", ".webp"])
def test_lossy_formats(suffix: str, tmp_path: Path) -> None:
    smooth = cv2.GaussianBlur(image(0), (0, 0), 4.0)
    write_image(tmp_path / f"picture{suffix}", smooth)
    np.testing.assert_allclose(read_gray(tmp_path / f"picture{suffix}"), smooth, atol=6)


@pytest.mark.parametrize("suffix", [".png", ".ppm", ".tif", ".bmp"])
def test_colour_becomes_its_luma(suffix: str, tmp_path: Path) -> None:
    colour = np.random.default_rng(1).integers(0, 256, (HEIGHT_PX, WIDTH_PX, 3), dtype=np.uint8)
    write_image(tmp_path / f"picture{suffix}", colour)
    expected = cv2.cvtColor(colour, cv2.COLOR_BGR2GRAY)
    np.testing.assert_array_equal(read_gray(tmp_path / f"picture{suffix}"), expected)


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".pgm", ".ppm", ".tif", ".webp", ".bmp"])
def test_a_picture_that_was_cut_off_is_refused(suffix: str, tmp_path: Path) -> None:
    pixels: AnyArray = image(0)
    if suffix == ".ppm":
        pixels = cv2.cvtColor(pixels, cv2.COLOR_GRAY2BGR)
    file = tmp_path / f"picture{suffix}"
    write_image(file, pixels)
    whole = file.read_bytes()
    for share in (0.02, 0.5, 0.97):
        file.write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(InputError, match="damaged"):
            read_gray(file)


@pytest.mark.parametrize("suffix", [".png", ".pgm", ".tif"])
def test_sixteen_bits_are_scaled_by_one_range(suffix: str, tmp_path: Path) -> None:
    path = write_folder_sequence(tmp_path, imu=False)
    convert(path, suffix, lambda pixels: 2000 + 8 * pixels.astype(np.uint16))
    for frame in open_sequence(path):
        np.testing.assert_allclose(frame.left, image(frame.index), atol=3)
        np.testing.assert_allclose(frame.right, image(frame.index, right=True), atol=3)


def test_a_dark_start_does_not_set_the_range_of_the_others(tmp_path: Path) -> None:
    """The first five of twelve frames once did, and all others were white."""
    path = write_folder_sequence(tmp_path, 12, imu=False)
    for side in ("left", "right"):
        for index, file in enumerate(sorted((path / side).iterdir())):
            pixels = cv2.imread(str(file), cv2.IMREAD_UNCHANGED).astype(np.uint16)
            write_image(file, 300 + pixels // 60 if index < 5 else 300 + 200 * pixels)
    for frame in list(open_sequence(path))[5:]:
        np.testing.assert_allclose(frame.left, image(frame.index), atol=5)


@pytest.mark.parametrize("count", [1, 2, 9, 10, 5500])
def test_the_range_is_that_of_frames_all_over_the_recording(count: int) -> None:
    indices = spread_indices(count)
    assert len(indices) == min(count, 9)
    assert (indices[0], indices[-1]) == (0, count - 1)
    gaps = np.diff(indices)
    assert len(gaps) == 0 or gaps.max() - gaps.min() <= 1


def test_a_damaged_picture_does_not_set_the_range(tmp_path: Path) -> None:
    path = write_folder_sequence(tmp_path, imu=False)
    convert(path, ".png", lambda pixels: 2000 + 8 * pixels.astype(np.uint16))
    last = max((path / "left").iterdir())
    last.write_bytes(last.read_bytes()[:100])
    frames = iter(open_sequence(path))
    np.testing.assert_allclose(next(frames).left, image(0), atol=3)
    with pytest.raises(InputError, match="damaged"):
        list(frames)


def test_the_range_is_that_of_percentiles() -> None:
    values = np.arange(10_000, dtype=np.uint16).reshape(100, 100)
    gray_range = GrayRange.of([values, values])
    assert (gray_range.low, gray_range.high) == (49, 9950)
    scaled = gray_range.to_8_bits(values)
    exact = np.clip((values.astype(float) - 49) * 255 / (9950 - 49), 0, 255)
    np.testing.assert_allclose(scaled, exact, atol=0.51)


def test_a_dull_picture_is_not_amplified() -> None:
    dull = np.full((10, 10), 500, np.uint16)
    dull[0, 0] = 503
    assert GrayRange.of([dull]).to_8_bits(dull)[0, 0] <= 3


def test_sixteen_bits_among_eight_are_refused(tmp_path: Path) -> None:
    path = write_folder_sequence(tmp_path, imu=False)
    write_image(path / "left" / "000003.png", image(3).astype(np.uint16))
    with pytest.raises(InputError, match="uint16; expected 8 bits"):
        list(open_sequence(path))


# --- a run ---------------------------------------------------------------------------------------


@pytest.mark.usefixtures("undrawn")
def test_a_run_can_be_repeated_from_its_settings(tmp_path: Path, monkeypatch: Any) -> None:
    """The settings have the calibration by its absolute path, and the rate."""
    write_wall(tmp_path / "wall", 4)
    (tmp_path / "wall" / "times.txt").unlink()
    camera = {
        "camera_model": "pinhole",
        "intrinsics": [200.0, 200.0, 159.5, 79.5],
        "distortion_model": "none",
        "resolution": [320, 160],
    }
    T_right_left = np.eye(4)
    T_right_left[0, 3] = -0.3
    chain = {"cam0": camera, "cam1": camera | {"T_cn_cnm1": T_right_left.tolist()}}
    (tmp_path / "chain.yaml").write_text(yaml.safe_dump(chain))
    monkeypatch.chdir(tmp_path)
    flags = ["--calibration", "chain.yaml", "--rate-hz", "10"]
    assert main(["run", "wall", "--out", "first", *flags]) == 0
    config = read_config(tmp_path / "first" / "config.yaml")
    assert config.calibration == tmp_path / "chain.yaml"
    assert config.rate_hz == 10.0
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert main(["run", "--config", "../first/config.yaml", "--out", "second"]) == 0
    first = (tmp_path / "first" / "trajectory.tum").read_bytes()
    assert first == (tmp_path / "elsewhere" / "second" / "trajectory.tum").read_bytes()


def test_sixteen_bits_of_the_euroc_layout_are_scaled_as_those_of_a_folder(tmp_path: Path) -> None:
    mav = write_euroc(tmp_path)
    for file in mav.glob("cam*/data/*.png"):
        pixels = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
        cv2.imwrite(str(file), 2000 + 8 * pixels.astype(np.uint16))
    for frame in open_sequence(mav):
        np.testing.assert_allclose(frame.left, image(frame.index), atol=3)

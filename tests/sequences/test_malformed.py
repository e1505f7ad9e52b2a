"""Malformed recordings: each is refused with the file, the field and what is wrong with it."""

from pathlib import Path

import numpy as np
import pytest

from probevo.errors import InputError
from probevo.sequences import open_sequence
from sequences.damage import (
    Edit,
    append,
    assert_refused,
    clear,
    cut,
    drop_line,
    remove,
    replace,
    swap_lines,
    write,
)
from sequences.recordings import (
    WIDTH_PX,
    image,
    write_euroc,
    write_folder_sequence,
    write_kitti_odometry,
    write_kitti_raw,
)

T0 = "1400000000.123456789"
T_ROW = "[0.0, -1.0, 0.0, 0.1]"

FOLDER: dict[str, tuple[Edit, list[str]]] = {
    "right image missing": (
        remove("right/000002.png"),
        ["right/000002.png", "missing", "4 images", "3"],
    ),
    "left image missing": (remove("left/000003.png"), ["left/000003.png", "missing"]),
    "right folder missing": (remove("right"), ["right", "missing"]),
    "left folder empty": (clear("left"), ["left", "no image"]),
    "calib missing": (remove("calib.yaml"), ["calib.yaml", "missing"]),
    "calib not yaml": (write("calib.yaml", b"fu_px: [1"), ["calib.yaml", "not YAML"]),
    "calib empty": (write("calib.yaml", b""), ["calib.yaml", "empty"]),
    "calib binary": (write("calib.yaml", b"\xff\xfe\x00"), ["calib.yaml", "text"]),
    "calib key missing": (
        replace("calib.yaml", "fu_px: 50.0", ""),
        ["calib.yaml", "fu_px is missing"],
    ),
    "calib key unknown": (
        replace("calib.yaml", "fu_px", "fx_px"),
        ["calib.yaml", "fx_px is not known (did you mean fu_px?)"],
    ),
    "calib imu key unknown": (
        append("calib.yaml", "  colour: red"),
        ["calib.yaml", "imu.colour is not known"],
    ),
    "calib not a number": (
        replace("calib.yaml", "cu_px: 31.5", "cu_px: wide"),
        ["calib.yaml", "cu_px", "number"],
    ),
    "focal length zero": (
        replace("calib.yaml", "fv_px: 50.0", "fv_px: 0"),
        ["calib.yaml", "fv_px"],
    ),
    "baseline NaN": (
        replace("calib.yaml", "_m: 0.5", "_m: .nan"),
        ["calib.yaml", "baseline_m", "nan"],
    ),
    "baseline zero": (
        replace("calib.yaml", "_m: 0.5", "_m: 0.0"),
        ["calib.yaml", "baseline_m", "0 m"],
    ),
    "baseline negative": (
        replace("calib.yaml", "_m: 0.5", "_m: -0.5"),
        ["baseline_m", "-0.5", "swapped"],
    ),
    "readout of minutes": (
        replace("calib.yaml", "_m: 0.5", "_m: 0.5\nreadout_s: 200"),
        ["calib.yaml", "readout_s", "200"],
    ),
    "width zero": (
        replace("calib.yaml", "width_px: 64", "width_px: 0"),
        ["calib.yaml", "width_px"],
    ),
    "T_cam_imu too short": (
        replace("calib.yaml", f"{T_ROW}, ", ""),
        ["calib.yaml", "imu.T_cam_imu", "16"],
    ),
    "T_cam_imu no rotation": (
        replace("calib.yaml", T_ROW, "[0, 1, 0, 0]"),
        ["calib.yaml", "imu.T_cam_imu", "rotation"],
    ),
    "T_cam_imu not finite": (
        replace("calib.yaml", T_ROW, "[0, -1, 0, .nan]"),
        ["calib.yaml", "imu.T_cam_imu", "finite"],
    ),
    "T_cam_imu with another last row": (
        replace("calib.yaml", "[0.0, 0.0, 0.0, 1.0]", "[0.0, 0.0, 0.0, 2.0]"),
        ["calib.yaml", "imu.T_cam_imu", "last row", "0 0 0 1"],
    ),
    "T_cam_imu missing": (
        replace("calib.yaml", "T_cam_imu", "T_cam"),
        ["calib.yaml", "imu.T_cam_imu is missing"],
    ),
    "accelerometer noise negative": (
        append("calib.yaml", "  accel_noise_m_s2_sqrt_hz: -1.0"),
        ["calib.yaml", "imu.accel_noise_m_s2_sqrt_hz", "greater than 0"],
    ),
    "accelerometer bias walk NaN": (
        append("calib.yaml", "  accel_bias_walk_m_s3_sqrt_hz: .nan"),
        ["calib.yaml", "imu.accel_bias_walk_m_s3_sqrt_hz"],
    ),
    "time offset infinite": (
        append("calib.yaml", "  time_offset_s: .inf"),
        ["calib.yaml", "imu.time_offset_s", "finite"],
    ),
    "gyro noise negative": (
        replace("calib.yaml", "1.0e-4", "-1.0"),
        ["calib.yaml", "imu.gyro_noise_rad_s_sqrt_hz"],
    ),
    "imu.csv missing": (remove("imu.csv"), ["imu.csv", "missing"]),
    "imu header wrong": (
        replace("imu.csv", "stamp_ns", "time"),
        ["imu.csv", "header", "stamp_ns,wx"],
    ),
    "imu NaN": (
        replace("imu.csv", "0.1,0,0,9.81", "nan,0,0,9.81"),
        ["imu.csv:2", "nan", "not finite"],
    ),
    "imu column missing": (
        replace("imu.csv", ",0,0,9.81", ",0,9.81"),
        ["imu.csv:2", "6 values", "7"],
    ),
    "imu unsorted": (swap_lines("imu.csv", 3, 5), ["imu.csv", "earlier"]),
    "imu stamp in seconds": (
        replace("imu.csv", "\n1400000000118456789", "\n1400000000.1"),
        ["imu.csv:2", "nanosec"],
    ),
    "imu on another clock": (
        append("calib.yaml", "  time_offset_s: 100.0"),
        ["imu.csv", "the frames from", "offset"],
    ),
    "times missing": (remove("times.txt"), ["times.txt", "missing"]),
    "times empty": (write("times.txt", b"\n"), ["times.txt", "no values"]),
    "times too few": (drop_line("times.txt", 3), ["times.txt", "3 stamps", "4 files"]),
    "times unsorted": (swap_lines("times.txt", 1, 2), ["times.txt", "stamp 2", "earlier"]),
    "times duplicate": (
        replace("times.txt", "00.223", "00.123"),
        ["times.txt", "stamp 1", "duplicate"],
    ),
    "times not numbers": (replace("times.txt", T0, "noon"), ["times.txt:1", "'noon'"]),
    "times NaN": (replace("times.txt", T0, "nan"), ["times.txt:1", "'nan'", "finite"]),
    "times in ns, one NaN": (
        write("times.txt", b"1400000000000000000\nnan\n1400000000200000000\n1400000000300000000\n"),
        ["times.txt:2", "'nan'", "not a finite number"],
    ),
    "times in ns with exponents": (
        write("times.txt", b"1.4e18\n1.41e18\n1.42e18\n1.43e18\n"),
        ["times.txt:1", "too large for a number of seconds", "nanoseconds?"],
    ),
    "times counted": (write("times.txt", b"0\n1\n2\n3\n"), ["times.txt", "decimal point"]),
    "times too large": (write("times.txt", b"1e30\n2e30\n3e30\n4e30\n"), ["times.txt:1", "1e30"]),
    "times of a huge exponent": (
        replace("times.txt", T0, "1e999999999"),
        ["times.txt:1", "'1e999999999'", "too large for a number of seconds"],
    ),
    "times of a tiny exponent": (
        replace("times.txt", T0, "1e-999999999"),
        ["times.txt:1", "'1e-999999999'", "too small for a number of seconds"],
    ),
    "times of many digits": (
        replace("times.txt", T0, "9" * 100_000 + ".0"),
        ["times.txt:1", "999...999", "too large for a number of seconds"],
    ),
    "times of many digits, whole": (
        write("times.txt", b"\n".join([b"9" * 100_000] * 4)),
        ["times.txt:1", "999...999", "not a whole number of nanoseconds"],
    ),
    "poses too few": (drop_line("poses.txt", 0), ["poses.txt", "3 poses", "4 frames"]),
    "poses of wrong width": (
        replace("poses.txt", "1.0 0.0 ", ""),
        ["poses.txt:1", "10 values", "12"],
    ),
    "poses partly NaN": (replace("poses.txt", "1.0", "nan"), ["poses.txt", "pose 0", "partly"]),
    "poses infinite": (replace("poses.txt", "1.0", "inf"), ["poses.txt:1", "inf"]),
    "poses all unknown": (
        write("poses.txt", b"nan nan nan nan nan nan nan nan nan nan nan nan\n" * 4),
        ["poses.txt"],
    ),
    "poses no rotation": (replace("poses.txt", "1.0", "2.0"), ["poses.txt", "pose 0", "rotation"]),
    "poses not numbers": (replace("poses.txt", "1.0", "one"), ["poses.txt:1", "'one'"]),
}

KITTI_RAW: dict[str, tuple[Edit, list[str]]] = {
    "calibration missing": (
        remove("../calib_cam_to_cam.txt"),
        ["calib_cam_to_cam.txt", "missing", "folder above"],
    ),
    "projection missing": (
        replace("../calib_cam_to_cam.txt", "P_rect_01", "P_rect_03"),
        ["cam_to_cam", "P_rect_01"],
    ),
    "projection too short": (
        replace("../calib_cam_to_cam.txt", " 31.5", ""),
        ["cam_to_cam", "P_rect_00", "11", "12"],
    ),
    "projection not numbers": (
        replace("../calib_cam_to_cam.txt", "31.5", "x"),
        ["cam_to_cam", "P_rect_00", "'x'"],
    ),
    "cameras differ": (
        replace("../calib_cam_to_cam.txt", "31.5", "30.5"),
        ["P_rect_00", "P_rect_01", "principal"],
    ),
    "baseline zero": (
        replace("../calib_cam_to_cam.txt", "-25.0", "0.0"),
        ["P_rect_01", "baseline_m", "0 m"],
    ),
    "baseline negative": (
        replace("../calib_cam_to_cam.txt", "-25.0", "25.0"),
        ["P_rect_01", "baseline_m", "swapped"],
    ),
    "R_rect no rotation": (
        replace("../calib_cam_to_cam.txt", "R_rect_00: 1", "R_rect_00: 3"),
        ["R_rect_00", "rotat"],
    ),
    "imu_to_velo missing": (
        remove("../calib_imu_to_velo.txt"),
        ["calib_imu_to_velo.txt", "missing"],
    ),
    "image_01 missing": (remove("image_01"), ["image_01", "missing"]),
    "timestamps missing": (
        remove("image_00/timestamps.txt"),
        ["image_00/timestamps.txt", "missing"],
    ),
    "timestamp no date": (
        replace("image_00/timestamps.txt", "2014-", "then "),
        ["image_00/timestamps.txt:1", "then"],
    ),
    "timestamp no time": (
        replace("image_00/timestamps.txt", " 16:", " 25:"),
        ["image_00/timestamps.txt:1", "25:"],
    ),
    "timestamp NaT": (
        append("image_00/timestamps.txt", "NaT"),
        ["image_00/timestamps.txt:5", "NaT"],
    ),
    "timestamp in the year 9999": (
        replace("image_00/timestamps.txt", "2014-", "9999-"),
        ["image_00/timestamps.txt:1", "'9999-05", "year from 1678 to 2261"],
    ),
    "timestamp before Christ": (
        replace("image_00/timestamps.txt", "2014-", "-5000-"),
        ["image_00/timestamps.txt:1", "'-5000-05", "year from 1678 to 2261"],
    ),
    "packet missing": (
        remove("oxts/data/0000000001.txt"),
        ["oxts/timestamps.txt", "4 stamps", "3 files"],
    ),
    "packets missing": (clear("oxts/data"), ["oxts/data", "0 OXTS packets"]),
    "packet too short": (
        write("oxts/data/0000000002.txt", b"1 2 3"),
        ["0000000002.txt", "3 values", "30"],
    ),
    "packet NaN": (
        replace("oxts/data/0000000002.txt", "49.0", "nan"),
        ["0000000002.txt", "'nan'", "finite"],
    ),
    "oxts unsorted": (
        swap_lines("oxts/timestamps.txt", 0, 1),
        ["oxts/timestamps.txt", "stamp 1", "earlier"],
    ),
}

KITTI_ODOMETRY: dict[str, tuple[Edit, list[str]]] = {
    "calib missing": (remove("calib.txt"), ["calib.txt", "missing", "P0"]),
    "P1 missing": (drop_line("calib.txt", 1), ["calib.txt", "P1", "missing"]),
    "P1 not finite": (replace("calib.txt", "-25.0", "nan"), ["calib.txt", "P1", "'nan'"]),
    "focal length zero": (replace("calib.txt", "P0: 50.0", "P0: 0.0"), ["calib.txt", "P0"]),
    "times too many": (append("times.txt", "9.9"), ["times.txt", "5 stamps", "4 files"]),
    "poses shorter than images": (
        drop_line("../../poses/07.txt", 3),
        ["07.txt", "3 poses", "4 frames"],
    ),
    "first image cut": (cut("image_0/000000.png", 0.5), ["image_0/000000.png", "damaged"]),
    "first image of another size": (
        write("image_0/000000.png", image(0)[:1, :1]),
        ["image_0/000000.png", "1×1 px, its partner 64×48 px"],
    ),
    "right image renamed": (
        lambda path: (path / "image_1/000001.png").rename(path / "image_1/1.png"),
        ["image_1/000001.png", "missing"],
    ),
}

STAMP_2 = "1400000000323456789"
EUROC: dict[str, tuple[Edit, list[str]]] = {
    "cam1 missing": (remove("mav0/cam1"), ["cam1/sensor.yaml", "missing"]),
    "image file missing": (
        remove(f"mav0/cam1/data/{STAMP_2}.png"),
        ["cam1/data.csv:4", STAMP_2, "missing"],
    ),
    "cameras never together": (
        write("mav0/cam1/data.csv", f"5,{STAMP_2}.png\n".encode()),
        ["cam1/data.csv", "0"],
    ),
    "stamp not a number": (
        replace("mav0/cam0/data.csv", f"\n{STAMP_2}", "\nlate"),
        ["cam0/data.csv:4", "'late'"],
    ),
    "stamps unsorted": (
        swap_lines("mav0/cam0/data.csv", 1, 2),
        ["cam0/data.csv", "stamp 1", "earlier"],
    ),
    "T_BS missing": (
        replace("mav0/cam0/sensor.yaml", "T_BS", "T_SB"),
        ["cam0/sensor.yaml", "T_BS is missing"],
    ),
    "T_BS too short": (
        replace("mav0/cam1/sensor.yaml", "1.0, ", ""),
        ["cam1/sensor.yaml", "T_BS.data", "16"],
    ),
    "T_BS no rotation": (
        replace("mav0/cam1/sensor.yaml", "[1.0", "[5.0"),
        ["cam1/sensor.yaml", "T_BS", "rotation"],
    ),
    "model unknown": (
        replace("mav0/cam0/sensor.yaml", "radial-tangential", "fov"),
        ["distortion_model"],
    ),
    "same camera twice": (
        replace("mav0/cam1/sensor.yaml", "0.5", "0.0"),
        ["cam1/sensor.yaml", "same place"],
    ),
    "gyro noise missing": (
        replace("mav0/imu0/sensor.yaml", "gyroscope_noise_density", "n"),
        ["imu0/", "gyro"],
    ),
    "accelerometer noise zero": (
        replace(
            "mav0/imu0/sensor.yaml",
            "accelerometer_noise_density: 2.0e-03",
            "accelerometer_noise_density: 0",
        ),
        ["imu0/", "accelerometer_noise_density", "greater than 0"],
    ),
    "imu data missing": (remove("mav0/imu0/data.csv"), ["imu0/data.csv", "missing"]),
    "imu NaN": (replace("mav0/imu0/data.csv", "0.1", "nan"), ["imu0/data.csv:2", "'nan'"]),
    "quaternion zero": (
        replace("mav0/state_groundtruth_estimate0/data.csv", ",1,0,0,0", ",0,0,0,0"),
        ["state_groundtruth_estimate0/data.csv", "quaternion", "pose 0"],
    ),
    "truth elsewhere": (
        write(
            "mav0/state_groundtruth_estimate0/data.csv", b"0,0,0,0,1,0,0,0\n9000,0,0,0,1,0,0,0\n"
        ),
        ["state_groundtruth_estimate0/data.csv", "no pose between"],
    ),
}


@pytest.mark.parametrize("case", FOLDER)
def test_malformed_folder(case: str, tmp_path: Path) -> None:
    path = write_folder_sequence(tmp_path)
    edit, fragments = FOLDER[case]
    edit(path)
    assert_refused(path, fragments)


@pytest.mark.parametrize("case", KITTI_RAW)
def test_malformed_kitti_raw(case: str, tmp_path: Path) -> None:
    path = write_kitti_raw(tmp_path)
    edit, fragments = KITTI_RAW[case]
    edit(path)
    assert_refused(path, fragments)


@pytest.mark.parametrize("case", KITTI_ODOMETRY)
def test_malformed_kitti_odometry(case: str, tmp_path: Path) -> None:
    path = write_kitti_odometry(tmp_path)
    edit, fragments = KITTI_ODOMETRY[case]
    edit(path)
    assert_refused(path, fragments)


@pytest.mark.parametrize("case", EUROC)
def test_malformed_euroc(case: str, tmp_path: Path) -> None:
    path = write_euroc(tmp_path)
    edit, fragments = EUROC[case]
    edit(path)
    assert_refused(path, fragments)


BAD_IMAGES: dict[str, tuple[Edit, str]] = {
    "cut": (cut("right/000002.png", 0.6), "its end is missing"),
    "empty": (write("right/000002.png", b""), "empty"),
    "text": (write("right/000002.png", b"not a picture"), "neither PNG nor JPEG"),
    "sixteen bits": (write("right/000002.png", image(0).astype(np.uint16) * 257), "uint16"),
    "other size": (
        write("right/000002.png", image(0)[:, :-2]),
        f"{WIDTH_PX - 2}×48 px; expected {WIDTH_PX}×48 px",
    ),
}


@pytest.mark.parametrize("case", BAD_IMAGES)
def test_bad_image_comes_up_at_its_frame(case: str, tmp_path: Path) -> None:
    path = write_folder_sequence(tmp_path)
    edit, fragment = BAD_IMAGES[case]
    edit(path)
    frames = iter(open_sequence(path))
    assert [next(frames).index for _ in range(2)] == [0, 1]
    with pytest.raises(InputError, match=r"right/000002\.png") as caught:
        next(frames)
    assert fragment in str(caught.value)


def test_imu_file_without_its_calibration(tmp_path: Path) -> None:
    write_folder_sequence(tmp_path, imu=False)
    (tmp_path / "imu.csv").write_text("stamp_ns,wx,wy,wz,ax,ay,az\n")
    assert_refused(tmp_path, ["calib.yaml", "section imu is missing"])

"""Data sets with layouts of their own: cameras, truths, and what is refused by name.

What all formats have in common is tested in test_formats.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from probevo.camera.stereo import StereoCamera
from probevo.sequences import open_sequence
from probevo.sequences.recording import StereoRecording
from sequences.damage import Edit, append, assert_refused, drop_line, remove, replace
from sequences.recordings import (
    BASELINE_M,
    CU_PX,
    CV_PX,
    FRAME_NS,
    FU_PX,
    HEIGHT_PX,
    START_NS,
    WIDTH_PX,
    image,
    poses,
    write_four_seasons,
    write_tartan_air,
    write_tum_vi,
    write_virtual_kitti,
)

CAMERA = StereoCamera(
    FU_PX, FU_PX, CU_PX, cv_px=CV_PX, baseline_m=BASELINE_M, size_px=(WIDTH_PX, HEIGHT_PX)
)


@pytest.mark.parametrize(("version", "height_px"), [(1, 480), (2, 640)])
def test_the_camera_of_tartan_air_is_that_of_its_version(
    version: int, height_px: int, tmp_path: Path
) -> None:
    """It drives ahead: along z of the camera, which is x of the aircraft."""
    sequence = open_sequence(write_tartan_air(tmp_path, frames=3, version=version))
    assert sequence.camera == StereoCamera(
        320.0, 320.0, 320.0, cv_px=height_px / 2, baseline_m=0.25, size_px=(640, height_px)
    )
    assert [frame.left.shape for frame in sequence] == [(height_px, 640)] * 3
    assert sequence.truth is not None
    np.testing.assert_allclose(sequence.truth.T_world_cam, poses(3), atol=1e-12)


def test_tartan_air_turns_to_the_right_about_y(tmp_path: Path) -> None:
    """A quarter turn of the aircraft about its z, which is down: y of the camera."""
    path = write_tartan_air(tmp_path, frames=2)
    half = float(np.sqrt(0.5))
    (path / "pose_left.txt").write_text(f"0 0 0 0 0 0 1\n0 0 0 0 0 {half!r} {half!r}\n")
    truth = open_sequence(path).truth
    assert truth is not None
    # What is ahead of the turned camera, z, lies to the right of the first one, x.
    np.testing.assert_allclose(truth.T_world_cam[1, :3, 2], [1.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(truth.T_world_cam[1, :3, 1], [0.0, 1.0, 0.0], atol=1e-12)


@pytest.mark.parametrize("write", [write_tartan_air, write_virtual_kitti])
def test_the_rate_can_be_given_where_no_file_has_times(
    write: Callable[[Path], Path], tmp_path: Path
) -> None:
    path = write(tmp_path)
    np.testing.assert_array_equal(open_sequence(path).stamps_ns, np.arange(4) * FRAME_NS)
    faster = open_sequence(path, rate_hz=25.0)
    np.testing.assert_array_equal(faster.stamps_ns, np.arange(4) * 40_000_000)


def test_virtual_kitti_has_the_camera_of_its_text_files(tmp_path: Path) -> None:
    sequence = open_sequence(write_virtual_kitti(tmp_path))
    assert sequence.camera == CAMERA
    first, *_ = sequence
    # JPEG loses some of the noise of the picture.
    assert np.corrcoef(first.left.ravel(), image(0).ravel())[0, 1] > 0.9


def test_four_seasons_takes_the_stereo_matrix_in_either_direction(tmp_path: Path) -> None:
    path = write_four_seasons(tmp_path)
    stereo = tmp_path / "calibration" / "undistorted_calib_stereo.txt"
    stereo.write_text(stereo.read_text().replace("-0.5", "0.5"))
    assert open_sequence(path).camera == CAMERA


def test_four_seasons_finds_a_transform_behind_a_byte_order_mark(tmp_path: Path) -> None:
    path = write_four_seasons(tmp_path)
    expected = open_sequence(path).imu
    assert expected is not None
    file = path / "Transformations.txt"
    lines = file.read_text().splitlines()
    file.write_text("\n".join(lines[3:]), encoding="utf-8-sig")
    found = open_sequence(path).imu
    assert found is not None
    np.testing.assert_array_equal(found.T_cam_imu, expected.T_cam_imu)


def test_four_seasons_drops_images_without_a_partner_and_says_so(tmp_path: Path) -> None:
    path = write_four_seasons(tmp_path)
    (path / "undistorted_images" / "cam1" / f"{START_NS + FRAME_NS}.png").unlink()
    sequence = open_sequence(path)
    np.testing.assert_array_equal(sequence.stamps_ns, START_NS + FRAME_NS * np.array([0, 2, 3]))
    assert isinstance(sequence, StereoRecording)
    assert sequence.notes == (("! pairs", "3; 1 images are without a partner"),)


def test_four_seasons_without_imu_and_truth(tmp_path: Path) -> None:
    path = write_four_seasons(tmp_path)
    (path / "imu.txt").unlink()
    (path / "GNSSPoses.txt").unlink()
    sequence = open_sequence(path)
    assert sequence.imu is None
    assert sequence.truth is None


def test_tum_vi_is_rectified_reduced_to_8_bits_and_has_its_own_noise(tmp_path: Path) -> None:
    sequence = open_sequence(write_tum_vi(tmp_path))
    assert sequence.camera.baseline_m == pytest.approx(BASELINE_M)
    assert sequence.camera.fu_px == pytest.approx(FU_PX)
    first, *_ = sequence
    assert first.left.dtype == np.uint8
    assert np.ptp(first.left) > 200
    assert sequence.imu is not None
    assert sequence.imu.gyro_noise_rad_s_sqrt_hz == 1.6e-4
    assert sequence.imu.accel_bias_walk_m_s3_sqrt_hz == 8.6e-4


def test_tum_vi_without_motion_capture(tmp_path: Path) -> None:
    path = write_tum_vi(tmp_path)
    (path / "mav0" / "mocap0" / "data.csv").unlink()
    assert open_sequence(path).truth is None


FAULTS: dict[str, tuple[Callable[[Path], Path], Edit, list[str]]] = {
    "tum-vi: omnidirectional": (
        write_tum_vi,
        replace("dso/camchain.yaml", "camera_model: pinhole", "camera_model: omni"),
        ["camchain.yaml", "omni"],
    ),
    "tum-vi: image missing": (
        write_tum_vi,
        remove(f"mav0/cam1/data/{START_NS}.png"),
        ["cam1/data.csv", "missing"],
    ),
    "4seasons: only distorted images": (
        write_four_seasons,
        lambda path: (path / "undistorted_images").rename(path / "distorted_images"),
        ["undistorted_images", "missing", "--calibration camchain.yaml"],
    ),
    "4seasons: no calibration": (
        write_four_seasons,
        lambda path: (path.parent / "calibration").rename(path.parent / "elsewhere"),
        ["calibration", "beside", "calibration.zip"],
    ),
    "4seasons: fisheye model": (
        write_four_seasons,
        replace("../calibration/undistorted_calib_0.txt", "Pinhole", "FisheyeKB"),
        ["undistorted_calib_0.txt:1", "Pinhole"],
    ),
    "4seasons: not rectified": (
        write_four_seasons,
        replace("../calibration/undistorted_calib_stereo.txt", "-0.5\n0.0", "-0.5\n0.01"),
        ["undistorted_calib_stereo.txt"],
    ),
    "4seasons: other intrinsics on the right": (
        write_four_seasons,
        replace("../calibration/undistorted_calib_1.txt", "Pinhole 50.0", "Pinhole 51.0"),
        ["differ", "equal"],
    ),
    "4seasons: no pose of the IMU": (
        write_four_seasons,
        replace("Transformations.txt", "TS_cam_imu", "TS_cam"),
        ["Transformations.txt", "TS_cam_imu", "missing"],
    ),
    "4seasons: quaternion too long": (
        write_four_seasons,
        replace("GNSSPoses.txt", ",0,0,0,1,2.0", ",0,0,1,1,2.0"),
        ["GNSSPoses.txt", "unit length"],
    ),
    "tartanair: right image missing": (
        write_tartan_air,
        remove("image_right/000002_right.png"),
        ["image_right", "number 2", "missing"],
    ),
    "tartanair: pose missing": (
        write_tartan_air,
        drop_line("pose_left.txt", 1),
        ["pose_left.txt", "3 poses for 4 frames"],
    ),
    "vkitti2: no text files": (
        write_virtual_kitti,
        remove("intrinsic.txt"),
        ["intrinsic.txt", "missing", "vkitti_2.0.3_textgt.tar"],
    ),
    "vkitti2: frame missing": (
        write_virtual_kitti,
        drop_line("extrinsic.txt", 3),
        ["extrinsic.txt", "frame 1 of camera 0", "missing"],
    ),
    "vkitti2: zoom": (
        write_virtual_kitti,
        replace("intrinsic.txt", "2 1 50.0", "2 1 60.0"),
        ["intrinsic.txt", "change"],
    ),
    "vkitti2: frame that has no image": (
        write_virtual_kitti,
        append("extrinsic.txt", "9 0 1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"),
        ["extrinsic.txt", "frame 9", "4 images"],
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_refused_by_name(fault: str, tmp_path: Path) -> None:
    write, edit, words = FAULTS[fault]
    path = write(tmp_path)
    edit(path)
    assert_refused(path, words)

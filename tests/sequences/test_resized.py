"""Images that were scaled after they had been calibrated: their calibration is scaled, too."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from cli.rendering import write_wall
from probevo.arrays import FloatArray
from probevo.camera.image_scale import ImageScale
from probevo.camera.rectification import PinholeCamera
from probevo.camera.stereo import StereoCamera
from probevo.cli.main import main
from probevo.errors import InputError
from probevo.sequences import open_sequence
from probevo.sequences.calibrations.calibration_files import read_stereo_calibration
from probevo.sequences.calibrations.ros_camera_info import CameraInfo, stereo_camera
from sequences.bags import as_message, camera_info, raw_image, write_messages
from sequences.calibrations.test_calibration_files import kalibr, write_yaml
from sequences.formats.test_rosbag import stereo_messages
from sequences.recordings import FRAME_NS, HEIGHT_PX, WIDTH_PX, write_euroc, write_folder_sequence

CAMERA = StereoCamera(620.0, 610.0, 601.5, cv_px=180.25, baseline_m=0.54, size_px=(1241, 376))
SCALED_PX = (620, 188)
"""Half of the size of images of 1241×376 px, but for the pixel that is left over."""
POINTS_M = np.array([[1.0, -2.0, 8.0], [-3.0, 0.5, 20.0], [0.2, 0.1, 3.0]])


def scaled(pixels: FloatArray, camera: StereoCamera) -> FloatArray:
    """Where observations lie in the images of ``SCALED_PX``: the corners of both coincide."""
    assert camera.size_px is not None
    scales = np.tile(np.array(SCALED_PX) / camera.size_px, 2)
    found: FloatArray = (pixels + 0.5) * scales - 0.5
    return found


def test_a_scaled_camera_sees_points_where_the_scaled_images_show_them() -> None:
    small = CAMERA.resized(SCALED_PX, "calib.yaml")
    expected = scaled(CAMERA.project(POINTS_M), CAMERA)
    np.testing.assert_allclose(small.project(POINTS_M), expected, atol=1e-9)
    assert small.size_px == SCALED_PX


@pytest.mark.parametrize("model", ["radtan", "equidistant"])
def test_a_scaled_lens_has_the_same_distortion(model: str) -> None:
    camera = PinholeCamera(
        620.0,
        610.0,
        601.5,
        180.25,
        distortion_model=model,
        distortion=(-0.1, 0.02, 1e-3, -2e-3),
        size_px=(1241, 376),
    )
    small = camera.resized(SCALED_PX, "camchain.yaml")

    def seen(by: PinholeCamera) -> FloatArray:
        rest = np.zeros(3)
        coefficients = np.array(by.distortion)
        if model == "radtan":
            pixels, _ = cv2.projectPoints(POINTS_M, rest, rest, by.matrix, coefficients)
        else:
            pixels, _ = cv2.fisheye.projectPoints(
                POINTS_M[:, None], rest, rest, by.matrix, coefficients
            )
        return np.asarray(pixels.reshape(-1, 2))

    scales = np.array(SCALED_PX) / camera.size_px
    np.testing.assert_allclose(seen(small), (seen(camera) + 0.5) * scales - 0.5, atol=1e-9)


def test_the_camera_info_of_a_bag_is_scaled_with_its_baseline() -> None:
    infos = [
        CameraInfo(as_message(camera_info(CAMERA, right=right)), where="topic")
        for right in (False, True)
    ]
    left, right = (info.resized(SCALED_PX) for info in infos)
    small = stereo_camera(left, right)
    np.testing.assert_allclose(
        small.project(POINTS_M), scaled(CAMERA.project(POINTS_M), CAMERA), atol=1e-9
    )
    np.testing.assert_allclose(left.pinhole().matrix, left.P[:, :3], atol=1e-9)


@pytest.mark.parametrize("size_px", [(620, 188), (621, 188), (2482, 752), (413, 125), (1241, 376)])
def test_sides_are_rounded(size_px: tuple[int, int]) -> None:
    ImageScale.between((1241, 376), size_px, "calib.yaml")


@pytest.mark.parametrize("size_px", [(1241, 370), (1200, 376), (620, 200), (376, 1241)])
def test_cropped_images_are_refused(size_px: tuple[int, int]) -> None:
    with pytest.raises(
        InputError, match=r"calib.yaml: it is for images of 1241×376 px(?s:.*)cropped"
    ):
        ImageScale.between((1241, 376), size_px, "calib.yaml")


def doubled(calibration: Path) -> None:
    """Write the ``calib.yaml`` of images twice as large."""
    content = yaml.safe_load(calibration.read_text("utf-8"))
    for key in ("fu_px", "fv_px", "width_px", "height_px"):
        content[key] *= 2
    for key in ("cu_px", "cv_px"):
        content[key] = 2.0 * (content[key] + 0.5) - 0.5
    calibration.write_text(yaml.safe_dump(content), "utf-8")


def test_a_folder_of_scaled_images(tmp_path: Path) -> None:
    path = write_folder_sequence(tmp_path)
    camera = open_sequence(path).camera
    doubled(path / "calib.yaml")
    with pytest.raises(InputError, match="this image has 64×48 px"):
        next(iter(open_sequence(path)))
    sequence = open_sequence(path, resized=True)
    assert sequence.camera == camera
    assert len(list(sequence)) == 4


def test_scaled_images_with_the_calibration_of_another_tool(tmp_path: Path) -> None:
    """It is that of one which gives the scaled values."""
    content = kalibr()
    for name in ("cam0", "cam1"):
        fu, fv, cu, cv = content[name]["intrinsics"]
        content[name]["intrinsics"] = [2 * fu, 2 * fv, 2 * cu + 0.5, 2 * cv + 0.5]
        content[name]["resolution"] = [2 * WIDTH_PX, 2 * HEIGHT_PX]
    small = write_yaml(tmp_path / "small.yaml", kalibr())
    large = write_yaml(tmp_path / "large.yaml", content)
    size_px = (WIDTH_PX, HEIGHT_PX)
    found = read_stereo_calibration(large, size_px, resized=True)
    expected = read_stereo_calibration(small, size_px)
    assert found.left == expected.left
    assert found.right == expected.right
    for path in (write_folder_sequence(tmp_path / "folder"), write_euroc(tmp_path / "euroc")):
        with pytest.raises(InputError, match=r"for images of 128×96 px(?s:.*)--resized"):
            open_sequence(path, calibration=large)
        opened = open_sequence(path, calibration=large, resized=True)
        assert opened.camera == expected.rectification().camera


def test_euroc_with_its_own_calibration(tmp_path: Path) -> None:
    path = write_euroc(tmp_path)
    camera = open_sequence(path).camera
    for name in ("cam0", "cam1"):
        file = path / "mav0" / name / "sensor.yaml"
        content = yaml.safe_load(file.read_text("utf-8").replace("%YAML:1.0", ""))
        fu, fv, cu, cv = content["intrinsics"]
        content["intrinsics"] = [2 * fu, 2 * fv, 2 * cu + 0.5, 2 * cv + 0.5]
        content["resolution"] = [2 * side for side in content["resolution"]]
        file.write_text(yaml.safe_dump(content), "utf-8")
    assert open_sequence(path, resized=True).camera == camera


def test_a_bag_of_scaled_images(tmp_path: Path) -> None:
    fields = raw_image(np.zeros((HEIGHT_PX // 2, WIDTH_PX // 2), np.uint8))
    messages = stereo_messages([0, FRAME_NS], [0, FRAME_NS], fields)
    path = write_messages(tmp_path / "small", "mcap", messages)
    with pytest.raises(InputError, match="--resized"):
        open_sequence(path)
    assert open_sequence(path, resized=True).camera.size_px == (WIDTH_PX // 2, HEIGHT_PX // 2)


def test_a_calibration_without_any_size_cannot_be_scaled(tmp_path: Path) -> None:
    storage = cv2.FileStorage(str(tmp_path / "stereo.yml"), cv2.FILE_STORAGE_WRITE)
    for key, matrix in {
        "M1": np.eye(3),
        "D1": np.zeros(4),
        "M2": np.eye(3),
        "D2": np.zeros(4),
    }.items():
        storage.write(key, matrix)
    storage.write("R", np.eye(3))
    storage.write("T", np.array([-0.1, 0.0, 0.0]))
    storage.release()
    with pytest.raises(InputError, match="does not have the size of the images"):
        read_stereo_calibration(tmp_path / "stereo.yml", (64, 48), resized=True)


@pytest.mark.usefixtures("undrawn")
def test_the_flag_of_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_wall(tmp_path / "wall", 4)
    wanted = main(["run", str(path), "--out", str(tmp_path / "as_it_is")])
    doubled(path / "calib.yaml")
    assert main(["run", str(path), "--out", str(tmp_path / "run")]) == 2
    assert "--resized" in capsys.readouterr().err
    assert main(["run", str(path), "--out", str(tmp_path / "run"), "--resized"]) == wanted
    paths = [tmp_path / name / "trajectory.tum" for name in ("as_it_is", "run")]
    assert paths[0].read_bytes() == paths[1].read_bytes()
    config = (tmp_path / "run" / "config.yaml").read_text("utf-8")
    assert re.search(r"^resized: true$", config, re.MULTILINE)

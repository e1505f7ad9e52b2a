"""Calibration files: those of others are read or refused by name, and written ones come back."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from probevo.arrays import FloatArray
from probevo.camera.rectification import PinholeCamera, Rectification
from probevo.errors import InputError
from probevo.geometry import se3, so3
from probevo.sequences import open_sequence
from probevo.sequences.calibrations.calibration_content import load_calibration
from probevo.sequences.calibrations.calibration_files import read_stereo_calibration
from probevo.sequences.calibrations.stereo_calibration import StereoCalibration
from probevo.sequences.formats.euroc import CameraFile
from probevo.sequences.recording import StereoRecording
from probevo.sequences.yaml_file import read_yaml
from sequences.recordings import image, write_folder_sequence, write_image, write_lines

SIZE_PX = (64, 48)
T_RIGHT_LEFT = se3.from_parts(
    so3.exp(np.array([0.007, -0.015, 0.014])), np.array([-0.11, 0.002, -0.001])
)
T_LEFT_IMU = se3.from_parts(so3.exp(np.array([0.1, -1.2, 0.4])), np.array([0.05, -0.02, 0.01]))
LEFT_K = (50.0, 51.0, 31.0, 23.0)
RIGHT_K = (49.0, 50.0, 32.0, 24.0)
RADTAN = (-0.1, 0.02, 1e-4, -2e-4)
EQUIDISTANT = (0.0035, 0.0007, -0.002, 0.0002)


def kalibr(distortion_model: str = "radtan", coefficients: Any = RADTAN) -> dict[str, Any]:
    """The content of a camchain-imucam file."""

    def camera(intrinsics: tuple[float, ...], T_cam_imu: FloatArray) -> dict[str, Any]:
        return {
            "camera_model": "pinhole",
            "intrinsics": list(intrinsics),
            "distortion_model": distortion_model,
            "distortion_coeffs": list(coefficients),
            "resolution": list(SIZE_PX),
            "T_cam_imu": T_cam_imu.tolist(),
            "timeshift_cam_imu": -0.03,
        }

    cam0 = camera(LEFT_K, T_LEFT_IMU)
    cam1 = camera(RIGHT_K, T_RIGHT_LEFT @ T_LEFT_IMU) | {"T_cn_cnm1": T_RIGHT_LEFT.tolist()}
    return {"cam0": cam0, "cam1": cam1}


def write_yaml(path: Path, content: Any) -> Path:
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


def assert_as_written(
    calibration: StereoCalibration, model: str = "radtan", coefficients: Any = RADTAN
) -> None:
    assert calibration.left == PinholeCamera(
        *LEFT_K, distortion_model=model, distortion=coefficients, size_px=SIZE_PX
    )
    assert calibration.right == PinholeCamera(
        *RIGHT_K, distortion_model=model, distortion=coefficients, size_px=SIZE_PX
    )
    np.testing.assert_allclose(calibration.T_right_left, T_RIGHT_LEFT, atol=1e-12)


@pytest.mark.parametrize(
    ("model", "coefficients"), [("radtan", RADTAN), ("equidistant", EQUIDISTANT)]
)
def test_kalibr(model: str, coefficients: Any, tmp_path: Path) -> None:
    path = write_yaml(tmp_path / "camchain.yaml", kalibr(model, coefficients))
    calibration = read_stereo_calibration(path, SIZE_PX)
    assert_as_written(calibration, model, coefficients)
    np.testing.assert_allclose(calibration.T_left_imu, T_LEFT_IMU, atol=1e-12)
    assert calibration.time_offset_s == -0.03


def test_kalibr_knows_the_readout_time_of_a_rolling_shutter(tmp_path: Path) -> None:
    """``line_delay`` is that from row to row of the images that were calibrated; those that are
    smaller take as long."""
    content = kalibr()
    for camera in content.values():
        camera["line_delay"] = 2e-4
    path = write_yaml(tmp_path / "camchain.yaml", content)
    readout_s = 2e-4 * (SIZE_PX[1] - 1)
    calibration = read_stereo_calibration(path, SIZE_PX)
    assert calibration.rectification().camera.readout_s == pytest.approx(readout_s)
    half = (SIZE_PX[0] // 2, SIZE_PX[1] // 2)
    assert calibration.resized(half).readout_s == pytest.approx(readout_s)
    content["cam0"]["line_delay"] = 30.0  # in microseconds
    wrong = read_stereo_calibration(write_yaml(path, content), SIZE_PX)
    with pytest.raises(InputError, match=r"readout_s is 1410"):
        wrong.rectification()


def test_a_number_that_yaml_takes_for_text_is_a_number(tmp_path: Path) -> None:
    """YAML 1.1 wants a point in 1e-5; those who write by hand leave it out."""
    text = yaml.safe_dump(kalibr())
    assert text.count("timeshift_cam_imu: -0.03") == 2
    path = tmp_path / "camchain.yaml"
    path.write_text(text.replace("timeshift_cam_imu: -0.03", "timeshift_cam_imu: 1e-5"))
    assert read_stereo_calibration(path).time_offset_s == 1e-5


def test_kalibr_without_chain_takes_the_poses_of_the_imu(tmp_path: Path) -> None:
    content = kalibr()
    del content["cam1"]["T_cn_cnm1"]
    assert_as_written(read_stereo_calibration(write_yaml(tmp_path / "chain.yaml", content)))
    for name in ("cam0", "cam1"):  # as OpenVINS writes it
        T_cam_imu = np.array(content[name].pop("T_cam_imu"))
        content[name]["T_imu_cam"] = se3.inverse(T_cam_imu).tolist()
    assert_as_written(read_stereo_calibration(write_yaml(tmp_path / "openvins.yaml", content)))


REFUSED: dict[str, tuple[str, str, Any, str]] = {
    "double sphere": ("cam0", "camera_model", "ds", "double sphere"),
    "omni": ("cam1", "camera_model", "omni", "omnidirectional"),
    "extended unified": ("cam0", "camera_model", "eucm", "extended unified"),
    "field of view": ("cam0", "distortion_model", "fov", "field of view"),
    "no size": ("cam0", "resolution", [64], "expected 1×2"),
    "no rotation": ("cam1", "T_cn_cnm1", np.diag([2.0, 1, 1, 1]).tolist(), "T_cn_cnm1"),
    "text": ("cam0", "intrinsics", "wide", "not a list of numbers"),
    "a text for a number": ("cam0", "timeshift_cam_imu", "soon", "expected a finite number"),
    "no finite number": ("cam0", "timeshift_cam_imu", "inf", "expected a finite number"),
    "too many digits": ("cam1", "T_cn_cnm1", [10**400] * 16, "not a list of numbers"),
    "a single one of them": ("cam0", "timeshift_cam_imu", 10**400, "expected a finite number"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_kalibr_models_are_refused_by_name(case: str, tmp_path: Path) -> None:
    camera, key, value, words = REFUSED[case]
    content = kalibr()
    content[camera][key] = value
    with pytest.raises(InputError, match=words) as refusal:
        read_stereo_calibration(write_yaml(tmp_path / "camchain.yaml", content))
    assert "camchain.yaml" in str(refusal.value)


def test_another_size_than_that_of_the_images_is_refused(tmp_path: Path) -> None:
    path = write_yaml(tmp_path / "camchain.yaml", kalibr())
    with pytest.raises(InputError, match="64×48 px; these have 752×480 px"):
        read_stereo_calibration(path, (752, 480))


def camera_matrix(intrinsics: tuple[float, ...]) -> FloatArray:
    fu, fv, cu, cv = intrinsics
    return np.array([[fu, 0.0, cu], [0.0, fv, cv], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize("suffix", [".yml", ".xml"])
def test_opencv_as_its_sample_writes_it(suffix: str, tmp_path: Path) -> None:
    """Two files; the distortion has 14 coefficients, of which the last six are zero."""
    distortion = np.r_[RADTAN, np.zeros(10)].reshape(1, 14)
    intrinsics = {"M1": camera_matrix(LEFT_K), "M2": camera_matrix(RIGHT_K)}
    intrinsics |= {"D1": distortion, "D2": distortion}
    extrinsics = {"R": T_RIGHT_LEFT[:3, :3].copy(), "T": T_RIGHT_LEFT[:3, 3:].copy()}
    for name, matrices in (("intrinsics", intrinsics), ("extrinsics", extrinsics)):
        storage = cv2.FileStorage(str(tmp_path / f"{name}{suffix}"), cv2.FILE_STORAGE_WRITE)
        for key, matrix in matrices.items():
            storage.write(key, matrix)
        storage.release()
    for name in ("intrinsics", "extrinsics"):
        calibration = read_stereo_calibration(tmp_path / f"{name}{suffix}", SIZE_PX)
        assert_as_written(calibration, coefficients=(*RADTAN, 0.0, 0.0, 0.0, 0.0))
    with pytest.raises(InputError, match="size of the images"):
        read_stereo_calibration(tmp_path / f"intrinsics{suffix}")


def test_opencv_in_one_file(tmp_path: Path) -> None:
    storage = cv2.FileStorage(str(tmp_path / "stereo.xml"), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", SIZE_PX[0])
    storage.write("image_height", SIZE_PX[1])
    storage.write("cameraMatrix1", camera_matrix(LEFT_K))
    storage.write("cameraMatrix2", camera_matrix(RIGHT_K))
    storage.write("distCoeffs1", np.array([RADTAN]))
    storage.write("distCoeffs2", np.array([RADTAN]))
    storage.write("R", T_RIGHT_LEFT[:3, :3].copy())
    storage.write("T", T_RIGHT_LEFT[:3, 3:].copy())
    storage.release()
    assert_as_written(read_stereo_calibration(tmp_path / "stereo.xml"))


def write_opencv(path: Path, coefficients: tuple[float, ...], distortion_model: str | None) -> Path:
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", SIZE_PX[0])
    storage.write("image_height", SIZE_PX[1])
    for number, intrinsics in ((1, LEFT_K), (2, RIGHT_K)):
        storage.write(f"K{number}", camera_matrix(intrinsics))
        storage.write(f"D{number}", np.array([coefficients]))
    storage.write("R", T_RIGHT_LEFT[:3, :3].copy())
    storage.write("T", T_RIGHT_LEFT[:3, 3:].copy())
    if distortion_model is not None:
        storage.write("distortion_model", distortion_model)
    storage.release()
    return path


@pytest.mark.parametrize(
    ("coefficients", "distortion_model", "model", "is_assumed"),
    [
        (EQUIDISTANT, None, "radtan", True),
        (EQUIDISTANT, "fisheye", "equidistant", False),
        (RADTAN, "plumb_bob", "radtan", False),
        ((*RADTAN, 0.01), None, "radtan", False),
        ((0.0, 0.0, 0.0, 0.0), None, "radtan", False),
    ],
)
@pytest.mark.parametrize("suffix", [".yml", ".xml"])
def test_four_coefficients_of_opencv_are_reported_if_nothing_tells_what_they_are(
    suffix: str,
    coefficients: tuple[float, ...],
    distortion_model: str | None,
    model: str,
    *,
    is_assumed: bool,
    tmp_path: Path,
) -> None:
    path = write_opencv(tmp_path / f"stereo{suffix}", coefficients, distortion_model)
    calibration = read_stereo_calibration(path)
    assert calibration.left.distortion_model == calibration.right.distortion_model == model
    notes = dict(calibration.notes)
    assert ("! calibration" in notes) == is_assumed
    if is_assumed:
        assert "the key distortion_model with the value fisheye" in notes["! calibration"]


def test_what_was_assumed_of_a_calibration_is_a_note_of_the_recording(tmp_path: Path) -> None:
    folder = write_folder_sequence(tmp_path / "folder", imu=False)
    sequence = open_sequence(
        folder, calibration=write_opencv(tmp_path / "stereo.yml", RADTAN, None)
    )
    assert isinstance(sequence, StereoRecording)
    assert "stereo.yml has four" in dict(sequence.notes)["! calibration"]


def test_orb_slam3(tmp_path: Path) -> None:
    lines = ["%YAML:1.0", 'File.version: "1.0"', 'Camera.type: "PinHole"']
    for name, intrinsics in (("Camera1", LEFT_K), ("Camera2", RIGHT_K)):
        pairs = zip(("fx", "fy", "cx", "cy"), intrinsics, strict=True)
        lines += [f"{name}.{key}: {value}" for key, value in pairs]
        pairs = zip(("k1", "k2", "p1", "p2"), RADTAN, strict=True)
        lines += [f"{name}.{key}: {value:.6f}" for key, value in pairs]
    lines += ["Camera.width: 64", "Camera.height: 48"]
    for key, T in (("Stereo.T_c1_c2", T_RIGHT_LEFT), ("IMU.T_b_c1", T_LEFT_IMU)):
        data = se3.inverse(T).ravel().tolist()
        lines += [f"{key}: !!opencv-matrix", "  rows: 4", "  cols: 4", "  dt: f", f"  data: {data}"]
    write_lines(tmp_path / "EuRoC.yaml", lines)
    calibration = read_stereo_calibration(tmp_path / "EuRoC.yaml", SIZE_PX)
    assert_as_written(calibration, coefficients=(*RADTAN, 0.0))
    np.testing.assert_allclose(calibration.T_left_imu, T_LEFT_IMU, atol=1e-12)


def test_a_vector_of_opencv_5_is_read(tmp_path: Path) -> None:
    """It has another tag than a matrix."""
    path = tmp_path / "vector.yml"
    lines = ["%YAML 1.2", "---", "D1: !!opencv-nd-matrix", "   sizes: [ 4 ]", "   dt: d"]
    write_lines(path, [*lines, "   data: [ 0.1, 0.2,", "       0.3, 0.4 ]"])
    np.testing.assert_array_equal(load_calibration(path).numbers("D1"), [0.1, 0.2, 0.3, 0.4])


def write_ros(folder: Path, distortion: tuple[float, ...] = RADTAN) -> None:
    """Write left.yaml and right.yaml of a rectification that OpenCV has computed."""
    R_left, R_right, P_left, P_right, *_ = cv2.stereoRectify(
        camera_matrix(LEFT_K),
        np.array(RADTAN),
        camera_matrix(RIGHT_K),
        np.array(RADTAN),
        SIZE_PX,
        T_RIGHT_LEFT[:3, :3].copy(),
        T_RIGHT_LEFT[:3, 3:].copy(),
    )
    for side, K, R, P in (("left", LEFT_K, R_left, P_left), ("right", RIGHT_K, R_right, P_right)):
        matrices = {
            "camera_matrix": camera_matrix(K),
            "distortion_coefficients": np.array([distortion]),
            "rectification_matrix": R,
            "projection_matrix": P,
        }
        content: dict[str, Any] = {
            key: {"rows": len(matrix), "cols": matrix.shape[1], "data": matrix.ravel().tolist()}
            for key, matrix in matrices.items()
        }
        content |= {"image_width": 64, "image_height": 48, "distortion_model": "plumb_bob"}
        write_yaml(folder / f"{side}.yaml", content)


def test_ros(tmp_path: Path) -> None:
    write_ros(tmp_path)
    for side in ("left", "right"):
        assert_as_written(read_stereo_calibration(tmp_path / f"{side}.yaml", SIZE_PX))
    (tmp_path / "left.yaml").rename(tmp_path / "front.yaml")
    with pytest.raises(InputError, match=r"left\.yaml: this file is missing"):
        read_stereo_calibration(tmp_path / "right.yaml")
    with pytest.raises(InputError, match="does not tell which"):
        read_stereo_calibration(tmp_path / "front.yaml")


def test_ros_with_the_zeros_that_opencv_appends(tmp_path: Path) -> None:
    """Thin-prism and tilt terms of zero change nothing; others are not known here."""
    write_ros(tmp_path, (*RADTAN, *np.zeros(10)))
    calibration = read_stereo_calibration(tmp_path / "left.yaml", SIZE_PX)
    assert_as_written(calibration, coefficients=(*RADTAN, 0.0, 0.0, 0.0, 0.0))
    write_ros(tmp_path, (*RADTAN, *np.zeros(9), 0.01))
    with pytest.raises(InputError, match="takes 4 or 5 or 8 finite coefficients"):
        read_stereo_calibration(tmp_path / "left.yaml", SIZE_PX).rectification()


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"fu_px: 3", "not the calibration of a stereo pair"),
        (b"[1, 2]", "not a calibration"),
        (b"cam0: {intrinsics: [1]}", "one camera"),
        (b"a: !!opencv-matrix 3", "not YAML"),
        (b"a: !!opencv-matrix [50., 0., 31.]", "found a sequence"),
        (b"\xff\xfe\x00", "text"),
    ],
)
def test_other_files_are_refused(content: bytes, words: str, tmp_path: Path) -> None:
    (tmp_path / "file.yaml").write_bytes(content)
    with pytest.raises(InputError, match=words):
        read_stereo_calibration(tmp_path / "file.yaml")
    (tmp_path / "file.xml").write_bytes(content)
    with pytest.raises(InputError):
        read_stereo_calibration(tmp_path / "file.xml")
    for suffix in ("yaml", "xml"):
        with pytest.raises(InputError, match=r"this file is missing\.\n *Name a calibration"):
            read_stereo_calibration(tmp_path / f"nothing.{suffix}")


# --- real files ----------------------------------------------------------------------------------

BASELINES_M: dict[str, float | str] = {
    "dellaldd_camchain-imucam-euroc.yaml": 0.11008,
    "kartikmohta_camchain-imucam.yaml": 0.20015,
    "openvins_euroc_mav.yaml": 0.11008,
    "openvins_kaist_vio.yaml": 0.04996,
    "openvins_rs_d455.yaml": "one camera",
    "openvins_tum_vi.yaml": 0.10106,
    "vins_fusion_realsense_d435i/realsense_stereo_imu_config.yaml": 0.06,
    "vins_fusion_realsense_d435i/left.yaml": "one camera of VINS-Fusion",
}


@pytest.mark.data
@pytest.mark.parametrize("name", BASELINES_M)
def test_real_files_are_read_or_refused_by_name(name: str, data_root: Path) -> None:
    path = data_root / "calibrations" / name
    known = BASELINES_M[name]
    if isinstance(known, str):
        with pytest.raises(InputError, match=known):
            read_stereo_calibration(path)
        return
    calibration = read_stereo_calibration(path)
    assert calibration.T_left_imu is not None
    camera = calibration.rectification().camera
    # VINS-Fusion's comes from two poses of the IMU, which were estimated apart.
    assert camera.baseline_m == pytest.approx(known, rel=0.02 if "vins" in name else 1e-3)


def raw_pixels(
    rectification: Rectification, camera: PinholeCamera, rect_px: FloatArray
) -> FloatArray:
    """Where in the raw left image the rays of rectified pixels are, [N, 2], px."""
    rectified = rectification.camera
    x, y = rectified.normalized(rect_px[:, 0], rect_px[:, 1])
    rays = np.column_stack([x, y, np.ones_like(x)]) @ rectification.C_rect_left
    no_motion = np.zeros(3)
    distortion = np.array(camera.distortion)
    return cv2.projectPoints(rays[:, None], no_motion, no_motion, camera.matrix, distortion)[0][
        :, 0
    ]


@pytest.mark.data
@pytest.mark.parametrize(
    ("name", "within_px"),
    [
        ("dellaldd_camchain-imucam-euroc.yaml", 1e-6),
        # It has eleven digits of two poses, whose difference is the pose of the pair.
        ("openvins_euroc_mav.yaml", 1e-5),
    ],
)
def test_euroc_by_kalibr_is_euroc_by_its_own_files(
    name: str, within_px: float, data_root: Path
) -> None:
    mav = data_root / "euroc" / "V1_01_micro" / "mav0"
    own = open_sequence(mav.parent)
    assert isinstance(own, StereoRecording)
    assert own.rectification is not None
    by_kalibr = read_stereo_calibration(data_root / "calibrations" / name).rectification()
    raw_camera = read_yaml(mav / "cam0" / "sensor.yaml", CameraFile).pinhole()
    u, v = np.meshgrid(np.linspace(0, 751, 20), np.linspace(0, 479, 15))
    pixels = np.column_stack([u.ravel(), v.ravel()])
    ours = raw_pixels(by_kalibr, raw_camera, pixels)
    theirs = raw_pixels(own.rectification, raw_camera, pixels)
    np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=within_px)


def write_raw_pair(root: Path, frames: int = 3) -> Path:
    """Raw images named by their stamps, with a Kalibr file."""
    for index in range(frames):
        name = f"{1520530308199447626 + index * 50_000_000}.png"
        write_image(root / "left" / name, image(index))
        write_image(root / "right" / name, image(index, right=True))
    return root


def test_a_folder_with_a_kalibr_file(tmp_path: Path) -> None:
    write_raw_pair(tmp_path / "raw")
    file = write_yaml(tmp_path / "camchain.yaml", kalibr())
    by_option = open_sequence(tmp_path / "raw", calibration=file)
    write_yaml(tmp_path / "raw" / "calib.yaml", kalibr())
    by_itself = open_sequence(tmp_path / "raw")
    expected = read_stereo_calibration(file).rectification()
    for sequence in (by_option, by_itself):
        assert sequence.camera == expected.camera
        frame = next(iter(sequence))
        left, right = expected.rectify(image(0), image(0, right=True))
        np.testing.assert_array_equal(frame.left, left)
        np.testing.assert_array_equal(frame.right, right)
    assert by_option.imu is None  # there are no samples


def test_a_folder_with_a_kalibr_file_and_samples_of_the_imu(tmp_path: Path) -> None:
    write_raw_pair(tmp_path)
    write_yaml(tmp_path / "calib.yaml", kalibr())
    start_ns = 1520530308199447626 - 30_000_000  # the clock of the IMU is 30 ms behind
    rows = [f"{start_ns + k * 5_000_000},0,0,0.1,0,0,9.81" for k in range(-2, 25)]
    write_lines(tmp_path / "imu.csv", ["stamp_ns,wx,wy,wz,ax,ay,az", *rows])
    sequence = open_sequence(tmp_path)
    assert isinstance(sequence, StereoRecording)
    assert sequence.imu is not None
    assert sequence.imu_stream is not None
    assert sequence.rectification is not None
    T_rect_left = se3.from_parts(sequence.rectification.C_rect_left, np.zeros(3))
    np.testing.assert_allclose(sequence.imu.T_cam_imu, T_rect_left @ T_LEFT_IMU, atol=1e-12)
    assert sequence.stamps_ns[0] in sequence.imu_stream.stamps_ns


def test_samples_of_an_imu_without_a_pose_are_not_left_out_silently(tmp_path: Path) -> None:
    write_raw_pair(tmp_path)
    content = kalibr()
    for camera in content.values():
        del camera["T_cam_imu"]
    write_yaml(tmp_path / "calib.yaml", content)
    without_samples = open_sequence(tmp_path)
    assert isinstance(without_samples, StereoRecording)
    assert "! IMU" not in dict(without_samples.notes)
    write_lines(tmp_path / "imu.csv", ["stamp_ns,wx,wy,wz,ax,ay,az", "0,0,0,0,0,0,9.8"])
    sequence = open_sequence(tmp_path)
    assert isinstance(sequence, StereoRecording)
    assert sequence.imu is None
    text = dict(sequence.notes)["! IMU"]
    assert "imu.csv is not used: calib.yaml does not have its pose" in text


NOISE = {
    "gyroscope_noise_density": 1e-4,
    "gyroscope_random_walk": 2e-5,
    "accelerometer_noise_density": 3e-3,
    "accelerometer_random_walk": 4e-4,
    "update_rate": 200.0,
    "rostopic": "/imu0",
}


@pytest.mark.parametrize("content", [NOISE, {"imu0": NOISE}], ids=["input", "result"])
def test_the_noise_of_the_imu_by_kalibr(content: dict[str, Any], tmp_path: Path) -> None:
    folder = write_folder_sequence(tmp_path / "folder")
    own = open_sequence(folder).imu
    by_file = open_sequence(folder, imu_noise=write_yaml(tmp_path / "imu.yaml", content)).imu
    assert own is not None
    assert by_file is not None
    np.testing.assert_array_equal(by_file.T_cam_imu, own.T_cam_imu)
    assert by_file.gyro_noise_rad_s_sqrt_hz == 1e-4
    assert by_file.gyro_bias_walk_rad_s2_sqrt_hz == 2e-5
    assert by_file.accel_noise_m_s2_sqrt_hz == 3e-3
    assert by_file.accel_bias_walk_m_s3_sqrt_hz == 4e-4
    assert by_file.gyro_bias_sigma_rad_s == own.gyro_bias_sigma_rad_s


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"gyroscope_random_walk": 0.0}, "gyroscope_random_walk: is 0"),
        ({"accelerometer_noise_density": "low"}, "expected a finite number"),
    ],
)
def test_faulty_noise_is_refused(change: dict[str, Any], words: str, tmp_path: Path) -> None:
    file = write_yaml(tmp_path / "imu.yaml", NOISE | change)
    with pytest.raises(InputError, match=words):
        open_sequence(write_folder_sequence(tmp_path / "folder"), imu_noise=file)


def test_noise_without_an_imu_is_refused(tmp_path: Path) -> None:
    file = write_yaml(tmp_path / "imu.yaml", NOISE)
    with pytest.raises(InputError, match="no IMU"):
        open_sequence(write_folder_sequence(tmp_path / "folder", imu=False), imu_noise=file)


@pytest.mark.data
def test_the_noise_of_tumvi(data_root: Path, tmp_path: Path) -> None:
    file = data_root / "tumvi_micro" / "imu_config.yaml"
    imu = open_sequence(write_folder_sequence(tmp_path), imu_noise=file).imu
    assert imu is not None
    assert imu.gyro_noise_rad_s_sqrt_hz == 0.00016
    assert imu.accel_bias_walk_m_s3_sqrt_hz == 0.00086


def row_offsets_px(left: Any, right: Any) -> FloatArray:
    """Row of the right minus that of the left image, [N], of SIFT's unambiguous matches."""
    sift: Any = cv2.SIFT_create(2000)  # type: ignore[attr-defined]
    left_points, left_words = sift.detectAndCompute(left, None)
    right_points, right_words = sift.detectAndCompute(right, None)
    matches = cv2.BFMatcher().knnMatch(left_words, right_words, k=2)
    good = [best for best, second in matches if best.distance < 0.6 * second.distance]
    rows = [(left_points[m.queryIdx].pt[1], right_points[m.trainIdx].pt[1]) for m in good]
    left_rows, right_rows = np.array(rows).T
    return right_rows - left_rows


@pytest.mark.data
def test_tumvi_rectifies_to_equal_rows(data_root: Path, tmp_path: Path) -> None:
    """The offset of 0.45 px is the calibration's: undistorting the raw matches gives it, too."""
    tumvi = data_root / "tumvi_micro"
    (tmp_path / "left").symlink_to(tumvi / "cam0" / "images")
    (tmp_path / "right").symlink_to(tumvi / "cam1" / "images")
    sequence = open_sequence(tmp_path, calibration=tumvi / "camchain.yaml")
    assert len(sequence) == 4
    assert sequence.stamps_ns[0] == 1520530308199447626
    for frame in sequence:
        offsets_px = row_offsets_px(frame.left, frame.right)
        assert len(offsets_px) > 50
        assert abs(np.median(offsets_px)) < 0.5
        assert np.median(np.abs(offsets_px - np.median(offsets_px))) < 0.1

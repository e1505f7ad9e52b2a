"""Every format: what was written comes back, with the same meaning."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml

from probevo.camera.stereo import StereoCamera
from probevo.errors import InputError
from probevo.sequences import open_sequence
from probevo.sequences.recording import StereoRecording
from sequences.recordings import (
    BASELINE_M,
    C_CAM_IMU,
    CU_PX,
    CV_PX,
    FU_PX,
    HEIGHT_PX,
    T_CAM_IMU,
    WIDTH_PX,
    camchain_yaml,
    image,
    poses,
    sensor_yaml,
    stamps_ns,
    write_euroc,
    write_folder_sequence,
    write_four_seasons,
    write_kitti_odometry,
    write_kitti_raw,
    write_lines,
    write_tartan_air,
    write_tracks,
    write_tum_vi,
    write_virtual_kitti,
)

WRITERS: dict[str, Callable[[Path], Path]] = {
    "folder": write_folder_sequence,
    "kitti-odometry": write_kitti_odometry,
    "kitti-raw": write_kitti_raw,
    "euroc": write_euroc,
    "tracks": write_tracks,
    "tum-vi": write_tum_vi,
    "4seasons": write_four_seasons,
    "tartanair": write_tartan_air,
    "vkitti2": write_virtual_kitti,
}
RECTIFIED = ("folder", "kitti-odometry", "kitti-raw", "4seasons")


@pytest.mark.parametrize("format", WRITERS)
def test_format_is_detected_and_can_be_named(format: str, tmp_path: Path) -> None:
    path = WRITERS[format](tmp_path)
    assert open_sequence(path).format == format
    assert open_sequence(str(path), format).path == path


@pytest.mark.parametrize("format", WRITERS)
def test_frames_are_numbered_and_carry_the_stamps(format: str, tmp_path: Path) -> None:
    sequence = open_sequence(WRITERS[format](tmp_path))
    frames = list(sequence)
    assert len(frames) == len(sequence) == 4
    assert [frame.index for frame in frames] == [0, 1, 2, 3]
    assert [frame.stamp_ns for frame in frames] == sequence.stamps_ns.tolist()


@pytest.mark.parametrize("format", WRITERS)
def test_truth_advances_one_metre_a_frame(format: str, tmp_path: Path) -> None:
    truth = open_sequence(WRITERS[format](tmp_path)).truth
    assert truth is not None
    assert truth.known.all()
    np.testing.assert_allclose(truth.T_world_cam, poses(4), atol=1e-6)


@pytest.mark.parametrize("format", WRITERS)
def test_a_sequence_can_be_read_twice(format: str, tmp_path: Path) -> None:
    sequence = open_sequence(WRITERS[format](tmp_path))
    for first, second in zip(sequence, sequence, strict=True):
        np.testing.assert_equal(first.left, second.left)
        np.testing.assert_equal(
            first.features and first.features.pixels, second.features and second.features.pixels
        )


@pytest.mark.parametrize("format", RECTIFIED)
def test_images_come_back(format: str, tmp_path: Path) -> None:
    sequence = open_sequence(WRITERS[format](tmp_path))
    assert sequence.camera == StereoCamera(
        FU_PX, FU_PX, CU_PX, cv_px=CV_PX, baseline_m=BASELINE_M, size_px=(WIDTH_PX, HEIGHT_PX)
    )
    for frame in sequence:
        np.testing.assert_array_equal(frame.left, image(frame.index))
        np.testing.assert_array_equal(frame.right, image(frame.index, right=True))
        assert frame.decode_ms > 0


@pytest.mark.parametrize("format", ["folder", "kitti-raw", "euroc", "tracks", "tum-vi", "4seasons"])
def test_imu_covers_every_interval(format: str, tmp_path: Path) -> None:
    sequence = open_sequence(WRITERS[format](tmp_path))
    first, *others = sequence
    assert first.imu is None
    for frame in others:
        assert frame.imu is not None
        assert frame.imu.stamps_ns[0] <= sequence.stamps_ns[frame.index - 1]
        assert frame.imu.stamps_ns[-1] >= frame.stamp_ns
    assert sequence.imu is not None
    np.testing.assert_allclose(sequence.imu.C_cam_imu, C_CAM_IMU, atol=1e-12)
    np.testing.assert_allclose(sequence.imu.T_cam_imu, T_CAM_IMU, atol=1e-12)


@pytest.mark.parametrize("kind", [np.int8, np.int32, np.int64, np.float32])
def test_whole_seconds_of_any_type_are_seconds(kind: type, tmp_path: Path) -> None:
    sequence = open_sequence(write_tracks(tmp_path, t=np.arange(3, 7).astype(kind)))
    assert [frame.stamp_ns for frame in sequence] == [
        3_000_000_000,
        4_000_000_000,
        5_000_000_000,
        6_000_000_000,
    ]


@pytest.mark.parametrize("format", ["folder", "euroc", "kitti-raw", "tum-vi", "4seasons"])
def test_stamps_keep_their_nanoseconds(format: str, tmp_path: Path) -> None:
    np.testing.assert_array_equal(open_sequence(WRITERS[format](tmp_path)).stamps_ns, stamps_ns(4))


def test_folder_without_imu_and_truth(tmp_path: Path) -> None:
    sequence = open_sequence(write_folder_sequence(tmp_path, imu=False, truth=False))
    assert sequence.imu is None
    assert sequence.truth is None
    assert all(frame.imu is None for frame in sequence)


def test_folder_accepts_nanoseconds_and_sparse_truth(tmp_path: Path) -> None:
    write_folder_sequence(tmp_path)
    (tmp_path / "times.txt").write_text("\n".join(map(str, stamps_ns(4))))
    lines = (tmp_path / "poses.txt").read_text().splitlines()
    (tmp_path / "poses.txt").write_text("\n".join(["nan " * 12, lines[1], "nan " * 12, lines[3]]))
    sequence = open_sequence(tmp_path)
    np.testing.assert_array_equal(sequence.stamps_ns, stamps_ns(4))
    assert sequence.truth is not None
    np.testing.assert_array_equal(sequence.truth.known, [False, True, False, True])
    np.testing.assert_allclose(sequence.truth.T_world_cam[[1, 3]], poses(3)[[0, 2]], atol=1e-12)


@pytest.mark.parametrize(("offset_s", "first_ns"), [(-0.003, -2_000_000), (0.003, -8_000_000)])
def test_folder_time_offset_moves_the_imu_to_the_clock_of_the_images(
    offset_s: float, first_ns: int, tmp_path: Path
) -> None:
    """As Kalibr's: t_imu = t_cam + offset. Samples come 5 ms before the frames, every 10 ms."""
    write_folder_sequence(tmp_path)
    with (tmp_path / "calib.yaml").open("a") as file:
        file.write(f"  time_offset_s: {offset_s}\n")
    sequence = open_sequence(tmp_path)
    _, second, *_ = sequence
    assert sequence.imu is not None
    assert sequence.imu.time_offset_s == offset_s
    assert second.imu is not None
    assert second.imu.stamps_ns[0] == stamps_ns(4)[0] + first_ns


ACCEL_KEYS = ("accel_noise_m_s2_sqrt_hz", "accel_bias_sigma_m_s2", "accel_bias_walk_m_s3_sqrt_hz")


def test_folder_accelerometer_noise_is_read(tmp_path: Path) -> None:
    write_folder_sequence(tmp_path)
    with (tmp_path / "calib.yaml").open("a") as file:
        file.writelines(f"  {key}: {value}\n" for value, key in enumerate(ACCEL_KEYS, start=1))
    imu = open_sequence(tmp_path).imu
    assert imu is not None
    assert [getattr(imu, key) for key in ACCEL_KEYS] == [1.0, 2.0, 3.0]


def test_folder_knows_the_readout_of_its_shutter(tmp_path: Path) -> None:
    write_folder_sequence(tmp_path, imu=False)
    assert open_sequence(tmp_path).camera.readout_s == 0.0
    with (tmp_path / "calib.yaml").open("a") as file:
        file.write("readout_s: 0.025\n")
    assert open_sequence(tmp_path).camera.readout_s == 0.025


def test_folder_transform_may_be_sixteen_numbers(tmp_path: Path) -> None:
    write_folder_sequence(tmp_path)
    text = (tmp_path / "calib.yaml").read_text()
    flat = text.replace(str(T_CAM_IMU.tolist()), str(T_CAM_IMU.ravel().tolist()))
    assert flat != text
    (tmp_path / "calib.yaml").write_text(flat)
    imu = open_sequence(tmp_path).imu
    assert imu is not None
    np.testing.assert_array_equal(imu.T_cam_imu, T_CAM_IMU)


def test_euroc_noise_is_that_of_sensor_yaml(tmp_path: Path) -> None:
    imu = open_sequence(write_euroc(tmp_path)).imu
    assert imu is not None
    assert imu.gyro_noise_rad_s_sqrt_hz == 1.7e-4
    assert imu.gyro_bias_walk_rad_s2_sqrt_hz == 1.9e-5
    assert imu.accel_noise_m_s2_sqrt_hz == 2e-3
    assert imu.accel_bias_walk_m_s3_sqrt_hz == 4e-3


def test_tracks_without_the_place_of_the_imu_have_it_at_the_camera(tmp_path: Path) -> None:
    imu = open_sequence(write_tracks(tmp_path, p_imu_cam=None)).imu
    assert imu is not None
    np.testing.assert_array_equal(imu.T_cam_imu[:3, 3], np.zeros(3))


def test_euroc_drops_images_without_a_partner(tmp_path: Path) -> None:
    path = write_euroc(tmp_path)
    lines = (path / "mav0" / "cam0" / "data.csv").read_text().splitlines()
    (path / "mav0" / "cam0" / "data.csv").write_text("\n".join([*lines[:2], *lines[3:]]))
    sequence = open_sequence(path)
    np.testing.assert_array_equal(sequence.stamps_ns, stamps_ns(4)[[0, 2, 3]])
    assert isinstance(sequence, StereoRecording)
    assert "without a partner: 0 left, 1 right" in dict(sequence.notes)["! pairs"]


@pytest.mark.parametrize(("write", "camera"), [(write_euroc, "cam1"), (write_tum_vi, "cam0")])
def test_stamps_of_a_pair_may_differ_a_little(
    write: Callable[[Path], Path], camera: str, tmp_path: Path
) -> None:
    path = write(tmp_path)
    data = path / "mav0" / camera / "data.csv"

    def shift(offset_ns: int) -> None:
        header, *lines = data.read_text().splitlines()
        rows = [line.split(",") for line in lines]
        data.write_text(
            "\n".join([header, *(f"{int(stamp) + offset_ns},{name}" for stamp, name in rows)])
        )

    shift(1_000)
    sequence = open_sequence(path)
    assert len(sequence) == 4
    assert isinstance(sequence, StereoRecording)
    assert "at most 0.001 ms apart" in dict(sequence.notes)["pairs"]
    np.testing.assert_array_equal(list(sequence)[2].right.shape, list(sequence)[2].left.shape)
    shift(5_000_000)
    with pytest.raises(InputError, match=r"only 0 of 4 left(?s:.*)--pair-tolerance-ms allows"):
        open_sequence(path)
    assert len(open_sequence(path, pair_tolerance_ms=6.0)) == 4


def test_the_truth_of_euroc_is_that_of_its_sensor(tmp_path: Path) -> None:
    """T_BS takes coordinates from the sensor to the body: T_map_body = T_map_sensor T_BS⁻¹."""
    path = write_euroc(tmp_path)
    folder = path / "mav0" / "state_groundtruth_estimate0"
    before = open_sequence(path).truth
    write_lines(folder / "sensor.yaml", sensor_yaml(np.eye(4)))
    same = open_sequence(path).truth
    assert before is not None
    assert same is not None
    np.testing.assert_array_equal(same.T_world_cam, before.T_world_cam)
    # A sensor whose z axis, along which it moves by the file, is the body's −y axis.
    T_body_sensor = np.array(
        [[1.0, 0.0, 0.0, 0.2], [0.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
    )
    write_lines(folder / "sensor.yaml", sensor_yaml(T_body_sensor))
    after = open_sequence(path).truth
    assert after is not None
    expected = T_body_sensor @ before.T_world_cam @ np.linalg.inv(T_body_sensor)
    np.testing.assert_allclose(after.T_world_cam, expected, atol=1e-12)
    np.testing.assert_allclose(after.T_world_cam[:, 1, 3], -before.T_world_cam[:, 2, 3], atol=1e-12)
    write_lines(folder / "sensor.yaml", ["comment: none"])
    with pytest.raises(InputError, match="T_BS is missing"):
        open_sequence(path)


def test_a_calibration_of_the_cameras_of_euroc_says_that_imu_and_truth_are_not_used(
    tmp_path: Path,
) -> None:
    """Both once vanished without a word."""
    path = write_euroc(tmp_path / "euroc")
    for camera in ("cam0", "cam1"):
        (path / "mav0" / camera / "sensor.yaml").unlink()
    chain = yaml.safe_load("\n".join(camchain_yaml(np.eye(4))))
    for camera in chain.values():
        del camera["T_cam_imu"]
    file = tmp_path / "cameras.yaml"
    file.write_text(yaml.safe_dump(chain))
    sequence = open_sequence(path, calibration=file)
    assert sequence.imu is None
    assert sequence.truth is None
    assert isinstance(sequence, StereoRecording)
    notes = dict(sequence.notes)
    assert notes["! IMU"].startswith("imu0 is not used: cameras.yaml does not have its pose")
    assert notes["! truth"].startswith("state_groundtruth_estimate0 is not used: its poses are")
    for name in ("! IMU", "! truth"):
        assert "T_cam_imu as --calibration" in notes[name]


@pytest.mark.parametrize("named_by", ["imu", "camera"])
def test_a_kalibr_file_replaces_the_cameras_of_euroc(named_by: str, tmp_path: Path) -> None:
    """The body is found by the file's T_cam_imu, or else by sensor.yaml of the left camera."""
    path = write_euroc(tmp_path / "euroc")
    own = open_sequence(path)
    assert own.imu is not None
    chain = [line.replace("equidistant", "radtan") for line in camchain_yaml(own.imu.T_cam_imu)]
    chain[1:1] = ["  timeshift_cam_imu: 0.002"]
    if named_by == "imu":
        (path / "mav0" / "cam0" / "sensor.yaml").unlink()
    else:
        shutil.rmtree(path / "mav0" / "imu0")
    (path / "mav0" / "cam1" / "sensor.yaml").unlink()
    file = tmp_path / "camchain.yaml"
    file.write_text("\n".join(chain))
    by_kalibr = open_sequence(path, calibration=str(file))
    assert by_kalibr.camera == own.camera
    assert own.truth is not None
    assert by_kalibr.truth is not None
    np.testing.assert_allclose(by_kalibr.truth.T_world_cam, own.truth.T_world_cam, atol=1e-9)
    if named_by == "camera":
        assert by_kalibr.imu is None
        return
    assert by_kalibr.imu is not None
    np.testing.assert_allclose(by_kalibr.imu.T_cam_imu, own.imu.T_cam_imu, atol=1e-9)
    assert by_kalibr.imu.time_offset_s == 0.002
    with pytest.raises(InputError, match="--calibration"):
        open_sequence(path)


def test_euroc_opens_from_within_mav0(tmp_path: Path) -> None:
    sequence = open_sequence(write_euroc(tmp_path) / "mav0")
    assert sequence.camera.baseline_m == pytest.approx(BASELINE_M)


def test_kitti_raw_without_oxts(tmp_path: Path) -> None:
    sequence = open_sequence(write_kitti_raw(tmp_path, oxts=False))
    assert sequence.imu is None
    assert sequence.truth is None


def test_tracks_come_back_frame_by_frame(tmp_path: Path) -> None:
    kept = np.r_[0:6, 12:24]  # frame 1 has no features
    with np.load(write_tracks(tmp_path)) as archive:
        arrays = {name: archive[name][kept] for name in ("frame", "track", "uv")}
    for frame in open_sequence(write_tracks(tmp_path, **arrays)):
        assert frame.left is None
        assert frame.features is not None
        rows = arrays["frame"] == frame.index
        np.testing.assert_array_equal(frame.features.ids, arrays["track"][rows])
        np.testing.assert_array_equal(frame.features.pixels, arrays["uv"][rows])


def test_tracks_gyro_sample_holds_over_the_interval_that_it_ends(tmp_path: Path) -> None:
    for frame in list(open_sequence(write_tracks(tmp_path)))[1:]:
        assert frame.imu is not None
        np.testing.assert_allclose(frame.imu.gyro_rad_s[-2:, 2], 0.1 * frame.index)
        assert np.isnan(frame.imu.accel_m_s2).all()

"""The IMU of a bag: faulty ones are left out or refused, and what was not measured is no zero."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

pytest.importorskip("rosbags")

from probevo.arrays import FloatArray
from probevo.cli.main import main
from probevo.errors import InputError
from probevo.output.ros.bag_writer import written_bag
from probevo.output.ros.ros_fields import transform_fields, vector_fields
from probevo.sequences import open_sequence
from probevo.sequences.formats.rosbag import BagRecording
from probevo.sequences.imu import ImuStream
from probevo.sequences.recording import StereoRecording
from sequences.formats.test_rosbag_truth import (
    FRAMES,
    OPTICAL,
    STAMPS_NS,
    add_faulty_transform,
    add_images,
)
from sequences.recordings import START_NS, T_CAM_IMU

TOPIC = "/imu"
PERIOD_NS = 5_000_000
NUM_SAMPLES = 70
RATE_RAD_S = np.array([0.0, 0.0, 0.1])
FORCE_M_S2 = np.array([0.3, 0.0, 9.81])
ZERO = np.zeros(3)
UNKNOWN = np.array([-1.0, *[0.0] * 8])
"""Covariance of a quantity that a message does not have."""
HOUR_NS = 3_600_000_000_000


def samples(
    rate_rad_s: FloatArray = RATE_RAD_S,
    force_m_s2: FloatArray = FORCE_M_S2,
    *,
    start_ns: int = START_NS,
    period_ns: int = PERIOD_NS,
    **covariances: FloatArray,
) -> list[tuple[int, dict[str, Any]]]:
    """Stamps and fields of alike samples."""
    fields = {
        "angular_velocity": vector_fields(rate_rad_s),
        "linear_acceleration": vector_fields(force_m_s2),
        **covariances,
    }
    return [(start_ns + k * period_ns, fields) for k in range(NUM_SAMPLES)]


def write_imu_bag(
    path: Path,
    topics: dict[str, list[tuple[int, dict[str, Any]]]],
    *,
    faulty_child: str | None = None,
    image_frame: str = OPTICAL,
    imu_frame: str = "imu_link",
) -> Path:
    """A bag of images and IMUs, which are mounted in the camera's frame."""
    with written_bag(path) as bag:
        mounting = transform_fields(T_CAM_IMU, START_NS, parent=OPTICAL, child="imu_link")
        if faulty_child != "imu_link":
            bag.write_transforms("/tf_static", START_NS, [mounting])
        if faulty_child is not None:
            add_faulty_transform(bag, faulty_child)
        for index in range(FRAMES):
            add_images(bag, index, frame=image_frame)
        for topic, rows in topics.items():
            for stamp_ns, fields in rows:
                bag.write(topic, "sensor_msgs/msg/Imu", stamp_ns, fields, frame=imu_frame)
    return path


def opened(path: Path, **options: object) -> BagRecording:
    bag = open_sequence(path, **options)
    assert isinstance(bag, BagRecording)
    return bag


def stream_of(bag: BagRecording | StereoRecording) -> ImuStream:
    assert bag.imu_stream is not None
    return bag.imu_stream


# --- faulty IMUs ---------------------------------------------------------------------------------

FAULTY = {
    "on another clock": (samples(start_ns=HOUR_NS), "Both need the same clock"),
    "without stamps": (samples(period_ns=0), "1 IMU samples; at least 2"),
    "accelerometer": (samples(ZERO), "the topic of an accelerometer"),
    "rates unknown": (samples(angular_velocity_covariance=UNKNOWN), "of an accelerometer"),
    "only zeros": (samples(ZERO, ZERO), "no angular rates"),
}


@pytest.mark.parametrize("name", FAULTY)
def test_a_faulty_imu_is_reported_and_not_used(name: str, tmp_path: Path) -> None:
    rows, words = FAULTY[name]
    bag = opened(write_imu_bag(tmp_path / "drive.mcap", {TOPIC: rows}))
    assert bag.imu is None
    assert bag.imu_stream is None
    assert [frame.imu for frame in bag] == [None] * FRAMES
    text = dict(bag.notes)["! IMU"]
    assert text.startswith("/imu is not used: ")
    assert words in text


@pytest.mark.parametrize("name", FAULTY)
@pytest.mark.parametrize("option", ["topics_imu", "imu_noise"])
def test_a_faulty_imu_that_the_user_wants_is_refused(
    option: str, name: str, tmp_path: Path
) -> None:
    rows, words = FAULTY[name]
    path = write_imu_bag(tmp_path / "drive.mcap", {TOPIC: rows})
    noise = {
        "gyroscope_noise_density": 1e-4,
        "gyroscope_random_walk": 2e-5,
        "accelerometer_noise_density": 3e-3,
        "accelerometer_random_walk": 4e-4,
    }
    file = tmp_path / "imu.yaml"
    file.write_text(yaml.safe_dump(noise))
    with pytest.raises(InputError, match=words) as refused:
        open_sequence(path, **{option: TOPIC if option == "topics_imu" else file})
    assert refused.value.where == f"{path}: {TOPIC}"


def test_of_several_imus_none_is_used_unless_it_is_named(tmp_path: Path) -> None:
    """Cameras with an IMU often have one topic for the gyro, and one for the accelerometer."""
    path = write_imu_bag(
        tmp_path / "drive.mcap",
        {"/gyro": samples(force_m_s2=ZERO), "/accel": samples(ZERO)},
    )
    bag = opened(path)
    assert bag.imu is None
    assert len(list(bag)) == FRAMES
    text = dict(bag.notes)["! IMU"]
    assert "/gyro" in text
    assert "/accel" in text
    assert "--topics.imu" in text
    gyro = stream_of(opened(path, topics_imu="/gyro"))
    assert (gyro.gyro_rad_s == RATE_RAD_S).all()
    assert np.isnan(gyro.accel_m_s2).all()
    with pytest.raises(InputError, match=r"/accel: .* accelerometer\.\n.*--topics\.imu"):
        open_sequence(path, topics_imu="/accel")


@pytest.mark.parametrize("options", [{"imu_noise": "imu.yaml"}, {"truth_of": "imu"}])
def test_an_option_of_the_imu_needs_to_know_which(options: dict[str, str], tmp_path: Path) -> None:
    path = write_imu_bag(tmp_path / "drive.mcap", {"/a": samples(), "/b": samples()})
    with pytest.raises(InputError, match=r"several topics are IMUs: /a, /b\.\n.*--topics\.imu"):
        open_sequence(path, **options)


# --- transforms ----------------------------------------------------------------------------------


def test_a_faulty_transform_of_a_frame_that_nobody_needs_is_skipped(tmp_path: Path) -> None:
    path = write_imu_bag(tmp_path / "drive.mcap", {TOPIC: samples()}, faulty_child="lidar")
    bag = opened(path)
    assert bag.imu is not None
    np.testing.assert_allclose(bag.imu.T_cam_imu, T_CAM_IMU, atol=1e-12)
    text = dict(bag.notes)["! tf_static"]
    assert text.startswith("the transform of lidar is not used: ")
    assert "has length 0." in text


def test_an_imu_whose_transform_is_faulty_is_not_used(tmp_path: Path) -> None:
    path = write_imu_bag(tmp_path / "drive.mcap", {TOPIC: samples()}, faulty_child="imu_link")
    bag = opened(path)
    assert bag.imu is None
    assert "of imu_link is not used" in dict(bag.notes)["! tf_static"]
    assert "does not have its pose" in dict(bag.notes)["! IMU"]


@pytest.mark.parametrize("frame", ["", "base_link", "/base_link"])
def test_headers_of_one_frame_do_not_say_where_the_imu_is(frame: str, tmp_path: Path) -> None:
    """Its axes were once taken for those of the image, silently."""
    path = write_imu_bag(
        tmp_path / "drive.mcap",
        {TOPIC: samples()},
        image_frame=frame,
        imu_frame=frame.removeprefix("/"),
    )
    bag = opened(path)
    assert bag.imu is None
    assert [each.imu for each in bag] == [None] * FRAMES
    assert "does not have its pose" in dict(bag.notes)["! IMU"]
    truth = tmp_path / "truth.tum"
    truth.write_text("".join(f"{stamp * 1e-9:.3f} 0 0 0 0 0 0 1\n" for stamp in STAMPS_NS))
    with pytest.raises(InputError, match="those of the IMU, whose place in the camera's frame"):
        open_sequence(path, truth=truth, truth_of="imu")


# --- without an accelerometer --------------------------------------------------------------------

GYRO_ONLY = {
    "said by the covariance": samples(linear_acceleration_covariance=UNKNOWN),
    "zeros": samples(force_m_s2=ZERO),
    "nan": samples(force_m_s2=np.full(3, np.nan)),
}


@pytest.mark.parametrize("suffix", [".bag", ".mcap"])
@pytest.mark.parametrize("name", GYRO_ONLY)
def test_a_force_that_was_not_measured_is_nan(name: str, suffix: str, tmp_path: Path) -> None:
    bag = opened(write_imu_bag(tmp_path / f"drive{suffix}", {TOPIC: GYRO_ONLY[name]}))
    assert np.isnan(stream_of(bag).accel_m_s2).all()
    assert (stream_of(bag).gyro_rad_s == RATE_RAD_S).all()
    assert dict(bag.notes)["IMU"] == "/imu has no accelerations: only its gyro is used."


def test_single_samples_may_lack_a_quantity(tmp_path: Path) -> None:
    """A zero among measured forces is a measurement, unless its covariance says otherwise."""
    rows = samples()
    rows[3] = samples(linear_acceleration_covariance=UNKNOWN)[3]
    rows[4] = samples(angular_velocity_covariance=UNKNOWN)[4]
    rows[5] = samples(ZERO, ZERO)[5]
    bag = opened(write_imu_bag(tmp_path / "drive.mcap", {TOPIC: rows}))
    stream = stream_of(bag)
    # The first sample is held before its own time: row 0 of the bag is row 1.
    assert np.flatnonzero(np.isnan(stream.accel_m_s2).any(axis=1)).tolist() == [4]
    assert np.flatnonzero(np.isnan(stream.gyro_rad_s).any(axis=1)).tolist() == [5]
    assert not stream.accel_m_s2[6].any()
    assert "IMU" not in dict(bag.notes)


def test_a_bag_without_accelerations_becomes_a_folder_and_a_bag_again(tmp_path: Path) -> None:
    rows = GYRO_ONLY["said by the covariance"]
    path = write_imu_bag(tmp_path / "drive.mcap", {TOPIC: rows})
    for source, target in (("drive.mcap", "folder"), ("folder", "again.mcap")):
        assert main(["convert", str(tmp_path / source), "--out", str(tmp_path / target)]) == 0
    bag = opened(path)
    for target in ("folder", "again.mcap"):
        converted = open_sequence(tmp_path / target)
        assert isinstance(converted, StereoRecording | BagRecording)
        np.testing.assert_array_equal(converted.stamps_ns, STAMPS_NS)
        mine = stream_of(converted).between(int(STAMPS_NS[0]), int(STAMPS_NS[-1]))
        theirs = stream_of(bag).between(int(STAMPS_NS[0]), int(STAMPS_NS[-1]))
        assert mine is not None
        assert theirs is not None
        np.testing.assert_array_equal(mine.stamps_ns, theirs.stamps_ns)
        np.testing.assert_array_equal(mine.gyro_rad_s, theirs.gyro_rad_s)
        assert np.isnan(mine.accel_m_s2).all()


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_samples_without_numbers_do_not_spoil_the_folder_of_a_bag(
    value: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its reader refuses them: without a rate they are left out, without a force it is unknown."""
    rows = samples()
    for row in (5, 6):
        rows[row] = samples(np.array([0.0, value, 0.1]))[row]
    rows[8] = samples(force_m_s2=np.array([0.3, 0.0, value]))[8]
    bag = opened(write_imu_bag(tmp_path / "drive.mcap", {TOPIC: rows}))
    assert main(["convert", str(bag.path), "--out", str(tmp_path / "folder")]) == 0
    assert "2 IMU samples are left out: they have no finite" in capsys.readouterr().out
    folder = open_sequence(tmp_path / "folder")
    assert isinstance(folder, StereoRecording)
    stamps_ns = stream_of(bag).stamps_ns
    np.testing.assert_array_equal(
        stream_of(folder).stamps_ns[1:-1], np.delete(stamps_ns, [0, 6, 7, -1])
    )
    is_unknown = np.isnan(stream_of(folder).accel_m_s2).all(axis=1)
    assert stream_of(folder).stamps_ns[is_unknown] == stamps_ns[9]


def test_an_imu_of_one_sample_with_numbers_is_not_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = samples(np.full(3, np.nan))
    rows[0] = samples()[0]
    path = write_imu_bag(tmp_path / "drive.mcap", {TOPIC: rows})
    assert main(["convert", str(path), "--out", str(tmp_path / "folder")]) == 0
    assert f"{NUM_SAMPLES} IMU samples are left out" in capsys.readouterr().out
    assert open_sequence(tmp_path / "folder").imu is None

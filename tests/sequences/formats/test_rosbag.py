"""Bags: what was written comes back, whatever the kind of bag; and what is refused, and why."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

pytest.importorskip("rosbags")

from rosbags.highlevel import AnyReader

from cli.rendering import write_wall
from probevo.arrays import AnyArray, Image
from probevo.camera.stereo import StereoCamera
from probevo.cli.main import main
from probevo.errors import InputError
from probevo.sequences import open_sequence
from probevo.sequences.formats.ros_images import gray_of
from probevo.sequences.formats.rosbag import BagRecording
from probevo.sequences.formats.rosbag_file import IMAGE_TYPES, IMU_TYPE, Topic
from probevo.sequences.formats.rosbag_topics import MAX_LISTED, topic_list
from probevo.sequences.gray_range import spread_indices
from probevo.sequences.stamp_pairs import pair_stamps
from sequences.bags import (
    KINDS,
    LEFT,
    RIGHT,
    Message,
    as_message,
    camera_info,
    compressed_image,
    images_message,
    imu_message,
    info_message,
    messages_of,
    raw_image,
    write_bag,
    write_messages,
)
from sequences.calibrations.test_calibration_files import kalibr, write_raw_pair, write_yaml
from sequences.recordings import (
    BASELINE_M,
    CU_PX,
    CV_PX,
    FRAME_NS,
    FU_PX,
    HEIGHT_PX,
    START_NS,
    T_CAM_IMU,
    WIDTH_PX,
    image,
    write_folder_sequence,
)

CAMERA = StereoCamera(
    FU_PX, FU_PX, CU_PX, cv_px=CV_PX, baseline_m=BASELINE_M, size_px=(WIDTH_PX, HEIGHT_PX)
)
LEFT_INFO = "/stereo/left/camera_info"
RIGHT_INFO = "/stereo/right/camera_info"


@pytest.mark.parametrize("kind", KINDS)
def test_a_bag_holds_what_the_folder_holds(kind: str, tmp_path: Path) -> None:
    folder = open_sequence(write_folder_sequence(tmp_path / "folder", truth=False))
    bag = open_sequence(write_bag(tmp_path / "recorded", kind, folder))
    assert bag.format == "rosbag"
    assert bag.camera == folder.camera
    np.testing.assert_array_equal(bag.stamps_ns, folder.stamps_ns)
    for mine, theirs in zip(bag, folder, strict=True):
        assert (mine.index, mine.stamp_ns) == (theirs.index, theirs.stamp_ns)
        np.testing.assert_array_equal(mine.left, theirs.left)
        np.testing.assert_array_equal(mine.right, theirs.right)
        assert (mine.imu is None) == (theirs.imu is None)
        if mine.imu is not None and theirs.imu is not None:
            np.testing.assert_array_equal(mine.imu.gyro_rad_s, theirs.imu.gyro_rad_s)
            np.testing.assert_array_equal(mine.imu.stamps_ns, theirs.imu.stamps_ns)
    assert bag.imu is not None
    np.testing.assert_allclose(bag.imu.T_cam_imu, T_CAM_IMU, atol=1e-12)


def test_png_compressed_images_are_lossless(tmp_path: Path) -> None:
    folder = open_sequence(write_folder_sequence(tmp_path / "folder", imu=False))
    messages = messages_of(folder, compressed_image)
    bag = open_sequence(write_messages(tmp_path / "recorded", "mcap", messages))
    for mine, theirs in zip(bag, folder, strict=True):
        np.testing.assert_array_equal(mine.left, theirs.left)
        np.testing.assert_array_equal(mine.right, theirs.right)


def test_a_bag_can_be_read_twice_and_left_early(tmp_path: Path) -> None:
    folder = open_sequence(write_folder_sequence(tmp_path / "folder", imu=False))
    bag = open_sequence(write_bag(tmp_path / "recorded", "db3", folder))
    for frame in bag:
        assert frame.index == 0
        break
    assert [frame.index for frame in bag] == [0, 1, 2, 3]


@pytest.fixture(scope="module")
def wall(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording on which odometry works."""
    return write_wall(tmp_path_factory.mktemp("wall"), 5)


@pytest.mark.usefixtures("undrawn")
def test_a_bag_gives_the_same_motions_as_its_pictures(wall: Path, tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "recorded", "mcap", open_sequence(wall))
    for name, path in (("pictures", wall), ("bag", bag)):
        assert main(["run", str(path), "--out", str(tmp_path / name)]) == 0
    for file in ("trajectory.tum", "trajectory.kitti.txt"):
        assert (tmp_path / "bag" / file).read_bytes() == (tmp_path / "pictures" / file).read_bytes()
    ours = np.load(tmp_path / "bag" / "motions.npz")
    theirs = np.load(tmp_path / "pictures" / "motions.npz")
    for name in ("T_curr_prev", "cov"):
        np.testing.assert_array_equal(ours[name], theirs[name])


# --- pairs ---------------------------------------------------------------------------------------


def test_pairs_are_mutually_nearest_and_within_the_tolerance() -> None:
    left_ns = np.array([0, 100, 200, 300, 400])
    right_ns = np.array([102, 4, 197, 350, 301, 401, 401])
    pairs = pair_stamps(left_ns, right_ns, tolerance_ns=3)
    np.testing.assert_array_equal(pairs.left, [1, 2, 3, 4])
    np.testing.assert_array_equal(pairs.right, [0, 2, 4, 5])
    np.testing.assert_array_equal(pairs.offsets_ns, [2, -3, 1, 1])


def test_no_pairs_of_nothing() -> None:
    assert len(pair_stamps(np.zeros(0, np.int64), np.array([1]), tolerance_ns=5)) == 0


def stereo_messages(
    left_ns: list[int], right_ns: list[int], fields: dict[str, Any] | None = None
) -> list[Message]:
    """Messages with these stamps, first all of the left camera."""
    messages = [
        info_message(LEFT_INFO, START_NS, camera_info(CAMERA)),
        info_message(RIGHT_INFO, START_NS, camera_info(CAMERA, right=True)),
    ]
    for topic, stamps_ns, right in ((LEFT, left_ns, False), (RIGHT, right_ns, True)):
        for index, stamp_ns in enumerate(stamps_ns):
            pixels = fields or raw_image(image(index, right))
            messages.append(images_message(topic, START_NS + stamp_ns, pixels))
    return messages


def test_unpaired_frames_are_left_out_and_counted(tmp_path: Path) -> None:
    left_ns = [k * FRAME_NS for k in range(5)]
    right_ns = [k * FRAME_NS + 100_000 for k in (0, 1, 3, 4)]
    path = write_messages(tmp_path / "recorded", "mcap", stereo_messages(left_ns, right_ns))
    bag = open_sequence(path)
    assert isinstance(bag, BagRecording)
    np.testing.assert_array_equal(bag.stamps_ns - START_NS, np.array([0, 1, 3, 4]) * FRAME_NS)
    text = dict(bag.notes)["! pairs"]
    assert "4, stamps at most 0.100 ms apart (within 2 ms)" in text
    assert "1 left, 0 right" in text
    # The right images are written 0, 1, 2, 3: the third of them belongs to the fourth left one.
    frames = list(bag)
    np.testing.assert_array_equal(frames[2].left, image(3))
    np.testing.assert_array_equal(frames[2].right, image(2, right=True))


def test_cameras_that_are_not_triggered_together_are_refused(tmp_path: Path) -> None:
    left_ns = [k * FRAME_NS for k in range(5)]
    right_ns = [k * FRAME_NS + 20_000_000 for k in range(5)]
    path = write_messages(tmp_path / "recorded", "db3", stereo_messages(left_ns, right_ns))
    with pytest.raises(InputError, match=r"only 0 of 5 left and 5 right.*20\.0 ms apart"):
        open_sequence(path)
    assert len(open_sequence(path, pair_tolerance_ms=25.0)) == 5


def test_headers_without_stamps_are_refused(tmp_path: Path) -> None:
    path = write_messages(tmp_path / "recorded", "db3", stereo_messages([0, 0, 0], [0, 0, 0]))
    with pytest.raises(InputError, match="have one stamp"):
        open_sequence(path)


# --- regions and binning --------------------------------------------------------------------------


def cropped_messages(
    left_pixels: list[Image], right_pixels: list[Image], changes: dict[str, Any]
) -> list[Message]:
    """A pair of cameras that send a part of what was calibrated."""
    messages = []
    for topic, info, pixels, right in (
        (LEFT, LEFT_INFO, left_pixels, False),
        (RIGHT, RIGHT_INFO, right_pixels, True),
    ):
        fields = {**camera_info(CAMERA, right=right), **changes}
        messages.append(info_message(info, START_NS, fields))
        for index, each in enumerate(pixels):
            stamp_ns = START_NS + index * FRAME_NS
            messages.append(images_message(topic, stamp_ns, raw_image(each)))
    return messages


ROI = {"x_offset": 8, "y_offset": 4, "width": 48, "height": 40}


@pytest.mark.parametrize(
    ("changes", "rows", "expected"),
    [
        ({"roi": ROI}, np.s_[4:44, 8:56], {"cu_px": CU_PX - 8.0, "cv_px": CV_PX - 4.0}),
        (
            {"binning_x": 2, "binning_y": 2},
            np.s_[::2, ::2],
            {
                "fu_px": 0.5 * FU_PX,
                "fv_px": 0.5 * FU_PX,
                "cu_px": 0.5 * (CU_PX + 0.5) - 0.5,
                "cv_px": 0.5 * (CV_PX + 0.5) - 0.5,
            },
        ),
        (
            {"roi": ROI, "binning_x": 2, "binning_y": 2},
            np.s_[4:44:2, 8:56:2],
            {
                "fu_px": 0.5 * FU_PX,
                "fv_px": 0.5 * FU_PX,
                "cu_px": 0.5 * (CU_PX - 7.5) - 0.5,
                "cv_px": 0.5 * (CV_PX - 3.5) - 0.5,
            },
        ),
        ({"binning_x": 2, "binning_y": 2}, np.s_[:, :], {}),
    ],
    ids=["region", "binning", "both", "of whole images"],
)
def test_a_camera_that_sends_a_part_of_what_was_calibrated(
    changes: dict[str, Any], rows: Any, expected: dict[str, float], tmp_path: Path
) -> None:
    """Its CameraInfo is that of the whole images."""
    left = [np.ascontiguousarray(image(index)[rows]) for index in range(3)]
    right = [np.ascontiguousarray(image(index, right=True)[rows]) for index in range(3)]
    path = write_messages(tmp_path / "recorded", "mcap", cropped_messages(left, right, changes))
    bag = open_sequence(path)
    assert bag.camera == replace(CAMERA, size_px=left[0].shape[::-1], **expected)
    np.testing.assert_array_equal(next(iter(bag)).left, left[0])


# --- encodings -----------------------------------------------------------------------------------

PIXELS = np.random.default_rng(3).integers(0, 256, (6, 8), dtype=np.uint8)
COLOUR = np.random.default_rng(4).integers(0, 256, (6, 8, 3), dtype=np.uint8)


def test_encodings_become_gray() -> None:
    def gray(pixels: Any, encoding: str, padding: int = 0) -> Any:
        return gray_of(as_message(raw_image(pixels, encoding, padding)), "here")

    np.testing.assert_array_equal(gray(PIXELS, "mono8"), PIXELS)
    np.testing.assert_array_equal(gray(PIXELS, "8UC1", padding=5), PIXELS)
    deep = PIXELS.astype(np.uint16) * 257
    np.testing.assert_array_equal(gray(deep, "mono16", padding=6), deep)
    luma = cv2.cvtColor(COLOUR, cv2.COLOR_BGR2GRAY)
    np.testing.assert_array_equal(gray(COLOUR, "bgr8"), luma)
    np.testing.assert_array_equal(gray(COLOUR[:, :, ::-1].copy(), "rgb8", padding=3), luma)


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_bayer_patterns_put_each_colour_in_its_place(pattern: str) -> None:
    """An evenly coloured scene has one gray value, that of its colour."""
    values = {"r": 200, "g": 120, "b": 30}
    mosaic = np.array(
        [[values[pattern[0]], values[pattern[1]]], [values[pattern[2]], values[pattern[3]]]]
    )
    pixels = np.tile(mosaic, (8, 8)).astype(np.uint8)
    gray = gray_of(as_message(raw_image(pixels, f"bayer_{pattern}8")), "here")
    luma = 0.299 * 200 + 0.587 * 120 + 0.114 * 30
    np.testing.assert_allclose(gray[2:-2, 2:-2], luma, atol=1.0)


def test_big_endian_images() -> None:
    deep = PIXELS.astype(np.uint16) * 3
    fields = raw_image(deep.astype(">u2").view(np.uint16), "mono16") | {"is_bigendian": 1}
    np.testing.assert_array_equal(gray_of(as_message(fields), "here"), deep)


@pytest.mark.parametrize(
    ("change", "words"),
    [({"encoding": "yuv422"}, "yuv422"), ({"step": 3}, "damaged"), ({"width": 80}, "damaged")],
)
def test_faulty_images_are_refused(change: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        gray_of(as_message(raw_image(PIXELS) | change), "here")


def write_deep_bag(path: Path, deep: Callable[[int, Image], AnyArray]) -> Path:
    """A bag of 16-bit images, made of 8-bit ones and their index."""
    stamps = [k * FRAME_NS for k in range(12)]
    messages = []
    for message in stereo_messages(stamps, stamps):
        if "encoding" in message.fields:
            index = (message.stamp_ns - START_NS) // FRAME_NS
            pixels = image(index, right=message.topic == RIGHT)
            fields = raw_image(deep(index, pixels), "mono16")
            messages.append(replace(message, fields=fields))
        else:
            messages.append(message)
    return write_messages(path, "mcap", messages)


def test_sixteen_bits_keep_one_range_for_the_whole_recording(tmp_path: Path) -> None:
    """A frame between those that set the range is brighter, and stays so."""
    path = write_deep_bag(
        tmp_path / "deep",
        lambda index, pixels: pixels.astype(np.uint16) * 4 + (1300 if index == 2 else 1000),
    )
    assert 2 not in spread_indices(12)
    frames = list(open_sequence(path))
    assert frames[0].left is not None
    assert frames[2].left is not None
    np.testing.assert_allclose(frames[0].left, image(0), atol=3)
    expected = np.minimum(image(2).astype(int) + 75, 255)
    np.testing.assert_allclose(frames[2].left, expected, atol=4)


def test_a_dark_start_of_a_bag_does_not_set_the_range_of_the_others(tmp_path: Path) -> None:
    path = write_deep_bag(
        tmp_path / "dark",
        lambda index, pixels: (
            300 + (pixels.astype(np.uint16) // 60 if index < 5 else 200 * pixels.astype(np.uint16))
        ),
    )
    for frame in list(open_sequence(path))[5:]:
        assert frame.left is not None
        np.testing.assert_allclose(frame.left, image(frame.index), atol=5)


# --- cameras -------------------------------------------------------------------------------------


def test_raw_images_are_rectified_by_the_camera_info(tmp_path: Path) -> None:
    """P shifts the principal point by three pixels: so does the rectified image."""
    shifted = replace(CAMERA, cu_px=CU_PX + 3.0)
    stamps = [0, FRAME_NS]
    messages = []
    for message in stereo_messages(stamps, stamps):
        topic = message.topic.replace("image_rect", "image_raw")
        fields = message.fields
        if "P" in fields:
            fields = camera_info(shifted, right="right" in topic) | {"K": fields["K"]}
        messages.append(replace(message, topic=topic, fields=fields))
    bag = open_sequence(write_messages(tmp_path / "raw", "bag", messages))
    assert isinstance(bag, BagRecording)
    assert bag.rectification is not None
    assert bag.camera.cu_px == CU_PX + 3.0
    frame = next(iter(bag))
    assert frame.left is not None
    np.testing.assert_array_equal(frame.left[:, 3:], image(0)[:, :-3])
    # The first three columns show nothing.
    inside = np.broadcast_to(np.arange(frame.left.shape[1]) >= 3, frame.left.shape)
    for mask in (frame.left_mask, frame.right_mask):
        assert mask is not None
        np.testing.assert_array_equal(mask > 0, inside)


def test_the_zeros_that_opencv_appends_to_the_coefficients_change_nothing(tmp_path: Path) -> None:
    """A rational model of 14 coefficients whose thin-prism and tilt terms are zero."""
    stamps = [0, FRAME_NS]
    rational = [0.1, -0.02, 0.0, 0.0, 0.01, 0.02, -0.01, 0.002]
    frames = []
    for name, coefficients in (("eight", rational), ("fourteen", [*rational, *[0.0] * 6])):
        messages = []
        for message in stereo_messages(stamps, stamps):
            topic = message.topic.replace("image_rect", "image_raw")
            fields = message.fields
            if "P" in fields:
                fields = fields | {"D": np.array(coefficients)}
                fields = fields | {"distortion_model": "rational_polynomial"}
            messages.append(replace(message, topic=topic, fields=fields))
        bag = open_sequence(write_messages(tmp_path / name, "bag", messages))
        frames.append(next(iter(bag)))
    np.testing.assert_array_equal(frames[0].left, frames[1].left)
    np.testing.assert_array_equal(frames[0].right, frames[1].right)


def test_images_of_another_size_than_the_camera_info_are_refused(tmp_path: Path) -> None:
    fields = raw_image(np.zeros((24, 32), np.uint8))
    messages = stereo_messages([0, FRAME_NS], [0, FRAME_NS], fields)
    with pytest.raises(InputError, match=r"have 32×24 px, but the CameraInfo is for 64×48 px"):
        open_sequence(write_messages(tmp_path / "small", "mcap", messages))


def test_without_camera_info_a_calibration_is_asked_for(tmp_path: Path) -> None:
    messages = [
        each for each in stereo_messages([0, FRAME_NS], [0, FRAME_NS]) if "P" not in each.fields
    ]
    path = write_messages(tmp_path / "bare", "mcap", messages)
    with pytest.raises(InputError, match=r"no CameraInfo beside it(?s:.*)--calibration"):
        open_sequence(path)


def test_an_uncalibrated_pair_is_refused(tmp_path: Path) -> None:
    messages = [
        replace(each, fields=camera_info(CAMERA)) if "P" in each.fields else each
        for each in stereo_messages([0, FRAME_NS], [0, FRAME_NS])
    ]
    with pytest.raises(InputError, match="no baseline"):
        open_sequence(write_messages(tmp_path / "mono", "mcap", messages))


def test_an_imu_without_a_pose_is_reported_and_not_used(tmp_path: Path) -> None:
    stamps = [k * FRAME_NS for k in range(3)]
    samples = [
        imu_message(START_NS + k * 10_000_000, np.zeros(3), np.array([0.0, 0.0, 9.81]))
        for k in range(21)
    ]
    bag = open_sequence(
        write_messages(tmp_path / "recorded", "mcap", [*stereo_messages(stamps, stamps), *samples])
    )
    assert isinstance(bag, BagRecording)
    assert bag.imu is None
    assert "tf_static" in dict(bag.notes)["! IMU"]


# --- topics --------------------------------------------------------------------------------------


def two_stereo_cameras() -> list[Message]:
    messages = stereo_messages([0, FRAME_NS], [0, FRAME_NS])
    rear = [replace(each, topic=each.topic.replace("stereo", "rear")) for each in messages]
    return [*messages, *rear]


def test_topics_are_named_where_several_fit(tmp_path: Path) -> None:
    path = write_messages(tmp_path / "two", "mcap", two_stereo_cameras())
    with pytest.raises(InputError, match=r"several topics could be the stereo images") as refusal:
        open_sequence(path)
    assert "/rear/right/image_rect (sensor_msgs/msg/Image, 2 messages)" in str(refusal.value)
    bag = open_sequence(path, topics_left="/rear/left/image_rect")
    assert isinstance(bag, BagRecording)
    assert bag.right_topic == "/rear/right/image_rect"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"topics_left": "/nowhere"}, "no such topic"),
        ({"topics_left": LEFT_INFO}, "its type is sensor_msgs/msg/CameraInfo"),
        ({"topics_imu": LEFT}, "expected sensor_msgs/msg/Imu"),
    ],
)
def test_a_wrong_topic_is_refused(options: dict[str, Any], words: str, tmp_path: Path) -> None:
    path = write_messages(tmp_path / "two", "mcap", two_stereo_cameras())
    with pytest.raises(InputError, match=words):
        open_sequence(path, **options)


def test_topics_that_are_not_read_are_counted() -> None:
    others = [Topic(f"/chatter{k:02}", "std_msgs/msg/String", 3) for k in range(40)]
    listed = topic_list([*others, Topic("/imu", IMU_TYPE, 1), Topic("/view", IMAGE_TYPES[0], 2)])
    lines = [line.strip() for line in listed.splitlines()]
    assert lines[1:3] == [
        "/view (sensor_msgs/msg/Image, 2 messages)",
        "/imu (sensor_msgs/msg/Imu, 1 message)",
    ]
    assert len(lines) == 1 + MAX_LISTED + 1
    assert lines[-1] == "… and 22 more, of types that are not read"


def test_the_command_line_names_topics(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_messages(tmp_path / "two", "mcap", two_stereo_cameras())
    flags = ["--topics.left", "/rear/left/image_rect", "--pair-tolerance-ms", "1"]
    assert main(["info", str(path), *flags]) == 0
    out = capsys.readouterr().out
    assert "/rear/left/image_rect and /rear/right/image_rect" in " ".join(out.split())
    assert "(within 1 ms)" in out
    assert main(["info", str(path)]) == 2
    assert "--topics.left" in capsys.readouterr().err


def test_an_option_of_another_format_is_refused(tmp_path: Path) -> None:
    folder = write_folder_sequence(tmp_path)
    with pytest.raises(InputError, match=r"topics_left .*for the format folder"):
        open_sequence(folder, topics_left="/left")


# --- damage and real bags ------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["bag", "db3", "mcap", "single mcap", "single db3"])
def test_a_bag_that_was_cut_off_is_refused(kind: str, tmp_path: Path) -> None:
    folder = open_sequence(write_folder_sequence(tmp_path / "folder", imu=False))
    path = write_bag(tmp_path / "recorded", kind, folder)
    file = (
        path if path.is_file() else next(each for each in path.iterdir() if each.suffix != ".yaml")
    )
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    with pytest.raises(InputError):
        list(open_sequence(path))


@pytest.mark.parametrize(
    ("field", "renamed"),
    [
        (b"uint8[] data", b"uint8[] dada"),
        (b"geometry_msgs/Vector3 angular_velocity", b"geometry_msgs/Vector3 angular_velocitx"),
        (b"float64[9] k", b"float64[9] q"),
    ],
    ids=["image", "imu", "camera info"],
)
def test_a_message_without_a_field_of_its_type_is_refused(
    field: bytes, renamed: bytes, tmp_path: Path
) -> None:
    """A bag defines its types by itself; in this one, a name is damaged."""
    stamps = [k * FRAME_NS for k in range(3)]
    sample = imu_message(START_NS, np.zeros(3), np.array([0.0, 0.0, 9.81]))
    path = write_messages(
        tmp_path / "whole", "single mcap", [*stereo_messages(stamps, stamps), sample]
    )
    damaged = tmp_path / "damaged.mcap"
    content = path.read_bytes()
    assert field in content
    damaged.write_bytes(content.replace(field, renamed))
    with pytest.raises(InputError, match=r"has no field|defines no") as refused:
        list(open_sequence(damaged))
    assert str(damaged) in str(refused.value)


def test_a_file_of_noise_is_refused(tmp_path: Path) -> None:
    for suffix in (".bag", ".mcap", ".db3"):
        path = tmp_path / f"noise{suffix}"
        path.write_bytes(np.random.default_rng(1).bytes(5000))
        with pytest.raises(InputError, match="cannot be read"):
            open_sequence(path)


LACKS = {
    "evo_nav2_turtlebot.mcap": ["no topic of images", "/odom (nav_msgs/msg/Odometry, 2639"],
    "evo_tf_example.bag": ["no topic of images", "/tf (tf2_msgs/msg/TFMessage, 517"],
    "foxglove_example-lz4.bag": ["no topic of images", "turtlesim/msg/Pose, 1344"],
    "geocam_test_bag_mcap": ["no two topics of images", "/test/sensor_msgs/image"],
    "geocam_test_bag_sqlite3": ["no two topics of images", "/test/sensor_msgs/compressed_image"],
    "klintan_sample.db3": ["no two topics of images", "/imu (sensor_msgs/msg/Imu, 1"],
    "meam620_map1.bag": ["no topic of images", "imu (sensor_msgs/msg/Imu, 1018"],
}


@pytest.mark.data
@pytest.mark.parametrize("name", LACKS)
def test_real_bags_say_what_they_lack(
    name: str, data_root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["info", str(data_root / "bags" / name)]) == 2
    error = capsys.readouterr().err
    assert all(words in error for words in LACKS[name])


# --- calibration files ---------------------------------------------------------------------------


def test_a_calibration_file_rectifies_a_bag_as_it_does_a_folder(tmp_path: Path) -> None:
    root = write_raw_pair(tmp_path / "raw", frames=3)
    file = write_yaml(tmp_path / "camchain.yaml", kalibr())
    folder = open_sequence(root, calibration=file)
    start_ns = int(folder.stamps_ns[0])
    messages = [
        images_message(topic, start_ns + index * 50_000_000, raw_image(image(index, right)))
        for index in range(3)
        for topic, right in (("/cam0/image_raw", False), ("/cam1/image_raw", True))
    ]
    gyro = np.array([0.0, 0.0, 0.1])
    messages += [
        imu_message(start_ns + k * 5_000_000, gyro, np.array([0.0, 0.0, 9.81]))
        for k in range(-20, 40)
    ]
    messages.sort(key=lambda message: message.stamp_ns)
    path = write_messages(tmp_path / "recorded", "mcap", messages)
    bag = open_sequence(path, calibration=file)
    assert bag.camera == folder.camera
    for mine, theirs in zip(bag, folder, strict=True):
        np.testing.assert_array_equal(mine.left, theirs.left)
        np.testing.assert_array_equal(mine.right, theirs.right)
    # The pose of the IMU is that of the file, and so is the offset of its clock.
    assert bag.imu is not None
    assert bag.imu.time_offset_s == -0.03
    np.testing.assert_allclose(np.linalg.norm(bag.imu.T_cam_imu[:3, 3]), 0.0547722557505, atol=1e-9)
    # A file without that pose is named.
    content = kalibr()
    del content["cam0"]["T_cam_imu"]
    cameras = write_yaml(tmp_path / "cameras.yaml", content)
    without = open_sequence(path, calibration=cameras)
    assert isinstance(without, BagRecording)
    assert without.imu is None
    assert f"{cameras} does not have" in dict(without.notes)["! IMU"]


@pytest.mark.data
def test_tumvi_as_a_bag_of_sixteen_bits(data_root: Path, tmp_path: Path) -> None:
    tumvi = data_root / "tumvi_micro"
    (tmp_path / "left").symlink_to(tumvi / "cam0" / "images")
    (tmp_path / "right").symlink_to(tumvi / "cam1" / "images")
    folder = open_sequence(tmp_path, calibration=tumvi / "camchain.yaml")
    messages = []
    for camera in ("cam0", "cam1"):
        for file in sorted((tumvi / camera / "images").iterdir()):
            fields = raw_image(cv2.imread(str(file), cv2.IMREAD_UNCHANGED), "mono16")
            messages.append(images_message(f"/{camera}/image_raw", int(file.stem), fields))
    path = write_messages(tmp_path / "recorded", "bag", messages)
    bag = open_sequence(path, calibration=tumvi / "camchain.yaml")
    for mine, theirs in zip(bag, folder, strict=True):
        assert mine.stamp_ns == theirs.stamp_ns
        np.testing.assert_array_equal(mine.left, theirs.left)
        np.testing.assert_array_equal(mine.right, theirs.right)


@pytest.mark.data
@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_kitti_as_bags_runs_to_the_same_bytes(data_root: Path, tmp_path: Path) -> None:
    kitti = data_root / "kitti_odometry" / "sequences" / "06"
    sequence = open_sequence(kitti)
    first = [each for each in messages_of(sequence) if each.stamp_ns <= sequence.stamps_ns[5]]
    packed = [
        each
        for each in messages_of(sequence, compressed_image)
        if each.stamp_ns <= sequence.stamps_ns[5]
    ]
    paths = {
        "ros1": write_messages(tmp_path / "ros1", "bag", first),
        "db3": write_messages(tmp_path / "db3", "db3", first),
        "mcap": write_messages(tmp_path / "mcap", "mcap", first),
        "packed": write_messages(tmp_path / "packed", "mcap zstd", packed),
    }
    for name, path in {"pictures": kitti, **paths}.items():
        out = tmp_path / f"out_{name}"
        assert main(["run", str(path), "--out", str(out), "--max-frames", "6"]) == 0
        trajectory = (out / "trajectory.tum").read_bytes()
        assert trajectory == (tmp_path / "out_pictures" / "trajectory.tum").read_bytes()


# --- without the extra ---------------------------------------------------------------------------


def test_without_the_extra_the_message_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "some.bag").write_bytes(b"")
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(InputError, match=r"pip install 'probevo\[bag\]'"):
        open_sequence(tmp_path / "some.bag")


@pytest.mark.parametrize("error", [MemoryError, OverflowError])
def test_a_bag_that_claims_more_than_there_is_is_damaged(
    error: type[Exception], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(self: AnyReader) -> None:
        raise error

    (tmp_path / "a.bag").write_bytes(b"")
    monkeypatch.setattr(AnyReader, "open", fail)
    monkeypatch.setattr(AnyReader, "__init__", lambda *_, **__: None)
    with pytest.raises(InputError, match=r"a\.bag: this bag cannot be read"):
        open_sequence(tmp_path / "a.bag")

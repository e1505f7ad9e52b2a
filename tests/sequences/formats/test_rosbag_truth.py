"""True poses from topics of bags and from TUM files, of the camera, the IMU or another frame."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags")

from probevo.arrays import FloatArray
from probevo.cli.main import main
from probevo.errors import InputError
from probevo.geometry import se3
from probevo.output.ros.bag_writer import BagWriter, header_fields, written_bag
from probevo.output.ros.ros_fields import camera_info_fields, image_fields, pose_fields
from probevo.output.ros.ros_fields import transform_fields as transform
from probevo.sequences import open_sequence
from probevo.sequences.formats.rosbag import BagRecording
from probevo.sequences.formats.rosbag_truth import TruthPoses
from probevo.sequences.pose_files import write_tum
from sequences.formats.test_rosbag import CAMERA
from sequences.recordings import T_CAM_IMU, image, poses, stamps_ns, write_folder_sequence

FRAMES = 4
OPTICAL = "left_optical"
T_BASE_CAM = se3.exp(np.array([0.3, 0.1, 0.5, 0.2, -0.4, 0.1]))
T_WORLD_CAM = se3.exp(np.array([5.0, 1.0, 2.0, 0.5, 0.5, 1.0])) @ poses(FRAMES)
STAMPS_NS = stamps_ns(FRAMES)


def add_truth(
    bag: BagWriter, kind: str, stamp_ns: int, T_world_base: FloatArray, *, topic: str
) -> None:
    pose: dict[str, Any] = {"pose": pose_fields(T_world_base)}
    if kind == "Odometry":
        fields = {"child_frame_id": "base", "pose": pose}
        bag.write(topic, "nav_msgs/msg/Odometry", stamp_ns, fields, frame="world")
    elif kind == "PoseStamped":
        bag.write(topic, "geometry_msgs/msg/PoseStamped", stamp_ns, pose, frame="world")
    elif kind == "TransformStamped":
        fields = transform(T_world_base, stamp_ns, parent="world", child="base")
        type_name = "geometry_msgs/msg/TransformStamped"
        bag.write(topic, type_name, stamp_ns, fields, frame="world")
    else:
        moved = transform(T_world_base, stamp_ns, parent="world", child="base")
        other = transform(np.eye(4), stamp_ns, parent="world", child="table")
        bag.write_transforms(topic, stamp_ns, [other, moved])


def add_images(bag: BagWriter, index: int, frame: str = OPTICAL) -> None:
    """Both images of a frame, and their CameraInfo, whose headers name a frame of ROS."""
    stamp_ns = int(STAMPS_NS[index])
    for side in ("left", "right"):
        info = camera_info_fields(CAMERA, is_right=side == "right")
        info_type = "sensor_msgs/msg/CameraInfo"
        bag.write(f"/{side}/camera_info", info_type, stamp_ns, info, frame=frame)
        pixels = image_fields(image(index, side == "right"))
        topic = f"/{side}/image_rect"
        bag.write(topic, "sensor_msgs/msg/Image", stamp_ns, pixels, frame=frame)


def add_faulty_transform(bag: BagWriter, child: str) -> None:
    """A static transform whose quaternion is (0, 0, 0, 0)."""
    fields = {"header": header_fields(int(STAMPS_NS[0]), OPTICAL), "child_frame_id": child}
    bag.write_transforms("/tf_static", int(STAMPS_NS[0]), [fields])


def write_truth_bag(
    path: Path,
    kind: str,
    *,
    is_mounted: bool = True,
    topic: str = "/truth",
    is_faulty: bool = False,
) -> Path:
    """A bag of images with the poses of a base, in which the camera is mounted.

    One pose of a faulty truth has the quaternion (0, 0, 0, 0).
    """
    with written_bag(path) as bag:
        if is_mounted:
            mounting = transform(T_BASE_CAM, int(STAMPS_NS[0]), parent="base", child=OPTICAL)
            bag.write_transforms("/tf_static", int(STAMPS_NS[0]), [mounting])
        for index, stamp_ns in enumerate(STAMPS_NS.tolist()):
            add_images(bag, index)
            T_world_base = T_WORLD_CAM[index] @ se3.inverse(T_BASE_CAM)
            add_truth(bag, kind, stamp_ns, T_world_base, topic=topic)
        if is_faulty:
            bag.write(topic, "nav_msgs/msg/Odometry", int(STAMPS_NS[-1]), {}, frame="world")
    return path


@pytest.mark.parametrize("suffix", [".bag", ".mcap"])
@pytest.mark.parametrize("kind", ["Odometry", "PoseStamped", "TransformStamped", "tf"])
def test_truth_is_that_of_the_camera(kind: str, suffix: str, tmp_path: Path) -> None:
    path = write_truth_bag(tmp_path / f"drive{suffix}", kind)
    assert open_sequence(path).truth is None  # a topic of another name has to be named
    options = {} if kind in ("Odometry", "TransformStamped") else {"truth_of": "base"}
    truth = open_sequence(path, topics_truth="/truth", **options).truth
    assert truth is not None
    np.testing.assert_allclose(truth.T_world_cam, poses(FRAMES), atol=1e-12)


def test_truth_that_was_found_by_its_name_alone_may_be_faulty(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The images can be read; if the user names the topic, the bag is refused."""
    topic = "/ground_truth/pose"
    path = write_truth_bag(tmp_path / "drive.mcap", "Odometry", topic=topic, is_faulty=True)
    bag = open_sequence(path)
    assert isinstance(bag, BagRecording)
    assert bag.truth is None
    assert len(list(bag)) == FRAMES
    text = dict(bag.notes)["! truth"]
    assert text.startswith("/ground_truth/pose is not used: the pose")
    assert "its quaternion has length 0." in text
    with pytest.raises(InputError, match=r"/ground_truth/pose: the pose .* has length 0\."):
        open_sequence(path, topics_truth=topic)
    assert main(["info", str(path)]) == 0
    assert "! truth" in capsys.readouterr().out


def test_faultless_truth_is_found_by_its_name(tmp_path: Path) -> None:
    path = write_truth_bag(tmp_path / "drive.mcap", "Odometry", topic="/ground_truth/pose")
    truth = open_sequence(path).truth
    assert truth is not None
    np.testing.assert_allclose(truth.T_world_cam, poses(FRAMES), atol=1e-12)


def test_truth_that_needs_a_faulty_transform_is_refused(tmp_path: Path) -> None:
    """The message says what is wrong with the transform."""
    path = tmp_path / "drive.mcap"
    with written_bag(path) as bag:
        add_faulty_transform(bag, "base")
        for index, stamp_ns in enumerate(STAMPS_NS.tolist()):
            add_images(bag, index)
            add_truth(bag, "Odometry", stamp_ns, T_WORLD_CAM[index], topic="/truth")
    with pytest.raises(InputError, match=r"frame base, .* transform of base: .* has length 0\."):
        open_sequence(path, topics_truth="/truth")
    assert open_sequence(path, topics_truth="/truth", truth_of="camera").truth is not None


@pytest.mark.parametrize(
    ("kind", "options", "message"),
    [
        ("PoseStamped", {}, "a frame that it does not name"),
        ("tf", {}, "--truth-of"),
        ("tf", {"truth_of": "chair"}, "it has no pose of chair"),
        ("Odometry", {"truth_of": "imu"}, "place in the camera's frame is not known"),
        ("Odometry", {"truth_of": "chair"}, "those of the frame chair"),
    ],
)
def test_an_unknown_body_is_refused(
    kind: str, options: dict[str, str], message: str, tmp_path: Path
) -> None:
    path = write_truth_bag(tmp_path / "drive.mcap", kind)
    with pytest.raises(InputError, match=message):
        open_sequence(path, topics_truth="/truth", **options)


def mocap_message(child: str, second: int) -> SimpleNamespace:
    """A TransformStamped of a body that is as many metres away as seconds have passed."""
    return SimpleNamespace(
        header=SimpleNamespace(frame_id="/world", stamp=SimpleNamespace(sec=second, nanosec=0)),
        child_frame_id=child,
        transform=SimpleNamespace(
            translation=SimpleNamespace(x=float(second), y=0.0, z=0.0),
            rotation=SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0),
        ),
    )


def test_a_topic_with_the_transforms_of_several_bodies_gives_those_of_one() -> None:
    """A motion capture system publishes all that it sees, in one topic."""
    found = TruthPoses("bag: /vicon", child="drone")
    unnamed = TruthPoses("bag: /vicon", child=None)
    for second in range(6):
        for poses_of_topic in (found, unnamed):
            poses_of_topic.add(mocap_message("/drone" if second % 2 else "wand", second))
    seconds, T_world_drone = found.arrays()
    assert (seconds // 10**9).tolist() == [1, 3, 5]
    assert T_world_drone[:, 0, 3].tolist() == [1.0, 3.0, 5.0]
    with pytest.raises(InputError, match="several frames: drone, wand"):
        unnamed.arrays()


def test_the_only_body_of_a_topic_may_have_another_name() -> None:
    found = TruthPoses("bag: /vicon", child="base_link")
    for second in range(3):
        found.add(mocap_message("drone", second))
    assert len(found.arrays()[0]) == 3


def test_a_topic_of_another_type_is_refused(tmp_path: Path) -> None:
    path = write_truth_bag(tmp_path / "drive.mcap", "Odometry")
    with pytest.raises(InputError, match="its type is sensor_msgs/msg/Image"):
        open_sequence(path, topics_truth="/left/image_rect")


def test_without_a_mounting_the_user_has_to_say_whose_poses_they_are(tmp_path: Path) -> None:
    path = write_truth_bag(tmp_path / "drive.mcap", "Odometry", is_mounted=False)
    with pytest.raises(InputError, match="those of the frame base"):
        open_sequence(path, topics_truth="/truth")
    truth = open_sequence(path, topics_truth="/truth", truth_of="camera").truth
    assert truth is not None
    expected = T_BASE_CAM @ poses(FRAMES) @ se3.inverse(T_BASE_CAM)
    np.testing.assert_allclose(truth.T_world_cam, expected, atol=1e-12)


def test_truth_of_a_folder_from_a_tum_file_of_its_imu(tmp_path: Path) -> None:
    """Poses at other times than the frames are interpolated."""
    path = write_folder_sequence(tmp_path / "folder", truth=False)
    T_any_imu = T_WORLD_CAM @ T_CAM_IMU
    write_tum(tmp_path / "imu.tum", STAMPS_NS - 30_000_000, T_any_imu)
    truth = open_sequence(path, truth=tmp_path / "imu.tum", truth_of="imu").truth
    assert truth is not None
    np.testing.assert_allclose(truth.T_world_cam, poses(FRAMES), atol=1e-9)
    with pytest.raises(InputError, match="is not known"):
        open_sequence(path, truth=tmp_path / "imu.tum", truth_of="wheel")


def test_truth_of_a_bag_from_a_tum_file_of_its_camera(tmp_path: Path) -> None:
    path = write_truth_bag(tmp_path / "drive.mcap", "Odometry")
    write_tum(tmp_path / "camera.tum", STAMPS_NS, T_WORLD_CAM)
    truth = open_sequence(path, truth=tmp_path / "camera.tum").truth
    assert truth is not None
    np.testing.assert_allclose(truth.T_world_cam, poses(FRAMES), atol=1e-12)
    with pytest.raises(InputError, match=r"both --truth and --topics\.truth"):
        open_sequence(path, truth=tmp_path / "camera.tum", topics_truth="/truth")

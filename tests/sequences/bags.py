"""Writers of bags, for tests: ``from sequences.bags import write_bag``. They need ``rosbags``."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from probevo.arrays import AnyArray, FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.sequences import Sequence

pytest.importorskip("rosbags")

from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

KINDS = ("bag", "bag lz4", "db3", "mcap", "mcap zstd", "single db3", "single mcap")
LEFT = "/stereo/left/image_rect"
RIGHT = "/stereo/right/image_rect"
IMU = "/imu/data"


@dataclass(frozen=True)
class Message:
    """A message to write: its type without the package of ROS's version, and its fields."""

    topic: str
    type: str
    stamp_ns: int
    fields: dict[str, Any]
    """All but the header; numbers, texts and arrays."""
    frame: str = ""


def write_messages(path: Path, kind: str, messages: Iterable[Message]) -> Path:
    """Write a bag of a kind; return the path to open."""
    is_ros1 = kind.startswith("bag")
    store = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE)
    if is_ros1:
        # The store has the messages of ROS's desktop only.
        text = "geometry_msgs/TransformStamped[] transforms"
        store.register(get_types_from_msg(text, "tf2_msgs/msg/TFMessage"))
        path = path.with_suffix(".bag")
        writer: Any = Ros1Writer(path)
        if "lz4" in kind:
            writer.set_compression(Ros1Writer.CompressionFormat.LZ4)
    else:
        plugin = StoragePlugin.MCAP if "mcap" in kind else StoragePlugin.SQLITE3
        writer = Ros2Writer(path, version=8, storage_plugin=plugin)
        if "zstd" in kind:
            writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    connections: dict[str, Any] = {}
    with writer:
        for number, message in enumerate(messages):
            if message.topic not in connections:
                connections[message.topic] = writer.add_connection(
                    message.topic, message.type, typestore=store
                )
            built = _built(message, store, is_ros1=is_ros1, number=number)
            serialize = store.serialize_ros1 if is_ros1 else store.serialize_cdr
            data = serialize(built, message.type)
            writer.write(connections[message.topic], message.stamp_ns, data)
    if kind.startswith("single"):
        (file,) = (each for each in path.iterdir() if each.suffix in (".db3", ".mcap"))
        return file
    return path


def _built(message: Message, store: Any, *, is_ros1: bool, number: int) -> Any:
    types = store.types
    stamp = types["builtin_interfaces/msg/Time"](
        sec=message.stamp_ns // 10**9, nanosec=message.stamp_ns % 10**9
    )
    header_fields = {"stamp": stamp, "frame_id": message.frame}
    if is_ros1:
        header_fields["seq"] = number
    fields = dict(message.fields)
    if message.type == "sensor_msgs/msg/CameraInfo":
        roi = {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False}
        roi |= fields.get("roi", {})
        fields["roi"] = types["sensor_msgs/msg/RegionOfInterest"](**roi)
        if not is_ros1:
            fields = {name.lower(): value for name, value in fields.items()}
    if message.type == "tf2_msgs/msg/TFMessage":
        header = types["std_msgs/msg/Header"](**header_fields)
        return types[message.type](transforms=[_transform(types, header, fields)])
    if message.type == "sensor_msgs/msg/Imu":
        vector = types["geometry_msgs/msg/Vector3"]
        fields = {
            "orientation": types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
            "orientation_covariance": np.zeros(9),
            "angular_velocity": vector(**dict(zip("xyz", fields["gyro"], strict=True))),
            "angular_velocity_covariance": np.zeros(9),
            "linear_acceleration": vector(**dict(zip("xyz", fields["accel"], strict=True))),
            "linear_acceleration_covariance": np.zeros(9),
        }
    return types[message.type](header=types["std_msgs/msg/Header"](**header_fields), **fields)


def _transform(types: Any, header: Any, fields: dict[str, Any]) -> Any:
    T = fields["T_parent_child"]
    vector = types["geometry_msgs/msg/Vector3"](**dict(zip("xyz", T[:3, 3].tolist(), strict=True)))
    q = dict(zip("xyzw", Rotation.from_matrix(T[:3, :3]).as_quat().tolist(), strict=True))
    quaternion = types["geometry_msgs/msg/Quaternion"](**q)
    return types["geometry_msgs/msg/TransformStamped"](
        header=header,
        child_frame_id=fields["child"],
        transform=types["geometry_msgs/msg/Transform"](translation=vector, rotation=quaternion),
    )


def raw_image(pixels: AnyArray, encoding: str = "mono8", padding: int = 0) -> dict[str, Any]:
    """The fields of a sensor_msgs/Image whose rows have some unused bytes at their end."""
    rows = pixels.reshape(len(pixels), -1).view(np.uint8)
    padded = np.pad(rows, ((0, 0), (0, padding)))
    return {
        "height": pixels.shape[0],
        "width": pixels.shape[1],
        "encoding": encoding,
        "is_bigendian": 0,
        "step": padded.shape[1],
        "data": padded.ravel(),
    }


def compressed_image(pixels: AnyArray, suffix: str = ".png") -> dict[str, Any]:
    data = cv2.imencode(suffix, pixels)[1].ravel()
    return {"format": f"mono8; {suffix[1:]} compressed ", "data": data}


def camera_info(camera: StereoCamera, right: bool = False) -> dict[str, Any]:
    """The fields of a rectified camera's CameraInfo, as ROS 1 names them."""
    assert camera.size_px is not None
    K = np.array(
        [[camera.fu_px, 0.0, camera.cu_px], [0.0, camera.fv_px, camera.cv_px], [0.0, 0.0, 1.0]]
    )
    shift = -camera.fu_px * camera.baseline_m if right else 0.0
    P = np.column_stack([K, [shift, 0.0, 0.0]])
    return {
        "height": camera.size_px[1],
        "width": camera.size_px[0],
        "distortion_model": "plumb_bob",
        "D": np.zeros(5),
        "K": K.ravel(),
        "R": np.eye(3).ravel(),
        "P": P.ravel(),
        "binning_x": 0,
        "binning_y": 0,
    }


def images_message(topic: str, stamp_ns: int, fields: dict[str, Any]) -> Message:
    kind = "Image" if "encoding" in fields else "CompressedImage"
    return Message(topic, f"sensor_msgs/msg/{kind}", stamp_ns, fields, frame="camera_left_optical")


def info_message(topic: str, stamp_ns: int, fields: dict[str, Any]) -> Message:
    return Message(topic, "sensor_msgs/msg/CameraInfo", stamp_ns, fields)


def imu_message(stamp_ns: int, gyro: FloatArray, accel: FloatArray) -> Message:
    fields = {"gyro": gyro.tolist(), "accel": accel.tolist()}
    return Message(IMU, "sensor_msgs/msg/Imu", stamp_ns, fields, frame="imu_link")


def imu_pose_message(T_cam_imu: FloatArray, stamp_ns: int) -> Message:
    """The pose of the IMU's frame in that of the left camera, as a static transform."""
    fields = {"T_parent_child": T_cam_imu, "child": "imu_link"}
    return Message(
        "/tf_static", "tf2_msgs/msg/TFMessage", stamp_ns, fields, frame="camera_left_optical"
    )


def messages_of(
    sequence: Sequence, image: Callable[[AnyArray], dict[str, Any]] = raw_image
) -> list[Message]:
    """The messages of a rectified recording, in the order of time."""
    suffix = "/compressed" if "format" in image(np.zeros((4, 4), np.uint8)) else ""
    messages = []
    stream = getattr(sequence, "imu_stream", None)
    if sequence.imu is not None and stream is not None:
        messages.append(imu_pose_message(sequence.imu.T_cam_imu, int(sequence.stamps_ns[0])))
        rows = zip(stream.stamps_ns, stream.gyro_rad_s, stream.accel_m_s2, strict=True)
        messages += [imu_message(int(stamp), gyro, accel) for stamp, gyro, accel in rows]
    for frame in sequence:
        for topic, pixels, right in ((LEFT, frame.left, False), (RIGHT, frame.right, True)):
            info = topic.replace("image_rect", "camera_info")
            fields = camera_info(sequence.camera, right)
            messages.append(info_message(info, frame.stamp_ns, fields))
            messages.append(images_message(topic + suffix, frame.stamp_ns, image(pixels)))
    return sorted(messages, key=lambda message: message.stamp_ns)


def write_bag(path: Path, kind: str, sequence: Sequence) -> Path:
    """Write a rectified recording as a bag; return the path to open."""
    return write_messages(path, kind, messages_of(sequence))


def as_message(fields: dict[str, Any]) -> SimpleNamespace:
    """A message as a reader hands it out."""
    return SimpleNamespace(**fields)

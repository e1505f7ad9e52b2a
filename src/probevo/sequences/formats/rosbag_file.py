"""Bags of ROS 1 and ROS 2 as files: topics, messages, and their stamps, without ROS.

The extra ``bag`` installs ``rosbags``, which does the reading.
"""

from __future__ import annotations

import struct
import sys
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from probevo.errors import InputError
from probevo.sequences.format_options import BAG_SUFFIXES

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

IMAGE_TYPES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
INFO_TYPE = "sensor_msgs/msg/CameraInfo"
IMU_TYPE = "sensor_msgs/msg/Imu"
TRANSFORM_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
POSE_TYPES = (
    "nav_msgs/msg/Odometry",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/TransformStamped",
)
"""Types whose messages are one pose each."""
STORAGE_ERRORS = (
    ("apsw", "Error"),
    ("sqlite3", "Error"),
    ("backports.zstd", "ZstdError"),
    ("compression.zstd", "ZstdError"),
)
"""Module and name of the errors of the libraries below rosbags."""


@dataclass(frozen=True)
class Topic:
    """A topic of a bag."""

    name: str
    type: str
    """Type of its messages, such as ``sensor_msgs/msg/Image``; "several types" if they differ."""
    count: int
    """Number of its messages."""


@dataclass(frozen=True)
class RawMessage:
    """A message as it is stored."""

    topic: str
    data: bytes


@dataclass(frozen=True)
class Decoder:
    """What turns stored messages into objects; it stays usable when the bag has been closed."""

    typestore: Any
    types: dict[str, str]
    """Type of the messages of each topic, as the bag names it."""
    is_ros2: bool
    path: Path

    def decoded(self, message: RawMessage) -> Any:
        """Return a message as an object with the fields of its type.

        Raises:
            InputError: the message is damaged.
        """
        deserialize = (
            self.typestore.deserialize_cdr if self.is_ros2 else self.typestore.deserialize_ros1
        )
        try:
            return deserialize(message.data, _full_name(self.types[message.topic]))
        except _bag_errors() as error:
            what = f"a message is damaged ({type(error).__name__}: {error})."
            raise InputError(f"{self.path}: {message.topic}", what) from error

    def stamp_ns(self, message: RawMessage) -> int:
        """Return the stamp of a message that begins with a header, without decoding the rest.

        Raises:
            InputError: the message is too short for a header.
        """
        # ROS 1: sequence number, seconds, nanoseconds. CDR: four bytes on the encoding, of which
        # the second tells the byte order, seconds, nanoseconds.
        order = "<" if not self.is_ros2 or message.data[1:2] == b"\x01" else ">"
        try:
            seconds, nanoseconds = struct.unpack_from(f"{order}iI", message.data, 4)
        except struct.error:
            what = "a message is damaged: it ends within its header."
            raise InputError(f"{self.path}: {message.topic}", what) from None
        return int(seconds) * 1_000_000_000 + int(nanoseconds)


@dataclass(frozen=True)
class OpenBag:
    """A bag while it is open."""

    reader: AnyReader
    path: Path
    topics: dict[str, Topic]
    """All topics by name, those without messages included."""
    decoder: Decoder

    def messages(self, topics: tuple[str, ...]) -> Iterator[RawMessage]:
        """Yield the messages of some topics in the order in which they were recorded.

        Raises:
            InputError: the bag is damaged.
        """
        connections = [each for each in self.reader.connections if each.topic in topics]
        if not connections:
            return
        try:
            for connection, _, data in self.reader.messages(connections):
                yield RawMessage(connection.topic, data)
        except _bag_errors() as error:
            raise _damaged(self.path, error) from error


@contextmanager
def complete_messages(path: Path) -> Iterator[None]:
    """Refuse a message that lacks a field of its type, as the bag defines that type by itself.

    Raises:
        InputError: a field is missing.
    """
    try:
        yield
    except AttributeError as error:
        type_name = getattr(error.obj, "__msgtype__", None)
        if type_name is None:  # a fault of ours
            raise
        what = f"a message of type {type_name} has no field {error.name!r}."
        cure = "The bag defines its types, and this one is damaged: record or convert it anew."
        raise InputError(path, what, cure) from error


@contextmanager
def opened_bag(path: Path) -> Iterator[OpenBag]:
    """Open a bag: a file .bag, .mcap or .db3, or a folder of ROS 2.

    A folder without ``metadata.yaml`` is read if it holds one storage file, or bags of ROS 1 only.

    Raises:
        InputError: rosbags is not installed, or the bag is damaged or of another kind.
    """
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        cure = "Install it: pip install 'probevo[bag]'."
        raise InputError(path, "bags need the package rosbags.", cure) from error
    try:
        # Bags of ROS 2 before Iron name the types of their messages, but do not define them.
        default = get_typestore(Stores.ROS2_HUMBLE)
        reader = AnyReader(_storage_files(path), default_typestore=default)
        reader.open()
    except _bag_errors() as error:
        raise _damaged(path, error) from error
    try:
        types = {each.topic: each.msgtype for each in reader.connections}
        topics = {
            name: Topic(name, _full_name(info.msgtype or "several types"), info.msgcount)
            for name, info in reader.topics.items()
        }
        decoder = Decoder(reader.typestore, types, is_ros2=reader.is2, path=path)
        yield OpenBag(reader, path, topics, decoder)
    finally:
        reader.close()


def _storage_files(path: Path) -> list[Path]:
    """Return what rosbags has to open for a path.

    Raises:
        InputError: the folder holds no bag, or several of ROS 2.
    """
    if path.is_file() and path.suffix not in BAG_SUFFIXES:
        what = f"rosbags knows a bag by its ending, and {path.suffix} is none that it knows."
        raise InputError(path, what, f"Rename it: {path.with_suffix(path.suffix.lower()).name}.")
    if path.is_file() or (path / "metadata.yaml").exists():
        return [path]
    files = sorted(file for file in path.iterdir() if file.suffix in BAG_SUFFIXES)
    if not files:
        cure = f"Looked for metadata.yaml and files {', '.join(BAG_SUFFIXES)}."
        raise InputError(path, "this folder holds no bag.", cure)
    if len(files) > 1 and any(file.suffix != ".bag" for file in files):
        names = ", ".join(file.name for file in files)
        raise InputError(path, f"metadata.yaml is missing; found {names}.", "Name one of them.")
    return files


def _full_name(type_name: str) -> str:
    """Return the name of a message type as rosbags has it: early ROS 2 left out ``msg``."""
    package, _, name = type_name.partition("/")
    return f"{package}/msg/{name}" if name and "/" not in name else type_name


def _bag_errors() -> tuple[type[Exception], ...]:
    """Return what reading a damaged bag raises; rosbags passes on much of what it meets inside."""
    from rosbags.highlevel import AnyReaderError
    from rosbags.rosbag1 import ReaderError as Ros1Error
    from rosbags.rosbag2 import ReaderError as Ros2Error
    from rosbags.serde import SerdeError
    from rosbags.typesys import TypesysError

    own = (AnyReaderError, Ros1Error, Ros2Error, SerdeError, TypesysError)
    storage = (OSError, EOFError, struct.error, zlib.error)
    content = (ValueError, KeyError, IndexError, TypeError, AssertionError, RuntimeError)
    sizes = (MemoryError, OverflowError)  # from sizes that a damaged bag claims
    # What rosbags reads databases and compressed chunks with differs between its versions.
    loaded = [(sys.modules.get(module), name) for module, name in STORAGE_ERRORS]
    libraries = [getattr(module, name) for module, name in loaded if module is not None]
    return (*own, *storage, *content, *sizes, *libraries)


def _damaged(path: Path, error: Exception) -> InputError:
    """Return the message for a bag that cannot be read."""
    what = f"this bag cannot be read ({type(error).__name__}: {error})."
    cure = "Is it complete? `rosbag reindex` and `ros2 bag reindex` mend bags that were cut off."
    return InputError(path, what, cure)

"""Bags of ROS 1 and ROS 2, written without ROS: one file .bag, .mcap or .db3.

The extra ``bag`` installs ``rosbags``, which does the writing.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from probevo.errors import InputError
from probevo.sequences.format_options import BAG_SUFFIXES
from probevo.storage.files import check_folder, written_together

TF_TYPE = "tf2_msgs/msg/TFMessage"
TF_DEFINITION = "geometry_msgs/TransformStamped[] transforms"
"""ROS 1's own list of messages, which rosbags follows, leaves out this one."""
MAX_STAMP_NS = 2**31 * 10**9
"""Seconds are 32 bits in a header: until 2038."""
FLOAT_TYPES = ("float32", "float64")


class BagWriter:
    """An open bag to which messages are added; ``written_bag`` opens it.

    A message is a dictionary of its fields, nested as its type is. Fields that it leaves out are
    zero or empty, so that the differences between ROS 1 and ROS 2 stay here.
    """

    def __init__(self, writer: Any, store: Any, *, is_ros1: bool) -> None:
        self._writer = writer
        self._store = store
        self._is_ros1 = is_ros1
        self._connections: dict[str, Any] = {}

    def write(
        self, topic: str, type_name: str, stamp_ns: int, fields: Mapping[str, Any], *, frame: str
    ) -> None:
        """Add a message, recorded at the time of its stamp.

        Args:
            topic: its topic.
            type_name: such as ``nav_msgs/msg/Odometry``.
            stamp_ns: stamp of its header, and time of recording.
            fields: all but the header.
            frame: ``frame_id`` of its header.

        Raises:
            InputError: the stamp does not fit into a message of ROS.
        """
        header = {"header": header_fields(stamp_ns, frame)}
        self._add(topic, type_name, stamp_ns, fields={**header, **fields})

    def write_transforms(
        self, topic: str, stamp_ns: int, transforms: list[Mapping[str, Any]]
    ) -> None:
        """Add a message of transforms, made by ``transform_fields``, to ``/tf`` or ``/tf_static``.

        Raises:
            InputError: the stamp does not fit into a message of ROS.
        """
        self._add(topic, TF_TYPE, stamp_ns, fields={"transforms": transforms})

    def _add(self, topic: str, type_name: str, stamp_ns: int, *, fields: Mapping[str, Any]) -> None:
        if topic not in self._connections:
            self._connections[topic] = self._connection(topic, type_name)
        message = self._built(type_name, fields)
        serialize = self._store.serialize_ros1 if self._is_ros1 else self._store.serialize_cdr
        self._writer.write(self._connections[topic], stamp_ns, serialize(message, type_name))

    def _connection(self, topic: str, type_name: str) -> Any:
        """Return the connection of a topic; late listeners get the last ``/tf_static``."""
        is_latched = topic.endswith("tf_static")
        if self._is_ros1:
            return self._writer.add_connection(
                topic, type_name, typestore=self._store, latching=1 if is_latched else None
            )
        return self._writer.add_connection(
            topic,
            type_name,
            typestore=self._store,
            offered_qos_profiles=(_latched_qos(),) if is_latched else (),
        )

    def _built(self, type_name: str, fields: Mapping[str, Any]) -> Any:
        """Return a message of rosbags; CameraInfo has names of its own in ROS 1."""
        definition = self._store.get_msgdef(type_name)
        values = {}
        for name, (kind, detail) in definition.fields:
            given = fields.get(name, fields.get(name.lower()))
            values[name] = self._value(kind.name, detail, given)
        return definition.cls(**values)

    def _value(self, kind: str, detail: Any, given: Any) -> Any:
        """Return the value of one field."""
        if kind == "NAME":
            return self._built(detail, given or {})
        if kind == "BASE":
            if given is not None:
                return given
            if detail[0] == "string":
                return ""
            return 0.0 if detail[0] in FLOAT_TYPES else 0
        (element_kind, element), count = detail
        if element_kind.name == "NAME":
            return [self._built(element, value) for value in given or ()]
        if element[0] == "string":
            return list(given or ())
        dtype = "uint8" if element[0] in ("byte", "char", "octet") else element[0]
        if given is None:
            return np.zeros(count, dtype)
        return np.ascontiguousarray(given, dtype).ravel()


def check_bag_path(path: Path, option: str) -> None:
    """Refuse a path that cannot be written as a bag, before anything is computed.

    Raises:
        InputError: rosbags is not installed, the ending is of no kind of bag, or the folder is
            not writable.
    """
    if path.suffix not in BAG_SUFFIXES:
        what = f"{path} ends in none of {', '.join(BAG_SUFFIXES)}."
        cure = "The ending says which kind of bag is written: .bag is ROS 1, the others ROS 2."
        raise InputError(option, what, cure)
    if path.is_dir():
        raise InputError(option, f"{path} is a folder.", "Name a file that is to be written.")
    check_folder(path.parent, option)
    _import_rosbags(option)


@contextmanager
def written_bag(path: Path) -> Iterator[BagWriter]:
    """Open a bag for writing; it appears when all of it has been written, and replaces the old one.

    Args:
        path: the file; its ending says which kind of bag it is, .bag (ROS 1), .mcap or .db3 (ROS
            2).

    Raises:
        InputError: as ``check_bag_path``, or the file cannot be written.
    """
    check_bag_path(path, str(path))
    from rosbags.rosbag1 import Writer as Ros1Writer
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Ros2Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    is_ros1 = path.suffix == ".bag"
    store = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE)
    if is_ros1:
        store.register(get_types_from_msg(TF_DEFINITION, TF_TYPE))
    with written_together(path.parent) as folder:
        target = folder / path.name
        partial = target if is_ros1 else folder / "bag"
        writer: Any
        if is_ros1:
            writer = Ros1Writer(partial)
        else:
            plugin = StoragePlugin.MCAP if path.suffix == ".mcap" else StoragePlugin.SQLITE3
            writer = Ros2Writer(partial, version=8, storage_plugin=plugin)
        with writer:
            yield BagWriter(writer, store, is_ros1=is_ros1)
        if not is_ros1:
            # rosbags writes a folder with metadata.yaml; the storage file has all of it.
            (storage,) = partial.glob(f"*{path.suffix}")
            storage.replace(target)
            (partial / "metadata.yaml").unlink()
            partial.rmdir()


def header_fields(stamp_ns: int, frame: str) -> dict[str, Any]:
    """Return the fields of a std_msgs/Header.

    Raises:
        InputError: the stamp is negative or beyond 2038, which a header cannot say.
    """
    if not 0 <= stamp_ns < MAX_STAMP_NS:
        what = f"the stamp {stamp_ns} ns cannot be written as a time of ROS."
        raise InputError("stamps", what, "ROS has times from 1970 to 2038, counted from 1970.")
    stamp = {"sec": int(stamp_ns // 10**9), "nanosec": int(stamp_ns % 10**9)}
    return {"stamp": stamp, "frame_id": frame}


def _import_rosbags(option: str) -> None:
    """Check that rosbags is there.

    Raises:
        InputError: it is not.
    """
    try:
        import rosbags.rosbag2  # noqa: F401
    except ImportError as error:
        cure = "Install it: pip install 'probevo[bag]'."
        raise InputError(option, "bags need the package rosbags.", cure) from error


def _latched_qos() -> Any:
    """Return the quality of service of ``/tf_static``: reliable, kept for late listeners."""
    from rosbags.interfaces import (
        Qos,
        QosDurability,
        QosHistory,
        QosLiveliness,
        QosReliability,
        QosTime,
    )

    unlimited = QosTime(sec=2147483647, nsec=4294967295)
    return Qos(
        history=QosHistory.KEEP_LAST,
        depth=1,
        reliability=QosReliability.RELIABLE,
        durability=QosDurability.TRANSIENT_LOCAL,
        deadline=unlimited,
        lifespan=unlimited,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=unlimited,
        avoid_ros_namespace_conventions=False,
    )

"""True poses in a bag: Odometry, PoseStamped, PoseWithCovarianceStamped, TransformStamped or tf."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from probevo.arrays import FloatArray, IntArray
from probevo.errors import InputError, brief
from probevo.geometry import se3


@dataclass
class TruthPoses:
    """The poses of one body in one world, as a topic gives them."""

    where: str
    """Bag and topic, for messages."""
    child: str | None
    """The frame whose poses are wanted; None to take the one that the messages name."""
    stamps_ns: list[int] = field(default_factory=list)
    T_world_child: list[FloatArray] = field(default_factory=list)
    named: str = ""
    """The frame that the messages name, "" where they name none."""
    parents: set[str] = field(default_factory=set)

    def add(self, message: Any) -> None:
        """Add what a message says of the body.

        Raises:
            InputError: a quaternion is not of unit length, or a number is not finite.
        """
        if hasattr(message, "transforms"):  # tf: many bodies
            for transform in message.transforms:
                if frame_name(transform.child_frame_id) == self.child:
                    self._add_transform(transform)
        elif hasattr(message, "transform"):
            self._add_transform(message)
        else:
            pose = message.pose.pose if hasattr(message.pose, "pose") else message.pose
            child = frame_name(getattr(message, "child_frame_id", ""))
            self._add(message.header, child, pose.position, rotation=pose.orientation)

    def arrays(self) -> tuple[IntArray, FloatArray]:
        """Return stamps, [M], ascending and distinct, and poses T_world_child, [M, 4, 4], m.

        Raises:
            InputError: there is no pose, or they are in several worlds.
        """
        if not self.stamps_ns:
            of = f" of {self.child}" if self.child else ""
            cure = "--truth-of names the frame whose poses are the truth."
            raise InputError(self.where, f"it has no pose{of}.", cure)
        if len(self.parents) > 1:
            what = f"its poses are in several frames: {', '.join(sorted(self.parents))}."
            raise InputError(self.where, what)
        stamps_ns, first = np.unique(np.array(self.stamps_ns, np.int64), return_index=True)
        return stamps_ns, np.array(self.T_world_child)[first]

    def _add_transform(self, message: Any) -> None:
        transform = message.transform
        self._add(
            message.header,
            frame_name(message.child_frame_id),
            transform.translation,
            rotation=transform.rotation,
        )

    def _add(self, header: Any, child: str, position: Any, *, rotation: Any) -> None:
        self.named = child
        self.parents.add(frame_name(header.frame_id))
        self.stamps_ns.append(header.stamp.sec * 10**9 + header.stamp.nanosec)
        self.T_world_child.append(rigid_matrix(position, rotation, self.where))


def rigid_matrix(position: Any, rotation: Any, where: str) -> FloatArray:
    """Return the matrix T_b_a, [4, 4], m, of a position and a quaternion.

    Raises:
        InputError: the quaternion is not of unit length, or a number is not finite.
    """
    t = np.array([position.x, position.y, position.z])
    q = np.array([rotation.x, rotation.y, rotation.z, rotation.w])
    length = float(np.linalg.norm(q))
    if not abs(length - 1.0) < 1e-3 or not np.isfinite(t).all():
        what = f"the pose {brief((t.tolist(), q.tolist()))} is none: its quaternion has length"
        raise InputError(where, f"{what} {length:.6g}.", "Expected finite numbers of unit length.")
    return se3.from_parts(Rotation.from_quat(q).as_matrix(), t)


def frame_name(name: str) -> str:
    """Return the name of a frame without the slash that early ROS put before it."""
    return name.removeprefix("/")

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
    """The poses that a topic gives; ``arrays`` returns the poses of one body in one world."""

    where: str
    """Bag and topic, for messages."""
    child: str | None
    """The frame whose poses are wanted; None to take the only one that the messages name. Where
    they name one other frame alone, their poses are taken for this frame's."""
    stamps_ns: list[int] = field(default_factory=list)
    T_world_child: list[FloatArray] = field(default_factory=list)
    children: list[str] = field(default_factory=list)
    """The frame that each message names, "" where it names none."""
    parents: list[str] = field(default_factory=list)
    """The frame of the world of each pose."""

    @property
    def named(self) -> str:
        """The frame that the messages name, "" where they name none; ``arrays`` refuses several."""
        return self.children[-1] if self.children else ""

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
            InputError: there is no pose, or they are of several bodies, or in several worlds.
        """
        if not self.stamps_ns:
            what = f"it has no pose of {self.child}." if self.child else "it has no pose."
            cure = "--truth-of names the frame whose poses are the truth."
            raise InputError(self.where, what, cure)
        rows = self._rows_of_body()
        parents = sorted({self.parents[row] for row in rows})
        if len(parents) > 1:
            what = f"its poses are in several frames: {', '.join(parents)}."
            raise InputError(self.where, what)
        stamps_ns, first = np.unique(np.array(self.stamps_ns, np.int64)[rows], return_index=True)
        return stamps_ns, np.array(self.T_world_child)[rows][first]

    def _rows_of_body(self) -> IntArray:
        """Return which of the poses belong to the body that is wanted.

        Raises:
            InputError: they are of several bodies, and none of them is the one that is wanted.
        """
        names = sorted(set(self.children))
        if len(names) > 1 and self.child not in names:
            what = f"its poses are those of several frames: {', '.join(names)}."
            cure = "--truth-of names the frame whose poses are the truth."
            raise InputError(self.where, what, cure)
        body = self.child if self.child in names else names[0]
        return np.flatnonzero([child == body for child in self.children])

    def _add_transform(self, message: Any) -> None:
        transform = message.transform
        self._add(
            message.header,
            frame_name(message.child_frame_id),
            transform.translation,
            rotation=transform.rotation,
        )

    def _add(self, header: Any, child: str, position: Any, *, rotation: Any) -> None:
        self.children.append(child)
        self.parents.append(frame_name(header.frame_id))
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

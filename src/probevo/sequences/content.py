"""What a recording shows, by which it is recognised under another name.

The images or features of the first frames suffice: cameras add noise to each.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from probevo.arrays import AnyArray
from probevo.sequences.base import Sequence, first_frames
from probevo.sequences.frame import Frame
from probevo.storage.files import name_as_text

FIRST_FRAMES = 5
"""Number of frames by which a recording is recognised."""


class FirstFrames(NamedTuple):
    """SHA-256 of the first frames of a recording."""

    view: str
    """Digest of their images or features; neither clock nor IMU count."""
    given: str
    """Digest of all that the odometry is given with them."""


@dataclass(frozen=True)
class SeenRecording:
    """A recording that a training has seen, as the file of what it learned states it."""

    name: str
    view: str | None
    """``FirstFrames.view``; None in files that do not state it."""


def digests_of_first_frames(sequence: Sequence) -> FirstFrames:
    """Return the digests of the first frames of a recording.

    Raises:
        InputError: one of these frames is faulty.
    """
    view = hashlib.sha256()
    given = hashlib.sha256()
    for frame in first_frames(sequence, FIRST_FRAMES):
        _add(view, _view_arrays(frame))
        hash_frame(given, frame)
    return FirstFrames(view.hexdigest(), given.hexdigest())


def is_among(sequence: Sequence, seen: Iterable[SeenRecording]) -> bool:
    """Return whether a training has seen a recording, under whatever name.

    Recordings whose view is not stated are compared by name.

    Raises:
        InputError: one of the first frames is faulty.
    """
    seen = tuple(seen)
    views = {each.view for each in seen if each.view is not None}
    names = {each.name for each in seen if each.view is None}
    if name_as_text(sequence.path.resolve()) in names:
        return True
    return bool(views) and digests_of_first_frames(sequence).view in views


def show_the_same(one: Sequence, other: Sequence, num_frames: int) -> bool:
    """Return whether the first frames of two recordings show the same.

    Raises:
        InputError: a frame is faulty.
    """
    same = 0
    for frame, other_frame in zip(
        first_frames(one, num_frames), first_frames(other, num_frames), strict=False
    ):
        arrays = _view_arrays(frame)
        other_arrays = _view_arrays(other_frame)
        if len(arrays) != len(other_arrays) or not all(map(np.array_equal, arrays, other_arrays)):
            return False
        same += 1
    return same == num_frames


def hash_frame(digest: hashlib._Hash, frame: Frame) -> None:
    """Add all that the odometry is given with a frame to the digest."""
    digest.update(np.int64(frame.stamp_ns).tobytes())
    _add(digest, _view_arrays(frame))
    if frame.imu is not None:
        _add(digest, [frame.imu.stamps_ns, frame.imu.gyro_rad_s, frame.imu.accel_m_s2])


def _view_arrays(frame: Frame) -> list[AnyArray]:
    """Return the images or features of a frame."""
    arrays: list[AnyArray | None] = [frame.left, frame.right]
    if frame.features is not None:
        arrays += [frame.features.ids, frame.features.pixels]
    return [array for array in arrays if array is not None]


def _add(digest: hashlib._Hash, arrays: Iterable[AnyArray]) -> None:
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())

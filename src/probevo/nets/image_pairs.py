"""Pairs of consecutive images of a recording as a network sees them, with their true rotations."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np

from probevo.arrays import FloatArray
from probevo.errors import InputError
from probevo.geometry import so3
from probevo.nets.flow_field import check_field_of_view, field_of_images
from probevo.sequences.base import Sequence
from probevo.sequences.content import digests_of_first_frames
from probevo.storage.files import name_as_text


@dataclass(frozen=True)
class ImagePairs:
    """N pairs of consecutive images."""

    fields: FloatArray
    """Fields as ``flow_field`` gives them, [N, 4, rows, columns], float32."""
    rotations: FloatArray
    """True rotation vectors φ = Log(C_curr_prev), [N, 3], rad."""

    def __len__(self) -> int:
        """Return N."""
        return len(self.fields)


def read_pairs(
    sequence: Sequence, num_frames: int, on_frame: Callable[[int], None] | None = None
) -> ImagePairs:
    """Go through a recording, and return the pairs whose true rotation is known.

    An image that repeats the previous one shows no motion, and makes no pair. If the camera has
    moved meanwhile, the image is an older one, and makes none with the next image, either.

    Args:
        sequence: the recording.
        num_frames: frames to read.
        on_frame: called with the number of frames done.

    Raises:
        InputError: it has no images or no truth, a camera that sees too little, or a faulty frame.
    """
    T_world_cam = true_poses(sequence)
    is_known = np.asarray(np.isfinite(T_world_cam).all(axis=(1, 2)))
    fields = []
    rotations = []
    prev_left = None
    is_prev_stale = False
    for frame in islice(sequence, num_frames):
        if frame.left is None:
            raise InputError(sequence.path, "there are no images.", "Networks need images.")
        k = frame.index
        is_repeated = prev_left is None or np.array_equal(prev_left, frame.left)
        is_stale = is_repeated or is_prev_stale
        if prev_left is not None and not is_stale and is_known[k - 1 : k + 1].all():
            C_world_prev, C_world_curr = T_world_cam[k - 1 : k + 1, :3, :3]
            fields.append(field_of_images(prev_left, frame.left, sequence.camera))
            # C_curr_prev = C_curr_world C_world_prev
            rotations.append(so3.log(C_world_curr.T @ C_world_prev))
        has_moved = k > 0 and not np.array_equal(T_world_cam[k - 1], T_world_cam[k])
        is_prev_stale = prev_left is not None and is_repeated and has_moved
        prev_left = frame.left
        if on_frame is not None:
            on_frame(k + 1)
    if not fields:
        what = "no two successive frames have a true pose."
        raise InputError(sequence.path, what, "Give a recording with ground truth.")
    return ImagePairs(np.array(fields), np.array(rotations))


def check_recording(sequence: Sequence) -> None:
    """Refuse a recording that networks cannot learn rotations from.

    Raises:
        InputError: it has no images, too small a field of view, or no true poses.
    """
    true_poses(sequence)


def true_poses(sequence: Sequence) -> FloatArray:
    """Return T_world_cam of a recording that networks can learn from, [K, 4, 4].

    Raises:
        InputError: as ``check_recording`` raises.
    """
    try:
        check_field_of_view(sequence.camera)
    except InputError as error:
        raise InputError(sequence.path, f"{error.where}: {error.what}", error.cure) from error
    if sequence.truth is None:
        what = "there are no true poses."
        raise InputError(sequence.path, what, "Give a recording with ground truth.")
    return sequence.truth.T_world_cam


def facts_of(sequence: Sequence, num_frames: int) -> dict[str, Any]:
    """Return what identifies a recording and its truth, in plain values."""
    truth = b"" if sequence.truth is None else sequence.truth.T_world_cam[:num_frames].tobytes()
    return {
        "name": name_as_text(sequence.path),
        "frames": num_frames,
        "first_and_last_ns": sequence.stamps_ns[[0, num_frames - 1]].tolist(),
        "camera": [np.asarray(value).tolist() for value in vars(sequence.camera).values()],
        "view": digests_of_first_frames(sequence).view,
        "truth": hashlib.sha256(truth).hexdigest(),
    }

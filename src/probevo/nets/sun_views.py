"""Single images as a network sees them, with the true direction of the sun.

Where the sun stands is said by ``sun.txt`` in the folder of a recording: a direction towards it, x
y z, in the camera of the first frame. Rendered scenes have the file.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import cv2
import numpy as np

from probevo.arrays import FloatArray, Image
from probevo.camera.stereo import StereoCamera
from probevo.errors import InputError
from probevo.nets.flow_field import CELL_PX, MIN_LEVELS, cell_means, virtual_view
from probevo.nets.image_pairs import true_poses
from probevo.sequences.base import Sequence
from probevo.sequences.formats.folder import SUN_FILE
from probevo.sequences.frame import Frame
from probevo.storage.files import check_regular

MAX_BYTES = 10_000
CURE = "Write the direction towards the sun into it, x y z, in the frame of the first camera."
CHANNELS = 4
"""Level, contrast, and gradients along x and y."""
NUM_STATISTICS = 2 * CHANNELS - 1
"""Numbers that ``image_statistics`` gives."""
MIN_SPREAD = 1e-3
"""Standard deviation of a channel over the cells that counts as none."""
BLUR_PX = 1.5
"""Blur of the image before its gradients are taken."""

PERIOD_NS = 500_000_000
"""Time from one measurement to the next: successive images see the same street."""


@dataclass(frozen=True)
class SunViews:
    """N images."""

    fields: FloatArray
    """Fields as ``sun_field`` gives them, [N, 4, rows, columns], float32."""
    directions: FloatArray
    """Directions towards the sun in the camera, unit vectors, [N, 3]."""

    def __len__(self) -> int:
        """Return N."""
        return len(self.fields)


def sun_field(image: Image, camera: StereoCamera) -> FloatArray:
    """Return what a network sees of one image, [4, rows, columns], float32.

    The channels are means over cells of the virtual camera's image: the logarithm of the grey level
    less its mean over the image, so that the exposure does not matter; the logarithm of the
    contrast within the cell; and the gradients of the logarithm along x and y, which tell lit from
    shaded sides.

    Raises:
        InputError: the camera's field of view is smaller than the virtual camera's.
    """
    # A factor of the exposure is an offset in the logarithms of grey levels.
    levels = virtual_view(image, camera).astype(np.float32)
    logs = np.log(levels + MIN_LEVELS)
    mean = cell_means(levels)
    variance = np.maximum(cell_means(levels**2) - mean**2, 0.0)
    smooth = cv2.GaussianBlur(logs, (0, 0), BLUR_PX)
    along_y, along_x = np.gradient(smooth)
    field = [
        cell_means(logs) - logs.mean(),
        np.log(np.sqrt(variance) + MIN_LEVELS) - np.log(mean + MIN_LEVELS),
        CELL_PX * cell_means(along_x),
        CELL_PX * cell_means(along_y),
    ]
    return np.stack(field).astype(np.float32)


def image_statistics(fields: FloatArray) -> FloatArray:
    """Return what tells an image of the day from one at night, in fog or of nothing, [N, 7].

    These are the means of contrast and gradients over the cells, and the logarithms of the standard
    deviations of all four channels. The mean of the level is zero in every image.

    Args:
        fields: as ``sun_field`` gives them, [N, 4, rows, columns].
    """
    fields = fields.astype(np.float64)
    means = fields[:, 1:].mean(axis=(2, 3))
    spreads = fields.std(axis=(2, 3))
    return np.concatenate([means, np.log(spreads + MIN_SPREAD)], axis=1)


def begins_period(prev_frame: Frame, frame: Frame) -> bool:
    """Return whether a frame is the first of its half second, which the sensor measures.

    The stamps decide, so that no state is kept. Where that frame repeats an image, none is measured
    in its half second.
    """
    return prev_frame.stamp_ns // PERIOD_NS != frame.stamp_ns // PERIOD_NS


def read_views(
    sequence: Sequence,
    num_frames: int,
    on_frame: Callable[[int], None] | None = None,
    *,
    is_thinned: bool = False,
) -> SunViews:
    """Go through a recording, and return the images whose true pose is known.

    An image that is repeated is left out, as the sensor leaves it out: it is of an earlier pose.

    Args:
        sequence: the recording.
        num_frames: frames to read.
        on_frame: called with the number of frames done.
        is_thinned: whether only the images are returned that the sensor measures, two a second.

    Raises:
        InputError: it has no images, no truth of its first frame or no ``sun.txt``, a camera that
            sees too little, a faulty frame, or no image that is returned.
    """
    sun_world = read_sun(sequence.path)
    T_world_cam = _poses_from_the_first(sequence)
    fields = []
    directions = []
    prev_frame: Frame | None = None
    for frame in islice(sequence, num_frames):
        if frame.left is None:
            raise InputError(sequence.path, "there are no images.", "Networks need images.")
        C_world_cam = T_world_cam[frame.index, :3, :3]
        if prev_frame is None or prev_frame.left is None:
            is_taken = not is_thinned
        else:
            is_measured = not is_thinned or begins_period(prev_frame, frame)
            is_taken = is_measured and not np.array_equal(frame.left, prev_frame.left)
        prev_frame = frame
        if is_taken and np.isfinite(C_world_cam).all():
            fields.append(sun_field(frame.left, sequence.camera))
            # The sun is so far away that only the attitude of the camera counts.
            directions.append(C_world_cam.T @ sun_world)
        if on_frame is not None:
            on_frame(frame.index + 1)
    if not fields:
        what = f"the sensor measures none of its {num_frames} frames whose true pose is known."
        raise InputError(
            sequence.path, what, "Take a longer recording: it measures twice a second."
        )
    return SunViews(np.array(fields), np.array(directions))


def check_sun_recording(sequence: Sequence) -> None:
    """Refuse a recording from which the sun cannot be learned.

    Raises:
        InputError: it has no images, no truth of its first frame or no ``sun.txt``, or sees too
            little.
    """
    _poses_from_the_first(sequence)
    read_sun(sequence.path)


def _poses_from_the_first(sequence: Sequence) -> FloatArray:
    """Return T_world_cam, [K, 4, 4], in which the world is the camera of the first frame.

    Raises:
        InputError: the true pose of the first frame is unknown, or as ``true_poses`` raises.
    """
    T_world_cam = true_poses(sequence)
    # A truth that begins later is relative to its first known pose, another camera than sun.txt is.
    if not np.isfinite(T_world_cam[0]).all():
        what = f"the true pose of its first frame is unknown, in whose camera {SUN_FILE} is."
        raise InputError(sequence.path, what, "Take a recording whose truth begins with it.")
    return T_world_cam


def read_sun(folder: Path) -> FloatArray:
    """Return the direction towards the sun in the first camera, a unit vector, [3].

    Raises:
        InputError: there is no such file, or it holds no direction.
    """
    path = folder / SUN_FILE
    if not path.exists():
        raise InputError(path, "there is no such file.", CURE)
    check_regular(path, MAX_BYTES)
    try:
        direction = np.array([float(word) for word in path.read_text("utf-8").split()])
    except (OSError, ValueError) as error:
        raise InputError(path, f"cannot be read: {error}.", CURE) from error
    if direction.shape != (3,) or not np.isfinite(direction).all() or not direction.any():
        raise InputError(path, "it holds no direction of three numbers.", CURE)
    unit: FloatArray = direction / np.linalg.norm(direction)
    return unit

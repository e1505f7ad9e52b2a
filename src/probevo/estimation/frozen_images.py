"""Detection of images that repeat: those of a driver that hangs, of a video whose frames were
doubled, or of a camera at rest."""

from __future__ import annotations

import cv2
import numpy as np

from probevo.arrays import FloatArray, Image
from probevo.estimation.motion_model import INNOVATION_GATE, MotionModel, MotionPrediction
from probevo.sequences.frame import Frame

BLOCK_PX = 8
"""Side of the blocks over which noise is averaged out."""
STANDING_DIFFERENCE = 0.03
"""Standard deviation of the difference of two block images, relative to their contrast, below which
they show the same."""


def are_frozen(
    prev_frame: Frame,
    frame: Frame,
    model: MotionModel,
    prediction: MotionPrediction,
    *,
    were_frozen: bool,
) -> bool:
    """Return whether the images do not change although the camera moves.

    They are the same bytes, or the same except for noise, and the camera was too fast to have come
    to rest within the step. They count as frozen until they change.

    Args:
        prev_frame: the previous frame.
        frame: the current frame.
        model: the motion model before the step.
        prediction: the motion that it predicts.
        were_frozen: whether the images were frozen in the previous frame.
    """
    if not model.is_moving:
        return False
    if are_repeated(prev_frame, frame):
        return True
    cannot_rest = prediction.squared_distance(np.eye(4), np.zeros((6, 6))) > INNOVATION_GATE
    return (were_frozen or cannot_rest) and _looks_repeated(prev_frame, frame)


def may_be_frozen(prev_frame: Frame, frame: Frame, model: MotionModel) -> bool:
    """Return whether the images repeat without telling whether the camera rests.

    Equal bytes mean a dropped frame, except from a camera without noise. Images that are equal but
    for noise are ambiguous if the last solved motion followed repeated images, or if a solve was
    rejected, as in a video whose frames come twice.

    Args:
        prev_frame: the previous frame.
        frame: the current frame.
        model: the motion model before the step.
    """
    if are_repeated(prev_frame, frame):
        return True
    is_ambiguous = model.is_after_repetition or model.refusals > 0
    return is_ambiguous and _looks_repeated(prev_frame, frame)


def are_repeated(prev: Frame, curr: Frame) -> bool:
    """Return whether an image of a frame equals that of the previous one, byte by byte.

    The noise of a camera makes two exposures differ, so that equal images mean a dropped frame.
    """
    pairs = ((prev.left, curr.left), (prev.right, curr.right))
    return any(
        one is not None and other is not None and _are_equal(one, other) for one, other in pairs
    )


def _looks_repeated(prev: Frame, curr: Frame) -> bool:
    """Return whether the left image of a frame is that of the previous frame but for noise.

    Noise averages out over blocks of pixels. The remaining difference, relative to the contrast of
    the image, is 0.3 or more from frame to frame on KITTI, Karlsruhe, and EuRoC in motion, and 0.01
    while EuRoC is at rest.
    """
    if prev.left is None or curr.left is None:
        return False
    before = _block_means(prev.left)
    now = _block_means(curr.left)
    return float((now - before).std()) < STANDING_DIFFERENCE * float(now.std())


def _block_means(image: Image) -> FloatArray:
    """Return the means of whole blocks of pixels, in every fourth row of blocks.

    A quarter of the rows is enough to compare images. An image smaller than a block is one block.
    """
    height, width = image.shape
    if height < BLOCK_PX or width < BLOCK_PX:
        return np.full((1, 1), image.mean())
    rows = height // BLOCK_PX
    columns = width // BLOCK_PX
    blocks = image[: rows * BLOCK_PX, : columns * BLOCK_PX].reshape(rows, BLOCK_PX, -1)[::4]
    strips = blocks.reshape(-1, columns * BLOCK_PX)
    means = cv2.resize(strips, (columns, len(blocks)), interpolation=cv2.INTER_AREA)
    return means.astype(np.float64)


def _are_equal(one: Image, other: Image) -> bool:
    """Return whether two images are equal."""
    # Nearly all images that differ do so in their middle row: comparing it first is faster.
    middle = slice(len(one) // 2, len(one) // 2 + 1)
    return np.array_equal(one[middle], other[middle]) and np.array_equal(one, other)

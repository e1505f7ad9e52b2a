"""Images that repeat: from a driver that hangs, a video whose frames were doubled, or a camera
at rest."""

from __future__ import annotations

import cv2
import numpy as np

from probevo.arrays import FloatArray, Image
from probevo.sequences.frame import Frame

BLOCK_PX = 8
"""Side of the blocks over which noise is averaged out."""
STANDING_DIFFERENCE = 0.03
"""Standard deviation of the difference of two block images, relative to their contrast, below which
they show the same."""
PYRAMID_LEVELS = 2
"""Levels above the image on which points are searched: they reach ten pixels and more."""
WINDOW_PX = 21
MAX_ITERATIONS = 30
MAX_STEP_PX = 0.003
"""The search has converged when its step is shorter: a search that ends earlier would end too near
to where it started, which is where the points were."""
MIN_TEXTURE = 0.001
"""Share of pixels that differ from their neighbour below which an image shows nothing."""


def are_repeated(prev: Frame, curr: Frame) -> bool:
    """Return whether an image of a frame equals the previous frame's, byte by byte.

    The noise of a camera makes two exposures differ, so that equal images mean a dropped frame.
    """
    pairs = ((prev.left, curr.left), (prev.right, curr.right))
    return any(
        one is not None and other is not None and _are_equal(one, other) for one, other in pairs
    )


def look_repeated(prev: Frame, curr: Frame) -> bool:
    """Return whether the left image of a frame equals the previous frame's but for noise.

    Noise averages out over blocks of pixels. The remaining difference, relative to the contrast of
    the image, is 0.3 or more from frame to frame on KITTI, Karlsruhe, and EuRoC in motion, and 0.01
    while EuRoC is at rest. At 60 frames a second and more, a slow camera has as little as one at
    rest: ``displacements`` tell them apart.
    """
    if prev.left is None or curr.left is None:
        return False
    before = _block_means(prev.left)
    now = _block_means(curr.left)
    return float((now - before).std()) < STANDING_DIFFERENCE * float(now.std())


def displacements(before: Image, now: Image, points_px: FloatArray) -> FloatArray:
    """Search points of an image in a later one, from where they were.

    Args:
        before: the earlier image.
        now: the later one.
        points_px: (u, v) in the earlier image, [N, 2], px.

    Returns:
        How far each has moved, [N, 2], px; NaN where it is not found.
    """
    if len(points_px) == 0:
        return np.zeros((0, 2))
    start_px = points_px.astype(np.float32)
    criteria = cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS
    found_px, status, _ = cv2.calcOpticalFlowPyrLK(
        before,
        now,
        start_px,
        start_px.copy(),
        winSize=(WINDOW_PX, WINDOW_PX),
        maxLevel=PYRAMID_LEVELS,
        criteria=(criteria, MAX_ITERATIONS, MAX_STEP_PX),
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    moved_px = (found_px - start_px).astype(np.float64)
    moved_px[status[:, 0] == 0] = np.nan
    return moved_px


def shows_nothing(frame: Frame) -> bool:
    """Return whether an image of a frame has one grey level nearly everywhere.

    Black or overexposed images are equal, although the camera takes one after the other.
    """
    return any(
        image is not None and float(np.mean(image[:, 1:] != image[:, :-1])) < MIN_TEXTURE
        for image in (frame.left, frame.right)
    )


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

"""Detection of raw images of colour cameras, whose pixels lie under a mosaic of colour filters."""

from __future__ import annotations

from probevo.arrays import Image

MIN_DIFFERENCE = 0.03
"""Relative difference of mean grey levels above which an image counts as a mosaic. Grey images of
six recordings have 0.004 at most; filters of red, green and blue differ by a third and more on
anything that is not grey."""


def mosaic_difference(image: Image) -> float:
    """Return by how much the mean grey levels under the four filters of a mosaic would differ,
    relative to the smallest one.

    A mosaic has one filter for each pixel of a square of two by two, so that each is a mean over
    every second row and column. In a grey image, all four see the same scene.

    Args:
        image: grey levels, [H, W].
    """
    height, width = image.shape
    whole = image[: height // 2 * 2, : width // 2 * 2]
    squares = whole.reshape(height // 2, 2, width // 2, 2)
    means = squares.mean(axis=(0, 2))
    if means.min() == 0.0:
        return 0.0
    return float(means.max() / means.min() - 1.0)

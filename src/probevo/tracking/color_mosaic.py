"""Detection of raw images of colour cameras, whose pixels lie under a mosaic of colour filters."""

from __future__ import annotations

from probevo.arrays import Image

MIN_DIFFERENCE = 0.03
"""Relative difference of mean grey levels above which an image counts as a mosaic. Grey images of
six recordings have 0.004 at most; filters of red, green and blue differ by a third and more on
anything that is not grey."""


def difference_of_places(image: Image) -> float:
    """Return by how much the means of even and odd rows and columns differ, relative to the least.

    A mosaic has one filter for each of the four places in a square of two by two pixels. In a grey
    image, all four see the same scene.

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

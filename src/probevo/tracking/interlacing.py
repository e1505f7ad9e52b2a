"""Detection of interlaced images, whose odd rows are from another time than their even ones.

Where the scene moves, each row of such an image resembles the next but one rather than the next:
edges look like combs. A single motion does not explain it.
"""

from __future__ import annotations

import numpy as np

from probevo.arrays import Image
from probevo.sequences.frame import Frame

COMBED_FROM = 1.25
"""Ratio of the differences of neighbouring rows to those of next but one from which an image counts
as combed. It is 1 for noise alone, and less for any scene, whose rows differ the more, the farther
they are apart: 0.54 to 0.69 on six recordings."""
EVERY_COLUMNS = 3
"""Columns from one that is compared to the next: even and odd ones in turn."""
EVERY_FRAMES = 2
"""Frames from one that is looked at to the next."""
MIN_COMBED = 5
"""Frames with combed images that a decision needs: a single one may show a fine pattern."""


def combing(image: Image) -> float:
    """Return by how much neighbouring rows differ, relative to the next but one.

    Args:
        image: grey levels, [H, W].

    Returns:
        Ratio of the mean absolute differences; 0 for an image of one grey level, or of two rows.
    """
    columns = image[:, ::EVERY_COLUMNS].astype(np.float32)
    if len(columns) < 3:
        return 0.0
    # Some sensors read odd and even rows by two amplifiers, one of which is brighter.
    columns[1::2] += columns[::2].mean() - columns[1::2].mean()
    difference_two_on = float(np.mean(np.abs(columns[2:] - columns[:-2])))
    difference_next = float(np.mean(np.abs(columns[1:] - columns[:-1])))
    return difference_next / difference_two_on if difference_two_on > 0.0 else 0.0


class Interlacing:
    """Looks for combed images, as frames come; a camera at rest shows none."""

    def __init__(self) -> None:
        self._num_frames = 0
        self._num_combed = 0

    @property
    def is_found(self) -> bool:
        """Whether the images are interlaced."""
        return self._num_combed >= MIN_COMBED

    def add(self, frame: Frame) -> None:
        """Take the next frame; one without images is left out."""
        if self.is_found or frame.left is None or frame.right is None:
            return
        self._num_frames += 1
        if self._num_frames % EVERY_FRAMES:
            return
        images = (frame.left, frame.right)
        # In a mosaic of colour filters, columns alternate as rows do.
        self._num_combed += all(
            combing(image) > COMBED_FROM and combing(image.T) < 1.0 for image in images
        )

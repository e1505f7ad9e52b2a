"""Changes of the exposure between two frames: the contrast of one image is given to the other.

Lucas–Kanade takes a point to look the same in both images. The high-pass filter removes an offset
of the grey levels, but not a gain: after a jump of the exposure, all windows differ by more than
the tracks do that are wrong.
"""

from __future__ import annotations

import cv2
import numpy as np

from probevo.sequences.prepared_images import Pyramid

LEAST_GAIN = 1.25
"""Change of the contrast from which an exposure has jumped. Where a scene moves on, it is at most
1.15 from frame to frame on KITTI, Karlsruhe and EuRoC."""
LARGEST_GAIN = 8.0
"""Beyond that, one of the two images shows nothing."""


def with_contrast_of(template: Pyramid, image: Pyramid) -> Pyramid:
    """Return a pyramid with the mean and the contrast of another one.

    It is returned as it is if it is empty, and where these hardly differ, or by more than any
    exposure makes them.
    """
    if not template:
        return template
    mean, contrast = _mean_and_contrast(image)
    template_mean, template_contrast = _mean_and_contrast(template)
    gain = contrast / template_contrast if template_contrast > 0.0 else 1.0
    if not LEAST_GAIN < max(gain, 1.0 / max(gain, 1e-9)) < LARGEST_GAIN:
        return template
    offset = mean - gain * template_mean
    return tuple(
        np.asarray(cv2.addWeighted(level, gain, level, 0.0, offset), dtype=np.uint8)
        for level in template
    )


def _mean_and_contrast(pyramid: Pyramid) -> tuple[float, float]:
    """Return mean and standard deviation of the grey levels of the coarsest level."""
    mean, deviation = cv2.meanStdDev(pyramid[-1])
    return float(mean[0, 0]), float(deviation[0, 0])

"""Compensation of exposure jumps: the contrast of one image is adapted to that of the other.

Lucas–Kanade assumes that a point looks the same in both images. The high-pass filter removes an
offset of the grey levels, but not a gain. After an exposure jump, even correct tracks would
therefore differ by more than the threshold that rejects wrong ones.
"""

from __future__ import annotations

import cv2
import numpy as np

from probevo.sequences.prepared_images import Pyramid

LEAST_GAIN = 1.25
"""Ratio of the contrasts that counts as an exposure jump. Without one, it is at most 1.15 from
frame to frame on KITTI, Karlsruhe and EuRoC."""
LARGEST_GAIN = 8.0
"""At a larger ratio, one of the two images is practically black or white."""


def with_contrast_of(template: Pyramid, image: Pyramid) -> Pyramid:
    """Return the template with mean and contrast of the image.

    It is returned unchanged if it is empty, or if the ratio of the contrasts is not between
    LEAST_GAIN and LARGEST_GAIN.
    """
    if not template:
        return template
    # Mean and spread of an affine map g I + o of the grey levels are g μ + o and g σ.
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

"""Compensation of other exposures: the contrast of one image is adapted to that of the other.

Lucas–Kanade assumes that a point looks the same in both images. The high-pass filter removes an
offset of the grey levels, but not a gain. After an exposure jump, or where both cameras are exposed
differently, even correct tracks would therefore differ by more than the threshold that rejects
wrong ones.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from probevo.sequences.prepared_images import Pyramid

MIN_GAIN = 1.25
"""Ratio of the contrasts that counts as an exposure jump. Without one, it is at most 1.15 from
frame to frame on KITTI, Karlsruhe and EuRoC."""
MIN_GAIN_IN_STEREO = 1.15
"""Ratio of the contrasts that counts as different exposures of the two cameras. With equal ones,
what only one of them sees makes it at most 1.09 on KITTI, Karlsruhe and EuRoC."""
MAX_GAIN = 8.0
"""At a larger ratio, one of the two images is practically black or white."""


def with_contrast_of(template: Pyramid, image: Pyramid, *, least_gain: float = MIN_GAIN) -> Pyramid:
    """Return the template with mean and contrast of the image.

    It is returned unchanged if it is empty, or if the ratio of the contrasts is not between
    ``least_gain`` and MAX_GAIN.

    Args:
        template: pyramid of the image that is adapted.
        image: pyramid of the image that it is adapted to.
        least_gain: ratio of the contrasts, above 1, that counts as another exposure.
    """
    if not template:
        return template
    # Mean and spread of an affine map g I + o of the grey levels are g μ + o and g σ.
    mean, contrast = _mean_and_contrast(image)
    template_mean, template_contrast = _mean_and_contrast(template)
    gain = contrast / template_contrast if template_contrast > 0.0 else 1.0
    if not least_gain < symmetric_gain(gain) < MAX_GAIN:
        return template
    offset = mean - gain * template_mean
    return tuple(
        np.asarray(cv2.addWeighted(level, gain, level, 0.0, offset), dtype=np.uint8)
        for level in template
    )


def symmetric_gain(gain: float) -> float:
    """Return the larger one of a gain and its inverse."""
    return max(gain, 1.0 / max(gain, 1e-9))


def contrast_ratio(template: Pyramid, image: Pyramid) -> float:
    """Return the contrast of the image over that of the template; NaN if that has none."""
    _, contrast = _mean_and_contrast(image)
    _, template_contrast = _mean_and_contrast(template)
    return contrast / template_contrast if template_contrast > 0.0 else math.nan


def _mean_and_contrast(pyramid: Pyramid) -> tuple[float, float]:
    """Return mean and standard deviation of the grey levels of the coarsest level."""
    mean, deviation = cv2.meanStdDev(pyramid[-1])
    return float(mean[0, 0]), float(deviation[0, 0])

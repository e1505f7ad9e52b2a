"""Cubic B-splines through the pixels of an image, for windows that lie between whole pixels.

Bilinear interpolation moves fine texture. Of a wave of 4 px, what is 0.2 px from a pixel appears
0.16 px from it, so that an alignment ends 0.04 px too far, and all features that have moved by the
same fraction of a pixel err alike. That is what a camera near rest shows, and disparities of like
fractions. A cubic B-spline moves the same wave by a seventh of that.

The coefficients are those whose spline goes through all pixels. The filter that gives them is
recursive (Unser, "Splines: a perfect fit for signal and image processing", IEEE Signal Processing
Magazine 1999), but its response falls by z = √3 − 2 from pixel to pixel, so that a few taps do. The
pixels themselves as coefficients would blur the image by (1, 4, 1) / 6, in pixels of each image: a
patch that has grown since it was cut would be compared with one that is blurred less.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from probevo.arrays import Image
from probevo.sequences.prepared_images import NONE_SATURATED, SplineImage

REACH_PX = 4
"""From here on, taps would be below 0.003."""
RESPONSE = (math.sqrt(3.0) - 2.0) ** np.abs(np.arange(-REACH_PX, REACH_PX + 1))
TAPS = (RESPONSE / RESPONSE.sum()).astype(np.float32)


def spline_through(image: Image, saturated: Image = NONE_SATURATED) -> SplineImage:
    """Return an image with the spline through its pixels.

    Args:
        image: [height, width], uint8.
        saturated: 1 where a pixel is saturated, else 0, [height, width], uint8; empty if none is.
    """
    return SplineImage(
        pixels=image,
        coefficients=np.asarray(cv2.sepFilter2D(image, cv2.CV_32F, TAPS, TAPS)),
        saturated=saturated,
    )

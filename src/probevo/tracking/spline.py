"""Cubic B-splines through the pixels of an image, for windows that lie between whole pixels.

Bilinear interpolation moves fine texture. Of a wave of 4 px, what is 0.2 px from a pixel appears
0.16 px from it, so that an alignment ends 0.04 px too far, and all features that have moved by the
same fraction of a pixel err alike. That is what a camera near rest shows, and disparities of like
fractions. A cubic B-spline moves the same wave by a seventh of that.

A B-spline blurs: at whole pixels it is the mean of the coefficients with the weights (1, 4, 1) / 6.
Coefficients whose spline goes through all pixels need a recursive filter over the image (Unser,
"Splines: a perfect fit for signal and image processing", IEEE Signal Processing Magazine 1999).
Three taps undo most of it. The blur that is left is common to a patch and to the image that it is
aligned with, since both are taken from splines.
"""

from __future__ import annotations

import cv2
import numpy as np

from probevo.arrays import FloatArray, Image

SHARPEN = np.array([-1.0, 8.0, -1.0]) / 6.0
"""Inverse of (1, 4, 1) / 6 up to the second order: waves of 4 px keep 0.89 of their contrast, those
of 8 px 0.99."""


def spline_coefficients(image: Image) -> FloatArray:
    """Return the coefficients of the B-spline of an image.

    Args:
        image: [height, width], uint8.

    Returns:
        [height, width], float32, grey levels.
    """
    return np.asarray(cv2.sepFilter2D(image, cv2.CV_32F, SHARPEN, SHARPEN))

"""Smooth errors over the image that the calibration of a rig has left, estimated online.

A lens has its own distortion, which a model of few coefficients fits to a few tenths of a pixel.
What is left is the same in every frame and alike for neighbouring features, so it does not average
out. On KITTI, errors of features in neighbouring places are correlated by 0.04 to 0.2, in one frame
and hardly less in frames ten apart; on rendered images, whose camera is exact, not at all.

The errors are three fields over the left image:

- c_u and c_v, px: how far both views of a point have to be moved, to the right and downwards;
- c_d, px: by how much the true disparity is larger than the measured one.

Each is a sum of products of Legendre polynomials, c = Σ c_ij P_i(x) P_j(y), with x and y from −1 to
1 across the image. Left out are modes that other estimates have, or that would absorb something
else:

- of c_u and c_v those of degree one and less, which are a shift, a rotation and another focal
  length;
- of c_d the parabola b₀ + b₁ x + b₂ x² (``camera.rig_calibration``), and all that depend on y. Rows
  go with depth, since the ground is near at the bottom, and noise in the disparity mimics an error
  that goes with depth, as it mimics b₀. With them the window drifts by 0.50 instead of 0.15 % on
  rendered streets with noise.

The coefficients are estimated together with b₁ and b₂ (``camera.image_errors``), from how well
features agree on one motion (``estimation.rig_update``).
"""

from __future__ import annotations

import math

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.distortion_field_numba import (
    MODE_COLUMNS,
    MODE_ROWS,
    ImagePlane,
    fill_modes,
)
from probevo.camera.stereo import StereoCamera

_I, _J = np.divmod(np.arange(MODE_COLUMNS * MODE_ROWS), MODE_ROWS)
DISPLACEMENT_MODES = np.flatnonzero(_I + _J > 1)
"""Modes of c_u and c_v, of all products P_i(x) P_j(y), counted row by row: i MODE_ROWS + j."""
DISPARITY_MODES = np.flatnonzero((_I > 2) & (_J == 0))
"""Modes of c_d."""
NUM_COEFFICIENTS = 2 * len(DISPLACEMENT_MODES) + len(DISPARITY_MODES)
"""Coefficients of c_u, c_v and c_d, in this order."""


def image_plane(camera: StereoCamera) -> ImagePlane:
    """Return the extent of a camera's images, from the first pixel to the last."""
    width_px, height_px = camera.extent_px
    return ImagePlane(width=max(width_px - 1.0, 1.0), height=max(height_px - 1.0, 1.0))


def modes_at(pixels: FloatArray, camera: StereoCamera) -> FloatArray:
    """Return P_i(x) P_j(y) at the left observations of N features, [N, MODE_COLUMNS MODE_ROWS]."""
    modes = np.empty((len(pixels), MODE_COLUMNS * MODE_ROWS))
    fill_modes(np.array(pixels, np.float64, order="C"), image_plane(camera), modes)
    return modes


def root_mean_square_px(coefficients: FloatArray) -> tuple[float, float]:
    """Return the root mean square over the image, px, of (c_u, c_v) and of c_d.

    Args:
        coefficients: of c_u, c_v and c_d, [NUM_COEFFICIENTS], px.
    """
    # The mean square of P_i(x) P_j(y) over the image is 1/((2i + 1)(2j + 1)).
    mean_square = 1.0 / ((2.0 * _I + 1.0) * (2.0 * _J + 1.0))
    weights = np.concatenate([mean_square[DISPLACEMENT_MODES]] * 2)
    displacement_px2 = weights @ coefficients[: len(weights)] ** 2
    disparity_px2 = mean_square[DISPARITY_MODES] @ coefficients[len(weights) :] ** 2
    return math.sqrt(displacement_px2), math.sqrt(disparity_px2)

"""Compiled loops of the rig's calibration: each is one pass over the stereo matches of a frame."""

from __future__ import annotations

from typing import NamedTuple

from probevo.arrays import FloatArray
from probevo.camera.transfer_numba import Intrinsics
from probevo.compiled import compiled

ROLL = 1
"""Index of the rows' coefficient that a roll of the right image makes."""
RADIAL = 6
"""Index of the rows' coefficient that a difference of the lenses' radial distortion makes."""


class RowOffsetNoise(NamedTuple):
    """The Student-t noise of row offsets around their model."""

    sigma_px: float
    """Scale."""
    dof: float
    """Degrees of freedom ν."""
    correlated: float
    """How many offsets count as one."""


@compiled
def add_row_equations(
    basis: FloatArray,
    offsets: FloatArray,
    coefficients: FloatArray,
    *,
    noise: RowOffsetNoise,
    information: FloatArray,
    gradient: FloatArray,
) -> None:
    """Add the normal equations of N row offsets, each under a Student-t around the coefficients.

    Args:
        basis: what the K coefficients multiply at each, [N, K].
        offsets: v_r − v_l of each, [N], px.
        coefficients: those at which the weights are taken, [K].
        noise: of the offsets.
        information: Σ w B Bᵀ is added to it, [K, K], px⁻².
        gradient: Σ w B (v_r − v_l) is added to it, [K], px⁻¹.
    """
    # Neighbours err alike: as many as ``correlated`` of them weigh as much as one.
    count = len(coefficients)
    variance = noise.sigma_px**2 * noise.correlated
    for n in range(len(offsets)):
        predicted = 0.0
        for i in range(count):
            predicted += basis[n, i] * coefficients[i]
        squared = ((offsets[n] - predicted) / noise.sigma_px) ** 2
        # IRLS weight of a Student-t in one dimension: (ν + 1)/(ν + s), over the variance.
        weight = (noise.dof + 1.0) / (noise.dof + squared) / variance
        for i in range(count):
            weighted = weight * basis[n, i]
            gradient[i] += weighted * offsets[n]
            for j in range(count):
                information[i, j] += weighted * basis[n, j]


@compiled
def fill_row_basis(pixels: FloatArray, camera: Intrinsics, basis: FloatArray) -> None:
    """Fill (1, x_r, y, x², xy, y², y r²) at N features, [N, 4] to [N, 7], with r² = x_r² + y²; x_r
    is that of the right image, and x and y are those of the left one."""
    for n in range(len(pixels)):
        x = (pixels[n, 0] - camera.cu) / camera.fu
        y = (pixels[n, 1] - camera.cv) / camera.fv
        x_right = (pixels[n, 2] - camera.cu) / camera.fu
        basis[n, 0] = 1.0
        basis[n, 1] = x_right
        basis[n, 2] = y
        basis[n, 3] = x * x
        basis[n, 4] = x * y
        basis[n, 5] = y * y
        basis[n, 6] = y * (x_right * x_right + y * y)


@compiled
def correct_observations(
    pixels: FloatArray, camera: Intrinsics, rows: FloatArray, disparity: FloatArray
) -> None:
    """Take the errors of the rig out of N observations, [N, 4], px, in place.

    Args:
        pixels: the observations.
        camera: the intrinsics.
        rows: a₀ … a₆, [7], px.
        disparity: b₁ and b₂, [2], px.
    """
    # Coefficients of the rows are in px of v: the same angle is f_u/f_v times as many of u.
    aspect = camera.fu / camera.fv
    for n in range(len(pixels)):
        x = (pixels[n, 0] - camera.cu) / camera.fu
        y = (pixels[n, 1] - camera.cv) / camera.fv
        x_right = (pixels[n, 2] - camera.cu) / camera.fu
        squared = x_right * x_right + y * y
        row_offset = (
            rows[0]
            + rows[1] * x_right
            + rows[2] * y
            + rows[3] * x * x
            + rows[4] * x * y
            + rows[5] * y * y
            + rows[6] * y * squared
        )
        # A roll, and another distortion than that of the left lens, move u_r, too.
        pixels[n, 2] += aspect * (rows[ROLL] * y - rows[RADIAL] * x_right * squared)
        # The true disparity d = u_l − u_r is larger by b₁ x + b₂ x².
        pixels[n, 2] -= disparity[0] * x + disparity[1] * x * x
        # The left image is taken for true, so that v_l stays.
        pixels[n, 3] -= row_offset

"""Compiled inner loops: cutting windows out of an image, and fitting them into another one by
affine maps.

The pixels of a window stand in one row. Indices are unsigned where speed matters: Numba allows for
negative ones otherwise.
"""

from __future__ import annotations

import numpy as np

from probevo.arrays import AnyArray, FloatArray, Image, IntArray
from probevo.compiled import compiled, copy_into, factor, substitute

BRIGHTNESS_NOISE = 4.0
"""Standard deviation of a pixel's brightness between two views of the same thing, grey levels."""
MAX_ITERATIONS = 8
MAX_STEP_PX = 0.05
"""A fit is done when its step is shorter; without having got there, it has failed."""
MAX_MOVE_PX = 2.0
"""What is further than this from where it was thought to be is something else."""


@compiled
def cut_windows(image: Image, center: IntArray, windows: AnyArray) -> None:
    """windows[n] = the image around center[n] = (u, v), [N, side, side], continued at the border by
    its last pixels."""
    height, width = image.shape
    reach = windows.shape[1] // 2
    for n in range(len(center)):
        for i in range(windows.shape[1]):
            row = min(max(center[n, 1] + i - reach, 0), height - 1)
            for j in range(windows.shape[2]):
                windows[n, i, j] = image[row, min(max(center[n, 0] + j - reach, 0), width - 1)]


@compiled
def apply(maps: FloatArray, affine: FloatArray, product: FloatArray) -> None:
    """product[n] = maps[n] affine[n], all [N, 2, 2]; NumPy takes thirty times as long."""
    for n in range(len(product)):
        for i in range(2):
            for j in range(2):
                product[n, i, j] = maps[n, i, 0] * affine[n, 0, j] + maps[n, i, 1] * affine[n, 1, j]


@compiled
def undo(product: FloatArray, affine: FloatArray, difference: FloatArray, maps: FloatArray) -> None:
    """maps[n] = product[n] affine[n]⁻¹, all [N, 2, 2], where the difference, [N], is finite;
    elsewhere they stay."""
    for n in range(len(maps)):
        if not difference[n] < np.inf:
            continue
        a = affine[n, 0, 0]
        b = affine[n, 0, 1]
        c = affine[n, 1, 0]
        d = affine[n, 1, 1]
        one = 1.0 / (a * d - b * c)
        for i in range(2):
            p = product[n, i, 0]
            q = product[n, i, 1]
            maps[n, i, 0] = (p * d - q * c) * one
            maps[n, i, 1] = (q * a - p * b) * one


@compiled
def fit(
    image: Image,
    windows: AnyArray,
    offset: FloatArray,
    expected: FloatArray,
    spread: float,
    pixels: FloatArray,
    affine: FloatArray,
    difference: FloatArray,
) -> None:
    """Fit windows into an image by affine maps near the expected ones: inverse compositional
    Gauss–Newton.

    A map takes x, px from the feature, to p + A x. Minimized is the sum over the window of
    (image(p + A x) − window(x))² / BRIGHTNESS_NOISE², plus ‖Â⁻¹ A − I‖² / spread² for the expected
    Â (Baker, Matthews: Lucas–Kanade 20 years on, IJCV 2004).

    Args:
        image: [height, width], uint8.
        windows: [N, side + 2, side + 2], uint8; the margin is for gradients.
        offset: of the feature from the middle of its window, [N, 2], px.
        expected: Â, [N, 2, 2].
        spread: how far from it A may be.
        pixels: about where the features are, [N, 2], px; out: p, where fitted.
        affine: out: A, [N, 2, 2]; Â where not fitted.
        difference: out: mean absolute difference of image and window, [N], grey levels; infinite
            where not fitted.
    """
    brightness = image.ravel()
    area = (windows.shape[1] - 2) * (windows.shape[2] - 2)
    place = np.empty((2, area), np.float32)
    descent = np.empty((6, area), np.float32)
    window = np.empty(area, np.float32)
    error = np.empty(area, np.float32)
    corner = np.empty(area, np.int32)
    part = np.empty((2, area), np.float32)
    information = np.empty((6, 6))
    lower = np.empty((6, 6))
    slope = np.empty(6)
    step = np.empty(6)
    A = np.empty((2, 2))
    prior = (BRIGHTNESS_NOISE / spread) ** 2
    for n in range(len(windows)):
        copy_into(affine[n], expected[n])
        copy_into(A, expected[n])
        u = pixels[n, 0]
        v = pixels[n, 1]
        difference[n] = np.inf
        _linearize(
            windows[n], offset[n], place, window=window, descent=descent, information=information
        )
        for k in range(2, 6):
            information[k, k] += prior
        if not factor(information, 6, lower):
            continue
        for _ in range(MAX_ITERATIONS):
            near = abs(u - pixels[n, 0]) < MAX_MOVE_PX and abs(v - pixels[n, 1]) < MAX_MOVE_PX
            if not (
                near and _locate(u, v, A, place=place, shape=image.shape, corner=corner, part=part)
            ):
                break
            _compare(brightness, image.shape[1], corner, part=part, window=window, error=error)
            for k in range(6):
                total = np.float32(0.0)
                for i in range(area):
                    total += descent[k, i] * error[i]
                slope[k] = total
            _add_prior(prior, A, expected[n], slope=slope)
            substitute(lower, slope, step)
            if not _take_back(step, A):
                break
            u -= A[0, 0] * step[0] + A[0, 1] * step[1]
            v -= A[1, 0] * step[0] + A[1, 1] * step[1]
            if step[0] * step[0] + step[1] * step[1] < MAX_STEP_PX * MAX_STEP_PX:
                difference[n] = np.abs(error).mean()
                pixels[n, 0] = u
                pixels[n, 1] = v
                copy_into(affine[n], A)
                break


@compiled
def _linearize(
    cut_out: AnyArray,
    offset: FloatArray,
    place: FloatArray,
    window: FloatArray,
    descent: FloatArray,
    information: FloatArray,
) -> None:
    """Of one window less its margin: x, [2, area], brightness, [area], and that by the six
    parameters of a small affine map (t, S) to x → t + (I + S) x, [6, area], with their inner
    products, [6, 6]."""
    brightness = cut_out.ravel()
    width = np.uintp(cut_out.shape[1])
    side = np.uintp(cut_out.shape[1] - 2)
    one = np.uintp(1)
    first = np.float32(cut_out.shape[1] // 2 - 1)
    u = first + np.float32(offset[0])
    v = first + np.float32(offset[1])
    for row in range(side):
        for column in range(side):
            k = row * side + column
            at = (row + one) * width + column + one
            window[k] = np.float32(brightness[at])
            place[0, k] = np.float32(column) - u
            place[1, k] = np.float32(row) - v
            descent[0, k] = np.float32(0.5) * (
                np.float32(brightness[at + one]) - np.float32(brightness[at - one])
            )
            descent[1, k] = np.float32(0.5) * (
                np.float32(brightness[at + width]) - np.float32(brightness[at - width])
            )
    for i in range(len(window)):
        along = descent[0, i]
        down = descent[1, i]
        x = place[0, i]
        y = place[1, i]
        descent[2, i] = along * x
        descent[3, i] = along * y
        descent[4, i] = down * x
        descent[5, i] = down * y
    for m in range(6):
        for n in range(m + 1):
            total = np.float32(0.0)
            for i in range(len(window)):
                total += descent[m, i] * descent[n, i]
            information[m, n] = information[n, m] = total


@compiled
def _locate(
    u: float,
    v: float,
    A: FloatArray,
    place: FloatArray,
    shape: tuple[int, int],
    corner: IntArray,
    part: FloatArray,
) -> bool:
    """Where p + A x is: index of the pixel to its upper left, [area], and the rest, [2, area];
    False if outside."""
    height, width = shape
    x = abs(place[0, 0]) + 1.0
    y = abs(place[1, 0]) + 1.0  # of the window's corner, at most half a pixel less
    reach_u = abs(A[0, 0]) * x + abs(A[0, 1]) * y
    reach_v = abs(A[1, 0]) * x + abs(A[1, 1]) * y
    if not (u >= reach_u and v >= reach_v and u + reach_u < width - 1 and v + reach_v < height - 1):
        return False
    left = int(u - reach_u)
    top = int(v - reach_v)  # near, so that single precision will do
    a = np.float32(A[0, 0])
    b = np.float32(A[0, 1])
    c = np.float32(A[1, 0])
    d = np.float32(A[1, 1])
    u_ = np.float32(u - left)
    v_ = np.float32(v - top)
    base = np.int32(top * width + left)
    for i in range(len(corner)):
        right = u_ + a * place[0, i] + b * place[1, i]
        down = v_ + c * place[0, i] + d * place[1, i]
        column = np.int32(right)
        row = np.int32(down)
        part[0, i] = right - np.float32(column)
        part[1, i] = down - np.float32(row)
        corner[i] = base + row * np.int32(width) + column
    return True


@compiled
def _compare(
    brightness: Image,
    width: int,
    corner: IntArray,
    part: FloatArray,
    window: FloatArray,
    error: FloatArray,
) -> None:
    """The image there, bilinear between its pixels, less the window, [area]."""
    one = np.uintp(1)
    below = np.uintp(width)
    for i in range(len(corner)):
        k = np.uintp(corner[i])
        upper = np.float32(brightness[k])
        upper_right = np.float32(brightness[k + one])
        lower = np.float32(brightness[k + below])
        lower_right = np.float32(brightness[k + below + one])
        upper += part[0, i] * (upper_right - upper)
        lower += part[0, i] * (lower_right - lower)
        error[i] = upper + part[1, i] * (lower - upper) - window[i]


@compiled
def _add_prior(prior: float, A: FloatArray, expected: FloatArray, slope: FloatArray) -> None:
    """Of ½ prior ‖Â⁻¹ A − I‖² by S, added to the slope's last four."""
    a = expected[0, 0]
    b = expected[0, 1]
    c = expected[1, 0]
    d = expected[1, 1]
    weight = prior / (a * d - b * c)
    slope[2] += weight * (d * A[0, 0] - b * A[1, 0]) - prior
    slope[3] += weight * (d * A[0, 1] - b * A[1, 1])
    slope[4] += weight * (a * A[1, 0] - c * A[0, 0])
    slope[5] += weight * (a * A[1, 1] - c * A[0, 1]) - prior


@compiled
def _take_back(step: FloatArray, A: FloatArray) -> bool:
    """A ← A (I + S)⁻¹, for step = (t, S); False if the step is too wild to be one."""
    determinant = (1.0 + step[2]) * (1.0 + step[5]) - step[3] * step[4]
    if not determinant > 0.25:
        return False
    for i in range(2):
        a = A[i, 0] / determinant
        b = A[i, 1] / determinant
        A[i, 0] = a * (1.0 + step[5]) - b * step[4]
        A[i, 1] = b * (1.0 + step[2]) - a * step[3]
    return True

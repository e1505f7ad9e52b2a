"""Compiled loops of anchor patches: cutting them out of an image, and aligning them with another.

The alignment is an inverse-compositional Gauss–Newton over affine maps (Baker, Matthews,
"Lucas–Kanade 20 years on: a unifying framework", IJCV 2004), under a perspective that is given. The
image may be brighter than the patch and have more contrast: gain and offset are projected out
(Baker, Gross, Matthews, "Lucas–Kanade 20 years on: part 3", CMU-RI-TR-03-35, 2003). Pixels that are
saturated in either do not count: their brightness does not change with the exposure, so that the
edges beside them would seem to move. The pixels of a patch are held in one row. Between its pixels,
the image is a cubic B-spline (``spline``). Indices are unsigned where speed matters: for signed
ones, Numba handles negative values.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from probevo.arrays import AnyArray, BoolArray, FloatArray, Image, IntArray
from probevo.compiled import (
    compiled,
    copy_into,
    dot_float32,
    factor,
    inner_products_float32,
    multiply_float32,
    substitute,
    sum_float32,
    sum_magnitudes_float32,
)

BRIGHTNESS_NOISE = 4.0
"""Standard deviation of a pixel's brightness between two views of the same point, grey levels."""
MAX_ITERATIONS = 16
MAX_STEP_PX = 0.05
"""The alignment has converged when its step moves no corner of the patch farther; if it never does,
it has failed."""
MIN_STEP_SCALE = 0.5
MAX_STEP_SCALE = 2.0
"""Bounds of the factor of a Gauss–Newton step. Steps are shortened if they oscillate, and
lengthened if the image has less contrast than the patch, when successive steps have the same
direction."""
MIN_STEP_DETERMINANT = 0.25
"""Smallest determinant of I + S of one step: the patch is not linear in a larger
change."""
MAX_MOVE_PX = 2.0
"""The alignment has failed when it moves farther than this from the predicted place."""
NUM_ADJUSTED = 8
"""Parameters that are adjusted to the pixels of a patch: affine map, gain and offset."""
MIN_SHARE = 0.25
"""Share of the pixels of a patch that must count, or the alignment fails."""
MAX_FORESHORTENING = 0.5
"""If the scale of a slanted surface changes by more than this from the centre of its patch to the
border, the surface is treated as if it faced the camera."""


class Anchors(NamedTuple):
    """Anchor patches of N features, and the prediction of their maps."""

    patch: AnyArray
    """[N, side + 2, side + 2], uint8; the margin of one pixel is for gradients."""
    saturated: AnyArray
    """1 where a pixel of the patch is saturated, else 0, [N, side, side], uint8."""
    offset_px: FloatArray
    """Offset of the feature from the middle of its patch, [N, 2], px."""
    predicted_affine: FloatArray
    """Predicted affine map Â of the patch to the image, [N, 2, 2]."""
    perspective: FloatArray
    """Perspective g of the patch in the image, [N, 2], 1/px."""


class PatchAlignment(NamedTuple):
    """Place and map of N features in an image: output of ``align_patches``."""

    pixels: FloatArray
    """Features p = (u, v), [N, 2], px; on input, and where the alignment fails, as predicted."""
    affine: FloatArray
    """Affine map A of the patch to the image, [N, 2, 2]; Â where the alignment fails."""
    difference: FloatArray
    """Mean absolute difference of image and patch, [N], grey levels; ∞ where it fails."""
    cov_px2: FloatArray
    """Covariance of p by the scatter of the brightness, see ``_fill_covariance``, [N, 2, 2], px²;
    ∞ where image and patch have nothing in common, NaN where the alignment fails."""


class Template(NamedTuple):
    """One patch without its margin, linearized by the six parameters (t, S) of a small map.

    The small map takes x to t + (I + S) x.
    """

    position: FloatArray
    """x of each pixel, from the feature, [2, area], px."""
    foreshortened: FloatArray
    """x / (1 + g·x) of each pixel, [2, area], px."""
    brightness: FloatArray
    """Grey level of each pixel, [area]."""
    steepest_descent: FloatArray
    """Derivatives of the brightness by (t, S), [6, area], with gain and offset projected out."""
    contrast: FloatArray
    """Brightness minus its mean, normalised to length 1, [area]; 0 for a uniform patch."""
    left_out: BoolArray
    """Whether a pixel does not count, [area]; derivatives and contrast are 0 there."""


class WarpedPixels(NamedTuple):
    """Positions of the pixels of a patch in the image."""

    corner: IntArray
    """Index, in the flat image, of the whole pixel to the upper left, [area], int32."""
    weights: FloatArray
    """Weights of the spline's four columns and four rows around each, by its offset from that whole
    pixel, [8, area]."""


@compiled
def cut_patches(image: Image, center: IntArray, patches: AnyArray) -> None:
    """Copy the image around center[n] = (u, v) into patches[n], [N, side, side].

    Beyond the border of the image its last pixels are repeated.
    """
    height, width = image.shape
    side = patches.shape[1]
    reach = side // 2
    for n in range(len(center)):
        left = center[n, 0] - reach
        top = center[n, 1] - reach
        if left >= 0 and top >= 0 and left + side <= width and top + side <= height:
            # Inside of the image, where nearly all patches are, no index needs clamping.
            for i in range(side):
                for j in range(side):
                    patches[n, i, j] = image[top + i, left + j]
            continue
        for i in range(side):
            row = min(max(top + i, 0), height - 1)
            for j in range(side):
                patches[n, i, j] = image[row, min(max(left + j, 0), width - 1)]


@compiled
def multiply_maps(outer: FloatArray, inner: FloatArray, product: FloatArray) -> None:
    """Set product[n] = outer[n] inner[n], all [N, 2, 2]; NumPy takes thirty times as long."""
    for n in range(len(product)):
        for i in range(2):
            for j in range(2):
                product[n, i, j] = outer[n, i, 0] * inner[n, 0, j] + outer[n, i, 1] * inner[n, 1, j]


@compiled
def compose_perspectives(
    outer: FloatArray, affine: FloatArray, inner: FloatArray, composed: FloatArray
) -> None:
    """Set composed[n] = inner[n] + affine[n]ᵀ outer[n], all [N, 2] but the affine maps, [N, 2, 2].

    That is the perspective of a map with the affine part ``affine`` and the perspective ``inner``,
    followed by one with the perspective ``outer``.
    """
    for n in range(len(composed)):
        for j in range(2):
            carried = affine[n, 0, j] * outer[n, 0] + affine[n, 1, j] * outer[n, 1]
            composed[n, j] = inner[n, j] + carried


@compiled
def divide_maps(
    product: FloatArray, inner: FloatArray, difference: FloatArray, outer: FloatArray
) -> None:
    """Set outer[n] = product[n] inner[n]⁻¹, all [N, 2, 2], where the difference, [N], is finite."""
    for n in range(len(outer)):
        if not difference[n] < np.inf:
            continue
        a = inner[n, 0, 0]
        b = inner[n, 0, 1]
        c = inner[n, 1, 0]
        d = inner[n, 1, 1]
        # inner⁻¹ = [[d, −b], [−c, a]] / det
        inverse_determinant = 1.0 / (a * d - b * c)
        for i in range(2):
            p = product[n, i, 0]
            q = product[n, i, 1]
            outer[n, i, 0] = (p * d - q * c) * inverse_determinant
            outer[n, i, 1] = (q * a - p * b) * inverse_determinant


@compiled
def align_patches(
    coefficients: FloatArray,
    saturated: Image,
    anchors: Anchors,
    sigma: float,
    alignment: PatchAlignment,
) -> None:
    """Align patches with an image by inverse-compositional Gauss–Newton over affine maps.

    A map takes x, px from the feature, to y = p + A x / (1 + g·x). Each step finds the small map W,
    W(x) = t + (I + S) x, of the patch that fits the image best, and then maps W⁻¹(x) instead of x;
    g is held. The cost is the sum over the patch of (image(y) − patch(x))² / BRIGHTNESS_NOISE²,
    with the best gain and offset of the patch, plus the prior ‖Â⁻¹ A − I‖² / sigma². Pixels that
    are saturated in the patch, or in the image at the predicted place, do not count.

    Args:
        coefficients: of the image's spline, [height, width], float32.
        saturated: 1 where a pixel of the image is saturated, else 0, [height, width], uint8; empty
            if none is.
        anchors: patches of N features with their predicted maps Â.
        sigma: standard deviation of the entries of Â⁻¹ A.
        alignment: in: predicted places; out: places, maps and differences.
    """
    pixels = alignment.pixels
    affine = alignment.affine
    flat_coefficients = coefficients.ravel()
    area = (anchors.patch.shape[1] - 2) * (anchors.patch.shape[2] - 2)
    # Work space, filled anew for each patch.
    template = Template(
        np.empty((2, area), np.float32),
        np.empty((2, area), np.float32),
        np.empty(area, np.float32),
        np.empty((6, area), np.float32),
        np.empty(area, np.float32),
        np.empty(area, np.bool_),
    )
    warped = WarpedPixels(np.empty(area, np.int32), np.empty((8, area), np.float32))
    error = np.empty(area, np.float32)
    information = np.empty((6, 6))
    lower = np.empty((6, 6))
    gradient = np.empty(6)
    step = np.empty(6)
    last_step = np.empty(6)
    A = np.empty((2, 2))
    # Everything is in units of BRIGHTNESS_NOISE: the cost is multiplied by its square, so that the
    # derivatives of the patch enter as grey levels.
    prior = (BRIGHTNESS_NOISE / sigma) ** 2
    fewest = max(MIN_SHARE * area, NUM_ADJUSTED + 1)  # one more shows how well it matches
    corner_px = 0.5 * (anchors.patch.shape[1] - 2)  # half the side, without the margin
    for n in range(len(anchors.patch)):
        predicted = anchors.predicted_affine[n]
        copy_into(affine[n], predicted)
        copy_into(A, predicted)
        u = pixels[n, 0]
        v = pixels[n, 1]
        # The patch counts as failed until its alignment converges.
        alignment.difference[n] = np.inf
        alignment.cov_px2[n] = np.nan
        # Where its pixels are expected in the image
        _set_positions(anchors.patch[n], anchors.offset_px[n], template.position)
        reach_px = _foreshorten(anchors.perspective[n], template)
        if not _warp(
            (u, v), A, template.foreshortened, reach_px, shape=coefficients.shape, warped=warped
        ):
            continue
        num_counted = _leave_out_saturated(
            anchors.saturated[n], saturated, warped, template.left_out
        )
        if num_counted < fewest:
            continue
        # Linearize the patch instead of the image: the information matrix is then constant, and is
        # factorised once for all iterations.
        _linearize(anchors.patch[n], num_counted, template, information=information)
        # The prior is on the shape S only: the translation t is what the alignment is for.
        for k in range(2, 6):
            information[k, k] += prior
        if not factor(information, 6, lower):
            continue
        scale = 1.0
        for iteration in range(MAX_ITERATIONS):
            if iteration > 0:
                near = abs(u - pixels[n, 0]) < MAX_MOVE_PX and abs(v - pixels[n, 1]) < MAX_MOVE_PX
                if not near or not _warp(
                    (u, v),
                    A,
                    template.foreshortened,
                    reach_px,
                    shape=coefficients.shape,
                    warped=warped,
                ):
                    break
            # Solve the normal equations for the step (t, S)
            _subtract(
                flat_coefficients, coefficients.shape[1], warped, template.brightness, error=error
            )
            multiply_float32(template.steepest_descent, error, gradient)
            _add_prior(prior, A, predicted, gradient=gradient)
            substitute(lower, gradient, step)
            if iteration > 0:
                scale = step_scale(scale, step, last_step, corner_px)
            for k in range(6):
                last_step[k] = step[k]
                step[k] *= scale
            # Inverse-compositional: W⁻¹(x) = (I + S)⁻¹ (x − t), so that A ← A (I + S)⁻¹, and p
            # moves by −A t of the new A.
            if not _compose_inverse(A, step):
                break
            u -= A[0, 0] * step[0] + A[0, 1] * step[1]
            v -= A[1, 0] * step[0] + A[1, 1] * step[1]
            # The error is that before the last step, which is too small to change it much.
            if _corner_motion_px(step, corner_px) < MAX_STEP_PX:
                if num_counted < area:
                    _clear(error, template.left_out)
                alignment.difference[n] = sum_magnitudes_float32(error) / num_counted
                pixels[n, 0] = u
                pixels[n, 1] = v
                copy_into(affine[n], A)
                variance = brightness_variance(
                    template.brightness, template.contrast, error, num_counted
                )
                _fill_covariance(lower, A, variance, cov_px2=alignment.cov_px2[n])
                break


@compiled
def _set_positions(patch: AnyArray, offset_px: FloatArray, position: FloatArray) -> None:
    """Set the positions of a patch's pixels without its margin, from the feature, [2, area], px."""
    side = np.uintp(patch.shape[1] - 2)
    # The middle of the patch without its margin is the whole pixel nearest to the feature.
    first = np.float32(patch.shape[1] // 2 - 1)
    u = first + np.float32(offset_px[0])
    v = first + np.float32(offset_px[1])
    for row in range(side):
        for column in range(side):
            k = row * side + column
            position[0, k] = np.float32(column) - u
            position[1, k] = np.float32(row) - v


@compiled
def _leave_out_saturated(
    patch_saturated: AnyArray, image_saturated: Image, warped: WarpedPixels, left_out: BoolArray
) -> int:
    """Leave out the pixels that are saturated in a patch or in the image, and return how many
    count.

    Args:
        patch_saturated: 1 where a pixel of the patch is saturated, [side, side].
        image_saturated: the same for the image, [height, width]; empty if none is.
        warped: where the pixels of the patch are in the image, between four of its pixels.
        left_out: out, [area].
    """
    flat_patch = patch_saturated.ravel()
    flat_image = image_saturated.ravel()
    width = image_saturated.shape[1]
    num_counted = len(flat_patch)
    for i in range(len(flat_patch)):
        is_saturated = flat_patch[i] != 0
        if len(flat_image) > 0:
            upper = warped.corner[i]
            lower = upper + width
            is_saturated |= (flat_image[upper] | flat_image[upper + 1]) != 0
            is_saturated |= (flat_image[lower] | flat_image[lower + 1]) != 0
        left_out[i] = is_saturated
        if is_saturated:
            num_counted -= 1
    return num_counted


@compiled
def _clear(values: FloatArray, left_out: BoolArray) -> None:
    """Set values to 0 where a pixel does not count, both [area]."""
    for i in range(len(values)):
        if left_out[i]:
            values[i] = np.float32(0.0)


@compiled
def _linearize(
    patch: AnyArray, num_counted: int, template: Template, information: FloatArray
) -> None:
    """Fill the derivatives of one patch, and their inner products, [6, 6].

    Args:
        patch: with its margin, [side + 2, side + 2].
        num_counted: number of pixels that count.
        template: with positions, and the pixels that are left out.
        information: out.
    """
    position = template.position
    window = template.brightness
    descent = template.steepest_descent
    brightness = patch.ravel()
    width = np.uintp(patch.shape[1])
    side = np.uintp(patch.shape[1] - 2)
    one = np.uintp(1)
    for row in range(side):
        for column in range(side):
            # k counts the pixels of the window, ``at`` those of the patch with its margin.
            k = row * side + column
            at = (row + one) * width + column + one
            window[k] = np.float32(brightness[at])
            # Central differences
            descent[0, k] = np.float32(0.5) * (
                np.float32(brightness[at + one]) - np.float32(brightness[at - one])
            )
            descent[1, k] = np.float32(0.5) * (
                np.float32(brightness[at + width]) - np.float32(brightness[at - width])
            )
    if num_counted < len(window):
        _clear(descent[0], template.left_out)
        _clear(descent[1], template.left_out)
    # Derivatives by S = [[s₀, s₁], [s₂, s₃]]: x times those by t
    for i in range(len(window)):
        along = descent[0, i]
        down = descent[1, i]
        x = position[0, i]
        y = position[1, i]
        descent[2, i] = along * x
        descent[3, i] = along * y
        descent[4, i] = down * x
        descent[5, i] = down * y
    _project_out_brightness(template, num_counted)
    # Gauss–Newton information of the patch, constant during the alignment
    inner_products_float32(descent, information)


@compiled
def _project_out_brightness(template: Template, num_counted: int) -> None:
    """Make the derivatives of a template orthogonal to its contrast and to a constant.

    An error that gain or offset explains, which is along these two, then moves no parameter.
    """
    contrast = template.contrast
    all_count = num_counted == len(contrast)
    copy_into(contrast, template.brightness)
    if not all_count:
        _clear(contrast, template.left_out)
    mean = np.float32(sum_float32(contrast) / num_counted)
    for i in range(len(contrast)):
        contrast[i] -= mean
    if not all_count:
        _clear(contrast, template.left_out)
    length = math.sqrt(dot_float32(contrast, contrast))
    to_unit_length = np.float32(1.0 / length) if length > 0.0 else np.float32(0.0)
    for i in range(len(contrast)):
        contrast[i] *= to_unit_length
    for m in range(6):
        derivative = template.steepest_descent[m]
        # Gram–Schmidt against a constant and the contrast, which are orthogonal to each other.
        offset = np.float32(sum_float32(derivative) / num_counted)
        gain = dot_float32(derivative, contrast)
        for i in range(len(contrast)):
            derivative[i] -= offset + gain * contrast[i]
        if not all_count:
            _clear(derivative, template.left_out)


@compiled
def step_scale(
    last_scale: float, step: FloatArray, last_step: FloatArray, corner_px: float
) -> float:
    """Return the factor of a Gauss–Newton step (t, S) that the change since the last one suggests.

    After a step s d, the next one is d' = d − s J d, where J is the ratio of the image's curvature
    to the patch's. Along d, s d·d / (d·d − d·d') is its inverse (Barzilai, Borwein, "Two-point step
    size gradient methods", IMA J. Numer. Anal. 1988).

    Args:
        last_scale: s.
        step: d', [6].
        last_step: d, [6].
        corner_px: distance at which S is compared with t, px.
    """
    area = corner_px * corner_px
    squared = 0.0
    product = 0.0
    # The metric: t, and S at the corner, both in px.
    for k in range(6):
        weight = 1.0 if k < 2 else area
        squared += weight * last_step[k] * last_step[k]
        product += weight * last_step[k] * step[k]
    # Near zero or negative where the next step is hardly shorter along d, or longer.
    change = squared - product
    if change * MAX_STEP_SCALE <= last_scale * squared:
        return MAX_STEP_SCALE
    return max(last_scale * squared / change, MIN_STEP_SCALE)


@compiled
def brightness_variance(
    brightness: FloatArray, contrast: FloatArray, error: FloatArray, num_counted: int
) -> float:
    """Return the variance of a patch's brightness by which it does not match the image.

    The image is I = a P + b + ε, with gain a and offset b of the patch P by regression. With the
    correlation r of image and patch, and the length c of P less its mean, ‖ε‖ / a is c √(1/r² − 1).
    In units of the patch, it does not depend on the exposure of the image.

    Args:
        brightness: P, [area], grey levels.
        contrast: P less its mean, of length 1, [area]; 0 where a pixel does not count.
        error: I − P, [area], grey levels; 0 where a pixel does not count.
        num_counted: number of pixels that count.

    Returns:
        ‖ε / a‖² by the degrees of freedom, those of gain, offset and affine map being lost, grey
        levels²; ∞ if there is no such gain, or it is not positive.
    """
    # The contrast has the mean 0 and the length 1, so that both parts of the regression are inner
    # products with it.
    length = float(dot_float32(brightness, contrast))
    along = float(dot_float32(error, contrast))
    offset = float(sum_float32(error)) / num_counted
    gain = (length + along) / length
    if not gain > 0.0:
        return np.inf
    squared = float(dot_float32(error, error)) - num_counted * offset**2 - along**2
    return max(squared, 0.0) / gain**2 / (num_counted - NUM_ADJUSTED)


@compiled
def _fill_covariance(
    lower: FloatArray, A: FloatArray, variance: float, cov_px2: FloatArray
) -> None:
    """Set the covariance of the place p, [2, 2], to that of a shift of the patch, mapped by A.

    With brightness of a variance that is independent from pixel to pixel, the parameters (t, S) of
    a small map have the covariance variance · H⁻¹, of which t is the first block, and p moves by
    A t (Nickels, Hutchinson, "Estimating uncertainty in SSD-based feature tracking", Image and
    Vision Computing 2002). Between pixels the spline takes a part of such noise away.

    Args:
        lower: Cholesky factor of H, the information about (t, S) for a variance of 1, [6, 6].
        A: [2, 2].
        variance: of the brightness, grey levels².
        cov_px2: out.
    """
    unit = np.zeros(6)
    column = np.empty(6)
    inverse = np.empty((2, 2))
    # The block of H⁻¹ that belongs to t: its first two columns solve H x = unit vector.
    for k in range(2):
        unit[k] = 1.0
        substitute(lower, unit, column)
        unit[k] = 0.0
        inverse[0, k] = column[0]
        inverse[1, k] = column[1]
    # variance · A (H⁻¹)ₜₜ Aᵀ
    for i in range(2):
        for j in range(2):
            total = 0.0
            for k in range(2):
                total += A[i, k] * (inverse[k, 0] * A[j, 0] + inverse[k, 1] * A[j, 1])
            cov_px2[i, j] = variance * total


@compiled
def _corner_motion_px(step: FloatArray, corner_px: float) -> float:
    """Return a bound of how far a step (t, S) moves the corners of a patch, px."""
    along = abs(step[0]) + corner_px * (abs(step[2]) + abs(step[3]))
    down = abs(step[1]) + corner_px * (abs(step[4]) + abs(step[5]))
    return math.hypot(along, down)


@compiled
def _foreshorten(perspective: FloatArray, template: Template) -> tuple[float, float]:
    """Fill x / (1 + g·x) of a template, and return bounds of its two coordinates, px.

    Where g·x might be beyond ±MAX_FORESHORTENING, g is taken for 0.
    """
    x = template.position
    foreshortened = template.foreshortened
    # The patch's corner is less than a pixel farther than its first pixel
    reach_u = abs(x[0, 0]) + 1.0
    reach_v = abs(x[1, 0]) + 1.0
    # No |g·x| in the patch exceeds this, so that no denominator is below 1 − most.
    most = abs(perspective[0]) * reach_u + abs(perspective[1]) * reach_v
    if not most < MAX_FORESHORTENING:
        copy_into(foreshortened, x)
        return reach_u, reach_v
    one = np.float32(1.0)
    g_u = np.float32(perspective[0])
    g_v = np.float32(perspective[1])
    for i in range(x.shape[1]):
        scale = one / (one + g_u * x[0, i] + g_v * x[1, i])
        foreshortened[0, i] = scale * x[0, i]
        foreshortened[1, i] = scale * x[1, i]
    return reach_u / (1.0 - most), reach_v / (1.0 - most)


@compiled
def _warp(
    center: tuple[float, float],
    A: FloatArray,
    position: FloatArray,
    reach_px: tuple[float, float],
    shape: tuple[int, int],
    warped: WarpedPixels,
) -> bool:
    """Find where p + A x is in the image for all x of a patch, foreshortened by the perspective;
    False if any may be outside.

    Args:
        center: p = (u, v), px.
        A: [2, 2].
        position: x, already divided by 1 + g·x, [2, area], px.
        reach_px: bounds of the coordinates of x.
        shape: (height, width) of the image.
        warped: out.
    """
    u, v = center
    height, width = shape
    corner = warped.corner
    weights = warped.weights
    # If the whole patch is inside, the loop below needs no check for each pixel. The spline needs
    # one more pixel on each side.
    x, y = reach_px
    reach_u = abs(A[0, 0]) * x + abs(A[0, 1]) * y + 1.0
    reach_v = abs(A[1, 0]) * x + abs(A[1, 1]) * y + 1.0
    if not (u >= reach_u and v >= reach_v and u + reach_u < width - 1 and v + reach_v < height - 1):
        return False
    # Relative to a whole pixel nearby, single precision is enough. All coordinates are positive
    # then, so that truncation rounds down.
    left = int(u - reach_u)
    top = int(v - reach_v)
    a = np.float32(A[0, 0])
    b = np.float32(A[0, 1])
    c = np.float32(A[1, 0])
    d = np.float32(A[1, 1])
    center_right = np.float32(u - left)
    center_down = np.float32(v - top)
    base = np.int32(top * width + left)
    for i in range(len(corner)):
        right = center_right + a * position[0, i] + b * position[1, i]
        down = center_down + c * position[0, i] + d * position[1, i]
        column = np.int32(right)
        row = np.int32(down)
        corner[i] = base + row * np.int32(width) + column
        column_weights = _spline_weights(right - np.float32(column))
        weights[0, i] = column_weights[0]
        weights[1, i] = column_weights[1]
        weights[2, i] = column_weights[2]
        weights[3, i] = column_weights[3]
        row_weights = _spline_weights(down - np.float32(row))
        weights[4, i] = row_weights[0]
        weights[5, i] = row_weights[1]
        weights[6, i] = row_weights[2]
        weights[7, i] = row_weights[3]
    return True


@compiled
def _subtract(
    flat_coefficients: FloatArray,
    width: int,
    warped: WarpedPixels,
    brightness: FloatArray,
    error: FloatArray,
) -> None:
    """Set the error to the image's spline less the patch's brightness, [area].

    Args:
        flat_coefficients: of the image's spline, [height · width], float32.
        width: of the image, px.
        warped: where the pixels of the patch are in the image.
        brightness: of the patch, [area].
        error: out.
    """
    corner = warped.corner
    weights = warped.weights
    for i in range(len(corner)):
        # Four by four coefficients, from one pixel to the upper left of the corner on.
        total = -brightness[i]
        k = np.uintp(corner[i]) - np.uintp(width) - np.uintp(1)
        for row in range(4):
            total += weights[4 + row, i] * (
                weights[0, i] * flat_coefficients[k]
                + weights[1, i] * flat_coefficients[k + np.uintp(1)]
                + weights[2, i] * flat_coefficients[k + np.uintp(2)]
                + weights[3, i] * flat_coefficients[k + np.uintp(3)]
            )
            k += np.uintp(width)
        error[i] = total


@compiled
def _spline_weights(
    fraction: np.float32,
) -> tuple[np.float32, np.float32, np.float32, np.float32]:
    """Return the weights of a cubic B-spline's four nearest coefficients.

    Args:
        fraction: offset from the second of them, 0 to 1.
    """
    one = np.float32(1.0)
    sixth = np.float32(1.0 / 6.0)
    rest = one - fraction
    first = sixth * rest * rest * rest
    last = sixth * fraction * fraction * fraction
    second = np.float32(2.0 / 3.0) - fraction * fraction * (one - np.float32(0.5) * fraction)
    return first, second, one - first - second - last, last


@compiled
def _add_prior(prior: float, A: FloatArray, predicted: FloatArray, gradient: FloatArray) -> None:
    """Add the derivative of ½ prior ‖Â⁻¹ A − I‖² by S to the last four entries of the gradient."""
    # After a step, Â⁻¹ A (I + S)⁻¹ − I is Â⁻¹ A − I − S to first order: like the error of the
    # image, Â⁻¹ A − I is what the step has to explain. Â⁻¹ = [[d, −b], [−c, a]] / det Â.
    a = predicted[0, 0]
    b = predicted[0, 1]
    c = predicted[1, 0]
    d = predicted[1, 1]
    weight = prior / (a * d - b * c)
    gradient[2] += weight * (d * A[0, 0] - b * A[1, 0]) - prior
    gradient[3] += weight * (d * A[0, 1] - b * A[1, 1])
    gradient[4] += weight * (a * A[1, 0] - c * A[0, 0])
    gradient[5] += weight * (a * A[1, 1] - c * A[0, 1]) - prior


@compiled
def _compose_inverse(A: FloatArray, step: FloatArray) -> bool:
    """Set A ← A (I + S)⁻¹ for step = (t, S); False if the step shrinks the patch too much."""
    determinant = (1.0 + step[2]) * (1.0 + step[5]) - step[3] * step[4]
    if not determinant > MIN_STEP_DETERMINANT:
        return False
    # (I + S)⁻¹ = [[1 + s₃, −s₁], [−s₂, 1 + s₀]] / det, with (s₀, s₁, s₂, s₃) = step[2:]
    for i in range(2):
        a = A[i, 0] / determinant
        b = A[i, 1] / determinant
        A[i, 0] = a * (1.0 + step[5]) - b * step[4]
        A[i, 1] = b * (1.0 + step[2]) - a * step[3]
    return True

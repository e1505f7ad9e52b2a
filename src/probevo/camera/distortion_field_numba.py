"""Compiled loops of the distortion field: one pass over the features of a frame each."""

from __future__ import annotations

from typing import NamedTuple

from probevo.arrays import FloatArray, IntArray
from probevo.camera.transfer_numba import NEAREST, Intrinsics, move_point
from probevo.compiled import compiled

MODE_COLUMNS = 6
"""Number of polynomials P_i across the image, of degrees 0 to 5."""
MODE_ROWS = 4
"""Number of polynomials P_j down the image, of degrees 0 to 3."""


class ImagePlane(NamedTuple):
    """The extent of the left image, in which the polynomials' variables go from −1 to 1."""

    width: float
    """px."""
    height: float
    """px."""


class FieldModes(NamedTuple):
    """The modes P_i(x) P_j(y) at the features of two frames, and which of them the fields have."""

    prev: FloatArray
    """[N, MODE_COLUMNS MODE_ROWS]."""
    curr: FloatArray
    """[N, MODE_COLUMNS MODE_ROWS]."""
    displacement_modes: IntArray
    """Indices of the modes of c_u and c_v."""
    disparity_modes: IntArray
    """Indices of the modes of c_d."""


@compiled
def fill_modes(pixels: FloatArray, plane: ImagePlane, modes: FloatArray) -> None:
    """Fill P_i(x) P_j(y) at the left observations of N features, [N, ≥ 2], px.

    A feature outside of the image has the modes of the nearest place in it: polynomials grow fast
    where nothing holds them.
    """
    for n in range(len(pixels)):
        x = min(max(2.0 * pixels[n, 0] / plane.width - 1.0, -1.0), 1.0)
        y = min(max(2.0 * pixels[n, 1] / plane.height - 1.0, -1.0), 1.0)
        column_value_before = 0.0
        column_value = 1.0
        for i in range(MODE_COLUMNS):
            row_value_before = 0.0
            row_value = 1.0
            for j in range(MODE_ROWS):
                modes[n, i * MODE_ROWS + j] = column_value * row_value
                following = _next_legendre(j, y, row_value, row_value_before)
                row_value_before = row_value
                row_value = following
            following = _next_legendre(i, x, column_value, column_value_before)
            column_value_before = column_value
            column_value = following


@compiled
def _next_legendre(degree: int, x: float, value: float, before: float) -> float:
    """Return P_{n+1}(x) by Bonnet's recursion, (n + 1) P_{n+1} = (2n + 1) x P_n − n P_{n−1}."""
    return ((2.0 * degree + 1.0) * x * value - degree * before) / (degree + 1.0)


@compiled
def correct_by_field(
    pixels: FloatArray,
    modes: FloatArray,
    coefficients: FloatArray,
    *,
    displacement_modes: IntArray,
    disparity_modes: IntArray,
) -> None:
    """Take the errors of the field out of N observations, [N, 4], px, in place.

    Args:
        pixels: the observations.
        modes: P_i(x) P_j(y) at these, [N, MODE_COLUMNS MODE_ROWS].
        coefficients: of c_u, c_v and c_d, px.
        displacement_modes: indices of the modes of c_u and c_v.
        disparity_modes: indices of the modes of c_d.
    """
    num_displacement = len(displacement_modes)
    for n in range(len(pixels)):
        u_px = 0.0
        v_px = 0.0
        d_px = 0.0
        for k in range(num_displacement):
            mode = modes[n, displacement_modes[k]]
            u_px += coefficients[k] * mode
            v_px += coefficients[num_displacement + k] * mode
        for k in range(len(disparity_modes)):
            d_px += coefficients[2 * num_displacement + k] * modes[n, disparity_modes[k]]
        pixels[n, 0] += u_px
        pixels[n, 1] += v_px
        pixels[n, 2] += u_px - d_px
        pixels[n, 3] += v_px


@compiled
def predict_pixels(
    T: FloatArray, camera: Intrinsics, refined: FloatArray, predicted: FloatArray
) -> None:
    """Fill the left pixels (u', v') of N points in the current frame, [N, 2], px.

    Args:
        T: T_curr_prev, [4, 4].
        camera: the intrinsics.
        refined: the points in the previous frame, (u, v, d), [N, 3], px.
        predicted: filled in; the principal point for what is behind the camera.
    """
    for n in range(len(refined)):
        X, Y, Z, _ = move_point(T, camera, refined[n])
        predicted[n, 0] = camera.cu
        predicted[n, 1] = camera.cv
        if Z >= NEAREST:
            predicted[n, 0] += camera.fu * X / Z
            predicted[n, 1] += camera.fv * Y / Z


@compiled
def field_sensitivities(
    T: FloatArray,
    camera: Intrinsics,
    refined: FloatArray,
    disparity_jacobian: FloatArray,
    modes: FieldModes,
    sensitivity: FloatArray,
) -> None:
    """Fill ∂e/∂(coefficients) of e = y' − f(T g(y)), [N, 4, NUM_COEFFICIENTS].

    A coefficient moves the observation y' in the current frame, and by the point g(y) the
    prediction. With q = C m + ρ t of ``transfer`` and c the first column of C,

        ∂u'/∂u = (c_x − c_z q_x/q_z)/q_z,    ∂d'/∂u = −c_z d'/(f_u q_z),

    and likewise by v, with the second column.

    Args:
        T: T_curr_prev, [4, 4].
        camera: the intrinsics.
        refined: the points in the previous frame, (u, v, d), [N, 3], px.
        disparity_jacobian: ∂f(T g(y))/∂d, [N, 4].
        modes: the modes of the field at these features.
        sensitivity: filled in; zero behind the camera.
    """
    num_displacement = len(modes.displacement_modes)
    for n in range(len(refined)):
        X, Y, Z, rho = move_point(T, camera, refined[n])
        if Z < NEAREST:
            sensitivity[n] = 0.0
            continue
        d_curr = camera.fb * rho / Z
        # By u of the previous frame, and by v.
        u_by_u = (T[0, 0] - T[2, 0] * X / Z) / Z
        v_by_u = camera.fv / camera.fu * (T[1, 0] - T[2, 0] * Y / Z) / Z
        d_by_u = -T[2, 0] * d_curr / (camera.fu * Z)
        u_by_v = camera.fu / camera.fv * (T[0, 1] - T[2, 1] * X / Z) / Z
        v_by_v = (T[1, 1] - T[2, 1] * Y / Z) / Z
        d_by_v = -T[2, 1] * d_curr / (camera.fv * Z)
        for k in range(num_displacement):
            before = modes.prev[n, modes.displacement_modes[k]]
            now = modes.curr[n, modes.displacement_modes[k]]
            sensitivity[n, 0, k] = now - u_by_u * before
            sensitivity[n, 1, k] = -v_by_u * before
            sensitivity[n, 2, k] = now - (u_by_u - d_by_u) * before
            sensitivity[n, 3, k] = -v_by_u * before
            sensitivity[n, 0, num_displacement + k] = -u_by_v * before
            sensitivity[n, 1, num_displacement + k] = now - v_by_v * before
            sensitivity[n, 2, num_displacement + k] = -(u_by_v - d_by_v) * before
            sensitivity[n, 3, num_displacement + k] = now - v_by_v * before
        for k in range(len(modes.disparity_modes)):
            before = modes.prev[n, modes.disparity_modes[k]]
            now = modes.curr[n, modes.disparity_modes[k]]
            for i in range(4):
                sensitivity[n, i, 2 * num_displacement + k] = -disparity_jacobian[n, i] * before
            sensitivity[n, 2, 2 * num_displacement + k] -= now

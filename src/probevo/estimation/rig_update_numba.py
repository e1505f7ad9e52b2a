"""Compiled loops of the rig's update: one pass over the features of a step each."""

from __future__ import annotations

from probevo.arrays import FloatArray
from probevo.camera.transfer_numba import Intrinsics
from probevo.compiled import compiled


@compiled
def disparity_sensitivities(
    disparity_jacobian: FloatArray,
    prev_px: FloatArray,
    curr_px: FloatArray,
    camera: Intrinsics,
    sensitivity: FloatArray,
) -> None:
    """Fill ∂e/∂(b₀, b₁, b₂, a₆), [N, 4, 4].

    A coefficient says how much larger the true disparity is than the measured one. That lowers
    u_r', and it moves the prediction f(T g(y)) through the depth.

    Args:
        disparity_jacobian: ∂f(T g(y))/∂d, [N, 4].
        prev_px: observations in the previous frame, [N, 4], px.
        curr_px: those in the current frame.
        camera: the intrinsics.
        sensitivity: filled in.
    """
    for n in range(len(prev_px)):
        # e = y' − f(T g(y)): the previous disparity moves f(T g(y)), the current one u_r' = u_l' −
        # d'.
        for k in range(4):
            before = _disparity_by(k, prev_px[n], camera)
            for i in range(4):
                sensitivity[n, i, k] = -disparity_jacobian[n, i] * before
            sensitivity[n, 2, k] -= _disparity_by(k, curr_px[n], camera)


@compiled
def _disparity_by(k: int, pixels: FloatArray, camera: Intrinsics) -> float:
    """Return what coefficient k of (b₀, b₁, b₂, a₆) adds to the disparity of an observation."""
    added = 1.0
    if k == 3:
        # A radial error moves v by a₆ y r², px, and u by a₆ (f_u/f_v) x r², here of the right
        # image.
        x_right = (pixels[2] - camera.cu) / camera.fu
        y = (pixels[1] - camera.cv) / camera.fv
        added = camera.fu / camera.fv * x_right * (x_right * x_right + y * y)
    elif k > 0:
        x = (pixels[0] - camera.cu) / camera.fu
        added = x if k == 1 else x * x
    return added


@compiled
def weigh_columns(
    information: FloatArray, weights: FloatArray, columns: FloatArray, weighted: FloatArray
) -> None:
    """Fill ``weighted`` with w Σ⁻¹ times the columns of each feature, [N, 4, K].

    Args:
        information: Σ⁻¹, [N, 4, 4].
        weights: w, [N].
        columns: [N, 4, K].
        weighted: [N, 4, K].
    """
    for n in range(len(weights)):
        for i in range(4):
            w0 = weights[n] * information[n, i, 0]
            w1 = weights[n] * information[n, i, 1]
            w2 = weights[n] * information[n, i, 2]
            w3 = weights[n] * information[n, i, 3]
            for k in range(columns.shape[2]):
                weighted[n, i, k] = (
                    w0 * columns[n, 0, k]
                    + w1 * columns[n, 1, k]
                    + w2 * columns[n, 2, k]
                    + w3 * columns[n, 3, k]
                )

"""The deviation of a feature from where the motion of most features takes it."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.geometry import se3
from probevo.predictors.base import Needs, Predictor
from probevo.predictors.predicted_place import predicted_place

ITERATIONS = 3
"""Gauss–Newton iterations that correct the predicted motion."""
MIN_FEATURES = 10
"""With fewer features, the predicted motion is not corrected."""
MIN_SCALE_PX = 0.2
"""Smallest scale of the robust weights: deviations well below it have full weight."""
PRIOR_INFORMATION = np.diag([1.0, 1.0, 1.0, 1e2, 1e2, 1e2])
"""Information of each iteration's correction ξ: 1 m and 0.1 rad, for measurements of 1 px.

It is negligible beside what a dozen features contribute, except along directions that they do not
observe, such as the translation when all are far away."""


def residual_flow(
    prev_px: FloatArray,
    curr_px: FloatArray,
    predicted_T_curr_prev: FloatArray,
    camera: StereoCamera,
) -> FloatArray:
    """Compute ln(1 + deviation/px) from the place where most features' motion takes each. Ours.

    The predicted motion knows nothing of the latest acceleration, nor of the latest rotation if
    there is no gyro. The effect of this on the flow is removed: ``ITERATIONS`` Gauss–Newton
    iterations correct the motion by the deviations (u, v) of all features in the left image, with
    weights 1/(1 + e²/s²), where s is their median. A moving object keeps its deviation, unless it
    fills most of the image.

    The value is a residual at a motion that the same features gave, so that it contains each
    feature's own error too.

    Args:
        prev_px: features in the previous frame, [N, 4], px.
        curr_px: features in the current frame, [N, 4], px.
        predicted_T_curr_prev: the predicted motion, [4, 4].
        camera: the rectified camera.

    Returns:
        [N], ln(1 + px); always defined.
    """
    T_curr_prev = predicted_T_curr_prev
    if len(curr_px) >= MIN_FEATURES:
        for _ in range(ITERATIONS):
            xi = _correction(prev_px, curr_px, T_curr_prev, camera=camera)
            T_curr_prev = se3.exp(xi) @ T_curr_prev
    du, dv = _deviation(curr_px, predicted_place(prev_px, T_curr_prev, camera), camera)
    return np.log1p(np.hypot(du, dv))


def _deviation(
    curr_px: FloatArray, place: FloatArray, camera: StereoCamera
) -> tuple[FloatArray, FloatArray]:
    """Return observed less predicted (u, v), [N] each, px, for predicted places [3, N]."""
    du = curr_px[:, 0] - camera.cu_px - camera.fu_px * place[0]
    dv = curr_px[:, 1] - camera.cv_px - camera.fv_px * place[1]
    return du, dv


def _correction(
    prev_px: FloatArray, curr_px: FloatArray, T_curr_prev: FloatArray, camera: StereoCamera
) -> FloatArray:
    """Compute the Gauss–Newton step ξ, [6], such that Exp(ξ) T_curr_prev fits most features."""
    place = predicted_place(prev_px, T_curr_prev, camera)
    x, y, inverse_depth = place
    # Jacobian by ξ = [ρ; φ], which moves q = (x, y, 1) by δ = inverse_depth ρ + φ × q and its image
    # by (δ_x − x δ_z, δ_y − y δ_z)
    zero = np.zeros_like(x)
    jacobian_u = camera.fu_px * np.stack(
        [inverse_depth, zero, -inverse_depth * x, -x * y, 1.0 + x * x, -y]
    )
    jacobian_v = camera.fv_px * np.stack(
        [zero, inverse_depth, -inverse_depth * y, -1.0 - y * y, x * y, x]
    )
    # Robust weights, of Cauchy's form
    du, dv = _deviation(curr_px, place, camera)
    squared = du * du + dv * dv
    weights = 1.0 / (1.0 + squared / max(float(np.median(squared)), MIN_SCALE_PX**2))
    # Normal equations of (u, v), Λ ξ = Σ w (j_u du + j_v dv) with Λ = Σ w (j_u j_uᵀ + j_v j_vᵀ) +
    # prior. The prior of each iteration is around zero, and so does not pull back to the
    # prediction.
    weighted_u = weights * jacobian_u
    weighted_v = weights * jacobian_v
    information = weighted_u @ jacobian_u.T + weighted_v @ jacobian_v.T + PRIOR_INFORMATION
    return np.asarray(np.linalg.solve(information, weighted_u @ du + weighted_v @ dv), np.float64)


RESIDUAL_FLOW = Predictor(
    name="residual_flow",
    columns={"residual_flow": "ln(1 + px)"},
    source="ours",
    needs=Needs.TRACKS,
    compute=lambda step: residual_flow(
        step.tracks.prev_px, step.tracks.curr_px, step.predicted_T_curr_prev, camera=step.camera
    ),
)

"""How far a feature is from where the motion of the rest takes it."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.geometry import se3
from probevo.predictors.expected_place import moved_by

STEPS = 3
"""Gauss–Newton steps that correct the expected motion."""
MIN_FEATURES = 10
"""With fewer features, the expected motion is taken as it is."""
MIN_SCALE_PX = 0.2
"""Deviations below this count in full."""
DAMPING = np.diag([1.0, 1.0, 1.0, 1e2, 1e2, 1e2])
"""As if each step of the correction were known to 1 m and 0.1 rad, measured with 1 px: nothing
beside what a dozen features tell, except of what they cannot tell, such as the translation when all
are far away."""


def residual_flow(
    previous_px: FloatArray, curr_px: FloatArray, expected: FloatArray, camera: StereoCamera
) -> FloatArray:
    """ln(1 + deviation/px) of the current left position from where the motion of most features
    takes it. Ours.

    The expected motion knows nothing of the last acceleration, nor of the last turn if there is no
    gyro. What this does to the flow drops out: the motion is corrected by ``STEPS`` Gauss–Newton
    steps on the deviations (u, v) of all features, each weighed by 1/(1 + e²/s²), s their median.
    What moves by itself keeps its deviation, unless it fills most of the image.

    The score is a residual, of a motion that the same features gave: it tells of each feature's own
    error too.

    Args:
        previous_px: features in the previous frame, [N, 4], px.
        curr_px: the same in the current frame, [N, 4], px.
        expected: T_curr_prev, [4, 4].
        camera: the rectified camera.

    Returns:
        [N], ln(1 + px); always defined.
    """
    T_curr_prev = expected
    if len(curr_px) >= MIN_FEATURES:
        for _ in range(STEPS):
            T_curr_prev = (
                se3.exp(_correction(previous_px, curr_px, T_curr_prev, camera=camera)) @ T_curr_prev
            )
    du, dv = _deviation(curr_px, moved_by(previous_px, T_curr_prev, camera), camera)
    return np.log1p(np.hypot(du, dv))


def _deviation(
    curr_px: FloatArray, moved: FloatArray, camera: StereoCamera
) -> tuple[FloatArray, FloatArray]:
    """(u, v) observed less predicted, [N] each, px."""
    du = curr_px[:, 0] - camera.cu_px - camera.fu_px * moved[0]
    return du, curr_px[:, 1] - camera.cv_px - camera.fv_px * moved[1]


def _correction(
    previous_px: FloatArray, curr_px: FloatArray, T_curr_prev: FloatArray, camera: StereoCamera
) -> FloatArray:
    """ξ, [6], with Exp(ξ) T_curr_prev nearer to what most features show."""
    moved = moved_by(previous_px, T_curr_prev, camera)
    x, y, rho = moved
    zero = np.zeros_like(x)
    # ξ = [ρ; φ] moves q = (x, y, 1) by δ = rho ρ + φ × q, and its image by (δ_x − x δ_z, δ_y − y
    # δ_z).
    columns_u = camera.fu_px * np.stack([rho, zero, -rho * x, -x * y, 1.0 + x * x, -y])
    columns_v = camera.fv_px * np.stack([zero, rho, -rho * y, -1.0 - y * y, x * y, x])
    du, dv = _deviation(curr_px, moved, camera)
    squared = du * du + dv * dv
    weights = 1.0 / (1.0 + squared / max(float(np.median(squared)), MIN_SCALE_PX**2))
    weighted_u = weights * columns_u
    weighted_v = weights * columns_v
    normal = weighted_u @ columns_u.T + weighted_v @ columns_v.T + DAMPING
    return np.asarray(np.linalg.solve(normal, weighted_u @ du + weighted_v @ dv), np.float64)

"""The deviation of a feature's disparity from what the predicted motion makes of it."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.predictors.base import Needs, Predictor
from probevo.predictors.predicted_place import predicted_place


def disparity_change(
    prev_px: FloatArray,
    curr_px: FloatArray,
    predicted_T_curr_prev: FloatArray,
    camera: StereoCamera,
) -> FloatArray:
    """Compute ln(1 + |d − d̂|/px), d the disparity, d̂ the one after the predicted motion. Ours.

    Disparity does not change with small rotations, and an error of the predicted speed hardly shows
    in it. Hence the predicted motion needs no correction here, unlike in ``residual_flow``. The
    predictor shows oncoming cars, whose flow looks like the flow of nearer things, and stereo
    matches that jump.

    Args:
        prev_px: features in the previous frame, [N, 4], px.
        curr_px: features in the current frame, [N, 4], px.
        predicted_T_curr_prev: the predicted motion, [4, 4].
        camera: the rectified camera.

    Returns:
        [N], ln(1 + px); always defined.
    """
    _, _, inverse_depth = predicted_place(prev_px, predicted_T_curr_prev, camera)
    # d̂ = f_u b ρ, with ρ the inverse depth in the current frame
    change: FloatArray = np.abs(
        curr_px[:, 0] - curr_px[:, 2] - camera.fu_px * camera.baseline_m * inverse_depth
    )
    return np.log1p(change)


DISPARITY_CHANGE = Predictor(
    name="disparity_change",
    columns={"disparity_change": "ln(1 + px)"},
    source="ours",
    needs=Needs.TRACKS,
    compute=lambda step: disparity_change(
        step.tracks.prev_px, step.tracks.curr_px, step.predicted_T_curr_prev, camera=step.camera
    ),
)

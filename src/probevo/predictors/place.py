"""The place of a feature in the image (PROBE-GK)."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.predictors.base import Needs, Predictor


def place(uv: FloatArray, camera: StereoCamera) -> FloatArray:
    """Compute normalized image coordinates x = (u − c_u)/f_u and y = (v − c_v)/f_v.

    PROBE-GK takes the pixels. Normalized coordinates mean the same to a camera of another
    resolution.

    Args:
        uv: features, [N, 2], px.
        camera: the rectified camera.

    Returns:
        x to the right and y down, [N, 2], focal lengths (tangents of angles); always defined.
    """
    return np.column_stack(camera.normalized(uv[:, 0], uv[:, 1]))


PLACE = Predictor(
    name="place",
    columns={"x": "focal lengths", "y": "focal lengths"},
    source="PROBE-GK: pixel location",
    needs=Needs.TRACKS,
    compute=lambda step: place(step.uv, step.camera),
)

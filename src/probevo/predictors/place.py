"""Where in the image a feature is (PROBE-GK)."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera


def place(uv: FloatArray, camera: StereoCamera) -> FloatArray:
    """Normalized image coordinates, so that they mean the same to a camera of another resolution.

    PROBE-GK takes the pixels.

    Args:
        uv: features, [N, 2], px.
        camera: the rectified camera.

    Returns:
        x = (u − c_u)/f_u to the right and y = (v − c_v)/f_v down, [N, 2], tangents of angles.
    """
    return np.column_stack(camera.normalized(uv[:, 0], uv[:, 1]))

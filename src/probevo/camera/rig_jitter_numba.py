"""Compiled loops: derivatives of right observations by a rotation of that camera
(``rig_jitter``)."""

from __future__ import annotations

from probevo.arrays import FloatArray
from probevo.camera.transfer_numba import Intrinsics
from probevo.compiled import compiled


@compiled
def right_offset(camera: Intrinsics, u_r: float, v_r: float, offset: FloatArray) -> None:
    """Fill in ∂(u_r, v_r)/∂ω at one observation, [2, 3], px/rad."""
    x = (u_r - camera.cu) / camera.fu
    y = (v_r - camera.cv) / camera.fv
    offset[0, 0] = -camera.fu * x * y
    offset[0, 1] = camera.fu * (1.0 + x * x)
    offset[0, 2] = -camera.fu * y
    offset[1, 0] = -camera.fv * (1.0 + y * y)
    offset[1, 1] = camera.fv * x * y
    offset[1, 2] = camera.fv * x


@compiled
def right_offsets(camera: Intrinsics, pixels: FloatArray, offsets: FloatArray) -> None:
    """Fill in the same at N observations, [N, 4] to [N, 2, 3]."""
    for n in range(len(pixels)):
        right_offset(camera, pixels[n, 2], pixels[n, 3], offsets[n])

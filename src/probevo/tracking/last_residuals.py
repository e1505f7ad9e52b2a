"""What the features of a step left of its motion, remembered for one step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.camera.stereo import StereoCamera
from probevo.camera.transfer_numba import NEAREST
from probevo.tracking.tracks import Tracks

LAST_RESIDUAL = "last_residual"
"""Name of the predictor that goes by them."""


@dataclass(frozen=True)
class LastResiduals:
    """How large the residuals of n features were in the step before, at the motion that was to
    judge them then."""

    ids: IntArray
    """Identity of each feature, [n]; no two are the same."""
    size_px: FloatArray
    """‖e‖ of each, e = y' − f(T g(y)) [4], [n], px; NaN where the motion takes the feature behind
    the camera."""

    @staticmethod
    def none() -> LastResiduals:
        """Of no feature at all: there was no step, or its motion was not solved."""
        return LastResiduals(np.zeros(0, np.int64), np.zeros(0))

    @staticmethod
    def left_by(
        tracks: Tracks, T_curr_prev: FloatArray | None, camera: StereoCamera
    ) -> LastResiduals:
        """Of all tracks of a step, those too that its motion T_curr_prev, [4, 4], was not solved
        with; none without."""
        if T_curr_prev is None:
            return LastResiduals.none()
        return LastResiduals(tracks.ids, _residual_sizes(tracks, T_curr_prev, camera))

    def of(self, ids: IntArray) -> FloatArray:
        """Those of the features with these identities, [N], px; NaN where nothing is known of one."""
        if not len(self.ids):
            return np.full(len(ids), np.nan)
        order = np.argsort(self.ids)
        nearest = order[np.minimum(np.searchsorted(self.ids, ids, sorter=order), len(order) - 1)]
        return np.where(self.ids[nearest] == ids, self.size_px[nearest], np.nan)


def _residual_sizes(tracks: Tracks, T_curr_prev: FloatArray, camera: StereoCamera) -> FloatArray:
    """‖y' − f(T g(y))‖, [N], px; a point is carried as its ray and inverse depth, as in
    ``reprojection_kernels``."""
    u_l, v_l, u_r, v_r = tracks.prev_px.T
    disparity = u_l - u_r
    rays = np.empty((3, len(tracks)))
    rays[0], rays[1] = camera.normalized(u_l, 0.5 * (v_l + v_r))
    rays[2] = 1.0
    t_per_px = T_curr_prev[:3, 3, None] / (camera.fu_px * camera.baseline_m)
    x, y, z = T_curr_prev[:3, :3] @ rays + t_per_px * disparity
    z = np.where(z < NEAREST, np.nan, z)
    u = camera.fu_px * x / z + camera.cu_px
    v = camera.fv_px * y / z + camera.cv_px
    residuals = tracks.curr_px - np.stack([u, v, u - disparity / z, v], axis=1)
    return np.asarray(np.linalg.norm(residuals, axis=1), np.float64)

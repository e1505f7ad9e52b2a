"""Residuals of the features of one step, kept for the next."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probevo.arrays import FloatArray, IntArray, rows_of
from probevo.camera.stereo import StereoCamera
from probevo.camera.transfer import transfer
from probevo.tracking.tracks import Tracks


@dataclass(frozen=True)
class LastResiduals:
    """Size of the residuals of n features in the previous step, at its reference motion."""

    ids: IntArray
    """Identity of each feature, [n]; no two are the same."""
    size_px: FloatArray
    """‖e‖ of each, e = y' − f(T g(y)) [4], [n], px; NaN where the motion takes the feature behind
    the camera."""

    @staticmethod
    def none() -> LastResiduals:
        """Return the residuals of no feature: there was no step, or its motion was not solved."""
        return LastResiduals(np.zeros(0, np.int64), np.zeros(0))

    @staticmethod
    def after_step(
        tracks: Tracks, T_curr_prev: FloatArray | None, camera: StereoCamera
    ) -> LastResiduals:
        """Compute the residuals of all tracks of a step at T_curr_prev, [4, 4]; none without it.

        Those of tracks that the solve did not use are included.
        """
        if T_curr_prev is None:
            return LastResiduals.none()
        return LastResiduals(tracks.ids, _residual_sizes(tracks, T_curr_prev, camera))

    def size_px_of(self, ids: IntArray) -> FloatArray:
        """Return the residuals of features by identity, [N], px; NaN where unknown."""
        sizes_px = np.full(len(ids), np.nan)
        rows = rows_of(ids, self.ids)
        is_known = rows >= 0
        sizes_px[is_known] = self.size_px[rows[is_known]]
        return sizes_px


def _residual_sizes(tracks: Tracks, T_curr_prev: FloatArray, camera: StereoCamera) -> FloatArray:
    """Compute ‖y' − f(T g(y))‖ of each track, [N], px; NaN behind the camera."""
    predicted = transfer(tracks.prev_px, T_curr_prev, camera)
    return np.asarray(np.linalg.norm(tracks.curr_px - predicted, axis=1), np.float64)

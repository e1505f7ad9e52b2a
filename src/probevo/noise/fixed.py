"""The classical noise model: one Gaussian covariance for every observation."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.noise.base import StereoNoise

OBSERVATION_SIGMA_PX = (0.2, 0.2, 0.2, 0.2)
"""Standard deviation of a tracked corner's (u_l, v_l, u_r, v_r): what the residuals of KITTI 0005
and 06 show."""


class Fixed:
    """Gaussian noise of one fixed covariance on every observation (PROBE's R; the nominal model of
    its Table I).

    Args:
        covariance: of (u_l, v_l, u_r, v_r), [4, 4], px².
    """

    columns: tuple[str, ...] = ()

    def __init__(self, covariance: FloatArray | None = None) -> None:
        self.covariance = (
            np.diag(np.square(OBSERVATION_SIGMA_PX)) if covariance is None else covariance
        )

    def predict(self, predictors: FloatArray) -> StereoNoise:
        """The same noise for each of N features, whatever their predictors [N, M]."""
        count = len(predictors)
        scale = np.broadcast_to(np.asarray(self.covariance, dtype=np.float64), (count, 4, 4))
        return StereoNoise(
            scale, np.full(count, np.inf), np.zeros((count, 4)), refers_to="observation"
        )

    def check_camera(self, camera: StereoCamera) -> None:
        """Any camera will do: nothing was learned from one."""

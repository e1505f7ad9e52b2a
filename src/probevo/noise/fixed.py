"""The Gaussian noise model: one fixed covariance for every observation (PROBE's nominal model)."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.noise.base import StereoNoise
from probevo.noise.positive_definite import check_positive_definite

OBSERVATION_SIGMA_PX = (0.2, 0.2, 0.2, 0.2)
"""Standard deviation of (u_l, v_l, u_r, v_r) of a tracked corner, from the residuals of KITTI 0005
and 06."""


class Fixed:
    """Gaussian noise with one covariance R for every observation (PROBE Table I, nominal).

    Args:
        covariance: R, of (u_l, v_l, u_r, v_r), [4, 4], px²; by default as for tracked corners.

    Raises:
        InputError: R is not positive definite.
    """

    columns: tuple[str, ...] = ()

    def __init__(self, covariance: FloatArray | None = None) -> None:
        if covariance is None:
            covariance = np.diag(np.square(OBSERVATION_SIGMA_PX))
        check_positive_definite(covariance, "covariance", 4)
        self.covariance = covariance

    def predict(self, predictors: FloatArray) -> StereoNoise:
        """Return the same noise for each of N features, whatever their predictors [N, M]."""
        count = len(predictors)
        covariance = np.asarray(self.covariance, dtype=np.float64)
        return StereoNoise(
            scale=np.broadcast_to(covariance, (count, 4, 4)),
            dof=np.full(count, np.inf),
            bias=np.zeros((count, 4)),
            refers_to="observation",
        )

    def check_camera(self, camera: StereoCamera) -> None:
        """Accept any camera: the model was not learned with one."""

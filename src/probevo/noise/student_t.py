"""The static M-estimator: one Student-t for every observation (PROBE-GK section 1.5.3, after Kerl et al. 2013)."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.noise.base import StereoNoise
from probevo.noise.fixed import OBSERVATION_SIGMA_PX


class StudentT:
    """Student-t noise of one fixed scale matrix on every observation.

    Args:
        dof: degrees of freedom ν; small values trust outliers less.
        scale: scale matrix of (u_l, v_l, u_r, v_r), [4, 4], px².
    """

    columns: tuple[str, ...] = ()

    def __init__(self, dof: float = 5.0, scale: FloatArray | None = None) -> None:
        self.dof = dof
        self.scale = np.diag(np.square(OBSERVATION_SIGMA_PX)) if scale is None else scale

    def predict(self, predictors: FloatArray) -> StereoNoise:
        """The same noise for each of N features, whatever their predictors [N, M]."""
        count = len(predictors)
        scale = np.broadcast_to(np.asarray(self.scale, dtype=np.float64), (count, 4, 4))
        return StereoNoise(scale, np.full(count, self.dof), np.zeros((count, 4)), refers_to="observation")

    def check_camera(self, camera: StereoCamera) -> None:
        """Any camera will do: nothing was learned from one."""

"""The drift of a run, which several figures of the report show."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probevo.arrays import FloatArray
from probevo.evaluation.consistency import drift_errors
from probevo.evaluation.trajectory_errors import distance_along_path
from probevo.geometry import se3
from probevo.output.run_result import RunResult


@dataclass(frozen=True)
class Drift:
    """The path of a run over N frames, its error, and the covariance that the run claims for it.

    Both start with 0 at the origin: the first frame with a known true pose, or the first of all
    without truth.
    """

    time_s: FloatArray
    """Time since the first frame of the run, [N]."""
    distance_m: FloatArray
    """Distance travelled, as estimated, [N]."""
    T_world_cam: FloatArray
    """Estimate, [N, 4, 4], m."""
    T_world_cam_true: FloatArray | None
    """Truth, made equal to the estimate at the origin, [N, 4, 4], m; NaN where unknown."""
    error: FloatArray | None
    """Error [ρ; φ] in each camera's frame, [N, 6], m and rad; NaN where unknown."""
    cov: FloatArray
    """Claimed covariance of the error, [N, 6, 6]; 0 up to the origin."""

    @property
    def sigma(self) -> FloatArray:
        """Standard deviation of each component of the error, [N, 6], m and rad."""
        return np.sqrt(np.diagonal(self.cov, axis1=1, axis2=2))

    @property
    def position_sigma_m(self) -> FloatArray:
        """Standard deviation of the position in its least certain direction, [N]."""
        return np.asarray(np.sqrt(np.linalg.eigvalsh(self.cov[:, :3, :3])[:, -1]))

    @property
    def position_cov_world(self) -> FloatArray:
        """Covariance of the position along the axes of the world frame, [N, 3, 3], m²."""
        C_world_cam = self.T_world_cam[:, :3, :3]
        return np.asarray(
            np.einsum("nij,njk,nlk->nil", C_world_cam, self.cov[:, :3, :3], C_world_cam)
        )


def drift_of(result: RunResult, truth: FloatArray | None) -> Drift:
    """Compute the drift of a run.

    Args:
        result: the run.
        truth: true poses T_world_cam, [N, 4, 4], m, in any world frame; NaN where unknown. With
            fewer than two known poses, there is no error.
    """
    origin = 0
    T_world_cam_true = None
    error = None
    if truth is not None:
        known = np.flatnonzero(np.isfinite(truth).all(axis=(1, 2)))
        if len(known) >= 2:
            origin = int(known[0])
            # Make the true pose equal to the estimated one at the origin.
            T_world_cam_true = result.T_world_cam[origin] @ se3.inverse(truth[origin]) @ truth
            error = drift_errors(result.T_world_cam, T_world_cam_true)
    cov = result.drift_covariances_from(origin)
    return Drift(
        time_s=(result.stamps_ns - result.stamps_ns[0]) * 1e-9,
        distance_m=distance_along_path(result.T_world_cam),
        T_world_cam=result.T_world_cam,
        T_world_cam_true=T_world_cam_true,
        error=error,
        cov=np.concatenate([np.zeros((origin, 6, 6)), cov]),
    )

"""What the figures of the report show, computed once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probevo.arrays import FloatArray
from probevo.evaluation.consistency import drift_covariances, drift_errors
from probevo.evaluation.trajectory_errors import distance_along_path
from probevo.geometry import se3
from probevo.output.run_result import RunResult


@dataclass(frozen=True)
class Drift:
    """The path of a run over N frames, how far it strayed from the truth, and how far it thinks
    that it may have.

    Both start with 0 at the origin: the first frame with a known true pose, or the first of all
    without truth.
    """

    time_s: FloatArray
    """Since the first frame of the run, [N]."""
    distance_m: FloatArray
    """Travelled, as estimated, [N]."""
    T_world_cam: FloatArray
    """Estimate, [N, 4, 4], m."""
    T_world_cam_true: FloatArray | None
    """Truth, made equal to the estimate at the origin, [N, 4, 4], m; NaN where unknown."""
    error: FloatArray | None
    """[ρ; φ] along each camera's axes, [N, 6], m and rad; NaN where unknown."""
    cov: FloatArray
    """Claimed covariance of it, [N, 6, 6]; 0 up to the origin."""

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
    """Drift of a run; the truth, T_world_cam [N, 4, 4], may have any world frame, NaN poses, and
    needs two others."""
    known = (
        np.flatnonzero(np.isfinite(truth).all(axis=(1, 2)))
        if truth is not None
        else np.empty(0, dtype=np.int64)
    )
    origin = 0
    T_world_cam_true = None
    error = None
    if truth is not None and len(known) >= 2:
        origin = int(known[0])
        T_world_cam_true = result.T_world_cam[origin] @ se3.inverse(truth[origin]) @ truth
        error = drift_errors(result.T_world_cam, T_world_cam_true)
    steps = (result.T_curr_prev, result.cov, result.common_mode, result.path_cross_cov)
    cov = drift_covariances(*(array[origin:] for array in steps))
    return Drift(
        time_s=(result.stamps_ns - result.stamps_ns[0]) * 1e-9,
        distance_m=distance_along_path(result.T_world_cam),
        T_world_cam=result.T_world_cam,
        T_world_cam_true=T_world_cam_true,
        error=error,
        cov=np.concatenate([np.zeros((origin, 6, 6)), cov]),
    )

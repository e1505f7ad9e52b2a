"""All figures of merit of a run against its ground truth, as in ``metrics.json``."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from probevo.arrays import FloatArray
from probevo.errors import InputError
from probevo.evaluation import segments, trajectory_errors
from probevo.evaluation.consistency import motion_consistency


@dataclass(frozen=True)
class Metrics:
    """Figures of merit over the frames whose true pose is known; None where one is not defined.

    Positions and attitudes are relative to the first of these frames. Segment errors, RPE and NEES
    do not depend on it.
    """

    num_frames: int
    """Frames with a known true pose."""
    armse_m: float | None = None
    """Average root mean square error of the position, mean_k √(‖e_k‖²/3), unaligned; PROBE,
    Table I."""
    final_error_m: float | None = None
    """Distance between estimated and true position at the last known frame, unaligned."""
    rot_armse_rad: float | None = None
    """ARMSE of the attitude: as ``armse_m``, for the rotation vector of the attitude error."""
    path_length_m: float | None = None
    """Length of the polyline through the known true positions: shorter than the true path
    where few are known."""
    ate_rmse_m: float | None = None
    """Absolute trajectory error, RMS over frames after the best rigid alignment."""
    ate_unaligned_rmse_m: float | None = None
    """RMS of the position error with the first poses made equal, instead of an alignment."""
    kitti_t_percent: float | None = None
    """Translation error over segments of 100, 200 … 800 m from every tenth frame. Where the truth
    is sparse, segments are longer (``segments.segment_errors``), also for
    ``short_t_percent``."""
    kitti_r_deg_per_m: float | None = None
    """Rotation error over the same segments."""
    short_t_percent: float | None = None
    """Translation error over segments of 10, 20, 30, 40, 50 m from every frame."""
    short_r_deg_per_m: float | None = None
    """Rotation error over the same segments."""
    rpe_t_m: float | None = None
    """Relative pose error frame to frame, RMS of the translation."""
    rpe_r_deg: float | None = None
    """Relative pose error frame to frame, RMS of the angle."""
    anees: float | None = None
    """Average NEES of the relative motions; 6 is consistent, unless the truth is itself noisy, as
    KITTI's is."""
    nees_coverage: dict[str, float] | None = None
    """Share, 0 … 1, of the relative motions inside their 50, 90, 95 and 99 % ellipsoids, keyed by
    that percentage."""
    smoothed: dict[str, float | None] | None = None
    """``armse_m``, ``final_error_m``, ``short_t_percent`` and ``short_r_deg_per_m`` of the smoothed
    path; None without a window. The caller of ``evaluate`` sets it."""
    out_of_domain: float | None = None
    """Share, 0 … 1, of the features used that lie outside of the noise model's domain; None if the
    model has no domain. The caller of ``evaluate`` takes it from the run: it needs no truth."""
    faults: dict[str, int] | None = None
    """Lost frames, steps that were not solved by their status, and samples and features that could
    not be used, by name; only those that occurred. The caller takes it from the run."""
    stopped: str | None = None
    """What stopped the run before its last frame; None if nothing did. The caller of ``evaluate``
    takes it from the run, too."""

    def of_path(self) -> dict[str, float | None]:
        """Return the errors that ``smoothed`` compares."""
        return {
            "armse_m": self.armse_m,
            "final_error_m": self.final_error_m,
            "short_t_percent": self.short_t_percent,
            "short_r_deg_per_m": self.short_r_deg_per_m,
        }

    def as_dict(self) -> dict[str, object]:
        """Convert to plain values, in the order above."""
        return asdict(self)


def evaluate(
    T_world_cam_est: FloatArray,
    T_world_cam_true: FloatArray,
    T_curr_prev: FloatArray | None = None,
    cov: FloatArray | None = None,
) -> Metrics:
    """Compare an estimated trajectory with the truth.

    Args:
        T_world_cam_est: estimated poses, [N, 4, 4], m.
        T_world_cam_true: true poses of the same frames, [N, 4, 4], m; NaN where unknown. World
            frames may differ.
        T_curr_prev: estimated relative motions, [N-1, 4, 4], m.
        cov: covariance of their left perturbation, [N-1, 6, 6]. Without both, the consistency is
            left out.

    Raises:
        InputError: the truth has another number of frames than the estimate.
    """
    if len(T_world_cam_est) != len(T_world_cam_true):
        raise InputError(
            "ground truth",
            f"has {len(T_world_cam_true)} poses, the estimate has {len(T_world_cam_est)}.",
            "Give one true pose a frame, NaN where it is unknown.",
        )
    # Frames whose true pose is known, [K]; one alone has no motion.
    frames = np.flatnonzero(np.isfinite(T_world_cam_true).all(axis=(1, 2)))
    if len(frames) < 2:
        return Metrics(num_frames=len(frames))
    # Errors of the trajectory: only frames with a known pose count.
    est = T_world_cam_est[frames]
    true = T_world_cam_true[frames]
    e_m = trajectory_errors.position_errors(est, true)
    # KITTI's segments start at every tenth frame of the recording, not of those known.
    kitti = segments.segment_errors(
        est,
        true,
        segments.KITTI_LENGTHS_M,
        starts=np.flatnonzero(frames % 10 == 0),
        frames=frames,
    )
    short = segments.segment_errors(
        est, true, segments.SHORT_LENGTHS_M, starts=np.arange(len(frames)), frames=frames
    )
    # Errors of single steps: both poses of a step have to be known, so that all frames go in.
    rpe = trajectory_errors.rpe_rmse(T_world_cam_est, T_world_cam_true)
    consistency = None
    if T_curr_prev is not None and cov is not None:
        consistency = motion_consistency(
            T_curr_prev, cov, trajectory_errors.relative_motions(T_world_cam_true)
        )
    return Metrics(
        num_frames=len(frames),
        armse_m=trajectory_errors.armse(e_m),
        final_error_m=float(np.linalg.norm(e_m[-1])),
        rot_armse_rad=trajectory_errors.armse(trajectory_errors.rotation_errors(est, true)),
        path_length_m=trajectory_errors.path_length(true),
        ate_rmse_m=trajectory_errors.ate_rmse(est, true),
        ate_unaligned_rmse_m=trajectory_errors.ate_rmse(est, true, align=False),
        kitti_t_percent=kitti.mean_translation_percent,
        kitti_r_deg_per_m=kitti.mean_rotation_deg_per_m,
        short_t_percent=short.mean_translation_percent,
        short_r_deg_per_m=short.mean_rotation_deg_per_m,
        rpe_t_m=rpe[0] if rpe else None,
        rpe_r_deg=rpe[1] if rpe else None,
        anees=consistency.anees if consistency else None,
        nees_coverage=consistency.coverage if consistency else None,
    )

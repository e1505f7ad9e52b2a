"""What a run leaves behind: its motions, their covariances, and how each came about."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.geometry import se3
from probevo.motion.estimate import MotionEstimate


@dataclass(frozen=True)
class RunResult:
    """A run over N frames. The first frame has a pose but no motion: the arrays of motions start at the second."""

    stamps_ns: IntArray
    """[N]."""
    T_world_cam: FloatArray
    """Poses of the left camera, world = first camera, [N, 4, 4], m."""
    T_curr_prev: FloatArray
    """Relative motions, [N-1, 4, 4], m."""
    cov: FloatArray
    """Covariance of the left perturbation [ρ; φ] of each motion, [N-1, 6, 6], m and rad."""
    shared: FloatArray
    """Columns of the errors that all motions share, [N-1, 6, 3]: see ``MotionEstimate.shared``."""
    status: IntArray
    """``motion.estimate.Status`` of each motion, [N-1]."""
    num_tracks: IntArray
    """[N-1]."""
    num_inliers: IntArray
    """Tracks that were trusted, [N-1]."""
    stage_ms: dict[str, FloatArray]
    """Wall time of each stage, [N-1], ms, by name in the order of the flow; 0 where a stage did not run."""
    total_ms: FloatArray
    """Wall time of the whole step, [N-1], ms."""
    rejected: dict[str, int] = field(default_factory=dict)
    """How many candidate points each consistency check turned away in all, by the check's name."""
    num_used: IntArray | None = None
    """Tracks that were solved with, [N-1]; None in the files of versions that did not say."""
    num_foreign: IntArray | None = None
    """Those of them that lie where the noise model has seen no training data, [N-1]; None if it knows of no such place.
    """

    @property
    def out_of_domain(self) -> float | None:
        """Share, 0 … 1, of all features solved with that lie where the noise model has seen no training data."""
        if self.num_used is None or self.num_foreign is None or not self.num_used.any():
            return None
        return float(self.num_foreign.sum() / self.num_used.sum())

    def __len__(self) -> int:
        """Number of frames N."""
        return len(self.stamps_ns)


class RunRecorder:
    """Collects the estimates of a run as they come; ``result`` may be asked for at any time."""

    def __init__(self) -> None:
        self._stamps_ns: list[int] = []
        self._motions: list[MotionEstimate] = []
        self._total_ms: list[float] = []
        self._rejected: Counter[str] = Counter()

    def add(
        self,
        stamp_ns: int,
        motion: MotionEstimate,
        *,
        total_ms: float | None = None,
        rejected: Mapping[str, int] | None = None,
    ) -> None:
        """Take in the estimate of the next frame.

        Args:
            stamp_ns: time of the frame.
            motion: its estimate; that of the first frame gives nothing but a place to start from.
            total_ms: wall time of the step; the sum of its stages by default.
            rejected: points turned away at this step, by the check's name.
        """
        self._stamps_ns.append(stamp_ns)
        self._motions.append(motion)
        self._total_ms.append(sum(motion.stage_ms.values()) if total_ms is None else total_ms)
        self._rejected.update(rejected or {})

    def result(self) -> RunResult:
        """All that was taken in so far."""
        steps = self._motions[1:]
        T_curr_prev = np.array([m.T_curr_prev for m in steps]).reshape(-1, 4, 4)
        foreign = None
        if any(m.num_foreign is not None for m in steps):
            foreign = np.array([m.num_foreign or 0 for m in steps], dtype=np.int64)
        stages = dict.fromkeys(name for m in steps for name in m.stage_ms)
        return RunResult(
            stamps_ns=np.array(self._stamps_ns, dtype=np.int64),
            T_world_cam=chain_motions(T_curr_prev)[: len(self._stamps_ns)],
            T_curr_prev=T_curr_prev,
            cov=np.array([m.cov for m in steps]).reshape(-1, 6, 6),
            shared=np.array([m.shared for m in steps]).reshape(-1, 6, 3),
            status=np.array([int(m.status) for m in steps], dtype=np.int64),
            num_tracks=np.array([m.num_tracks for m in steps], dtype=np.int64),
            num_inliers=np.array([m.num_inliers for m in steps], dtype=np.int64),
            stage_ms={name: np.array([m.stage_ms.get(name, 0.0) for m in steps]) for name in stages},
            total_ms=np.array(self._total_ms[1:], dtype=np.float64),
            rejected=dict(self._rejected),
            num_used=np.array([m.num_used for m in steps], dtype=np.int64),
            num_foreign=foreign,
        )


def chain_motions(T_curr_prev: Iterable[FloatArray]) -> FloatArray:
    """Poses T_world_cam, [N, 4, 4], world = first camera, from N-1 relative motions: T_w,k = T_w,k-1 T_k,k-1⁻¹."""
    poses = [np.eye(4)]
    for motion in T_curr_prev:
        poses.append(poses[-1] @ se3.inverse(motion))
    return np.array(poses)

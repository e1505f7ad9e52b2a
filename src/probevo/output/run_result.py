"""What a run leaves behind: its motions, their covariances, and how each came about."""

from __future__ import annotations

from array import array
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
    """Collects the estimates of a run as they come, 700 bytes each; ``result`` may be asked for at any time."""

    def __init__(self) -> None:
        # Arrays that grow, of plain numbers: as objects, the same would take four times the memory.
        self._stamps_ns, self._total_ms = array("q"), array("d")
        self._T_curr_prev, self._cov, self._shared = array("d"), array("d"), array("d")
        self._counts = array("q")
        """Status, tracks, trusted, used, foreign (−1 for None) of each step."""
        self._stage_ms: dict[str, array[float]] = {}
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
        self._rejected.update(rejected or {})
        if len(self._stamps_ns) == 1:
            return
        for name in motion.stage_ms:
            if name not in self._stage_ms:
                self._stage_ms[name] = array("d", bytes(8 * len(self._total_ms)))  # zeros
        for name, times_ms in self._stage_ms.items():
            times_ms.append(motion.stage_ms.get(name, 0.0))
        self._total_ms.append(sum(motion.stage_ms.values()) if total_ms is None else total_ms)
        self._T_curr_prev.frombytes(motion.T_curr_prev.tobytes())
        self._cov.frombytes(motion.cov.tobytes())
        self._shared.frombytes(motion.shared.tobytes())
        foreign = -1 if motion.num_foreign is None else motion.num_foreign
        self._counts.extend((motion.status, motion.num_tracks, motion.num_inliers, motion.num_used, foreign))

    def result(self) -> RunResult:
        """All that was taken in so far."""
        T_curr_prev = np.array(self._T_curr_prev).reshape(-1, 4, 4)
        status, num_tracks, num_inliers, num_used, foreign = np.array(self._counts).reshape(-1, 5).T.copy()
        return RunResult(
            stamps_ns=np.array(self._stamps_ns),
            T_world_cam=chain_motions(T_curr_prev)[: len(self._stamps_ns)],
            T_curr_prev=T_curr_prev,
            cov=np.array(self._cov).reshape(-1, 6, 6),
            shared=np.array(self._shared).reshape(-1, 6, 3),
            status=status,
            num_tracks=num_tracks,
            num_inliers=num_inliers,
            stage_ms={name: np.array(times_ms) for name, times_ms in self._stage_ms.items()},
            total_ms=np.array(self._total_ms),
            rejected=dict(self._rejected),
            num_used=num_used,
            num_foreign=np.maximum(foreign, 0) if (foreign >= 0).any() else None,
        )


def chain_motions(T_curr_prev: Iterable[FloatArray]) -> FloatArray:
    """Poses T_world_cam, [N, 4, 4], world = first camera, from N-1 relative motions: T_w,k = T_w,k-1 T_k,k-1⁻¹."""
    poses = [np.eye(4)]
    for motion in T_curr_prev:
        poses.append(poses[-1] @ se3.inverse(motion))
    return np.array(poses)

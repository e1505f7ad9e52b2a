"""The supervision of a drive, its true motion as far as it is known, and the error α of PROBE."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np

from probevo.arrays import BoolArray, FloatArray, IntArray
from probevo.config.training import SupervisionName
from probevo.errors import InputError
from probevo.evaluation.trajectory_errors import armse, rigid_alignment
from probevo.geometry import se3, so3
from probevo.geometry.uncertainty import compound_chain
from probevo.sequences.base import Sequence
from probevo.sequences.stamps import NS_PER_S

MIN_ALPHA_M = 1e-6
"""Smallest error α: a smaller one is due to chance, and its logarithm would weigh most."""
LOOP_SIGMA = np.array([0.1, 0.1, 0.1, 0.02, 0.02, 0.02])
"""Standard deviation of a loop closure that was not measured, m and rad: the vehicle is parked by
hand."""
MIN_POSITIONS = 4
"""Minimum number of positions for the alignment of a path; three always fit."""


@dataclass(frozen=True)
class Supervision:
    """Stretches of a drive over which the true motion is known."""

    kind: SupervisionName
    frames: IntArray
    """Frames whose truth is used, ascending, [F]."""
    T_world_cam: FloatArray
    """Their true poses, [F, 4, 4]; with ``position`` only the positions count."""

    @property
    def is_assumed(self) -> bool:
        """Whether it is a loop that is assumed to close, without a measurement of its ends."""
        return self.kind == "loop" and bool((self.T_world_cam == np.eye(4)).all())

    def completed(self, T_curr_prev: FloatArray) -> Supervision:
        """Return the supervision, with the motions of all features instead of unknown truth.

        Args:
            T_curr_prev: motion of each step, [K − 1, 4, 4], which replaces the truth if the kind is
                ``none``.
        """
        return from_step_to_step(T_curr_prev) if self.kind == "none" else self

    @property
    def stretches(self) -> IntArray:
        """First and last frame of each of U stretches, [U, 2]."""
        if self.kind in ("position", "loop"):
            return np.array([[self.frames[0], self.frames[-1]]])
        return np.column_stack([self.frames[:-1], self.frames[1:]])

    def stretch_of_step(self, num_steps: int) -> IntArray:
        """Return the stretch that each step belongs to, [num_steps]; −1 for none.

        Step k leads to frame k + 1.
        """
        stretch = np.full(num_steps, -1)
        for number, (first, last) in enumerate(self.stretches.tolist()):
            stretch[first:last] = number
        return stretch

    @property
    def digest(self) -> str:
        """SHA-256 of the truth that is used."""
        frames = np.asarray(self.frames, np.int64)
        poses = np.asarray(self.T_world_cam, np.float64)
        return hashlib.sha256(frames.tobytes() + poses.tobytes()).hexdigest()

    def errors(self, T_curr_prev: FloatArray) -> FloatArray:
        """Compute the error α of motions over each of the U stretches.

        It is the RMS over the axes of the translation error, √(‖Δr‖²/3) (PROBE IV-A), of the motion
        from the first to the last frame of the stretch; with ``position``, the ARMSE of the path
        after the best rigid alignment.

        Args:
            T_curr_prev: motion of each step, [K − 1, 4, 4].

        Returns:
            α, [U], m.
        """
        estimated = se3.chain_motions(T_curr_prev)[self.frames]
        true = self.T_world_cam
        if self.kind == "position":
            # Without attitudes, the path is aligned as a whole, and has one error.
            positions = estimated[:, :3, 3]
            true_positions = true[:, :3, 3]
            T_true_est = rigid_alignment(positions, true_positions)
            aligned = se3.transform(T_true_est, positions)
            return np.maximum([armse(aligned - true_positions)], MIN_ALPHA_M)

        # Otherwise compare the motion over each stretch, T_start_end, of which the position counts;
        # a loop is one stretch.
        last = len(self.frames) - 1
        starts = np.array([0]) if self.kind == "loop" else np.arange(last)
        ends = np.array([last]) if self.kind == "loop" else np.arange(last) + 1
        estimated_m = (se3.inverse(estimated[starts]) @ estimated[ends])[:, :3, 3]
        true_m = (se3.inverse(true[starts]) @ true[ends])[:, :3, 3]
        alphas: FloatArray = np.linalg.norm(estimated_m - true_m, axis=1) / np.sqrt(3.0)
        return np.maximum(alphas, MIN_ALPHA_M)

    def predicted_errors(self, T_curr_prev: FloatArray, cov: FloatArray) -> FloatArray:
        """Compute the error α that the covariances of the motions predict over each stretch.

        Args:
            T_curr_prev: motion of each step, [K − 1, 4, 4].
            cov: covariance of each motion, [K − 1, 6, 6].

        Returns:
            √(tr Σ_r/3) at the end of each stretch, [U], m.
        """
        alphas = np.empty(len(self.stretches))
        for number, (first, last) in enumerate(self.stretches.tolist()):
            # A perturbation of the last pose moves its position by ρ − p∧ φ: Exp(ξ) acts on the
            # left, so that p becomes p + ρ + φ × p.
            T_start_cam, cov_end = compound_chain(T_curr_prev[first:last], cov[first:last])
            to_position = np.hstack([np.eye(3), -so3.wedge(T_start_cam[-1, :3, 3])])
            alphas[number] = np.sqrt(np.trace(to_position @ cov_end[-1] @ to_position.T) / 3.0)
        return np.maximum(alphas, MIN_ALPHA_M)


def supervision_of(
    sequence: Sequence, kind: SupervisionName, every_s: float, num_frames: int
) -> Supervision:
    """Return the part of a recording's truth that is used.

    Args:
        sequence: the recording.
        kind: what is known.
        every_s: time between the frames whose truth is used; 0 uses all.
        num_frames: number of its frames that are used.

    Raises:
        InputError: there is no truth, or too little for this kind.
    """
    # Poses of the frames that are used, NaN where unknown; a pose counts as known if all its
    # entries are finite.
    where = sequence.path
    poses = np.full((num_frames, 4, 4), np.nan)
    if sequence.truth is not None:
        poses = sequence.truth.T_world_cam[:num_frames]
    is_known: BoolArray = np.asarray(np.isfinite(poses).all(axis=(1, 2)))
    if kind == "none":
        return Supervision(kind, np.arange(num_frames), poses)
    if kind == "loop":
        return _loop(sequence, poses, is_known)

    # The other kinds need truth, and enough of it.
    if not is_known.any():
        raise InputError(
            where,
            f"it has no ground truth, which --supervision {kind} needs.",
            "Take --supervision none, or loop if it ends where it began; the default is gt.",
        )
    if kind == "gt" and not is_known.all():
        raise InputError(
            where,
            f"only {is_known.sum()} of {len(is_known)} frames have a true pose.",
            "Take --supervision sparse.",
        )
    # Some of the known frames, at the wanted distance in time; stretches lie between them.
    frames = _spaced(np.flatnonzero(is_known), sequence.stamps_ns, every_s)
    fewest = MIN_POSITIONS if kind == "position" else 2
    if len(frames) < fewest:
        raise InputError(
            where,
            f"the truth of {len(frames)} frames is used; --supervision {kind} needs {fewest}.",
            "Give a longer recording, or a smaller --every-s.",
        )
    return Supervision(kind, frames, poses[frames])


def _loop(sequence: Sequence, poses: FloatArray, is_known: BoolArray) -> Supervision:
    """Return the true ends of a loop, or the assumption that it closes.

    The truth of a frame next to an end stands for it.

    Args:
        sequence: the recording.
        poses: true poses of the frames that are used, [num_frames, 4, 4].
        is_known: which of them are known, [num_frames].

    Raises:
        InputError: the end of the loop is not known, and the last frames are not used; or the
            truth, as far as it is known, is no loop.
    """
    num_frames = len(poses)
    known = np.flatnonzero(is_known)
    # Measured ends need not coincide.
    if len(known) >= 2 and known[0] <= 1 and known[-1] >= num_frames - 2:
        ends = known[[0, -1]]
        return Supervision("loop", ends, poses[ends])
    # Without them, the loop closes only if it is run to its end.
    if num_frames < len(sequence):
        raise InputError(
            sequence.path,
            f"only {num_frames} of its {len(sequence)} frames are used, but the loop closes at the"
            " last one.",
            "Leave out --max-frames.",
        )
    if len(known) >= 2:
        _refuse_open(sequence, poses[known, :3, 3], known, num_frames)
    ends = np.array([0, num_frames - 1])
    return Supervision("loop", ends, np.stack([np.eye(4), np.eye(4)]))


def _refuse_open(
    sequence: Sequence, positions: FloatArray, known: IntArray, num_frames: int
) -> None:
    """Refuse a recording whose truth, as far as it is known, cannot return to where it began.

    Args:
        sequence: the recording.
        positions: the known true positions, [F, 3], m.
        known: their frames, ascending, [F].
        num_frames: number of its frames that are used.

    Raises:
        InputError: its ends are too far from each other.
    """
    # In the frames without truth, it moves by no more than where it is fastest.
    lengths = np.linalg.norm(np.diff(positions, axis=0), axis=1) / np.diff(known)
    num_unknown = num_frames - 1 - int(known[-1] - known[0])
    gap_m = float(np.linalg.norm(positions[-1] - positions[0]))
    if gap_m > 3.0 * LOOP_SIGMA[0] + num_unknown * lengths.max():
        raise InputError(
            sequence.path,
            f"it is no loop: its truth ends {gap_m:.1f} m from where it begins.",
            "Take --supervision sparse.",
        )


def from_step_to_step(T_curr_prev: FloatArray) -> Supervision:
    """Return the supervision in which these motions, [K − 1, 4, 4], stand for the truth."""
    return Supervision("none", np.arange(len(T_curr_prev) + 1), se3.chain_motions(T_curr_prev))


def _spaced(frames: IntArray, stamps_ns: IntArray, every_s: float) -> IntArray:
    """Return the first frame, and then each that is at least every_s after the last one taken."""
    if every_s == 0.0:
        return frames
    taken = []
    due_ns = -np.inf
    for frame in frames.tolist():
        if stamps_ns[frame] >= due_ns:
            taken.append(frame)
            due_ns = stamps_ns[frame] + every_s * NS_PER_S
    return np.array(taken, np.int64)

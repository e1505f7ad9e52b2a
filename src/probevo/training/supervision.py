"""What is known of a drive, and the α of PROBE: how far motions are from it, over a step, a stretch
or all the path."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np

from probevo.arrays import BoolArray, FloatArray, IntArray
from probevo.errors import InputError
from probevo.evaluation.trajectory_errors import armse, rigid_alignment
from probevo.geometry import se3, so3
from probevo.geometry.uncertainty import compound_chain
from probevo.sequences.base import Sequence
from probevo.sequences.stamps import NS_PER_S
from probevo.training.settings import SupervisionName

LEAST_ALPHA_M = 1e-6
"""An error below a thousandth of a millimetre is chance; its logarithm would weigh most."""
FEWEST_POSITIONS = 4
"""To align a path with; three always fit."""


@dataclass(frozen=True)
class Supervision:
    """Stretches of a drive over which the motion is known, and what it truly was."""

    kind: SupervisionName
    frames: IntArray
    """Frames whose truth is used, ascending, [F]."""
    T_world_cam: FloatArray
    """Their true poses, [F, 4, 4]; of ``position``, only the positions count."""

    @property
    def is_assumed(self) -> bool:
        """Whether it is a loop of which nobody has measured how well it closes."""
        return self.kind == "loop" and bool((self.T_world_cam == np.eye(4)).all())

    def completed(self, T_curr_prev: FloatArray) -> Supervision:
        """With ``none``, the motions of all features, [K − 1, 4, 4], in place of the truth; else as
        it is."""
        return from_step_to_step(T_curr_prev) if self.kind == "none" else self

    @property
    def stretches(self) -> IntArray:
        """First and last frame of each of U stretches, [U, 2]."""
        if self.kind in ("position", "loop"):
            return self.frames[[[0, -1]]]
        return np.column_stack([self.frames[:-1], self.frames[1:]])

    def stretch_of_step(self, num_steps: int) -> IntArray:
        """The stretch that each step belongs to, [num_steps]; −1 for none. Step k leads to frame k
        + 1."""
        owner = np.full(num_steps, -1)
        for number, (first, last) in enumerate(self.stretches.tolist()):
            owner[first:last] = number
        return owner

    @property
    def digest(self) -> str:
        """SHA-256 of the truth that is used."""
        content = (
            np.asarray(self.frames, np.int64).tobytes()
            + np.asarray(self.T_world_cam, np.float64).tobytes()
        )
        return hashlib.sha256(content).hexdigest()

    def errors(self, T_curr_prev: FloatArray) -> FloatArray:
        """α of motions T_curr_prev [K − 1, 4, 4] over each of the U stretches, [U], m.

        It is the RMS over the axes of the translation's error, √(‖Δr‖²/3) (PROBE IV-A): of the
        motion from the first to the last frame of the stretch; for ``position`` the ARMSE of the
        path after the best rigid fit.
        """
        T_world_cam = se3.chain_motions(T_curr_prev)[self.frames]
        if self.kind == "position":
            positions = T_world_cam[:, :3, 3]
            true = self.T_world_cam[:, :3, 3]
            T_true_est = rigid_alignment(positions, true)
            return np.maximum([armse(se3.transform(T_true_est, positions) - true)], LEAST_ALPHA_M)
        last = len(self.frames) - 1
        start, end = (
            ([0], [last]) if self.kind == "loop" else (np.arange(last), np.arange(last) + 1)
        )
        estimated, true = (
            (se3.inverse(poses[start]) @ poses[end])[:, :3, 3]
            for poses in (T_world_cam, self.T_world_cam)
        )
        alphas: FloatArray = np.linalg.norm(estimated - true, axis=1) / np.sqrt(3.0)
        return np.maximum(alphas, LEAST_ALPHA_M)

    def expected_errors(self, T_curr_prev: FloatArray, cov: FloatArray) -> FloatArray:
        """α that motions with these covariances, [K − 1, 6, 6], should have: √(tr Σ_r/3) at each
        stretch's end, [U]."""
        alphas = np.empty(len(self.stretches))
        for number, (first, last) in enumerate(self.stretches.tolist()):
            T_start_cam, cov_end = compound_chain(T_curr_prev[first:last], cov[first:last])
            to_position = np.hstack([np.eye(3), -so3.wedge(T_start_cam[-1, :3, 3])])
            alphas[number] = np.sqrt(np.trace(to_position @ cov_end[-1] @ to_position.T) / 3.0)
        return np.maximum(alphas, LEAST_ALPHA_M)


def supervision_of(
    sequence: Sequence, kind: SupervisionName, every_s: float, num_frames: int
) -> Supervision:
    """What is used of the truth of a recording.

    Args:
        sequence: the recording.
        kind: what is known.
        every_s: time between the frames whose truth is used; 0 uses all.
        num_frames: frames of it that are used.

    Raises:
        InputError: there is no truth, or too little for this kind.
    """
    where = sequence.path
    poses = (
        np.full((num_frames, 4, 4), np.nan)
        if sequence.truth is None
        else sequence.truth.T_world_cam[:num_frames]
    )
    known: BoolArray = np.asarray(np.isfinite(poses).all(axis=(1, 2)))
    if kind == "loop":
        ends = np.array([0, num_frames - 1])
        if known[ends].all():
            return Supervision(kind, ends, poses[ends])
        if num_frames < len(sequence):
            what = (
                f"only {num_frames} of its {len(sequence)} frames are used, but the loop closes at"
                " the last one."
            )
            raise InputError(where, what, "Leave out --max-frames.")
        return Supervision(kind, ends, np.stack([np.eye(4)] * 2))
    if kind == "none":
        return Supervision(kind, np.arange(num_frames), poses)
    if not known.any():
        what = f"it has no ground truth, which --supervision {kind} needs."
        raise InputError(where, what, "Take --supervision none, or loop if it ends where it began.")
    if kind == "gt" and not known.all():
        what = f"only {known.sum()} of {len(known)} frames have a true pose."
        raise InputError(where, what, "Take --supervision sparse.")
    frames = _spaced(np.flatnonzero(known), sequence.stamps_ns, every_s)
    fewest = FEWEST_POSITIONS if kind == "position" else 2
    if len(frames) < fewest:
        what = f"the truth of {len(frames)} frames is used; --supervision {kind} needs {fewest}."
        raise InputError(where, what, "Give a longer recording, or a smaller --every-s.")
    return Supervision(kind, frames, poses[frames])


def from_step_to_step(T_curr_prev: FloatArray) -> Supervision:
    """These motions, [K − 1, 4, 4], as if they were the truth."""
    return Supervision("none", np.arange(len(T_curr_prev) + 1), se3.chain_motions(T_curr_prev))


def _spaced(frames: IntArray, stamps_ns: IntArray, every_s: float) -> IntArray:
    """Of these frames the first, and then each that is at least so much later than the last one
    taken."""
    if every_s == 0.0:
        return frames
    taken = []
    due_ns = -np.inf
    for frame in frames.tolist():
        if stamps_ns[frame] >= due_ns:
            taken.append(frame)
            due_ns = stamps_ns[frame] + every_s * NS_PER_S
    return np.array(taken, np.int64)

"""A recording, tracked and solved once: all that training needs to know of it, without its images."""

from __future__ import annotations

import io
from collections.abc import Iterable
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from probevo.arrays import AnyArray, BoolArray, FloatArray, IntArray
from probevo.tracking.tracks import Tracks

SINGLE = ("prev_px", "curr_px", "phi")
"""What is of single precision on disk."""


@dataclass(frozen=True)
class Drive:
    """K − 1 consecutive steps of a recording, all of them or a part, and the n features of all
    steps, in their order.

    On disk, pixels and predictors are of single precision: half the size, and 0.0001 px at most.
    """

    T_curr_prev: FloatArray
    """Motion of each step as all its features give it, [K − 1, 4, 4]."""
    numbers: IntArray
    """Which step of the recording each is, ascending, [K − 1]; what is missing in between was not
    taken."""
    first_of_step: IntArray
    """Where the features of each step begin, and the end of the last, [K]."""
    prev_px: FloatArray
    """(u_l, v_l, u_r, v_r) of each feature in the frame before, corrected, [n, 4]."""
    curr_px: FloatArray
    """The same in the current frame."""
    ids: IntArray
    """Identity of its track, [n]."""
    phi: FloatArray
    """Its place in the prediction space, [n, M]."""
    used: BoolArray
    """Whether the step was solved and this one had a part in it, [n]; RANSAC and the pre-filter
    turn some away."""

    def rows(self, step: int) -> slice:
        """Where the features of a step are."""
        return slice(*self.first_of_step[step : step + 2].tolist())

    def tracks(self, step: int) -> Tracks:
        """The features of a step; their ages are not kept."""
        rows = self.rows(step)
        return Tracks(
            self.prev_px[rows],
            self.curr_px[rows],
            self.ids[rows],
            age=np.zeros(rows.stop - rows.start, np.int64),
        )

    @property
    def step_of_feature(self) -> IntArray:
        """The step that each feature belongs to, [n]."""
        return np.repeat(np.arange(len(self.T_curr_prev)), np.diff(self.first_of_step))

    def kept(self, steps: BoolArray) -> Drive:
        """Only the steps that are marked, [K − 1]."""
        rows = steps[self.step_of_feature]
        features = {
            name: getattr(self, name)[rows] for name in ("prev_px", "curr_px", "ids", "phi", "used")
        }
        counts = np.diff(self.first_of_step)[steps]
        return Drive(
            self.T_curr_prev[steps],
            self.numbers[steps],
            np.concatenate([[0], np.cumsum(counts)]),
            **features,
        )


def joined(parts: Iterable[Drive]) -> Drive:
    """One after another as one."""
    found = list(parts)
    arrays = {
        field.name: np.concatenate([getattr(part, field.name) for part in found])
        for field in fields(Drive)
    }
    counts = np.concatenate([np.diff(part.first_of_step) for part in found])
    return Drive(**arrays | {"first_of_step": np.concatenate([[0], np.cumsum(counts)])})


def drive_bytes(drive: Drive) -> bytes:
    """An ``.npz`` file."""
    arrays: dict[str, AnyArray] = {
        field.name: getattr(drive, field.name) for field in fields(Drive)
    }
    arrays |= {name: arrays[name].astype(np.float32) for name in SINGLE}
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **arrays)
    return buffer.getvalue()


def load_drive(path: Path) -> Drive:
    """Read what ``drive_bytes`` gave."""
    with np.load(path, allow_pickle=False) as archive:
        arrays = {field.name: archive[field.name] for field in fields(Drive)}
    wide: dict[str, AnyArray] = {name: arrays[name].astype(np.float64) for name in SINGLE}
    return Drive(**arrays | wide)

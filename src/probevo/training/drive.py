"""A drive: a recording that is tracked and solved once; all that training needs, without images."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

from probevo.arrays import AnyArray, BoolArray, FloatArray, IntArray, concatenated
from probevo.storage.npz import read_npz, write_npz
from probevo.tracking.tracks import Tracks

SINGLE = ("prev_px", "curr_px", "phi")
"""Arrays that are of single precision on disk."""


@dataclass(frozen=True)
class Drive:
    """K − 1 consecutive steps of a recording, or a part of them, and the n features of all steps.

    On disk, pixels and predictors are of single precision: this halves the size and changes a pixel
    coordinate by at most 0.0001 px.
    """

    T_curr_prev: FloatArray
    """Motion of each step, solved with all its features, [K − 1, 4, 4]."""
    numbers: IntArray
    """Number of each step in the recording, ascending, [K − 1]; gaps are steps that were left
    out."""
    first_of_step: IntArray
    """Index of the first feature of each step, and the end of the last step, [K]."""
    prev_px: FloatArray
    """(u_l, v_l, u_r, v_r) of each feature in the previous frame, corrected, [n, 4]."""
    curr_px: FloatArray
    """The same in the current frame."""
    ids: IntArray
    """Identity of the track of each feature, [n]."""
    phi: FloatArray
    """Place of each feature in the prediction space, [n, M]."""
    used: BoolArray
    """Whether the step was solved and the feature took part, [n]: RANSAC and the gyro's pre-filter
    reject some."""

    def rows(self, step: int) -> slice:
        """Return the features of a step."""
        return slice(int(self.first_of_step[step]), int(self.first_of_step[step + 1]))

    def tracks(self, step: int) -> Tracks:
        """Return the features of a step as tracks; their ages are not known."""
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

    def subset(self, steps: BoolArray) -> Drive:
        """Return the drive with the marked steps only, [K − 1]."""
        # The mask of the steps, spread to their features, [n]
        rows = steps[self.step_of_feature]
        counts = np.diff(self.first_of_step)[steps]
        return Drive(
            T_curr_prev=self.T_curr_prev[steps],
            numbers=self.numbers[steps],
            first_of_step=np.concatenate([[0], np.cumsum(counts)]),
            prev_px=self.prev_px[rows],
            curr_px=self.curr_px[rows],
            ids=self.ids[rows],
            phi=self.phi[rows],
            used=self.used[rows],
        )


def joined(parts: Iterable[Drive]) -> Drive:
    """Concatenate the parts of a drive."""
    # Feature indices begin at 0 in each part, and are counted anew over all parts.
    drives = list(parts)
    counts = np.concatenate([np.diff(part.first_of_step) for part in drives])
    return replace(concatenated(drives), first_of_step=np.concatenate([[0], np.cumsum(counts)]))


def save_drive(path: Path, drive: Drive) -> None:
    """Write a drive as an ``.npz`` file, completely or not at all.

    Raises:
        InputError: the file cannot be written.
    """
    arrays: dict[str, AnyArray] = {
        field.name: getattr(drive, field.name) for field in fields(Drive)
    }
    # Half the size; no array is computed with in single precision.
    for name in SINGLE:
        arrays[name] = arrays[name].astype(np.float32)
    write_npz(path, arrays)


def load_drive(path: Path) -> Drive:
    """Read a file that ``save_drive`` has written.

    Raises:
        KeyError, or one of ``NO_NPZ``: the file is damaged.
    """
    archive = read_npz(path)
    arrays: dict[str, AnyArray] = {field.name: archive[field.name] for field in fields(Drive)}
    for name in SINGLE:
        arrays[name] = arrays[name].astype(np.float64)
    return Drive(**arrays)

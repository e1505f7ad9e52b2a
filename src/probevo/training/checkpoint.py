"""What a training has done so far, on disk, so that it can be stopped at any moment and go on."""

from __future__ import annotations

import io
import json
import shutil
from collections.abc import Sequence as Collection
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from probevo.arrays import AnyArray, FloatArray, IntArray
from probevo.errors import InputError
from probevo.output.files import write_atomically
from probevo.sequences.base import Sequence
from probevo.training.drive import Drive, load_drive, save_drive
from probevo.training.settings import TrainSettings

Iteration = list[tuple[IntArray, FloatArray]]
"""Of each drive, the features that took part in a motion with a known error, and that error."""


@dataclass(frozen=True)
class Checkpoint:
    """A folder beside the model file; each thing in it is written whole or not at all."""

    folder: Path

    @staticmethod
    def opened(
        out: Path, sequences: Collection[Sequence], settings: TrainSettings, columns: tuple[str, ...]
    ) -> Checkpoint:
        """The work so far for this model file, or none yet.

        Raises:
            InputError: what lies there belongs to other recordings or settings, or the place cannot be written to.
        """
        checkpoint = Checkpoint(out.with_name(out.name + ".work"))
        facts = {
            "settings": settings.model_dump(mode="json", exclude={"neighbors", "exponent", "average"}),
            "columns": columns,
            "recordings": [[str(s.path.resolve()), len(s), s.stamps_ns[[0, -1]].tolist()] for s in sequences],
        }
        plan, text = checkpoint.folder / "plan.json", json.dumps(facts, indent=1) + "\n"
        before = plan.read_text() if plan.exists() else ""
        if before and before != text and any(checkpoint.folder.glob("*.npz")):
            what = "a training that was stopped here had other recordings or settings."
            raise InputError(checkpoint.folder, what, "Repeat those to go on with it, or delete this folder.")
        if before != text:  # nothing was done yet, or ``remove`` was stopped
            shutil.rmtree(checkpoint.folder, ignore_errors=True)
        write_atomically(plan, text)
        return checkpoint

    def drive(self, number: int) -> Drive | None:
        """A recording that is through."""
        path = self._drive(number)
        return load_drive(path) if path.exists() else None

    def keep_drive(self, number: int, drive: Drive) -> None:
        """Write it."""
        save_drive(self._drive(number), drive)

    def iteration(self, number: int) -> Iteration | None:
        """An iteration that is done."""
        path = self._iteration(number)
        if not path.exists():
            return None
        with np.load(path, allow_pickle=False) as archive:
            count = len(archive.files) // 2
            return [(archive[f"features_{k}"], archive[f"alphas_{k}"]) for k in range(count)]

    def keep_iteration(self, number: int, iteration: Iteration) -> None:
        """Write it."""
        buffer = io.BytesIO()
        arrays: dict[str, AnyArray] = {}
        for k, (features, alphas) in enumerate(iteration):
            arrays |= {f"features_{k}": features, f"alphas_{k}": alphas}
        np.savez(buffer, allow_pickle=False, **arrays)
        write_atomically(self._iteration(number), buffer.getvalue())

    def remove(self) -> None:
        """The model is written: nothing of this is needed any more."""
        with suppress(OSError):
            (self.folder / "plan.json").unlink()  # first, lest a rest of this pass for work to go on with
        shutil.rmtree(self.folder, ignore_errors=True)

    def _drive(self, number: int) -> Path:
        return self.folder / f"drive-{number}.npz"

    def _iteration(self, number: int) -> Path:
        return self.folder / f"iteration-{number}.npz"

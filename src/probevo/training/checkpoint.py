"""What a training has done so far, on disk, so that it can be stopped at any moment and go on."""

from __future__ import annotations

import io
import json
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from probevo import __version__
from probevo.arrays import AnyArray, FloatArray, IntArray
from probevo.camera.stereo import StereoCamera
from probevo.errors import InputError
from probevo.files import remove_stale, write_atomically
from probevo.noise.base import LearnedNoiseModel
from probevo.noise.model_io import load_model, save_model
from probevo.training.recording import TICKET
from probevo.training.settings import TrainSettings
from probevo.training.supervised_drive import DriveOnDisk, whole

Iteration = list[tuple[IntArray, FloatArray]]
"""Of each drive, the features that took part in a motion with a known error, and that error."""


PLAN = "plan.json"
DRIVES = ("drive-[0-9]*.json", "drive-[0-9]*.npz", "drive-[0-9]*.frames")
MADE_OF_DRIVES = (
    "drive-truth-*.npz",
    "thin-*.json",
    "thin-*.npz",
    "iteration-*.npz",
    "turn-*.safetensors",
)
KINDS = (PLAN, TICKET, *DRIVES, *MADE_OF_DRIVES)
OWN = tuple(f"{name}{end}" for name in KINDS for end in ("", ".part", ".*.part"))
"""All that is ever written into the folder, and so all that is ever removed from it."""


@dataclass(frozen=True)
class Checkpoint:
    """A folder beside the model file; each thing in it is written whole or not at all."""

    folder: Path

    @staticmethod
    def opened(
        out: Path,
        recordings: list[list[Any]],
        truths: list[str],
        settings: TrainSettings,
        columns: tuple[str, ...],
    ) -> Checkpoint:
        """The work so far for this model file, or none yet. What other settings or truth made of
        the drives is dropped.

        Args:
            out: the model file.
            recordings, truths: the facts of each ``Source``, and the digests of their truth.
            settings: all settings.
            columns: of the prediction space.

        Raises:
            InputError: what lies there belongs to other recordings, predictors or settings of the
                odometry, is damaged or not ours, or the place cannot be written to.
        """
        checkpoint = Checkpoint(out.with_name(out.name + ".work"))
        checkpoint._refuse_foreign()
        chosen = settings.model_dump(
            mode="json", exclude={"neighbors", "exponent", "average", "iterations"}
        )
        of_drives = {name: chosen.pop(name) for name in ("odometry", "max_frames", "predictors")}
        facts = {
            "probevo": __version__,
            "drives": {**of_drives, "columns": list(columns), "recordings": recordings},
            "iterations": chosen | {"truths": truths},
        }
        before = checkpoint._plan()
        same = all(before.get(part) == facts[part] for part in ("probevo", "drives"))
        if before and not same and any(checkpoint.folder.glob("drive-[0-9]*.npz")):
            differs = "recordings, predictors or odometry"
            if before.get("drives") == facts["drives"]:
                differs = f"code, probevo {before.get('probevo')} instead of {__version__}"
            what = f"a training that was stopped here had other {differs}."
            raise InputError(
                checkpoint.folder, what, "Repeat those to go on with it, or delete this folder."
            )
        if not same:  # no drive is begun yet, or ``remove`` was stopped
            checkpoint._remove(*OWN)
        elif before.get("iterations") != facts["iterations"]:
            checkpoint._remove(*MADE_OF_DRIVES)
        checkpoint._remove("*.part", "*.frames")
        write_atomically(checkpoint.folder / PLAN, json.dumps(facts, indent=1) + "\n")
        return checkpoint

    def drive(self, number: int, camera: StereoCamera) -> DriveOnDisk:
        """The recording of that number, whatever there is of it."""
        return DriveOnDisk(self.folder, number, camera)

    def iteration(self, number: int) -> Iteration | None:
        """An iteration that is done."""
        path = self._iteration(number)
        if not path.exists():
            return None
        with whole(path), np.load(path, allow_pickle=False) as archive:
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

    def turn(self, number: int) -> LearnedNoiseModel | None:
        """The model after a turn of EM that is done."""
        path = self._turn(number)
        return load_model(path) if path.exists() else None

    def keep_turn(self, number: int, model: LearnedNoiseModel) -> None:
        """Write it."""
        save_model(model, self._turn(number))

    def remove(self) -> None:
        """The model is written: nothing of this is needed any more."""
        self._remove(*OWN)  # the plan first, lest a rest of this pass for work to go on with
        with suppress(OSError):
            self.folder.rmdir()

    def _plan(self) -> dict[str, Any]:
        path = self.folder / PLAN
        if not path.exists():
            return {}
        with whole(path):
            plan = json.loads(path.read_text("utf-8"))
            if not (isinstance(plan, dict) and "drives" in plan):
                raise ValueError("it is no plan of a training")
            return plan

    def _refuse_foreign(self) -> None:
        if self.folder.exists() and not self.folder.is_dir():
            raise InputError(
                self.folder,
                "is in the way: a folder of this name keeps the work so far.",
                "Move it.",
            )
        found = set(self.folder.iterdir()) if self.folder.exists() else set()
        foreign = sorted(found - {path for pattern in OWN for path in self.folder.glob(pattern)})
        if foreign:
            what = (
                f"holds {foreign[0].name}, which is none of ours; the work so far is kept in a"
                " folder of this name."
            )
            raise InputError(self.folder, what, "Move it, or give the model another name.")

    def _remove(self, *patterns: str) -> None:
        for pattern in patterns:
            for path in sorted(self.folder.glob(pattern)):
                remove_stale(path)

    def _turn(self, number: int) -> Path:
        return self.folder / f"turn-{number}.safetensors"

    def _iteration(self, number: int) -> Path:
        return self.folder / f"iteration-{number}.npz"

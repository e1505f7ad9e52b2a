"""The intermediate results of a training on disk, so that it can be stopped and resumed."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from probevo import __version__
from probevo.arrays import AnyArray
from probevo.camera.stereo import StereoCamera
from probevo.config.training import TrainSettings
from probevo.errors import InputError
from probevo.noise.base import LearnedNoiseModel
from probevo.noise.model_io import load_model, save_model
from probevo.storage.files import remove_stale, write_atomically
from probevo.storage.lock import LOCK
from probevo.storage.npz import read_npz, write_npz
from probevo.training.lease import LEASE
from probevo.training.probe.subsets import SubsetErrors
from probevo.training.supervised_drive import DriveOnDisk, damage_reported

Iteration = list[SubsetErrors]
"""The errors of the subsets of each drive."""


PLAN = "plan.json"
"""File with the settings and recordings that the folder belongs to."""
DRIVES = ("drive-[0-9]*.json", "drive-[0-9]*.npz", "drive-[0-9]*.frames")
"""Recorded drives, which depend on recordings, predictors and odometry only."""
MADE_OF_DRIVES = (
    "drive-truth-*.npz",
    "thin-*.json",
    "thin-*.npz",
    "iteration-*.npz",
    "em-iteration-*.safetensors",
)
"""Files that depend on the other settings or on the truth, too."""
KINDS = (PLAN, LEASE, *DRIVES, *MADE_OF_DRIVES)
OWN = tuple(f"{name}{suffix}" for name in KINDS for suffix in ("", ".part", ".*.part"))
"""All files that are ever written into the folder, and so all that are ever removed from it."""
BEFORE_PLAN = (LOCK, f"{PLAN}.*.part")
"""Files that may lie in the folder before the plan does."""
FINISHED = {"drives": None}
"""The plan of a training whose other files are being removed."""


def checkpoint_folder(out: Path) -> Path:
    """Return the folder of the checkpoint of a model file."""
    return out.with_name(out.name + ".work")


@dataclass(frozen=True)
class Checkpoint:
    """A folder beside the model file; each file in it is written whole or not at all."""

    folder: Path

    @staticmethod
    def opened(
        out: Path,
        recordings: list[list[Any]],
        truths: list[str],
        settings: TrainSettings,
        columns: tuple[str, ...],
    ) -> Checkpoint:
        """Open the checkpoint of a model file, or begin a new one; the caller holds its lock.

        Files that were made of the drives with other settings or other truth are removed.

        Args:
            out: the model file.
            recordings: ``Source.facts`` of each recording.
            truths: ``Source.truth`` of each recording.
            settings: all settings.
            columns: columns of the prediction space.

        Raises:
            InputError: the folder belongs to other recordings, predictors or settings of the
                odometry, is damaged, holds foreign files, or cannot be written to.
        """
        checkpoint = Checkpoint(checkpoint_folder(out))
        checkpoint._refuse_foreign()

        # What the recorded drives depend on, and what the iterations over them depend on.
        chosen = settings.model_dump(
            mode="json", exclude={"neighbors", "exponent", "average", "iterations"}
        )
        drive_settings = {
            name: chosen.pop(name) for name in ("odometry", "max_frames", "predictors")
        }
        plan = {
            "probevo": __version__,
            "drives": {**drive_settings, "columns": list(columns), "recordings": recordings},
            "iterations": chosen | {"truths": truths},
        }

        # Refuse to mix the drives of two different trainings.
        kept_plan = checkpoint._plan()
        is_same = all(kept_plan.get(part) == plan[part] for part in ("probevo", "drives"))
        is_work = kept_plan.get("drives") and any(checkpoint.folder.glob("drive-[0-9]*.npz"))
        if is_work and not is_same:
            differs = "recordings, predictors or odometry"
            if kept_plan.get("drives") == plan["drives"]:
                differs = f"code, probevo {kept_plan.get('probevo')} instead of {__version__}"
            raise InputError(
                checkpoint.folder,
                f"a training that was stopped here had other {differs}.",
                "Repeat those to go on with it, or delete this folder.",
            )

        # Remove what cannot be used. With another plan no drive is begun yet, or an earlier removal
        # was interrupted.
        if kept_plan and not is_same:
            checkpoint._remove_all()
        elif kept_plan.get("iterations") != plan["iterations"]:
            checkpoint._remove(*MADE_OF_DRIVES)
        checkpoint._remove("*.part", "*.frames")
        write_atomically(checkpoint.folder / PLAN, json.dumps(plan, indent=1) + "\n")
        return checkpoint

    def drive(self, number: int, camera: StereoCamera) -> DriveOnDisk:
        """Return the drive of the recording of that number, complete or not."""
        return DriveOnDisk(self.folder, number, camera)

    def iteration(self, number: int) -> Iteration | None:
        """Read an iteration of PROBE; None if it is not stored."""
        path = self._iteration_path(number)
        if not path.exists():
            return None
        with damage_reported(path):
            archive = read_npz(path)
            num_drives = len(archive) // 2
            return [
                SubsetErrors(archive[f"features_{k}"], archive[f"alphas_{k}"])
                for k in range(num_drives)
            ]

    def keep_iteration(self, number: int, iteration: Iteration) -> None:
        """Write an iteration of PROBE."""
        arrays: dict[str, AnyArray] = {}
        for k, (features, alphas) in enumerate(iteration):
            arrays[f"features_{k}"] = features
            arrays[f"alphas_{k}"] = alphas
        write_npz(self._iteration_path(number), arrays)

    def em_model(self, number: int) -> LearnedNoiseModel | None:
        """Read the model after an EM iteration; None if it is not stored."""
        path = self._em_path(number)
        return load_model(path) if path.exists() else None

    def keep_em_model(self, number: int, model: LearnedNoiseModel) -> None:
        """Write the model after an EM iteration."""
        save_model(model, self._em_path(number))

    def remove(self) -> None:
        """Remove the checkpoint, which is no longer needed once the model is written."""
        if self._plan():
            self._remove_all()

    def _plan(self) -> dict[str, Any]:
        """Read the plan; empty if there is none."""
        path = self.folder / PLAN
        if not path.exists():
            return {}
        with damage_reported(path):
            plan = json.loads(path.read_text("utf-8"))
            if not (isinstance(plan, dict) and "drives" in plan):
                raise ValueError("it is not the plan of a training")
            return plan

    def _refuse_foreign(self) -> None:
        """Refuse a folder that holds files of others, or files whose plan is missing."""
        if self.folder.exists() and not self.folder.is_dir():
            raise InputError(
                self.folder,
                "is in the way: a folder of this name keeps the work so far.",
                "Move it.",
            )
        files = set(self.folder.iterdir()) if self.folder.exists() else set()
        foreign = sorted(files - self._matching(LOCK, *OWN))
        without_plan = sorted(files - self._matching(*BEFORE_PLAN))
        if foreign:
            what = f"holds {foreign[0].name}, which is none of ours"
        elif without_plan and self.folder / PLAN not in files:
            what = f"holds {without_plan[0].name} but no {PLAN}, so that it is none of ours"
        else:
            return
        raise InputError(
            self.folder,
            f"{what}; the work so far is kept in a folder of this name.",
            "Move it, or give the model another name.",
        )

    def _matching(self, *patterns: str) -> set[Path]:
        return {path for pattern in patterns for path in self.folder.glob(pattern)}

    def _remove_all(self) -> None:
        """Remove all files but the lock; the plan goes last and says meanwhile that nothing counts.

        So an interrupted removal does not pass for a checkpoint, nor for files of others.
        """
        write_atomically(self.folder / PLAN, json.dumps(FINISHED) + "\n")
        self._remove(*(pattern for pattern in OWN if pattern != PLAN))
        self._remove(PLAN)

    def _remove(self, *patterns: str) -> None:
        for pattern in patterns:
            for path in sorted(self.folder.glob(pattern)):
                remove_stale(path)

    def _em_path(self, number: int) -> Path:
        return self.folder / f"em-iteration-{number}.safetensors"

    def _iteration_path(self, number: int) -> Path:
        return self.folder / f"iteration-{number}.npz"


class NoCheckpoint:
    """A checkpoint that keeps nothing, for a training that need not be resumed."""

    def iteration(self, number: int) -> Iteration | None:
        """Return None: no iteration is stored."""

    def keep_iteration(self, number: int, iteration: Iteration) -> None:
        """Discard the iteration."""

    def em_model(self, number: int) -> LearnedNoiseModel | None:
        """Return None: no model is stored."""

    def keep_em_model(self, number: int, model: LearnedNoiseModel) -> None:
        """Discard the model."""

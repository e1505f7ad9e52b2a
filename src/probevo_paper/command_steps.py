"""Steps that several experiments of ``probevo paper`` take."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from probevo.camera.likeness import difference_text
from probevo.cli import train
from probevo.cli.text import table
from probevo.errors import InputError
from probevo.output.trial_table import TrialTable
from probevo.sequences import open_sequence
from probevo_sim import command as simulate
from probevo_sim.scene.writer import scene_folder

if TYPE_CHECKING:
    from probevo import sequences
    from probevo.config.training import TrainSettings
    from probevo_sim.scene.config import SceneConfig


def render(name: str, config: SceneConfig, folder: Path) -> sequences.Sequence:
    """Open a rendered scene; whatever an earlier call did not finish is rendered now."""
    print(f"{name}: rendering, or taking what is there", flush=True)
    path = folder / scene_folder(name.replace(" ", "-"), config)
    return open_sequence(simulate.render_with_progress(config, path))


def refuse_other_camera(drives: Sequence[sequences.Sequence], option: str) -> None:
    """Refuse drives with another camera than the first, which is trained on.

    A model refuses such a drive, too, but only after its training.

    Raises:
        InputError: the camera of a drive differs.

    """
    first = drives[0]
    for drive in drives[1:]:
        unlike = difference_text(drive.camera, first.camera)
        if unlike:
            what = f"the camera of {drive.path} is not that of {first.path}: {unlike}."
            raise InputError(option, what, "Give drives of one camera.")


def train_all(
    recording: Path, label: str, trainings: Mapping[str, TrainSettings], out: Path
) -> dict[str, Path]:
    """Train each learned estimator on one recording; return the model files by its name."""
    models = {}
    for name, settings in trainings.items():
        print(f"{label}: training {name}", flush=True)
        models[name] = out / "models" / f"{label}-{name}.safetensors".replace(" ", "-")
        train.train_with_progress((recording,), settings, models[name])
    return models


def table_text(trials: TrialTable, *remarks: str) -> str:
    """Return the table as text, followed by these remarks and the table's own notes."""
    head, *rows = trials.as_table().text_rows()
    return "\n".join([table(head, rows), "", *remarks, *trials.notes, ""])

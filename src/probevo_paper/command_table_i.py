"""``probevo paper table-i``: PROBE Table I from the first recording to the last file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from probevo.cli import compare, train
from probevo.output.comparison.comparison import Comparison
from probevo.output.trial_table import TrialTable
from probevo.sequences import open_sequence
from probevo_paper.command_steps import table_text
from probevo_paper.table_i import (
    AGGRESSIVE,
    NOMINAL,
    OURS,
    PROBE,
    STUDENT_T,
    TRIALS,
    KittiDrive,
    TablePlan,
    plan_table,
    probe_settings,
    training_settings,
)
from probevo_paper.table_i_config import TableIConfig
from probevo_paper.table_i_files import table_of, write_table

Models = Mapping[tuple[KittiDrive, str], Path]
"""Model files by the training drive and the name of the learned estimator."""


def repeat_table(settings: TableIConfig, kitti: Path, out: Path) -> list[str]:
    """Repeat as much of the table as the drives allow; return the lines to print.

    Args:
        settings: settings of all runs.
        kitti: folder of KITTI raw.
        out: folder for the results.

    Raises:
        InputError: a recording or a setting is at fault, or a file cannot be written.

    """
    plan = plan_table(kitti)
    # The runs of the classical estimators are planned for the checks that it makes, since a
    # training takes long.
    _runs(plan, {}, settings, kitti=kitti, out=out)
    print(f"{len(plan.trials)} of {len(TRIALS)} trials can be run.", flush=True)
    models = _train(plan, settings, kitti, out=out)

    def trial_table(done: Comparison) -> TrialTable:
        return table_of(done, plan, settings.max_frames)

    def text(done: Comparison) -> str:
        return table_text(trial_table(done), "ARMSE / final error, m.")

    def write(done: Comparison) -> None:
        """Write the table after each run."""
        write_table(out, done, trial_table(done), text=text(done))

    runs = _runs(plan, models, settings, kitti=kitti, out=out)
    comparison = compare.run_all(runs, 1, write, out=out)
    return [text(comparison), str(out / "table_i.html")]


def _train(plan: TablePlan, settings: TableIConfig, kitti: Path, out: Path) -> Models:
    """Train each learned estimator on each training drive."""
    models = {}
    for drive in plan.training_drives:
        for name, training in training_settings(settings).items():
            file = out / "models" / f"{drive.name}-{name.replace(', ', '-')}.safetensors"
            train.train_with_progress((kitti / drive.folder,), training, file)
            models[drive, name] = file
    return models


def _runs(
    plan: TablePlan, models: Models, settings: TableIConfig, *, kitti: Path, out: Path
) -> list[compare.Job]:
    """Plan the runs of each trial; learned estimators run only where their model is there."""
    classical = [
        compare.Estimator(NOMINAL, "fixed", settings),
        compare.Estimator(AGGRESSIVE, "fixed", compare.aggressive(settings)),
        compare.Estimator(STUDENT_T, "student-t", settings),
    ]
    learned = {PROBE: probe_settings(settings), OURS: settings}
    runs = []
    for trial in plan.trials:
        sequence = open_sequence(kitti / trial.drive.folder, "kitti-raw")
        estimators = list(classical)
        for name, its_settings in learned.items():
            if (trial.training, name) in models:
                model = models[trial.training, name]
                estimators.append(compare.Estimator(name, str(model), its_settings))
        runs += compare.plan([compare.Recording(trial.drive.name, sequence)], estimators, out)
    return runs

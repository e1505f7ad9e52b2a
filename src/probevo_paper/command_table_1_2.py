"""``probevo paper table-1.2``: thesis Table 1.2 from the first recording to the last file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from probevo.cli import compare
from probevo.errors import InputError
from probevo.noise.registry import untrained_names
from probevo.output.comparison.comparison import Comparison
from probevo.output.trial_table import TrialTable
from probevo.sequences import open_sequence
from probevo_paper.command_steps import refuse_other_camera, render, table_text, train_all
from probevo_paper.table_1_2 import (
    ESTIMATORS,
    OWN,
    SYNTHETIC,
    TrialRecordings,
    run_settings,
    scenes,
)
from probevo_paper.table_1_2_config import RowName, Table12Config
from probevo_paper.table_1_2_files import STEM, table_of, write_table
from probevo_sim.point_world import write_training_and_test


def repeat_table(settings: Table12Config, own: tuple[Path, Path] | None, out: Path) -> list[str]:
    """Repeat the table; return the lines to print.

    Args:
        settings: the rows to simulate, and how to run and train.
        own: recordings of the user, to train on and to test on; None if there are none.
        out: folder for the results.

    Raises:
        InputError: a recording or a setting is at fault, or a file cannot be written.

    """
    # What the user gave is checked before anything is rendered.
    own_trials = [_own_recordings(own, settings)] if own else []
    trials = [_simulated_recordings(name, settings, out) for name in dict.fromkeys(settings.rows)]
    trials += own_trials
    if not trials:
        raise InputError(
            "--rows", "no row is named.", "Name one at least, or give --train and --test."
        )
    planned = [trial.name for trial in trials]
    without_truth = [trial.name for trial in trials if not trial.has_truth]

    # The runs of the classical estimators are planned for the checks that it makes, since a
    # training takes long.
    _runs(trials, {}, out)
    models = {
        trial.name: train_all(
            trial.train.path, trial.name, trial.training_settings(settings), out=out
        )
        for trial in trials
    }

    def trial_table(done: Comparison) -> TrialTable:
        return table_of(done, planned, without_truth)

    def write(done: Comparison) -> None:
        """Write the table after each run."""
        write_table(out, done, trial_table(done), text=table_text(trial_table(done)))

    comparison = compare.run_all(_runs(trials, models, out), 1, write, out=out)
    return [table_text(trial_table(comparison)), str(out / f"{STEM}.html")]


def _simulated_recordings(name: RowName, settings: Table12Config, out: Path) -> TrialRecordings:
    """Simulate the recordings of a row, unless an earlier call left them."""
    folder = out / "recordings"
    configs = scenes(name, settings)
    if configs is None:
        print(f"{name}: simulating", flush=True)
        write_training_and_test(SYNTHETIC, folder / name)
        train = open_sequence(folder / name / "train.npz")
        test = open_sequence(folder / name / "test.npz")
    else:
        train_config, test_config = configs
        train = render(f"{name} train", train_config, folder)
        test = render(f"{name} test", test_config, folder)
    return TrialRecordings(name, train, test, runs=run_settings(name, settings))


def _own_recordings(own: tuple[Path, Path], settings: Table12Config) -> TrialRecordings:
    """Open the user's recordings."""
    train, test = (recording.sequence for recording in compare.open_recordings(own))
    refuse_other_camera([train, test], "--test")
    return TrialRecordings(OWN, train, test, runs=run_settings(OWN, settings))


def _runs(
    trials: list[TrialRecordings], models: Mapping[str, Mapping[str, Path]], out: Path
) -> list[compare.Job]:
    """Plan the runs; learned estimators run only where their model is there.

    Args:
        trials: the recordings of each row.
        models: model files by the names of row and estimator.
        out: folder for the results.

    """
    runs = []
    for trial in trials:
        noises = {name: name for name in untrained_names()}
        for name, model in models.get(trial.name, {}).items():
            noises[name] = str(model)
        estimators = [
            compare.Estimator(name, noises[name], trial.runs)
            for name in ESTIMATORS
            if name in noises
        ]
        runs += compare.plan([compare.Recording(trial.name, trial.test)], estimators, out)
    return runs

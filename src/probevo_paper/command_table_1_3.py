"""``probevo paper table-1.3``: thesis Table 1.3 from the first recording to the last file."""

from __future__ import annotations

from pathlib import Path

from probevo.cli import compare
from probevo.errors import InputError
from probevo.noise.model_io import load_model
from probevo.output.comparison.comparison import Comparison, Entry
from probevo.output.trial_table import TrialTable
from probevo.sequences import Sequence
from probevo_paper.command_steps import refuse_other_camera, render, table_text, train_all
from probevo_paper.gk_tables import GK_EM, STATIC
from probevo_paper.table_1_3 import loop_columns, loops, table_of, training_settings
from probevo_paper.table_1_3_config import Table13Config
from probevo_paper.table_1_3_page import write_loops_page
from probevo_paper.table_files import write_table_files


def repeat_table(settings: Table13Config, own: tuple[Path, ...], out: Path) -> list[str]:
    """Repeat the table; return the lines to print.

    Args:
        settings: the loops to render, and how to run and train.
        own: loops of the user, which are taken instead of rendered ones; empty if there are none.
        out: folder for the results.

    Raises:
        InputError: a recording or a setting is at fault, or a file cannot be written.

    """
    if own:
        recordings = _own_loops(own)
    else:
        recordings = {
            name: render(name, config, out / "recordings")
            for name, config in loops(settings).items()
        }
    names = tuple(recordings)
    training_loop = names[0]
    test_loops = names[1:]

    # The static M-estimator runs on the training loop, too, where EM is compared with it. Its run
    # is planned before the training, which takes long, for the checks that this makes.
    static = compare.Estimator(STATIC, STATIC, settings.run_settings())
    runs = compare.plan(
        [compare.Recording(training_loop, recordings[training_loop])], [static], out
    )
    models = train_all(
        recordings[training_loop].path, training_loop, training_settings(settings), out=out
    )
    iterations = load_model(models[GK_EM]).training["iterations"]
    learned = [
        compare.Estimator(name, str(model), static.settings) for name, model in models.items()
    ]
    runs += compare.plan(
        [compare.Recording(name, recordings[name]) for name in test_loops], [static, *learned], out
    )

    def columns(entry: Entry) -> dict[str, object]:
        return loop_columns(entry, bool(own))

    def trial_table(done: Comparison) -> TrialTable:
        return table_of(done, names, bool(own))

    def write(done: Comparison) -> None:
        """Write table and page after each run."""
        table = trial_table(done)
        write_table_files(
            out / "table_1_3",
            done,
            table,
            text=table_text(table),
            published_of=columns,
            more={"trained_on": training_loop, "iterations": iterations},
        )
        write_loops_page(
            out / "table_1_3.html",
            done,
            table,
            iterations=iterations,
            training_loop=training_loop,
        )

    comparison = compare.run_all(runs, 1, write, out=out)
    return [table_text(trial_table(comparison)), str(out / "table_1_3.html")]


def _own_loops(paths: tuple[Path, ...]) -> dict[str, Sequence]:
    """Open the user's loops, by name."""
    if len(paths) < 2:
        raise InputError(
            "--loops",
            "only one recording is named.",
            "Give one to train on, and others to test on.",
        )
    recordings = {
        recording.name: recording.sequence for recording in compare.open_recordings(paths)
    }
    refuse_other_camera(list(recordings.values()), "--loops")
    return recordings

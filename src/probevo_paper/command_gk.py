"""The experiments of ``probevo paper`` that repeat tables of PROBE-GK: recordings, trainings, runs,
and the table."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from probevo.cli.text import table
from probevo.errors import InputError

if TYPE_CHECKING:
    from probevo.cli.compare import Job
    from probevo.output.comparison import Comparison
    from probevo.output.trial_table import TrialTable
    from probevo.sequences import Sequence
    from probevo.training.settings import TrainSettings
    from probevo_paper.table_1_2 import Row
    from probevo_paper.table_1_2_config import RowName, Table12Config
    from probevo_paper.table_1_3_config import Table13Config
    from probevo_sim.scene.config import SceneConfig


def table_1_2(settings: Table12Config, own: tuple[Path, Path] | None, out: Path) -> list[str]:
    """Repeat thesis Table 1.2, with the user's recordings to train and to test on; returns what to
    print.

    Raises:
        InputError: a recording or a setting is at fault, or a file cannot be written.
    """
    from probevo.cli.compare import run_all
    from probevo_paper.table_1_2_files import STEM, table_of, write_table

    own_row = _own_row(own, settings)  # what the user gave is checked before anything is rendered
    rows = [_row(name, settings, out) for name in dict.fromkeys(settings.rows)] + own_row
    if not rows:
        raise InputError(
            "--rows", "no row is named.", "Name one at least, or give --train and --test."
        )
    _jobs_1_2(rows, {}, out)
    models = {
        row.name: _train(row.train.path, row.name, row.trainings(settings), out=out) for row in rows
    }
    untrue = [row.name for row in rows if not row.has_truth]

    def of(done: Comparison) -> TrialTable:
        return table_of(done, [row.name for row in rows], untrue)

    def write(done: Comparison) -> None:
        write_table(out, done, of(done), text=table_text(of(done)))

    comparison = run_all(_jobs_1_2(rows, models, out), 1, write, out=out)
    return [table_text(of(comparison)), str(out / f"{STEM}.html")]


def table_1_3(settings: Table13Config, own: tuple[Path, ...], out: Path) -> list[str]:
    """Repeat thesis Table 1.3, on the user's loops if there are any; returns what to print.

    Raises:
        InputError: a recording or a setting is at fault, or a file cannot be written.
    """
    from probevo.cli.compare import Estimator, Recording, plan, run_all
    from probevo.noise.model_io import load_model
    from probevo_paper.kernel_trials import GK_EM, STATIC
    from probevo_paper.table_1_3 import published, table_of, trainings
    from probevo_paper.table_1_3_page import write_loops_page
    from probevo_paper.table_files import write_table_files

    loops = _own_loops(own) if own else _rendered_loops(settings, out)
    first, *others = names = tuple(loops)
    static = Estimator(STATIC, STATIC, settings.shared())
    jobs = plan(
        [Recording(first, loops[first])], [static], out
    )  # what can be checked before the training
    models = _train(loops[first].path, first, trainings(settings), out=out)
    turns = load_model(models[GK_EM]).training["iterations"]
    estimators = [
        static,
        *(Estimator(name, str(model), static.settings) for name, model in models.items()),
    ]
    jobs += plan([Recording(name, loops[name]) for name in others], estimators, out)

    def of(done: Comparison) -> TrialTable:
        return table_of(done, names, bool(own))

    def write(done: Comparison) -> None:
        text = table_text(of(done))
        stem = out / "table_1_3"
        more = {"trained_on": first, "turns": turns}
        write_table_files(
            stem,
            done,
            of(done),
            text=text,
            published=lambda entry: published(entry, bool(own)),
            more=more,
        )
        write_loops_page(stem.with_suffix(".html"), done, of(done), turns=turns, first=first)

    comparison = run_all(jobs, 1, write, out=out)
    return [table_text(of(comparison)), str(out / "table_1_3.html")]


def table_text(trials: TrialTable, *remarks: str) -> str:
    """The table as text, and what to know about it: these remarks, and its own notes."""
    from probevo.output.trial_table import trials_text

    head, *rows = trials_text(trials)
    return "\n".join([table(head, rows), "", *remarks, *trials.notes, ""])


def _row(name: RowName, settings: Table12Config, out: Path) -> Row:
    """A row of the printed table, its recordings simulated, or found where an earlier call left
    them."""
    from probevo.sequences import open_sequence
    from probevo_paper.table_1_2 import SYNTHETIC, Row, run_settings, scenes
    from probevo_sim.point_world import write_training_and_test

    configs = scenes(name, settings)
    folder = out / "recordings"
    if configs is None:
        print(f"{name}: simulating", flush=True)
        write_training_and_test(SYNTHETIC, folder / name)
        train, test = (open_sequence(folder / name / file) for file in ("train.npz", "test.npz"))
    else:
        train, test = (
            _render(f"{name} {part}", config, folder)
            for part, config in zip(("train", "test"), configs, strict=True)
        )
    return Row(name, train, test, runs=run_settings(name, settings))


def _own_row(own: tuple[Path, Path] | None, settings: Table12Config) -> list[Row]:
    from probevo.cli.compare import open_recordings
    from probevo_paper.table_1_2 import OWN, Row, run_settings

    if own is None:
        return []
    train, test = (recording.sequence for recording in open_recordings(own, None))
    _refuse_other_camera([train, test], "--test")
    return [Row(OWN, train, test, runs=run_settings(OWN, settings))]


def _own_loops(paths: tuple[Path, ...]) -> dict[str, Sequence]:
    from probevo.cli.compare import open_recordings

    if len(paths) < 2:
        raise InputError(
            "--loops",
            "only one recording is named.",
            "Give one to train on, and others to test on.",
        )
    loops = {recording.name: recording.sequence for recording in open_recordings(paths, None)}
    _refuse_other_camera(list(loops.values()), "--loops")
    return loops


def _refuse_other_camera(drives: list[Sequence], option: str) -> None:
    """Refuse, before the training, what a model trained on the first of these drives would refuse
    after it."""
    from probevo.camera.likeness import difference

    for drive in drives[1:]:
        unlike = difference(drive.camera, drives[0].camera)
        if unlike:
            what = f"the camera of {drive.path} is not that of {drives[0].path}: {unlike}."
            raise InputError(option, what, "Give drives of one camera.")


def _rendered_loops(settings: Table13Config, out: Path) -> dict[str, Sequence]:
    from probevo_paper.table_1_3 import loops

    return {
        name: _render(name, config, out / "recordings") for name, config in loops(settings).items()
    }


def _render(name: str, config: SceneConfig, folder: Path) -> Sequence:
    """The scene, rendered as far as an earlier call did not."""
    from probevo_sim import command as simulate
    from probevo.cli.demo import scene_folder
    from probevo.sequences import open_sequence

    print(f"{name}: rendering, or taking what is there", flush=True)
    return open_sequence(
        simulate.render_with_progress(config, folder / scene_folder(name.replace(" ", "-"), config))
    )


def _train(
    recording: Path, label: str, trainings: Mapping[str, TrainSettings], out: Path
) -> dict[str, Path]:
    """The model file of each learned estimator."""
    from probevo.cli.train import train_with_progress

    models = {}
    for name, settings in trainings.items():
        print(f"{label}: training {name}", flush=True)
        models[name] = out / "models" / f"{label}-{name}.safetensors".replace(" ", "-")
        train_with_progress((recording,), settings, models[name])
    return models


def _jobs_1_2(rows: list[Row], models: Mapping[str, Mapping[str, Path]], out: Path) -> list[Job]:
    """The runs, those of learned estimators only where the model is there."""
    from probevo.cli.compare import Estimator, Recording, plan
    from probevo.noise.classical import CLASSICAL
    from probevo_paper.table_1_2 import ESTIMATORS

    jobs = []
    for row in rows:
        noises = {name: name for name in CLASSICAL} | {
            n: str(path) for n, path in models.get(row.name, {}).items()
        }
        estimators = [
            Estimator(name, noises[name], row.runs) for name in ESTIMATORS if name in noises
        ]
        jobs += plan([Recording(row.name, row.test)], estimators, out)
    return jobs

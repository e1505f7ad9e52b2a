"""Stand-ins for rendering, training and single runs, for the tests of the tables."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from cli.rendering import write_wall
from probevo.cli import run
from probevo.noise import StudentT
from probevo.noise.model_io import save_model

ITERATIONS = [
    {"log_likelihood": -3.0, "loop_error_m": 0.5},
    {"log_likelihood": -2.5, "loop_error_m": 0.25},
]


@contextmanager
def stand_ins(iterations: list[dict[str, float]] | None = None) -> Iterator[SimpleNamespace]:
    """Replace scenes by walls and models by Student-t; record what was to be rendered and trained.

    ``iterations`` is what the models say of EM, ``ITERATIONS`` if it is not given.
    """
    calls = SimpleNamespace(scenes=[], trainings=[])

    def render_wall(config: Any, folder: Path) -> Path:
        calls.scenes.append(config)
        return write_wall(folder)

    def train(recordings: tuple[Path, ...], settings: Any, out: Path) -> None:
        calls.trainings.append(SimpleNamespace(recordings=recordings, settings=settings, out=out))
        save_model(
            StudentT(
                dof=4.0, training={"iterations": ITERATIONS if iterations is None else iterations}
            ),
            out,
        )

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("probevo_sim.command.render_with_progress", render_wall)
        patch.setattr("probevo.cli.train.train_with_progress", train)
        patch.setattr(
            "probevo.output.report.report.write_report", lambda path, *_, **__: path.touch()
        )
        yield calls


def interrupt_run(monkeypatch: pytest.MonkeyPatch, number: int) -> None:
    """Raise KeyboardInterrupt, as Ctrl-C does, in place of the run of this number, from 1."""
    run_with_progress = run.run_with_progress
    started: list[None] = []

    def interrupted(*arguments: Any, **keywords: Any) -> Any:
        started.append(None)
        if len(started) == number:
            raise KeyboardInterrupt
        return run_with_progress(*arguments, **keywords)

    monkeypatch.setattr(run, "run_with_progress", interrupted)

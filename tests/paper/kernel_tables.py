"""In place of rendering and of training, for the tests of the tables of PROBE-GK."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from cli.rendering import write_wall
from probevo.noise import StudentT
from probevo.noise.model_io import save_model

TURNS = [
    {"log_likelihood": -3.0, "loop_error_m": 0.5},
    {"log_likelihood": -2.5, "loop_error_m": 0.25},
]


@contextmanager
def stand_ins(turns: list[dict[str, float]] | None = None) -> Iterator[SimpleNamespace]:
    """Walls for scenes, Student-t for all models; what was to be rendered and trained is collected."""
    calls = SimpleNamespace(scenes=[], trainings=[])

    def put_a_wall(config: Any, folder: Path) -> Path:
        calls.scenes.append(config)
        return write_wall(folder)

    def train(recordings: tuple[Path, ...], settings: Any, out: Path) -> None:
        calls.trainings.append(SimpleNamespace(recordings=recordings, settings=settings, out=out))
        save_model(StudentT(dof=4.0, training={"iterations": TURNS if turns is None else turns}), out)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("probevo_sim.command.render_with_progress", put_a_wall)
        patch.setattr("probevo.cli.train.train_with_progress", train)
        patch.setattr("probevo.output.report.write_report", lambda path, *_: path.touch())
        yield calls

"""One small recording and one run on it, for all tests of the commands."""

from pathlib import Path

import pytest

from cli.rendering import write_wall
from probevo.cli.main import main


@pytest.fixture(autouse=True)
def no_figures(undrawn: None) -> None:
    """Draw figures in the fixtures of a session or module only, as in ``wall_run``."""


@pytest.fixture(scope="session")
def wall(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recording; copy it to change it."""
    return write_wall(tmp_path_factory.mktemp("wall"))


@pytest.fixture(scope="session")
def wall_run(wall: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The --out folder of a run over it; copy it to change it."""
    out = tmp_path_factory.mktemp("run")
    assert main(["run", str(wall), "--out", str(out)]) == 0
    return out

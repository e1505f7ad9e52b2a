"""Python files that lie beside the data are never run, not even by child processes."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from probevo.sequences.pose_files import write_tum
from probevo_sim.point_config import PointConfig
from probevo_sim.point_world import simulate_points, write_points

NAMES = ("numba", "joblib", "numpy", "yaml", "scipy", "cv2", "pickle", "random", "sitecustomize")
SOURCE = Path(__file__).parents[2] / "src"
COMMANDS = """\
import os, sys
from probevo.cli import first_use, main

commands = {
    "run": "drive.npz --out run",
    "train": "drive.npz other.npz --kind student-t --supervision none --out model.safetensors",
    "compare": "drive.npz --noise fixed --out compared",
    "inspect": "drive.npz --out inspected",
    "eval": "path.tum --gt path.tum",
}
first_use.is_solver_compiled = lambda: False
for command, words in commands.items():
    assert main.main([command, *words.split()]) == 0, command
    assert not {"", ".", os.getcwd()} & set(sys.path), command
    from probevo.output import page
    page.inline_svg = lambda *_: ""  # the figures of one page have shown what drawing imports
sys.exit(first_use.compile_solver().wait())
"""
"""The entry point, as if nothing were compiled yet; it waits for the process that compiles.

What a command has imported, the next one does not import again. So each leaves a path of imports
behind that does not lead into the folder.
"""
CLUSTER = """\
import os, sys
from distributed import LocalCluster
from probevo.cli import main

if __name__ == "__main__":
    data = os.getcwd()
    os.chdir(os.path.dirname(__file__))
    words = [os.path.join(data, word) if "." in word else word for word in sys.argv[1:]]
    with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster:
        os.chdir(data)
        sys.exit(main.main([*words, "--cluster", cluster.scheduler_address]))
"""
"""A cluster that was started elsewhere, and a command in the folder of the data."""
TRAIN = [
    *("train", "drive.npz", "other.npz", "--kind", "student-t", "--supervision", "none"),
    *("--out", "model.safetensors"),
]
WORKERS = """\
import math
from probevo.training.workers import Workers

assert Workers(jobs=2).map(math.sqrt, [1.0, 4.0], ["one", "four"]) == [1.0, 2.0]
"""
"""What ``train --jobs 2`` does."""


@pytest.fixture
def hostile(tmp_path: Path) -> Path:
    """A folder with a recording and with modules that leave a trace where they are run."""
    folder = tmp_path / "data"
    folder.mkdir()
    for seed, name in enumerate(("drive", "other")):
        world = simulate_points(
            PointConfig(radius_m=3.0, landmarks=400),
            duration_s=0.5,
            rng=np.random.default_rng(seed),
        )
        write_points(world, folder / f"{name}.npz")
    write_tum(folder / "path.tum", world.stamps_ns, world.T_world_cam)
    for name in NAMES:
        (folder / f"{name}.py").write_text("import os\nos.mkdir(__file__ + '.ran')\n")
    return folder


def call(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Run Python in a folder, with the default rules on what it imports."""
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONSAFEPATH"}
    return subprocess.run(
        [sys.executable, *words],
        cwd=folder,
        env=environment | {"PYTHONPATH": str(SOURCE)},
        capture_output=True,
        text=True,
        check=False,
    )


def traces(folder: Path) -> list[str]:
    return [path.name for path in folder.glob("*.ran")]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "words"),
    [(COMMANDS, []), (CLUSTER, TRAIN), (WORKERS, [])],
    ids=["commands", "cluster", "workers"],
)
def test_no_module_of_the_working_directory_is_run(
    text: str, words: list[str], hostile: Path
) -> None:
    if text is CLUSTER:
        pytest.importorskip("distributed")
    script = hostile.parent / "script.py"
    script.write_text(text)
    done = call(hostile, str(script), *words)
    assert traces(hostile) == []
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_the_module_run_as_a_command_runs_none_either(hostile: Path) -> None:
    """Python puts the working directory first on the path of ``python -m probevo``."""
    done = call(hostile, "-m", "probevo", "info", "drive.npz")
    assert traces(hostile) == []
    assert done.returncode == 0, done.stderr

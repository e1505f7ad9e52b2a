"""Measure how long it takes from the command to the first frame.

    python benchmarks/cold_start.py [--model MODEL.safetensors] [--repeats 3] [--install]

Measures `probevo --help`, and `probevo run` with and without compiled code on disk. Each figure is
the wall time since the process was started, the least of some repeats, and the CPU time that the
process had used by then, which does not depend on other work of the machine. --install also builds
the wheel and installs it with its dependencies into an empty environment, without pip's cache: from
the network, unless pip is configured otherwise.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from recordings import available

ROOT = Path(__file__).parents[1]
FRAMES = 50
WATCH = """
import os, sys, time
from probevo.cli.main import main
from probevo import odometry

step = odometry.StereoOdometry.step
times = []

def watched(self, frame):
    times.append((time.time(), time.process_time()))
    return step(self, frame)

odometry.StereoOdometry.step = watched
code = main(sys.argv[2:])
print(f"{times[0][0]} {times[0][1]} {times[2][0]} {times[2][1]}", file=open(sys.argv[1], "w"))
sys.exit(code)
"""
"""Program that runs a command, and records when its first and its third step began: by the third,
all compiled code is loaded."""


class Cost(NamedTuple):
    """Wall and CPU time."""

    wall_s: float
    cpu_s: float


class RunCost(NamedTuple):
    """Time from the start of the process to the first and to the third step."""

    first: Cost
    third: Cost


def least(costs: Sequence[Cost]) -> Cost:
    """Return the least wall and the least CPU time."""
    return Cost(min(cost.wall_s for cost in costs), min(cost.cpu_s for cost in costs))


def children_cpu_s() -> float:
    """Return the CPU time of all child processes that have ended."""
    times = os.times()
    return times.children_user + times.children_system


def cost_of(command: Sequence[str | Path]) -> Cost:
    """Return what a command costs from start to end."""
    start = time.time()
    cpu_s = children_cpu_s()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    cpu_s = children_cpu_s() - cpu_s
    return Cost(time.time() - start, cpu_s)


def run_cost(recording: Path, noise: str, cache: Path) -> RunCost:
    """Run over the first frames of a recording, with compiled code in a cache folder."""
    with tempfile.TemporaryDirectory() as folder:
        words = ["run", recording, "--noise", noise, "--max-frames", FRAMES, "--out", folder]
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache)}
        command = [sys.executable, "-c", WATCH, f"{folder}/times", *map(str, words)]
        start = time.time()
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, env=environment)
        words = Path(folder, "times").read_text().split()
    first_s, first_cpu_s, third_s, third_cpu_s = map(float, words)
    return RunCost(
        first=Cost(first_s - start, first_cpu_s), third=Cost(third_s - start, third_cpu_s)
    )


def report(what: str, cost: Cost, limit_s: float) -> None:
    """Print a cost beside its limit."""
    print(
        f"{what:60} {cost.wall_s:6.2f} s wall {cost.cpu_s:6.2f} s CPU   (wanted < {limit_s:g} s)",
        flush=True,
    )


def report_runs(recording: Path, noise: str, repeats: int) -> None:
    """Print what the first run costs, which compiles, and the later ones."""
    name = Path(noise).name
    with tempfile.TemporaryDirectory() as cache:
        compiling = run_cost(recording, noise, Path(cache))
        report(f"first run of all, {name}: to the third frame", compiling.third, 20.0)
        runs = [run_cost(recording, noise, Path(cache)) for _ in range(repeats)]
    first = least([run.first for run in runs])
    third = least([run.third for run in runs])
    report(f"second run, {name}: to the first frame", first, 2.0)
    report(f"second run, {name}: to the third, all code loaded", third, 3.0)


def report_install() -> None:
    """Print size of the wheel, time to install it into an empty environment, and size on disk."""
    with tempfile.TemporaryDirectory() as folder:
        venv = Path(folder, "venv")
        subprocess.run([sys.executable, "-m", "venv", venv], check=True)
        pip = [venv / "bin" / "python", "-m", "pip", "--disable-pip-version-check"]
        subprocess.run(
            [*pip, "wheel", "--quiet", "--no-deps", "--wheel-dir", folder, ROOT], check=True
        )
        (wheel,) = Path(folder).glob("*.whl")
        print(f"wheel: {wheel.stat().st_size / 2**20:.2f} MB (wanted < 1 MB)", flush=True)
        empty = size_mb(venv)
        cost = cost_of([*pip, "install", "--quiet", "--no-cache-dir", wheel])
        report("core installed from an empty environment", cost, 60.0)
        packages = next(Path(venv, "lib").glob("python*/site-packages"))
        sizes = {path.name: size_mb(path) for path in packages.iterdir() if path.is_dir()}
        largest = sorted(sizes.items(), key=lambda item: -item[1])[:8]
        print(
            f"on disk: {size_mb(venv) - empty:.0f} MB, of which "
            + ", ".join(f"{n} {mb:.0f}" for n, mb in largest)
        )


def size_mb(folder: Path) -> float:
    """Return the size of all files below a folder, MiB."""
    return sum(path.lstat().st_size for path in folder.rglob("*") if path.is_file()) / 2**20


def main() -> None:
    """Parse the command line, and print all costs."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--model", help="a model file to run with as well")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--install", action="store_true")
    arguments = parser.parse_args()
    help_command = [sys.executable, "-m", "probevo.cli.main", "--help"]
    report("probevo --help", least([cost_of(help_command) for _ in range(5)]), 0.6)
    recording = available()["raw 0005"]
    report_runs(recording, "student-t", arguments.repeats)
    if arguments.model:
        report_runs(recording, arguments.model, arguments.repeats)
    if arguments.install:
        report_install()


if __name__ == "__main__":
    main()

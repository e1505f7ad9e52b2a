"""From nothing to the first frame: help, `probevo run` with and without compiled code on disk; on
request, the install.

python benchmarks/cold_start.py [--model MODEL.safetensors] [--repeats 3] [--install]

Each figure is wall time since the process was started, the least of some repeats, and the CPU time
that the process had used by then: on a machine with other work, only the latter tells. --install
builds the wheel, and installs it with all it needs into an empty environment, without pip's cache:
from the network, unless pip is configured otherwise.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from recordings import available

ROOT = Path(__file__).parents[1]
FRAMES = 50
WATCH = """
import os, sys, time
from probevo.cli.main import main
from probevo import odometry

step, times = odometry.StereoOdometry.step, []

def watched(self, frame):
    times.append((time.time(), time.process_time()))
    return step(self, frame)

odometry.StereoOdometry.step = watched
code = main(sys.argv[2:])
print(f"{times[0][0]} {times[0][1]} {times[2][0]} {times[2][1]}", file=open(sys.argv[1], "w"))
sys.exit(code)
"""
"""Runs a command, and notes when its first and its third step began: by the third, all compiled
code is loaded."""


def help_s() -> tuple[float, float]:
    """Wall and CPU time of `probevo --help`."""
    start = time.time()
    before = os.times()
    subprocess.run(
        [sys.executable, "-m", "probevo.cli.main", "--help"], check=True, stdout=subprocess.DEVNULL
    )
    after = os.times()
    cpu_s = (
        after.children_user + after.children_system - before.children_user - before.children_system
    )
    return time.time() - start, cpu_s


def run_s(recording: Path, noise: str, cache: Path) -> tuple[float, float, float, float]:
    """Wall and CPU time to the first step of a run, and to its third."""
    with tempfile.TemporaryDirectory() as folder:
        words = ["run", recording, "--noise", noise, "--max-frames", FRAMES, "--out", folder]
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache)}
        command = [sys.executable, "-c", WATCH, f"{folder}/times", *map(str, words)]
        start = time.time()
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, env=environment)
        first, first_cpu, third, third_cpu = map(float, Path(folder, "times").read_text().split())
    return first - start, first_cpu, third - start, third_cpu


def report(what: str, wall_s: float, cpu_s: float, limit_s: float) -> None:
    print(
        f"{what:60} {wall_s:6.2f} s wall {cpu_s:6.2f} s CPU   (wanted < {limit_s:g} s)", flush=True
    )


def run_times(recording: Path, noise: str, repeats: int) -> None:
    name = Path(noise).name
    with tempfile.TemporaryDirectory() as cache:
        _, _, wall_s, cpu_s = run_s(recording, noise, Path(cache))
        report(f"first run of all, {name}: to the third frame", wall_s, cpu_s, 20.0)
        runs = [run_s(recording, noise, Path(cache)) for _ in range(repeats)]
    wall_s, cpu_s, third_s, third_cpu_s = (min(times) for times in zip(*runs, strict=True))
    report(f"second run, {name}: to the first frame", wall_s, cpu_s, 2.0)
    report(f"second run, {name}: to the third, all code loaded", third_s, third_cpu_s, 3.0)


def install() -> None:
    """Size of the wheel, time to install it into an empty environment, and what that takes on disk."""
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
        start = time.time()
        before = os.times()
        subprocess.run([*pip, "install", "--quiet", "--no-cache-dir", wheel], check=True)
        after = os.times()
        cpu_s = (
            after.children_user
            + after.children_system
            - before.children_user
            - before.children_system
        )
        report("core installed from an empty environment", time.time() - start, cpu_s, 60.0)
        packages = next(Path(venv, "lib").glob("python*/site-packages"))
        sizes = {path.name: size_mb(path) for path in packages.iterdir() if path.is_dir()}
        largest = sorted(sizes.items(), key=lambda item: -item[1])[:8]
        print(
            f"on disk: {size_mb(venv) - empty:.0f} MB, of which "
            + ", ".join(f"{n} {mb:.0f}" for n, mb in largest)
        )


def size_mb(folder: Path) -> float:
    return sum(path.lstat().st_size for path in folder.rglob("*") if path.is_file()) / 2**20


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--model", help="a model file to run with as well")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--install", action="store_true")
    given = parser.parse_args()
    report("probevo --help", *map(min, zip(*(help_s() for _ in range(5)), strict=True)), 0.6)
    for model in ("student-t", *([given.model] if given.model else [])):
        run_times(available()["raw 0005"], model, given.repeats)
    if given.install:
        install()

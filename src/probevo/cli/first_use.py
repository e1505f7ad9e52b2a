"""Compilation in the very first run, to which a second process contributes.

Numba compiles each compiled loop when it is first called, one after the other, and caches the
result on disk, where other processes find it.
"""

from __future__ import annotations

import subprocess
import sys
from functools import cache
from pathlib import Path


def getting_ready() -> str:
    """Return the text to show until the first frame is done.

    If nothing is compiled yet, another process begins to compile the solver.
    """
    if is_solver_compiled():
        return "starting"
    import joblib

    if joblib.cpu_count() > 1:
        compile_solver()
    return "compiling, only this first time: 20 to 60 s"


def say_if_compiling() -> None:
    """Say on stderr that the first use compiles, before a command that shows no progress."""
    if not is_solver_compiled():
        print(getting_ready(), file=sys.stderr, flush=True)


def is_solver_compiled() -> bool:
    """Return whether Numba's cache holds the compiled solver."""
    from probevo.measurements.stereo_numba import normal_equations

    # Numba names the index of a function's cache after its module, name and line.
    module = normal_equations.__module__.rpartition(".")[2]
    return any(solver_cache().glob(f"{module}.{normal_equations.__qualname__}-*.nbi"))


def solver_cache() -> Path:
    """Return the folder where Numba caches the compiled solver."""
    from probevo.measurements.stereo_numba import normal_equations

    return Path(normal_equations.stats.cache_path)  # type: ignore[attr-defined]


@cache
def compile_solver() -> subprocess.Popen[bytes]:
    """Start a process that compiles the solver, once; nobody needs to wait for it."""
    command = "from probevo.cli.first_use import solve_once; solve_once()"
    return subprocess.Popen(
        [sys.executable, "-P", "-c", command],  # -P: no module of the working directory is imported
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


def solve_once() -> None:
    """Run the odometry without RANSAC on points along a straight drive to compile the solver.

    Compiling the tracker and RANSAC takes as long, and is left to the process of the user.
    """
    import numpy as np

    import probevo as pv
    from probevo.config import RansacConfig
    from probevo.sequences.frame import StereoFeatures

    camera = pv.StereoCamera.centered(700.0, 0.5, (1200, 400))
    points = np.random.default_rng(0).uniform([-8.0, -2.0, 12.0], [8.0, 2.0, 40.0], (200, 3))
    odometry = pv.StereoOdometry(camera, config=pv.OdometryConfig(ransac=RansacConfig(mode="off")))
    for k in range(4):
        pixels = camera.project(points - [0.0, 0.0, 1.0 * k])
        odometry.step(pv.Frame(k, 100_000_000 * k, features=StereoFeatures(np.arange(200), pixels)))

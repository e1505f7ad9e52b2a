"""The first run of all has to compile, and a second process does its share.

Numba compiles each inner loop when it is first called, one after the other, and keeps the result on
disk, where other processes find it.
"""

from __future__ import annotations

import subprocess
import sys
from functools import cache
from pathlib import Path


def getting_ready() -> str:
    """What to say until the first frame is through; the first time of all, the compiling of the
    solver is begun."""
    if any(compiled_in().glob("minimize.minimize-*.nbi")):
        return "starting"
    import joblib

    if joblib.cpu_count() > 1:
        compile_solver()
    return "compiling, this first time of all: 10 to 30 s"


def compiled_in() -> Path:
    """The folder in which the solver is kept once it is compiled."""
    from probevo.estimation.gauss_newton import minimize

    return Path(minimize.stats.cache_path)  # type: ignore[attr-defined]


@cache
def compile_solver() -> subprocess.Popen[bytes]:
    """Begin to compile the solver in a process of its own, once; nobody needs to wait for it."""
    command = "from probevo.cli.first_use import solve_once; solve_once()"
    nowhere = subprocess.DEVNULL
    return subprocess.Popen(
        [sys.executable, "-c", command], stdin=nowhere, stdout=nowhere, stderr=nowhere
    )


def solve_once() -> None:
    """Call all that follows RANSAC, on points along a straight drive; tracking and RANSAC compile
    as long."""
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

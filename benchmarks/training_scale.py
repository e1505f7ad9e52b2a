"""Measure what training costs, by the number of samples to learn from.

    python benchmarks/training_scale.py [samples …]    10,000 to 1,000,000 by default
    python benchmarks/training_scale.py --workers      recording by one process and by two
    python benchmarks/training_scale.py --fitted       loss by the number of fitted samples

A sample is a feature of a step; 10,000,000 of them take a quarter of an hour. Drives of the point
world of 100,000 samples each lie on disk as tracks files; each size is a process of its own, whose
peak memory the operating system reports. CPU time is given beside wall time, since others may be
using the machine.
"""

from __future__ import annotations

import os

# Libraries read these once, when NumPy is imported: one core.
os.environ |= {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}

import json
import resource
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter, process_time
from typing import NamedTuple, cast

import numpy as np

import probevo as pv
from probevo.config import OdometryConfig
from probevo.config.training import TrainSettings
from probevo.noise import GeneralizedKernel
from probevo.predictors import prediction_space
from probevo.sequences.formats.tracks_file import TracksRecording
from probevo.training.checkpoint import Checkpoint
from probevo.training.gk.expectation_maximization import num_iterations
from probevo.training.recording import record_all
from probevo.training.sources import checked_sources
from probevo.training.workers import Workers
from probevo_sim.point_config import PointConfig
from probevo_sim.point_world import simulate_points, write_points

PREDICTORS = ("place", "last_residual", "age", "flow")
SETTINGS = TrainSettings(
    kind="gk",
    supervision="none",
    predictors=PREDICTORS,
    odometry=OdometryConfig(self_calibration=False),
)
SAMPLES_A_DRIVE = 100_000
WORLD = PointConfig(landmarks=1600, outliers={"fraction": 0.05})  # type: ignore[arg-type]
SAMPLES_A_STEP = 190
DIFFERENT = 10
"""Drives that are simulated. Further ones are links to these, which cost the training the same."""
SIZES_HEAD = (
    "samples",
    "fitted to",
    "s",
    "CPU s",
    "recording",
    "search and first fit",
    "the rest, µs a sample",
    "all, µs a sample",
    "peak MB",
)


def write_drives(folder: Path, samples: int) -> list[Path]:
    """Write tracks files with about so many samples in all."""
    paths = []
    for number in range(-(-samples // SAMPLES_A_DRIVE)):
        wanted = min(SAMPLES_A_DRIVE, samples - number * SAMPLES_A_DRIVE)
        paths.append(folder / f"{number}.npz")
        if number >= DIFFERENT and wanted == SAMPLES_A_DRIVE:
            paths[-1].hardlink_to(paths[number % DIFFERENT])
            continue
        rng = np.random.default_rng(number)
        write_points(
            simulate_points(WORLD, wanted / SAMPLES_A_STEP / WORLD.rate_hz, rng), paths[-1]
        )
    return paths


def cpu_s() -> float:
    """Return the CPU time of this process and of its children that have ended."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(part.ru_utime + part.ru_stime for part in used)


def train(folder: Path) -> None:
    """Train in this process on the drives of a folder, and print its cost as JSON."""
    phases: list[tuple[int, float]] = []
    start = perf_counter()
    cpu = cpu_s()

    def show(done: int, total: int) -> None:
        phases.append((done, cpu_s() - cpu))

    paths = sorted(folder.glob("*.npz"))
    out = pv.train_model(paths, SETTINGS, folder / "m.safetensors", show)
    model = cast(GeneralizedKernel, pv.load_model(out))
    drives = [cast(TracksRecording, pv.open_sequence(path)) for path in paths]
    frames = sum(entry["frames"] for entry in model.training["recordings"])

    def cpu_s_until(passes: float) -> float:
        """Return the CPU time until the frames were passed over so many times."""
        return max((used for done, used in phases if done <= passes * frames), default=0.0)

    # Passes before the first iteration of the kernel: recording, and the iterations of the static
    # models. The second half of that iteration is the search and the first fit.
    first = 1 + num_iterations(SETTINGS) - SETTINGS.gk.iterations
    facts = {
        "samples": model.num_samples_,
        "features": sum(len(drive.features.ids) for drive in drives),
        "clock": perf_counter() - start,
        "cpu": cpu_s() - cpu,
        "recording": cpu_s_until(1.0),
        "search": cpu_s_until(first + 1.0) - cpu_s_until(first + 0.5),
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
    }
    print(json.dumps(facts))


def print_sizes(sizes: list[int]) -> None:
    """Print the cost of a training for each number of samples."""
    print(f"| {' | '.join(SIZES_HEAD)} |\n|{'---|' * len(SIZES_HEAD)}")
    for size in sizes:
        with TemporaryDirectory() as name:
            write_drives(Path(name), size)
            done = subprocess.run(
                [sys.executable, __file__, "--train", name], stdout=subprocess.PIPE, check=True
            )
        cost = json.loads(done.stdout)
        rest_s = cost["cpu"] - cost["search"]
        print(
            f"| {size:,} | {cost['samples']:,} | {cost['clock']:.0f} | {cost['cpu']:.0f} |"
            f" {cost['recording']:.1f} | {cost['search']:.1f} | {1e6 * rest_s / size:.0f} |"
            f" {1e6 * cost['cpu'] / size:.0f} | {cost['peak_mb']:.0f} |",
            flush=True,
        )


class RecordingTime(NamedTuple):
    """Time to record all drives."""

    wall_s: float
    busy_s: float
    """CPU time of the first process meanwhile."""


def record(folder: Path, workers: Workers) -> RecordingTime:
    """Record all drives of a folder."""
    paths = sorted(folder.glob("*.npz"))
    space = prediction_space(PREDICTORS)
    sources = checked_sources(paths, SETTINGS, space)
    with TemporaryDirectory() as name:
        facts = [source.facts for source in sources]
        truths = [source.truth for source in sources]
        work = Checkpoint.opened(
            Path(name, "m.safetensors"), facts, truths, settings=SETTINGS, columns=space.columns
        )
        drives = [work.drive(number, source.camera) for number, source in enumerate(sources)]
        start = perf_counter()
        busy = process_time()
        record_all(
            sources, drives, space, settings=SETTINGS, workers=workers, on_frames=lambda done: None
        )
        return RecordingTime(perf_counter() - start, process_time() - busy)


def print_workers() -> None:
    """Print the time of recording by one process and by two, the least of three each."""
    with TemporaryDirectory() as name:
        write_drives(Path(name), 4 * SAMPLES_A_DRIVE)
        # The first recordings compile the code and start the processes, and do not count.
        for jobs in (1, 2):
            record(Path(name), Workers(jobs))
        one = min(record(Path(name), Workers(1)) for _ in range(3))
        two = min(record(Path(name), Workers(2)) for _ in range(3))
    print(
        f"recording: one process {one.wall_s:.1f} s ({one.busy_s:.1f} s busy), two"
        f" {two.wall_s:.1f} s (the first one {two.busy_s:.1f} s busy besides):"
        f" {one.wall_s / two.wall_s:.2f} times as fast"
    )


def errors_of(count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Draw correlated places in eight columns, three of which set σ, and errors with ν = 5, px."""
    places = rng.normal(size=(count, 5)) @ np.random.default_rng(1).normal(size=(5, 8))
    places += 0.5 * rng.normal(size=(count, 8))
    x, y, z = (places / places.std(axis=0))[:, :3].T
    sigma = 0.3 * np.exp(0.6 * np.tanh(2.0 * x) + 0.3 * np.sin(3.0 * y) + 0.2 * z)
    return places, sigma[:, None] * rng.standard_t(5, size=(count, 4))


def print_fitted() -> None:
    """Print the likelihood of held-out samples by the number of samples that are fitted to.

    K grows with the square root of that number, as in the search.
    """
    rng = np.random.default_rng(0)
    asked, residuals = errors_of(40_000, rng)
    print("| fitted to | nats a feature | CPU s | peak MB |\n|---|---|---|---|")
    for count in (30_000, 100_000, 300_000, 500_000, 1_000_000):
        places, errors = errors_of(count, rng)
        model = pv.noise.GeneralizedKernel(
            neighbors=round(7.3 * count**0.5),
            weights=np.array([1.0, 1.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0]),
            prior_counts=4.0,
            dof_counts=10.0,
            bias_counts=np.inf,
        )
        spread = np.tile(1e-4 * np.eye(4), (count, 1, 1))
        start = process_time()
        model.fit(places, errors, error_cov=spread)
        fit_s = process_time() - start
        nats = model.predict(asked).log_likelihood(residuals).mean()
        peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
        print(f"| {count:,} | {nats:.4f} | {fit_s:.1f} | {peak_mb:.0f} |", flush=True)


def main() -> None:
    """Do what the command line says."""
    if sys.argv[1:2] == ["--train"]:
        train(Path(sys.argv[2]))
    elif sys.argv[1:2] == ["--workers"]:
        print_workers()
    elif sys.argv[1:2] == ["--fitted"]:
        print_fitted()
    else:
        print_sizes([int(float(word)) for word in sys.argv[1:]] or [10_000, 100_000, 1_000_000])


if __name__ == "__main__":
    main()

"""Compare PROBE with nominal and aggressive RANSAC and with the static Student-t.

    python benchmarks/probe.py [point|city|residential|road|rover|kitti|loop …, all by default]
    python benchmarks/probe.py ablation     from PROBE as published to ours, one change at a time

Each trial trains on one drive and is tested on another, of another place (the point world: of other
landmarks; raw 0005: on its second half; the loops: the same field driven again). Scenes are first
rendered into out/probe.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from recordings import RECORDINGS

import probevo as pv
from probevo.cli.compare import aggressive
from probevo.config import OdometryConfig
from probevo.config.training import PUBLISHED_PREDICTORS, SupervisionName, TrainSettings
from probevo.evaluation.metrics import Metrics, evaluate
from probevo.output.run_result import RunRecorder, RunResult
from probevo_sim.point_config import PointConfig
from probevo_sim.point_world import write_training_and_test
from probevo_sim.scene.config import Effects, PresetName, SceneConfig
from probevo_sim.scene.writer import write_scene

OUT = Path("out/probe")
TRIALS = ("point", "city", "residential", "road", "rover", "kitti", "loop")
EFFECTS = Effects(traffic=0.5, shadows=0.5, noise=0.3)
"""The effects of the demo: clearly harder than a clean scene, but every estimator copes."""
ROAD_EFFECTS = Effects(traffic=0.25, shadows=0.25, noise=0.15)
"""Half of ``EFFECTS``: with all of it, most features of the bare road are on the cars that drive
along, and every estimator follows them (drift 65 to 117 %)."""
STREET_M = 120.0
ROAD_M = 250.0
ROVER_M = 40.0
LOOPS = 5
PUBLISHED_SETTINGS = TrainSettings.published().model_copy(
    update={"predictors": tuple(name for name in PUBLISHED_PREDICTORS if name != "acceleration")}
)
"""PROBE as published without the accelerometer, which not all of these drives have."""
FROM_TRACKS = (
    "flow_variance",
    "place",
    "disparity",
    "disparity_change",
    "residual_flow",
    "row_offset",
    "flow",
)
"""Our predictors for the point world, which has no images."""
PUBLISHED_FROM_TRACKS = ("turn_rate", "flow_variance")
"""The published predictors for the point world."""
ABLATION: dict[str, dict[str, object]] = {
    "as published": {},
    "with RANSAC": {"odometry": OdometryConfig(estimator="two-frame")},
    "scaling Student-t noise": {"base": "student-t"},
    "subsets of 8, 40 of them": {"subset": 8, "iterations": 40},
    "α against others of the step, and geometry": {"relative": True},
    "geometric mean": {"average": "geometric"},
    "subsets that lean (contrast 3)": {"contrast": 3.0},
    "our predictors": {"predictors": TrainSettings().predictors},
    "no truth": {"supervision": "none"},
}
"""Changes from PROBE as published to ours, each on top of those before."""
HEAD = (
    "trial",
    "estimator",
    "step, mm",
    "ARMSE, m",
    "final error, m",
    "drift, %",
    "rotation, °/m",
    "ANEES",
)


@dataclass(frozen=True)
class Trial:
    """A drive to train on, and those to test on."""

    name: str
    train: Path
    tests: tuple[Path, ...]
    supervisions: tuple[SupervisionName, ...] = ("gt", "none")
    images: bool = True
    half: int | None = None
    """Train on so many frames, and test on those from there on."""


class Estimator(NamedTuple):
    """A noise model, and the settings that the odometry runs with."""

    name: str
    noise: pv.noise.NoiseModel
    config: OdometryConfig


def scene(
    preset: PresetName, seed: int, distance_m: float, drive: int = 0, truth: str = "all"
) -> Path:
    """Render a scene as far as an earlier call did not; return its folder."""
    effects = ROAD_EFFECTS if preset == "road" else EFFECTS
    config = SceneConfig(
        preset=preset, seed=seed, drive=drive, distance_m=distance_m, truth=truth, effects=effects
    )
    return write_scene(config, OUT / f"{preset}-{seed}-{drive}-{truth}")


def trials(wanted: list[str], places: int | None = None) -> Iterator[Trial]:
    """Yield the trials of these names, streets tested in so many places.

    By default that is one place, and two for the road.
    """
    for name in wanted:
        if name == "point":
            write_training_and_test(PointConfig(), OUT / "point")
            train = OUT / "point" / "train.npz"
            test = OUT / "point" / "test.npz"
            yield Trial("point world", train, (test,), images=False)
        elif name in ("city", "residential"):
            train = scene(name, 1, STREET_M)
            tests = tuple(scene(name, seed, STREET_M) for seed in range(2, 2 + (places or 1)))
            yield Trial(name, train, tests)
        elif name == "road":
            train = scene(name, 1, ROAD_M)
            tests = tuple(scene(name, seed, ROAD_M) for seed in range(2, 2 + (places or 2)))
            yield Trial(name, train, tests)
        elif name == "rover":
            yield Trial(name, scene("rover", 1, ROVER_M), (scene("rover", 2, ROVER_M),))
        elif name == "kitti" and all(path.is_dir() for path in RECORDINGS.values()):
            raw = RECORDINGS["raw 0005"]
            yield Trial("raw 0005, second half", raw, (raw,), half=77)
            yield Trial("raw 0005 → odometry 06", raw, (RECORDINGS["odometry 06"],))
        elif name == "loop":
            first, *rest = (scene("rover", 0, ROVER_M, drive, "loop") for drive in range(LOOPS))
            yield Trial("rover loops", first, tuple(rest), ("loop", "none"))


def estimators(trial: Trial) -> Iterator[Estimator]:
    """Yield the estimators of a trial; the learned ones are trained first."""
    plain = OdometryConfig(estimator="two-frame")
    yield Estimator("nominal RANSAC", pv.noise.Fixed(), plain)
    yield Estimator("aggressive RANSAC", pv.noise.Fixed(), aggressive(plain))
    yield Estimator("student-t", pv.noise.StudentT(), plain)

    published = PUBLISHED_SETTINGS.model_copy(update={"supervision": trial.supervisions[0]})
    if not trial.images:
        published = published.model_copy(update={"predictors": PUBLISHED_FROM_TRACKS})
    yield learned("PROBE as published", trial, published)

    for supervision in trial.supervisions:
        ours = TrainSettings(supervision=supervision)
        if not trial.images:
            ours = ours.model_copy(update={"predictors": FROM_TRACKS})
        yield learned(f"PROBE, ours, {supervision}", trial, ours)


def learned(name: str, trial: Trial, settings: TrainSettings) -> Estimator:
    """Train on the drive of a trial."""
    path = OUT / "models" / f"{trial.name}-{name}.safetensors".replace(" ", "-")
    model = train(trial.train, settings.model_copy(update={"max_frames": trial.half}), path)
    return Estimator(f"{name} {chosen(model)}", model, settings.odometry)


def train(recording: Path, settings: TrainSettings, path: Path) -> pv.noise.NearestNeighbors:
    """Train on a recording, and load the model."""
    return pv.load_model(pv.train_model([pv.open_sequence(recording)], settings, path))


def chosen(model: pv.noise.NearestNeighbors) -> str:
    """Return the K and γ that the training chose."""
    return f"(K {model.neighbors}, γ {model.exponent:g})"


def estimate(path: Path, noise: pv.noise.NoiseModel, config: OdometryConfig) -> RunResult:
    """Run the odometry over a whole recording."""
    sequence = pv.open_sequence(path)
    recorder = RunRecorder()
    odometry = pv.StereoOdometry(sequence.camera, noise, sequence.imu, config)
    for frame in islice(sequence, len(sequence)):
        recorder.add(frame.stamp_ns, odometry.step(frame))
    return recorder.result()


def run(path: Path, noise: pv.noise.NoiseModel, config: OdometryConfig, first: int) -> Metrics:
    """Run over a recording; return the metrics over the frames from ``first`` on."""
    result = estimate(path, noise, config)
    truth = pv.open_sequence(path).truth.T_world_cam
    return evaluate(
        result.T_world_cam[first:],
        truth[first:],
        result.T_curr_prev[first:],
        cov=result.cov[first:],
    )


def print_ablation() -> None:
    """Print the RMS error of a step, mm, on the second street of each preset, change by change."""
    settings = PUBLISHED_SETTINGS
    path = OUT / "models" / "ablation.safetensors"
    for name, change in ABLATION.items():
        settings = settings.model_copy(update=change)
        cells = []
        for preset in ("city", "residential", "rover"):
            distance_m = ROVER_M if preset == "rover" else STREET_M
            model = train(scene(preset, 1, distance_m), settings, path)
            metrics = run(scene(preset, 2, distance_m), model, settings.odometry, 0)
            cells.append(f"{1e3 * (metrics.rpe_t_m or np.nan):.2f} {chosen(model)}")
        print(f"| {name} | {' | '.join(cells)} |", flush=True)


def print_trial(trial: Trial) -> None:
    """Print a row for each estimator and test drive."""
    for estimator in estimators(trial):
        for number, path in enumerate(trial.tests, start=1):
            metrics = run(path, estimator.noise, estimator.config, trial.half or 0)
            figures = (
                1e3 * (metrics.rpe_t_m or np.nan),
                metrics.armse_m,
                metrics.final_error_m,
                metrics.short_t_percent,
                metrics.short_r_deg_per_m,
                metrics.anees,
            )
            cells = [
                "–" if value is None or not np.isfinite(value) else f"{value:.3g}"
                for value in figures
            ]
            label = trial.name if len(trial.tests) == 1 else f"{trial.name} {number}"
            print(f"| {label} | {estimator.name} | {' | '.join(cells)} |", flush=True)


def main() -> None:
    """Print the tables of docs/probe.md."""
    cv2.setNumThreads(1)
    if sys.argv[1:] == ["ablation"]:
        print_ablation()
        return
    print(f"| {' | '.join(HEAD)} |\n|{'---|' * len(HEAD)}")
    for trial in trials(sys.argv[1:] or list(TRIALS)):
        print_trial(trial)


if __name__ == "__main__":
    main()

"""Learn on spoiled recordings, and test on others that are spoiled: docs/degradation.md.

    python benchmarks/learning_spoiled.py [--of 06 kitti_0039 city residential] [--seeds 10]
        [--estimators two-frame window] [--models out/learning_spoiled]

The static Student-t and generalized kernels with several sets of predictors are learned without
truth, from raw 0005 for real recordings and from a rendered city and residential street for
rendered ones, all spoiled as by ``probevo simulate spoil``. Other recordings are spoiled by other
seeds. The reference is the exact truth of rendered ones; of real ones, the run on the clean images,
once with the untrained Student-t for all models, and once with the model's own.

Prints, for each recording, estimator and model: steps that are OK; RMS error of their translation
over all seeds; the ratio to the fitted Student-t's, median over the seeds; how many seeds are
better, and by a fifth; the same two for the model's own clean run; NEES over 6 (1 is consistent),
median over the seeds, and on how many seeds it is nearer to 1 than the fitted Student-t's; OK steps
outside of their 99.73 % region.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from probe import scene
from recordings import ROOT

import probevo as pv
from probevo.arrays import IntArray
from probevo.camera.stereo import StereoCamera
from probevo.config.training import KERNEL_PREDICTORS, KernelSettings, TrainSettings
from probevo.estimation.motion_estimate import Status
from probevo.evaluation.trajectory_errors import relative_motions
from probevo.output.run_result import RunRecorder, RunResult
from probevo.sequences import Sequence
from probevo.sequences.frame import Frame
from probevo_sim.spoiling.config import SpoilConfig
from probevo_sim.spoiling.recording import SpoiledRecording
from probevo_sim.spoiling.stress import StepErrors, step_errors

REAL = {
    "06": "kitti_odometry/sequences/06",
    "kitti_0039": "kitti_0039/sequences/39",
}
RENDERED = ("city", "residential")
STREET_M = 120.0
TRAINING_PLACE = 1
TEST_PLACE = 2
"""Seeds of the places that streets are rendered of."""
REAL_TRAINING = "kitti_raw/2011_09_26/2011_09_26_drive_0005_sync"
TRAINING_SEEDS = {"real": (100, 101, 102), "rendered": (100,)}
"""How the recordings of a training are spoiled; each version of one counts as a drive."""
SEVERITY = 0.5
CLEAN_START_FRAMES = 5
OUTSIDE = 20.06
"""Squared Mahalanobis distance that 0.27 % exceed, with six degrees of freedom."""
FITTED = "fitted Student-t"
NEW = ("alignment",)
"""Predictors of how well windows match, which older versions did not have."""
OLD = tuple(name for name in KERNEL_PREDICTORS if name not in NEW)
SETS = {
    "gk, old predictors": OLD,
    "gk": (*OLD, *NEW),
}
TRAININGS = {FITTED: TrainSettings(kind="student-t", supervision="none")} | {
    name: TrainSettings(
        kind="gk", supervision="none", gk=KernelSettings(iterations=3), predictors=predictors
    )
    for name, predictors in SETS.items()
}
"""What is learned, by the name in the table."""
HEAD = (
    "noise",
    "OK, %",
    "step, mm",
    "× fitted",
    "seeds better, by a fifth",
    "by its own clean run: × fitted",
    "seeds",
    "NEES / 6",
    "seeds nearer to 1",
    "outside, %",
)


@dataclass(frozen=True)
class World:
    """A recording in memory."""

    camera: StereoCamera
    frames: list[Frame]
    kept: IntArray
    """Numbers of the frames in the recording that it was made of."""


@dataclass(frozen=True)
class Score:
    """What a model has achieved on one spoiled recording."""

    ok: float
    """Share of the steps."""
    squared_mm2: float
    """Mean squared error of the OK steps."""
    nees: float
    """Mean NEES of the OK steps, over 6."""
    outside: float
    """Share of the OK steps."""
    own_squared_mm2: float
    """Mean squared error of the OK steps against the model's own reference."""

    @staticmethod
    def of(errors: StepErrors, own: StepErrors) -> Score:
        """Summarise the errors of the steps against the common and against the own reference."""
        nees = np.array(errors.nees)[np.array(errors.is_ok, bool)]
        return Score(
            ok=float(np.mean(errors.is_ok)),
            squared_mm2=mean_square_mm2(errors),
            nees=float(nees.mean()) / 6.0,
            outside=float((nees > OUTSIDE).mean()),
            own_squared_mm2=mean_square_mm2(own),
        )


def mean_square_mm2(errors: StepErrors) -> float:
    """Return the mean squared translation error of the OK steps."""
    translation_mm = 1e3 * np.array(errors.translation_m)[np.array(errors.is_ok, bool)]
    return float(np.mean(translation_mm**2))


def spoiling(seed: int) -> SpoilConfig:
    """Return how a recording is spoiled."""
    return SpoilConfig(seed=seed, severity=SEVERITY, clean_start_frames=CLEAN_START_FRAMES)


def spoiled_copies(path: Path, seeds: Iterable[int]) -> list[SpoiledRecording]:
    """Return the spoiled copies of a recording to learn from."""
    original = pv.open_sequence(path)
    return [
        # Of another path each: a training takes no recording twice
        replace(SpoiledRecording.of(original, spoiling(seed)), path=path / f"seed-{seed}")
        for seed in seeds
    ]


def models(folder: Path, names: Iterable[str], *, kind: str) -> dict[str, pv.noise.NoiseModel]:
    """Learn each model from real or rendered recordings, unless the folder has it."""
    paths = (
        [ROOT / REAL_TRAINING]
        if kind == "real"
        else [scene(preset, TRAINING_PLACE, STREET_M) for preset in RENDERED]
    )
    found: dict[str, pv.noise.NoiseModel] = {}
    for name in names:
        file = f"{kind}-{name}.safetensors".replace(" ", "-")
        if not (folder / file).is_file():
            copies = [copy for path in paths for copy in spoiled_copies(path, TRAINING_SEEDS[kind])]
            pv.train_model(copies, TRAININGS[name], folder / file)
        model = pv.load_model(folder / file)
        print(f"{name}: {', '.join(model.columns) or 'no predictors'}", flush=True)
        found[name] = model
    return found


def clean_world(path: Path) -> World:
    """Load a recording into memory."""
    sequence = pv.open_sequence(path)
    frames = [replace(frame, imu=None) for frame in sequence]
    return World(sequence.camera, frames, kept=np.arange(len(frames)))


def spoiled_world(path: Path, seed: int) -> World:
    """Load a spoiled recording into memory."""
    sequence = SpoiledRecording.of(pv.open_sequence(path), spoiling(seed))
    kept = [index for index, plan in enumerate(sequence.plans) if plan.effect != "dropped"]
    frames = [replace(frame, imu=None) for frame in sequence]
    return World(sequence.camera, frames, kept=np.array(kept))


def run(world: World, noise: pv.noise.NoiseModel, estimator: str) -> RunResult:
    """Run the odometry without any IMU."""
    config = pv.OdometryConfig.model_validate({"estimator": estimator})
    odometry = pv.StereoOdometry(world.camera, noise, config=config)
    recorder = RunRecorder()
    for frame in world.frames:
        recorder.add(frame.stamp_ns, odometry.step(frame))
    return recorder.result()


def exact(result: RunResult, sequence: Sequence) -> RunResult:
    """Return a run that has found the truth."""
    if sequence.truth is None:
        raise ValueError(f"{sequence.path} has no truth")
    return replace(
        result,
        T_curr_prev=relative_motions(sequence.truth.T_world_cam),
        cov=np.zeros_like(result.cov),
        status=np.full_like(result.status, Status.OK),
    )


def row(name: str, scores: list[Score], fitted: list[Score]) -> str:
    """Return a line of the table."""
    pairs = list(zip(scores, fitted, strict=True))
    ratio = np.sqrt([one.squared_mm2 / other.squared_mm2 for one, other in pairs])
    own = np.sqrt([one.own_squared_mm2 / other.own_squared_mm2 for one, other in pairs])
    nearer = sum(abs(np.log(one.nees)) < abs(np.log(other.nees)) for one, other in pairs)
    cells = [
        name,
        f"{100.0 * np.mean([one.ok for one in scores]):.1f}",
        f"{np.sqrt(np.mean([one.squared_mm2 for one in scores])):.2f}",
        f"{np.median(ratio):.2f}",
        f"{(ratio < 1.0).sum()}, {(ratio <= 0.8).sum()}",
        f"{np.median(own):.2f}",
        f"{(own < 1.0).sum()}, {(own <= 0.8).sum()}",
        f"{np.median([one.nees for one in scores]):.2f}",
        str(nearer),
        f"{100.0 * np.mean([one.outside for one in scores]):.1f}",
    ]
    return "| " + " | ".join(cells) + " |"


def test(
    path: Path,
    learned: dict[str, pv.noise.NoiseModel],
    estimator: str,
    *,
    kind: str,
    num_seeds: int,
) -> dict[str, list[Score]]:
    """Return the scores of each model on a recording, one for each seed."""
    clean = clean_world(path)
    common = run(clean, pv.noise.StudentT(), estimator)
    if kind == "real":
        own = {name: run(clean, noise, estimator) for name, noise in learned.items()}
    else:
        common = exact(common, pv.open_sequence(path))
        own = dict.fromkeys(learned, common)
    scores: dict[str, list[Score]] = {name: [] for name in learned}
    for seed in range(num_seeds):
        world = spoiled_world(path, seed)
        for name, noise in learned.items():
            result = run(world, noise, estimator)
            errors = step_errors(common, result, world.kept)
            scores[name].append(Score.of(errors, step_errors(own[name], result, world.kept)))
    return scores


def main() -> None:
    """Parse the command line, learn, and print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=10, help="spoiled versions of each recording")
    parser.add_argument("--of", nargs="+", default=[*REAL, *RENDERED])
    parser.add_argument("--estimators", nargs="+", default=["two-frame", "window"])
    parser.add_argument("--noise", nargs="+", default=list(TRAININGS), help="which models")
    parser.add_argument("--models", type=Path, default=Path("out/learning_spoiled"))
    given = parser.parse_args()
    cv2.setNumThreads(1)
    for name in given.of:
        path = ROOT / REAL[name] if name in REAL else scene(name, TEST_PLACE, STREET_M)
        kind = "real" if name in REAL else "rendered"
        learned = models(given.models, given.noise, kind=kind)
        for estimator in given.estimators:
            scores = test(path, learned, estimator, kind=kind, num_seeds=given.seeds)
            print(f"\n{name}, {estimator}, {given.seeds} seeds\n")
            print(f"| {' | '.join(HEAD)} |\n|{'---|' * len(HEAD)}")
            for model in learned:
                print(row(model, scores[model], scores[FITTED]), flush=True)


if __name__ == "__main__":
    main()

"""Compare PROBE-GK with the best static Student-t in the point world.

    python benchmarks/kernel_points.py [seeds] [law …]    20 seeds of every law by default

Prints error and consistency of the motion for each noise law: how the noise depends on the place
in the image. 5 % of the landmarks are outliers,
±20 px. Training and test worlds are independent, the rig is flawless, and all estimators start from
the same RANSAC:

- *best-scaled static*: the Student-t (ν = 5) whose scale has the least ARMSE on the test itself,
  with the noise of residuals, as in PROBE-GK, and with that of observations, as probevo ships it;
- *fitted Student-t* and the kernels *GK-…*: learned on the training world;
- *known covariances*: our odometry with the true covariance of every observation;
- *oracle*: the same, but it also knows which landmarks are outliers.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal, NamedTuple

import numpy as np
from points import KnownCovariances, oracle

import probevo as pv
from probevo.config.training import KernelSettings, SupervisionName, TrainSettings
from probevo.estimation.reprojection import solve_reprojection
from probevo.evaluation.consistency import feature_coverage
from probevo.evaluation.metrics import Metrics, evaluate
from probevo.measurements.stereo_observations import StereoObservations
from probevo.output.run_result import RunRecorder
from probevo_sim.point_config import PointConfig
from probevo_sim.point_world import PointWorld, write_training_and_test

LAWS = ("row", "column", "radius", "disparity", "heavy-tailed", "correlated")
SCALES_PX = (0.1, 0.2, 0.4, 0.8)
PREDICTORS = ("place", "disparity")
NO_CALIBRATION = pv.OdometryConfig(estimator="two-frame", self_calibration=False)
COVERAGE_SEEDS = 3
"""Seeds of which the coverage of single features is computed, too."""
HEAD = (
    "law",
    "estimator",
    "ARMSE, m",
    "RMS of a step, mm",
    "ANEES",
    "features within 50 / 90 / 95 / 99 %",
)


class Training(NamedTuple):
    """How a learned estimator is trained."""

    kind: Literal["student-t", "gk"]
    supervision: SupervisionName
    kernel: KernelSettings = KernelSettings()


TRAININGS = {
    "fitted Student-t": Training("student-t", "gt"),
    "GK-GT published": Training(
        "gk", "gt", KernelSettings(variant="published", refers_to="residual", iterations=1)
    ),
    "GK-GT": Training("gk", "gt"),
    "GK-EM": Training("gk", "none"),
}


def config_of(law: str, seed: int) -> PointConfig:
    """Return the worlds of a law; *correlated* is that of rows, left and right correlated."""
    noise = {"law": "row", "correlation": 0.8} if law == "correlated" else {"law": law}
    return PointConfig.model_validate(
        {"seed": seed, "noise": noise, "outliers": {"fraction": 0.05, "range_px": 20.0}}
    )


def train(folder: Path, training: Training) -> pv.noise.NoiseModel:
    """Train on the training world of a folder."""
    settings = TrainSettings(
        kind=training.kind,
        supervision=training.supervision,
        predictors=PREDICTORS if training.kind == "gk" else None,
        gk=training.kernel,
        odometry=NO_CALIBRATION,
    )
    sequence = pv.open_sequence(folder / "train.npz")
    return pv.load_model(pv.train_model([sequence], settings, folder / "m.safetensors"))


def run(world: PointWorld, noise: pv.noise.NoiseModel) -> Metrics:
    """Run the odometry over a world."""
    odometry = pv.StereoOdometry(world.camera, noise, config=NO_CALIBRATION)
    recorder = RunRecorder()
    for frame in world.frames():
        recorder.add(frame.stamp_ns, odometry.step(frame))
    result = recorder.result()
    return evaluate(result.T_world_cam, world.T_world_cam, result.T_curr_prev, cov=result.cov)


def best_scaled_static(world: PointWorld, refers_to: str) -> Metrics:
    """Run the static Student-t at each scale; return the metrics of that with the least ARMSE."""
    runs = [
        run(world, pv.noise.StudentT(5.0, scale_px**2 * np.eye(4), refers_to=refers_to))
        for scale_px in SCALES_PX
    ]
    return min(runs, key=lambda metrics: metrics.armse_m)


def coverage(world: PointWorld, model: pv.noise.NoiseModel) -> list[float]:
    """Return the shares of inliers within their 50, 90, 95 and 99 % regions at the true motion."""
    shares: dict[str, list[float]] = defaultdict(list)
    odometry = pv.StereoOdometry(world.camera, model, config=NO_CALIBRATION)
    frames = world.frames()
    odometry.step(next(frames))
    for step, frame in zip(world.steps(), frames, strict=True):
        odometry.step(frame)
        noise = model.predict(odometry.phi).subset(np.flatnonzero(odometry.used))
        tracks = odometry.tracks.subset(odometry.used)
        # No iteration is taken, so that residuals and their information are those at the truth.
        at_truth = solve_reprojection(
            StereoObservations.of(tracks.prev_px, tracks.curr_px, noise, camera=world.camera),
            guess=step.T_curr_prev,
            max_iterations=0,
        )
        scale = np.linalg.inv(at_truth.features.information)
        residual_noise = pv.noise.StereoNoise(scale, noise.dof, np.zeros((len(scale), 4)))
        for level, share in feature_coverage(residual_noise, at_truth.features.residuals).items():
            shares[level].append(share)
    return [float(np.mean(values)) for values in shares.values()]


def print_law(law: str, seeds: int) -> None:
    """Print the rows of a law: means over the seeds."""
    metrics: dict[str, list[Metrics]] = defaultdict(list)
    coverages: dict[str, list[list[float]]] = defaultdict(list)
    for seed in range(seeds):
        with TemporaryDirectory() as name:
            folder = Path(name)
            config = config_of(law, seed)
            _, test = write_training_and_test(config, folder)
            for refers_to in ("residual", "observation"):
                metrics[f"best-scaled static, {refers_to}"].append(
                    best_scaled_static(test, refers_to)
                )
            for label, training in TRAININGS.items():
                model = train(folder, training)
                metrics[label].append(run(test, model))
                if seed < COVERAGE_SEEDS:
                    coverages[label].append(coverage(test, model))
            metrics["known covariances"].append(run(test, KnownCovariances(config)))
            metrics["oracle"].append(oracle(test))
    for label, runs in metrics.items():
        armse_m = np.mean([each.armse_m for each in runs])
        step_mm = np.mean([1e3 * each.rpe_t_m for each in runs])
        anees = np.mean([each.anees for each in runs])
        shares = np.mean(coverages.get(label, [[]]), axis=0)
        percents = " / ".join(f"{100 * share:.1f}" for share in shares)
        print(
            f"| {law} | {label} | {armse_m:.4f} | {step_mm:.2f} | {anees:.2f} | {percents} |",
            flush=True,
        )


def main() -> None:
    """Print the tables of docs/probe-gk.md."""
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    print(f"| {' | '.join(HEAD)} |\n|{'---|' * len(HEAD)}")
    for law in sys.argv[2:] or LAWS:
        print_law(law, seeds)


if __name__ == "__main__":
    main()

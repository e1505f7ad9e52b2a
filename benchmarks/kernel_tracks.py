"""Compare PROBE-GK with the fitted Student-t on KITTI tracks that it was not trained on.

    python benchmarks/kernel_tracks.py [iterations of EM, 5 by default]

Each of six drives is left out in turn, and the models are trained on the other five. The fitted
Student-t has a full 4×4 scale and ν, without and with time-correlated errors of the disparity; the
kernel has these, too. Prints the likelihood of the residuals, drift and rotation.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from recordings import ROOT

import probevo as pv
from probevo.config import OdometryConfig
from probevo.evaluation.metrics import Metrics, evaluate
from probevo.noise import GeneralizedKernel, StudentT
from probevo.noise.metric import Metric
from probevo.output.run_result import RunRecorder
from probevo.predictors import Needs, PredictionSpace, prediction_space
from probevo.training.drive import joined
from probevo.training.extraction import Extraction
from probevo.training.gk.expectation import MotionPosterior, feature_errors, solve_drive
from probevo.training.gk.expectation_maximization import learn_kernel, learn_student_t
from probevo.training.settings import KERNEL, KernelSettings, TrainSettings
from probevo.training.supervised_drive import DriveInMemory
from probevo.training.supervision import supervision_of
from probevo.training.trainer import TrainingContext

TRACKS = ROOT / "kitti_tracks"
STUDENT_T = "Student-t"
CORRELATED = "it, time-correlated"
KERNEL_NAME = "gk"


class Scores(NamedTuple):
    """The results of a noise model on a drive."""

    nats: float
    """Mean log-likelihood of the residuals, nats a feature."""
    drift_percent: float
    rotation_deg_per_m: float


def likelihood(drive: DriveInMemory, model: pv.noise.NoiseModel, motions: MotionPosterior) -> float:
    """Return the mean log-likelihood of the residuals at these motions, nats a feature.

    Each residual is conditioned on the earlier ones of its track.
    """
    errors = feature_errors(
        drive,
        motions,
        model.predict,
        OdometryConfig().solver,
        share=1.0,
        rng=np.random.default_rng(0),
    )
    return float(errors.log_likelihood.mean())


def run(path: Path, noise: pv.noise.NoiseModel) -> Metrics:
    """Run the odometry over a tracks file."""
    sequence = pv.open_sequence(path)
    recorder = RunRecorder()
    odometry = pv.StereoOdometry(
        sequence.camera, noise, sequence.imu, config={"estimator": "two-frame"}
    )
    for frame in sequence:
        recorder.add(frame.stamp_ns, odometry.step(frame))
    result = recorder.result()
    return evaluate(
        result.T_world_cam, sequence.truth.T_world_cam, result.T_curr_prev, cov=result.cov
    )


def space_of_tracks() -> PredictionSpace:
    """Return the default prediction space of the kernel without predictors that need images."""
    images = Needs.LEFT | Needs.PREVIOUS_LEFT
    predictors = prediction_space(KERNEL).predictors
    return PredictionSpace(tuple(each for each in predictors if not each.needs & images))


def load(path: Path, space: PredictionSpace, settings: TrainSettings) -> DriveInMemory:
    """Read a drive for a training without ground truth."""
    sequence = pv.open_sequence(path)
    count = len(sequence)
    drive = joined(Extraction(sequence, space, settings.odometry, num_frames=count))
    supervision = supervision_of(sequence, "none", 0.0, num_frames=count)
    return DriveInMemory(drive, sequence.camera, supervision)


def print_row(path: Path, scores: dict[str, Scores], own_nats: float) -> None:
    """Print the row of a drive that was left out."""
    learned = [scores[name] for name in (STUDENT_T, CORRELATED, KERNEL_NAME)]
    figures = [f"{each.nats:.2f}" for each in learned]
    figures += [f"{each.drift_percent:.2f}" for each in learned]
    figures += [f"{each.rotation_deg_per_m:.4f}" for each in learned]
    shipped = run(path, pv.noise.StudentT())
    cells = [
        *figures,
        f"{own_nats:.2f}",
        f"{shipped.short_t_percent:.2f}, {shipped.short_r_deg_per_m:.4f}",
    ]
    print(f"| {path.stem} | {' | '.join(cells)} |", flush=True)


def main() -> None:
    """Print the table of docs/probe-gk.md, and the means over the drives."""
    iterations = int(sys.argv[1]) if len(sys.argv) > 1 else 5
    settings = TrainSettings(
        kind="gk", supervision="none", gk=KernelSettings(iterations=iterations)
    )
    uncorrelated = settings.model_copy(
        update={"gk": KernelSettings(iterations=iterations, time_correlation=False)}
    )
    space = space_of_tracks()
    paths = sorted(TRACKS.glob("*.npz"))
    drives = [load(path, space, settings) for path in paths]

    columns = [
        f"{measure}: {name}"
        for measure in ("nats", "drift, %", "°/m")
        for name in (STUDENT_T, CORRELATED, KERNEL_NAME)
    ]
    print(f"| left out | {' | '.join(columns)} | nats: own Student-t | shipped |\n|{'---|' * 12}")
    rows: list[dict[str, Scores]] = []
    own_nats: list[float] = []
    for number, (path, own) in enumerate(zip(paths, drives, strict=True)):
        # Train on all drives but this one.
        rest = [drive for other, drive in enumerate(drives) if other != number]
        phi = np.concatenate([drive.drive.phi for drive in rest])
        metric = Metric.fitted(phi, space.columns, space.may_be_undefined)
        context = TrainingContext(drives=rest, metric=metric, settings=settings)
        models: dict[str, StudentT | GeneralizedKernel] = {
            STUDENT_T: learn_student_t(replace(context, settings=uncorrelated)),
            CORRELATED: learn_student_t(context),
            KERNEL_NAME: learn_kernel(context),
        }

        # All likelihoods are those at the motions of the Student-t.
        motions = solve_drive(own, models[STUDENT_T].predict, settings.odometry.solver)
        scores = {}
        for name, model in models.items():
            metrics = run(path, model)
            scores[name] = Scores(
                nats=likelihood(own, model, motions),
                drift_percent=metrics.short_t_percent,
                rotation_deg_per_m=metrics.short_r_deg_per_m,
            )
        rows.append(scores)

        # For comparison, a Student-t that was fitted to the left-out drive itself.
        of_own = learn_student_t(replace(context, drives=[own]))
        own_nats.append(likelihood(own, of_own, motions))
        print_row(path, scores, own_nats[-1])

    kernel_nats = np.array([row[KERNEL_NAME].nats for row in rows])
    gains = [
        np.mean(kernel_nats - [row[name].nats for row in rows]) for name in (STUDENT_T, CORRELATED)
    ]
    gains.append(np.mean(kernel_nats - own_nats))
    print("\ngain over the three, nats: " + ", ".join(f"{gain:.2f}" for gain in gains))
    for name in (STUDENT_T, CORRELATED):
        drift = geometric_mean(
            [row[KERNEL_NAME].drift_percent / row[name].drift_percent for row in rows]
        )
        rotation = geometric_mean(
            [row[KERNEL_NAME].rotation_deg_per_m / row[name].rotation_deg_per_m for row in rows]
        )
        print(f"against the {name}: drift × {drift:.3f}, rotation × {rotation:.3f}")


def geometric_mean(ratios: list[float]) -> float:
    """Return the geometric mean."""
    return float(np.exp(np.log(ratios).mean()))


if __name__ == "__main__":
    main()

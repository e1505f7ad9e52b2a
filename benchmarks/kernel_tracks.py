"""Compare PROBE-GK with the fitted Student-t on KITTI tracks that it was not trained on.

    python benchmarks/kernel_tracks.py [iterations of EM, 5 by default]

Each of six drives is left out in turn, and the models are trained on the other five. The fitted
Student-t has a full 4×4 scale and ν, without and with time-correlated errors of the disparity; the
kernel has these, too. Prints the likelihood of the residuals, and drift and rotation with two
frames and with the window, where the untrained Student-t stands beside them.
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
from probevo.config.training import KERNEL_PREDICTORS, KernelSettings, TrainSettings
from probevo.evaluation.metrics import Metrics, evaluate
from probevo.noise import GeneralizedKernel, StudentT
from probevo.noise.metric import Metric
from probevo.output.run_result import RunRecorder
from probevo.predictors import Needs, PredictionSpace, prediction_space
from probevo.training.drive import joined
from probevo.training.extraction import Extraction
from probevo.training.gk.expectation import MotionPosterior, feature_errors, solve_drive
from probevo.training.gk.expectation_maximization import learn_kernel, learn_student_t
from probevo.training.supervised_drive import DriveInMemory
from probevo.training.supervision import supervision_of
from probevo.training.trainer import TrainingContext

TRACKS = ROOT / "kitti_tracks"
UNTRAINED = "untrained"
STUDENT_T = "Student-t"
CORRELATED = "it, time-correlated"
KERNEL_NAME = "gk"
ESTIMATORS = ("two-frame", "window")


class Scores(NamedTuple):
    """The results of a noise model on a drive."""

    nats: float
    """Mean log-likelihood of the residuals, nats a feature."""
    metrics: dict[str, Metrics]
    """Drift and rotation by the name of the estimator."""


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


def run(path: Path, noise: pv.noise.NoiseModel, estimator: str) -> Metrics:
    """Run an estimator over a tracks file."""
    sequence = pv.open_sequence(path)
    recorder = RunRecorder()
    odometry = pv.StereoOdometry(
        sequence.camera, noise, sequence.imu, config={"estimator": estimator}
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
    predictors = prediction_space(KERNEL_PREDICTORS).predictors
    return PredictionSpace(tuple(each for each in predictors if not each.needs & images))


def load(path: Path, space: PredictionSpace, settings: TrainSettings) -> DriveInMemory:
    """Read a drive for a training without ground truth."""
    sequence = pv.open_sequence(path)
    count = len(sequence)
    drive = joined(Extraction(sequence, space, settings.odometry, num_frames=count))
    supervision = supervision_of(sequence, "none", 0.0, num_frames=count)
    return DriveInMemory(drive, sequence.camera, supervision)


def print_rows(path: Path, scores: dict[str, Scores], own_nats: float) -> None:
    """Print what was found on a drive that was left out: likelihoods, then a line an estimator."""
    nats = ", ".join(f"{name} {score.nats:.2f}" for name, score in scores.items())
    print(f"{path.stem}: nats a feature: {nats}; Student-t of this drive itself {own_nats:.2f}")
    for estimator in ESTIMATORS:
        cells = []
        for name, score in scores.items():
            metrics = score.metrics[estimator]
            cells.append(
                f"{name} {metrics.short_t_percent:.2f} / {metrics.short_r_deg_per_m:.4f},"
                f" {metrics.final_error_m:.1f} m"
            )
        print(f"  {estimator:9}  {';  '.join(cells)}", flush=True)


def print_means(rows: list[dict[str, Scores]], own_nats: list[float]) -> None:
    """Print how the kernel compares with the other models, over all drives."""
    kernel_nats = np.array([row[KERNEL_NAME].nats for row in rows])
    gains = [
        np.mean(kernel_nats - [row[name].nats for row in rows]) for name in (STUDENT_T, CORRELATED)
    ]
    gains.append(np.mean(kernel_nats - own_nats))
    print("\ngain over the three, nats: " + ", ".join(f"{gain:.2f}" for gain in gains))
    for estimator in ESTIMATORS:
        for name in (UNTRAINED, STUDENT_T, CORRELATED):
            pairs = [
                (row[KERNEL_NAME].metrics[estimator], row[name].metrics[estimator]) for row in rows
            ]
            drift = geometric_mean(
                [ours.short_t_percent / its.short_t_percent for ours, its in pairs]
            )
            rotation = geometric_mean(
                [ours.short_r_deg_per_m / its.short_r_deg_per_m for ours, its in pairs]
            )
            print(f"{estimator}, gk against {name}: drift × {drift:.3f}, rotation × {rotation:.3f}")


def main() -> None:
    """Print the tables of docs/probe-gk.md, and the means over the drives."""
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

    rows: list[dict[str, Scores]] = []
    own_nats: list[float] = []
    for number, (path, own) in enumerate(zip(paths, drives, strict=True)):
        # Train on all drives but this one.
        rest = [drive for other, drive in enumerate(drives) if other != number]
        phi = np.concatenate([drive.drive.phi for drive in rest])
        metric = Metric.fitted(phi, space.columns, space.may_be_undefined)
        context = TrainingContext(drives=rest, metric=metric, settings=settings)
        models: dict[str, StudentT | GeneralizedKernel] = {
            UNTRAINED: StudentT(),
            STUDENT_T: learn_student_t(replace(context, settings=uncorrelated)),
            CORRELATED: learn_student_t(context),
            KERNEL_NAME: learn_kernel(context),
        }

        # All likelihoods are those at the motions of the Student-t.
        motions = solve_drive(own, models[STUDENT_T].predict, settings.odometry.solver)
        scores = {}
        for name, model in models.items():
            scores[name] = Scores(
                nats=likelihood(own, model, motions),
                metrics={estimator: run(path, model, estimator) for estimator in ESTIMATORS},
            )
        rows.append(scores)

        # For comparison, a Student-t that was fitted to the left-out drive itself.
        of_own = learn_student_t(replace(context, drives=[own]))
        own_nats.append(likelihood(own, of_own, motions))
        print_rows(path, scores, own_nats[-1])
    print_means(rows, own_nats)


def geometric_mean(ratios: list[float]) -> float:
    """Return the geometric mean."""
    return float(np.exp(np.log(ratios).mean()))


if __name__ == "__main__":
    main()

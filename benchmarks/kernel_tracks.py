"""PROBE-GK on six drives of KITTI tracks, each left out in turn: likelihood and motion against the
fitted Student-t.

python benchmarks/kernel_tracks.py [turns]

The fitted Student-t: full 4×4 scale and ν, without and with what lasts of a disparity's error; gk
has it.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import probevo as pv
from probevo.config import OdometryConfig
from probevo.evaluation.metrics import Metrics, evaluate
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

TRACKS = Path("../shared/data/kitti_tracks")


def likelihood(drive: DriveInMemory, model: pv.noise.NoiseModel, motions: MotionPosterior) -> float:
    """Of the residuals at these motions, each given all before it, nats a feature."""
    solver = OdometryConfig().solver
    rng = np.random.default_rng(0)
    found = feature_errors(drive, motions, model.predict, solver, share=1.0, rng=rng)
    return float(found.log_likelihood.mean())


def run(path: Path, noise: pv.noise.NoiseModel) -> Metrics:
    sequence = pv.open_sequence(path)
    recorder = RunRecorder()
    odometry = pv.StereoOdometry(sequence.camera, noise, sequence.imu)
    for frame in sequence:
        recorder.add(frame.stamp_ns, odometry.step(frame))
    result = recorder.result()
    return evaluate(
        result.T_world_cam, sequence.truth.T_world_cam, result.T_curr_prev, cov=result.cov
    )


def main() -> None:
    paths = sorted(TRACKS.glob("*.npz"))
    turns = int(sys.argv[1]) if len(sys.argv) > 1 else 5
    space = PredictionSpace(
        tuple(
            p
            for p in prediction_space(KERNEL).predictors
            if not p.needs & (Needs.LEFT | Needs.PREVIOUS_LEFT)
        )
    )
    settings = TrainSettings(kind="gk", supervision="none", gk=KernelSettings(iterations=turns))
    drives = []
    for path in paths:
        sequence = pv.open_sequence(path)
        drive = joined(Extraction(sequence, space, settings.odometry, num_frames=len(sequence)))
        drives.append(
            DriveInMemory(
                drive,
                sequence.camera,
                supervision_of(sequence, "none", 0.0, num_frames=len(sequence)),
            )
        )
    fresh = settings.model_copy(
        update={"gk": KernelSettings(iterations=turns, time_correlation=False)}
    )
    ratios = []
    gains = []
    columns = [
        f"{what}: {who}"
        for what in ("nats", "drift, %", "°/m")
        for who in ("Student-t", "it, lasting", "gk")
    ]
    print(f"| left out | {' | '.join(columns)} | nats: own Student-t | shipped |\n|{'---|' * 12}")
    for number, path in enumerate(paths):
        rest = [drive for n, drive in enumerate(drives) if n != number]
        own = drives[number]
        metric = Metric.fitted(
            np.concatenate([each.drive.phi for each in rest]), space.columns, space.may_be_undefined
        )
        models = [
            learn_student_t(TrainingContext(rest, metric, fresh)),
            learn_student_t(TrainingContext(rest, metric, settings)),
            learn_kernel(TrainingContext(rest, metric, settings)),
        ]
        oneself = learn_student_t(TrainingContext([own], metric, settings))
        at = solve_drive(own, models[0].predict, settings.odometry.solver)
        nats = [likelihood(own, model, at) for model in (*models, oneself)]
        runs = [run(path, model) for model in (*models, pv.noise.StudentT())]
        drift, rotation = (
            [getattr(r, name) for r in runs] for name in ("short_t_percent", "short_r_deg_per_m")
        )
        ratios.append([[values[2] / values[n] for values in (drift, rotation)] for n in (0, 1)])
        gains.append(nats[2] - np.array(nats)[[0, 1, 3]])
        figures = [f"{value:.2f}" for value in (*nats[:3], *drift[:3])] + [
            f"{value:.4f}" for value in rotation[:3]
        ]
        shipped = f"{drift[3]:.2f}, {rotation[3]:.4f}"
        print(f"| {path.stem} | {' | '.join(figures)} | {nats[3]:.2f} | {shipped} |", flush=True)
    print(
        "\ngain over the three, nats: "
        + ", ".join(f"{gain:.2f}" for gain in np.mean(gains, axis=0))
    )
    for name, (drift, rotation) in zip(
        ("Student-t", "it, lasting"), np.exp(np.log(ratios).mean(axis=0)).tolist(), strict=True
    ):
        print(f"against the {name}: drift × {drift:.3f}, rotation × {rotation:.3f}")


if __name__ == "__main__":
    main()

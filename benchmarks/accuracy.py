"""Measure the accuracy of the classical noise models on the real recordings.

    python benchmarks/accuracy.py

All runs have the same settings. Prints drift and rotation over pieces of 10 to 50 m, the worst step
against the truth, and how many steps were not solved; and the drift on EuRoC V1_01, which is at
rest, beside its claimed 3σ.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from recordings import ROOT, available

import probevo as pv
from probevo.evaluation.consistency import drift_covariances
from probevo.evaluation.metrics import evaluate
from probevo.evaluation.trajectory_errors import relative_motions
from probevo.output.run_result import RunRecorder, RunResult
from probevo.sequences import Sequence

MODELS: dict[str, Callable[[], pv.noise.NoiseModel]] = {
    "fixed": pv.noise.Fixed,
    "student-t": pv.noise.StudentT,
}


def run(sequence: Sequence, model: str) -> RunResult:
    """Run the odometry over a whole recording."""
    odometry = pv.StereoOdometry(
        sequence.camera, MODELS[model](), sequence.imu, config={"estimator": "two-frame"}
    )
    recorder = RunRecorder()
    for frame in sequence:
        recorder.add(frame.stamp_ns, odometry.step(frame))
    return recorder.result()


def print_accuracy(path: Path, model: str) -> None:
    """Print the row of a recording and a noise model."""
    sequence = pv.open_sequence(path)
    result = run(sequence, model)
    truth = sequence.truth.T_world_cam
    metrics = evaluate(result.T_world_cam, truth)
    estimated_m = result.T_curr_prev[:, :3, 3]
    step_errors_m = np.linalg.norm(estimated_m - relative_motions(truth)[:, :3, 3], axis=1)
    unsolved = int((result.status != pv.Status.OK).sum())
    print(
        f"{path.stem:28} {model:10} {metrics.short_t_percent:10.3f}"
        f" {metrics.short_r_deg_per_m:13.4f} {np.nanmax(step_errors_m):14.2f} {unsolved:9d}"
    )


def print_drift_at_rest(path: Path) -> None:
    """Print how far the pose drifts where the camera does not move, and the claimed 3σ."""
    result = run(pv.open_sequence(path), "student-t")
    cov = drift_covariances(
        result.T_curr_prev, result.cov, result.common_mode, path_cross_cov=result.path_cross_cov
    )
    drift_m = result.T_world_cam[-1, :3, 3]
    sigma_m = np.sqrt(np.diagonal(cov[-1])[:3])
    print(
        f"EuRoC at rest: drift {np.round(1e3 * drift_m, 2)} mm, 3σ {np.round(3e3 * sigma_m, 2)} mm"
    )


def main() -> None:
    """Print the table, and the drift at rest where that recording is available."""
    print(
        f"{'recording':28} {'noise':10} {'short t, %':>10} {'short r, °/m':>13}"
        f" {'worst step, m':>14} {'unsolved':>9}"
    )
    paths = list(available().values()) + sorted((ROOT / "kitti_tracks").glob("*.npz"))
    for path in paths:
        for model in MODELS:
            print_accuracy(path, model)
    at_rest = ROOT / "euroc" / "V1_01_micro"
    if at_rest.is_dir():
        print_drift_at_rest(at_rest)


if __name__ == "__main__":
    main()

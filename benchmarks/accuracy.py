"""Accuracy on the real recordings: every noise model, one set of settings.

python benchmarks/accuracy.py
"""

from __future__ import annotations

import numpy as np
from recordings import ROOT, available

import probevo as pv
from probevo.evaluation.consistency import drift_covariances
from probevo.evaluation.metrics import evaluate
from probevo.evaluation.trajectory_errors import relative_motions
from probevo.output.run_result import RunRecorder, RunResult
from probevo.sequences import Sequence

MODELS = {"fixed": pv.noise.Fixed, "student-t": pv.noise.StudentT}


def run(sequence: Sequence, model: str) -> RunResult:
    odometry = pv.StereoOdometry(sequence.camera, MODELS[model](), sequence.imu)
    recorder = RunRecorder()
    for frame in sequence:
        recorder.add(frame.stamp_ns, odometry.step(frame))
    return recorder.result()


def main() -> None:
    print(
        f"{'recording':28} {'noise':10} {'short t, %':>10} {'short r, °/m':>13}"
        f" {'worst step, m':>14} {'unsolved':>9}"
    )
    paths = list(available().values()) + sorted((ROOT / "kitti_tracks").glob("*.npz"))
    for path in paths:
        for model in MODELS:
            sequence = pv.open_sequence(path)
            result = run(sequence, model)
            truth = sequence.truth.T_world_cam
            metrics = evaluate(result.T_world_cam, truth)
            off = np.linalg.norm(
                result.T_curr_prev[:, :3, 3] - relative_motions(truth)[:, :3, 3], axis=1
            )
            print(
                f"{path.stem:28} {model:10} {metrics.short_t_percent:10.3f}"
                f" {metrics.short_r_deg_per_m:13.4f} {np.nanmax(off):14.2f}"
                f" {int((result.status != pv.Status.OK).sum()):9d}"
            )
    euroc = ROOT / "euroc" / "V1_01_micro"
    if euroc.is_dir():
        result = run(pv.open_sequence(euroc), "student-t")
        cov = drift_covariances(
            result.T_curr_prev, result.cov, result.common_mode, path_cross_cov=result.path_cross_cov
        )
        drift = result.T_world_cam[-1, :3, 3]
        sigma = np.sqrt(np.diagonal(cov[-1])[:3])
        print(
            f"EuRoC at rest: drift {np.round(1e3 * drift, 2)} mm, 3σ {np.round(3e3 * sigma, 2)} mm"
        )


if __name__ == "__main__":
    main()

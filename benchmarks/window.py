"""Compare the sliding window with the two-frame estimator: drift, and consistency along the path.

    python benchmarks/window.py [NOISE …]

On real recordings and on rendered ones, for the live path, of which each pose is known when its
frame is the newest, and for the smoothed one, of which each pose is that with which it left the
window. NOISE is a kind or a file of a noise model; ``student-t`` by default.

Drift and rotation are over pieces of 10 to 50 m. NEES is that of the motion over 1, 10 and 50
frames, divided by its 6 dimensions: 1 is consistent, unless the truth is noisier than the estimate,
as KITTI's and EuRoC's are. The truth of rendered recordings is exact.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from plain_odometry import RECORDINGS, yaw_error_deg
from recordings import ROOT

import probevo as pv
from probevo.arrays import FloatArray
from probevo.estimation.motion_estimate import MotionEstimate
from probevo.evaluation.consistency import drift_covariances
from probevo.evaluation.metrics import evaluate
from probevo.geometry import se3
from probevo.geometry.uncertainty import normalized_error_squared
from probevo.runner import SmoothedPath
from probevo_sim.scene.config import Effects, SceneConfig
from probevo_sim.scene.writer import write_scene

EFFECTS = Effects(noise=0.5, traffic=0.5, shadows=0.5, blur=0.3, rectification=0.5)
SCENES = {
    "city, clean": SceneConfig(preset="city", seed=11, distance_m=100.0),
    "residential, clean": SceneConfig(preset="residential", seed=12, distance_m=100.0),
    "rover's loop, clean": SceneConfig(preset="rover", seed=13, distance_m=60.0),
    "city, effects": SceneConfig(preset="city", seed=14, distance_m=100.0, effects=EFFECTS),
    "residential, effects": SceneConfig(
        preset="residential", seed=15, distance_m=100.0, effects=EFFECTS
    ),
    "rover's loop, effects": SceneConfig(preset="rover", seed=16, distance_m=60.0, effects=EFFECTS),
}
"""Seeds of which no setting was chosen."""
SPANS = (1, 10, 50)
"""Frames that the NEES spans."""


@dataclass(frozen=True)
class Path3d:
    """Poses of a run over N frames, and the motions between them."""

    T_world_cam: FloatArray
    """[N, 4, 4], m."""
    steps: list[MotionEstimate]
    """The N − 1 motions; empty for a smoothed path."""
    live_cov: FloatArray
    """Covariance of each live pose, [N, 6, 6]."""
    smoothed_cov: FloatArray | None
    """Covariance of each smoothed pose, [N, 6, 6]; None without a window."""


def run(
    sequence: pv.sequences.Sequence, estimator: str, noise: str
) -> Iterator[tuple[str, Path3d]]:
    """Yield the live path of an estimator, and the smoothed one if it has one."""
    odometry = pv.StereoOdometry(
        sequence.camera, noise, sequence.imu, config={"estimator": estimator}
    )
    smoothed = SmoothedPath()
    steps = []
    for frame in sequence:
        steps.append(odometry.step(frame))
        smoothed.add(odometry.window)
    live_cov = np.array([step.pose_cov for step in steps])
    smoothed_cov = smoothed.covariances(odometry.window)
    poses = np.array([step.T_world_cam for step in steps])
    yield estimator, Path3d(poses, steps[1:], live_cov, smoothed_cov)
    smoothed_poses = smoothed.poses(odometry.window)
    if smoothed_poses is not None:
        yield "smoothed", Path3d(smoothed_poses, [], live_cov, smoothed_cov)


def normalized_nees(path: Path3d, truth: FloatArray, first: int, span: int) -> float | None:
    """Return the average NEES of motions over some frames, over its dimensions; None if the path is
    too short."""
    squared = []
    for start in range(first, len(truth) - span, span):
        ends = truth[[start, start + span]]
        if not path.steps or not np.isfinite(ends).all():
            continue
        steps = path.steps[start : start + span]
        correction = None
        if path.smoothed_cov is not None:
            correction = path.live_cov[start] - path.smoothed_cov[start]
        cov = drift_covariances(
            np.array([step.T_curr_prev for step in steps]),
            np.array([step.cov for step in steps]),
            np.array([step.common_mode for step in steps]),
            path_cross_cov=np.array([step.path_cross_cov for step in steps]),
            correction_of_first=correction,
        )[-1]
        if span == 1:
            cov = steps[0].cov
        estimated = se3.inverse(path.T_world_cam[start + span]) @ path.T_world_cam[start]
        true = se3.inverse(ends[1]) @ ends[0]
        squared.append(normalized_error_squared(estimated[None], true[None], cov[None])[0])
    return float(np.mean(squared)) / 6.0 if squared else None


def show(name: str, sequence: pv.sequences.Sequence, first: int, noise: str) -> None:
    """Print a row for each path."""
    truth = sequence.truth.T_world_cam
    known = np.flatnonzero(np.isfinite(truth[first:]).all(axis=(1, 2)))
    for estimator in ("two-frame", "window"):
        for label, path in run(sequence, estimator, noise):
            estimate = path.T_world_cam[first:]
            metrics = evaluate(estimate, truth[first:])
            yaw_deg = yaw_error_deg(estimate[known], truth[first:][known])
            nees = [normalized_nees(path, truth, first, span) for span in SPANS]
            numbers = [
                _text(metrics.short_t_percent, ".3f"),
                _text(metrics.short_r_deg_per_m, ".4f"),
                _text(metrics.final_error_m, ".4f"),
                _text(yaw_deg, ".2f"),
                *(_text(value, ".2f") for value in nees),
            ]
            cells = " ".join(f"{number:>9}" for number in numbers)
            print(f"{name:26} {label:10} {cells}", flush=True)


def _text(value: float | None, form: str) -> str:
    return "–" if value is None else format(value, form)


def main() -> None:
    """Print a table for each noise model."""
    cv2.setNumThreads(1)
    recordings = RECORDINGS | {"V1_01_micro": (ROOT / "euroc" / "V1_01_micro", 0)}
    for noise in sys.argv[1:] or ["student-t"]:
        heads = ("t, %", "r, °/m", "end, m", "yaw, °", *(f"NEES {span}" for span in SPANS))
        print(f"{noise:26} {'path':10} {' '.join(f'{head:>9}' for head in heads)}")
        for name, (path, first) in recordings.items():
            if path.is_dir():
                show(name, pv.open_sequence(path), first, noise)
            else:
                print(f"{name:26} not there")
        with tempfile.TemporaryDirectory() as folder:
            for name, config in SCENES.items():
                out = Path(folder) / name.replace(" ", "_").replace(",", "").replace("'", "")
                write_scene(config, out, jobs=2)
                show(name, pv.open_sequence(out), 0, noise)


if __name__ == "__main__":
    main()

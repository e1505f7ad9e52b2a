"""Compare the sliding window with the two-frame estimator: drift, and consistency along the path.

    python benchmarks/window.py [NOISE …]

On real recordings and on rendered ones, for the live path, of which each pose is known when its
frame is the newest, and for the smoothed one, of which each pose is that with which it left the
window. NOISE is a kind or a file of a noise model; ``student-t`` by default.

Drift and rotation are over pieces of 10 to 50 m. NEES is divided by its 6 dimensions: 1 is
consistent, unless the truth is noisier than the estimate, as KITTI's and EuRoC's are; that of
rendered recordings is exact. It is that of the motion from frame to frame, of the motion over 8
frames by the joint covariance of the window, and of the pose since the first frame.
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
from probevo.evaluation.metrics import evaluate
from probevo.geometry import se3
from probevo.geometry.uncertainty import normalized_error_squared
from probevo.runs.smoothed_path import SmoothedPath
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
SPAN = 8
"""Frames that a motion within the window spans."""
EVERY = 25
"""Frames between the poses whose error since the first frame is taken."""


@dataclass
class Consistency:
    """Squared errors of poses in units of their covariances, over their 6 dimensions."""

    step: list[float]
    """Of the motion from frame to frame."""
    window: list[float]
    """Of the motion over ``SPAN`` frames, by the joint covariance of the window's poses."""
    path: list[float]
    """Of the pose in the world, at every ``EVERY``-th frame."""


def run(
    sequence: pv.sequences.Sequence, estimator: str, noise: str
) -> Iterator[tuple[str, FloatArray, Consistency]]:
    """Yield the live path T_world_cam of an estimator, [N, 4, 4], with its consistency, and the
    smoothed one if it has one."""
    truth = sequence.truth.T_world_cam
    odometry = pv.StereoOdometry(
        sequence.camera, noise, sequence.imu, config={"estimator": estimator}
    )
    smoothed = SmoothedPath()
    live = []
    found = Consistency([], [], [])
    for k, frame in enumerate(sequence):
        estimate = odometry.step(frame)
        live.append(estimate.T_world_cam)
        window = odometry.window
        smoothed.add(window)
        if k == 0 or not np.isfinite(truth[[0, k - 1, k]]).all():
            continue
        step = se3.inverse(truth[k]) @ truth[k - 1]
        found.step.append(nees(estimate.T_curr_prev, step, estimate.cov))
        if k % EVERY == 0:
            from_first = se3.inverse(truth[k]) @ truth[0]
            T_cam_world = estimate.T_cam_world
            found.path.append(nees(T_cam_world, from_first, estimate.cov_cam_world))
        in_window = window is not None and {k, k - SPAN} <= set(window.frames.tolist())
        if in_window and np.isfinite(truth[k - SPAN]).all():
            T, cov = odometry.relative(k, k - SPAN)
            found.window.append(nees(T, se3.inverse(truth[k]) @ truth[k - SPAN], cov))
    yield estimator, np.array(live), found
    poses = smoothed.poses(odometry.window)
    if poses is None:
        return
    of_path = []
    for k in range(EVERY, len(truth), EVERY):
        if np.isfinite(truth[[0, k]]).all():
            T_cam_world = se3.inverse(poses.T_world_cam[k])
            from_first = se3.inverse(truth[k]) @ truth[0]
            of_path.append(nees(T_cam_world, from_first, poses.cov[k]))
    yield "smoothed", poses.T_world_cam, Consistency([], [], of_path)


def nees(T: FloatArray, truth: FloatArray, cov: FloatArray) -> float:
    """Return the normalised squared error of one pose, over its 6 dimensions."""
    return float(normalized_error_squared(T[None], truth[None], cov[None])[0]) / 6.0


def show(name: str, sequence: pv.sequences.Sequence, first: int, noise: str) -> None:
    """Print a row for each path."""
    truth = sequence.truth.T_world_cam
    known = np.flatnonzero(np.isfinite(truth[first:]).all(axis=(1, 2)))
    for estimator in ("two-frame", "window"):
        for label, path, consistency in run(sequence, estimator, noise):
            estimate = path[first:]
            metrics = evaluate(estimate, truth[first:])
            yaw_deg = yaw_error_deg(estimate[known], truth[first:][known])
            numbers = [
                _text(metrics.short_t_percent, ".3f"),
                _text(metrics.short_r_deg_per_m, ".4f"),
                _text(metrics.final_error_m, ".4f"),
                _text(yaw_deg, ".2f"),
                _mean(consistency.step),
                _mean(consistency.window),
                _mean(consistency.path),
            ]
            cells = " ".join(f"{number:>9}" for number in numbers)
            print(f"{name:26} {label:10} {cells}", flush=True)


def _mean(values: list[float]) -> str:
    return format(np.mean(values), ".2f") if values else "–"


def _text(value: float | None, form: str) -> str:
    return "–" if value is None else format(value, form)


def head(noise: str) -> str:
    """Return the head of the table of a noise model."""
    columns = ("t, %", "r, °/m", "end, m", "yaw, °", "NEES 1", f"NEES {SPAN}", "NEES path")
    return f"{noise:26} {'path':10} {' '.join(f'{column:>9}' for column in columns)}"


def show_scenes(noise: str) -> None:
    """Print the rows of the rendered recordings."""
    with tempfile.TemporaryDirectory() as folder:
        for name, config in SCENES.items():
            out = Path(folder) / name.replace(" ", "_").replace(",", "").replace("'", "")
            write_scene(config, out, jobs=2)
            show(name, pv.open_sequence(out), 0, noise)


def main() -> None:
    """Print a table for each noise model."""
    cv2.setNumThreads(1)
    recordings = RECORDINGS | {"V1_01_micro": (ROOT / "euroc" / "V1_01_micro", 0)}
    for noise in sys.argv[1:] or ["student-t"]:
        print(head(noise))
        for name, (path, first) in recordings.items():
            if path.is_dir():
                show(name, pv.open_sequence(path), first, noise)
            else:
                print(f"{name:26} not there")
        show_scenes(noise)


if __name__ == "__main__":
    main()

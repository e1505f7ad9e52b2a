"""Measure how long errors of features last, and whether it matters how far these move in between.

    python benchmarks/residual_correlation.py

Of the landmarks that stand still and were seen in six or more frames of a window, prints the
correlation of successive residuals after the adjustment, for u_l, v_l and u_r, and their standard
deviation: of all, and by how far the landmark has moved over the image between the two frames. An
adjustment takes a part of each error away: white noise would have −0.1. Without IMU, ``student-t``.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from recordings import ROOT
from window import SCENES

import probevo as pv
from probevo.arrays import FloatArray, IntArray
from probevo.camera.stereo import StereoCamera
from probevo.estimation.window.window import Window
from probevo.geometry import se3
from probevo.sequences import Sequence
from probevo_sim.scene.writer import write_scene

RECORDINGS = {
    "odometry 06": ROOT / "kitti_odometry" / "sequences" / "06",
    "kitti_0039": ROOT / "kitti_0039" / "sequences" / "39",
    "EuRoC MH_01": ROOT / "euroc" / "MH_01_micro",
    "EuRoC V1_01, at rest": ROOT / "euroc" / "V1_01_micro",
}
RENDERED = ("city, clean", "city, effects", "rover's loop, clean")
MOVED_PX = (0.0, 0.1, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, np.inf)
MIN_PAIRS = 100
MIN_FRAMES = 6
MIN_STATIC_WEIGHT = 0.5
OUTLIER_PX = 1.5
FULL_WINDOW = 9
"""Index of the frame from which on the window is full."""
EVERY = 3
"""Frames from one window that counts to the next; they share most of their observations."""


def residuals(window: Window, camera: StereoCamera) -> tuple[IntArray, FloatArray]:
    """Return the landmark of each of M observations, [M], and measured minus predicted (u_l, v_l,
    u_r), [M, 3], px; the jitter of the rig is left out."""
    observations = window.observations
    landmark = window.landmark_rows
    anchor = observations.slot[observations.start[:-1]][landmark]
    u, v, disparity_px, time_correlated_px = window.landmarks.state[landmark].T
    # h, the point in each frame over its depth in the anchor frame.
    T_anchor_world = window.T_cam_world[anchor]
    T_frame_anchor = window.T_cam_world[observations.slot] @ se3.inverse(T_anchor_world)
    x, y = camera.normalized(u, v)
    ray = np.column_stack([x, y, np.ones_like(x)])
    inverse_depth = disparity_px / (camera.fu_px * camera.baseline_m)
    h = np.einsum("mij,mj->mi", T_frame_anchor[:, :3, :3], ray)
    h += T_frame_anchor[:, :3, 3] * inverse_depth[:, None]
    # The rectified camera, and the errors of the rig: b of the disparity and κ of the lenses.
    x = h[:, 0] / h[:, 2]
    y = h[:, 1] / h[:, 2]
    d_px = disparity_px / h[:, 2]
    x_right = x - d_px / camera.fu_px
    b0, b1, b2, kappa = window.rig_errors
    u_left = camera.fu_px * x * (1.0 + kappa * (x**2 + y**2)) + camera.cu_px
    v_left = camera.fv_px * y * (1.0 + kappa * (x**2 + y**2)) + camera.cv_px
    u_right = camera.fu_px * x_right * (1.0 + kappa * (x_right**2 + y**2)) + camera.cu_px
    u_right += b0 + b1 * x + b2 * x**2 - time_correlated_px
    predicted = np.column_stack([u_left, v_left, u_right])
    return landmark, observations.pixels[:, :3] - predicted


def pairs(sequence: Sequence) -> Iterator[tuple[FloatArray, FloatArray, FloatArray]]:
    """Yield successive residuals, [N, 3] and [N, 3], px, and how far each has moved, [N], px."""
    odometry = pv.StereoOdometry(sequence.camera)
    for frame in sequence:
        odometry.step(frame)
        window = odometry.window
        if window is None or frame.index < FULL_WINDOW or frame.index % EVERY:
            continue
        landmark, error_px = residuals(window, sequence.camera)
        num_seen = np.bincount(landmark, minlength=len(window.ids))
        good = num_seen[landmark] >= MIN_FRAMES
        good &= window.landmarks.static_weight[landmark] > MIN_STATIC_WEIGHT
        good &= np.abs(error_px).max(axis=1) < OUTLIER_PX
        chosen = good[1:] & good[:-1] & (landmark[1:] == landmark[:-1])
        moved = np.diff(window.observations.pixels[:, :2], axis=0)
        yield (
            error_px[:-1][chosen],
            error_px[1:][chosen],
            np.linalg.norm(moved, axis=1)[chosen],
        )


def show(name: str, sequence: Sequence) -> None:
    """Print the correlations of a recording."""
    before, after, moved_px = map(np.concatenate, zip(*pairs(sequence), strict=True))
    print(f"{name:26} {'all':>11}  {_line(before, after)}")
    for low, high in pairwise(MOVED_PX):
        chosen = (moved_px >= low) & (moved_px < high)
        if chosen.sum() >= MIN_PAIRS:
            print(f"{'':26} {low:4g} – {high:4g}  {_line(before[chosen], after[chosen])}")


def _line(before: FloatArray, after: FloatArray) -> str:
    variances = np.mean(before**2, axis=0) * np.mean(after**2, axis=0)
    correlation = np.mean(before * after, axis=0) / np.sqrt(variances)
    sigma_px = np.sqrt(np.mean(after**2, axis=0))
    numbers = " ".join(f"{value:5.2f}" for value in correlation)
    return f"{len(before):7}  {numbers}   {' '.join(f'{value:.3f}' for value in sigma_px)}"


def main() -> None:
    """Print the correlations of all recordings."""
    cv2.setNumThreads(1)
    print(f"{'':26} {'moved, px':>11}  {'pairs':>7}  correlation, u_l v_l u_r   σ, px")
    for name, path in RECORDINGS.items():
        if path.is_dir():
            show(name, pv.open_sequence(path))
    for name in RENDERED:
        with tempfile.TemporaryDirectory() as folder:
            write_scene(SCENES[name], Path(folder) / "drive")
            show(name, pv.open_sequence(Path(folder) / "drive"))


if __name__ == "__main__":
    main()

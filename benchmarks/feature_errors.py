"""Where features are wrong in clean scenes: those on the ground and those above the horizon,
against the exact truth.

python benchmarks/feature_errors.py
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

import probevo as pv
from probevo.arrays import FloatArray
from probevo.tracking import Tracks
from probevo_sim.scene.config import RigConfig, SceneConfig
from probevo_sim.scene.recording import SceneRecording, open_scene

HALF = 7
FULL = RigConfig(width_px=1242, height_px=375, focal_px=720.0)
TRUSTED = 0.5


def plane_fit() -> FloatArray:
    """Takes a window of disparities to what is left of it beside a plane."""
    place = np.mgrid[-HALF : HALF + 1, -HALF : HALF + 1].reshape(2, -1)
    basis = np.column_stack([np.ones(place.shape[1]), *place])
    return np.eye(len(basis)) - basis @ np.linalg.pinv(basis)


def errors(scene: SceneRecording, index: int, tracks: Tracks, weights: FloatArray) -> FloatArray:
    """Row against the horizon, disparity error, px, and flow error along the flow, %, of features
    on one surface."""
    truth = scene.pixel_truth(index - 1)
    residual_maker = plane_fit()
    u, v = np.round(tracks.prev_px[:, :2]).astype(int).T
    disparity = np.pad(truth.disparity_px, HALF, mode="edge")
    window = sliding_window_view(disparity, (2 * HALF + 1, 2 * HALF + 1))[v, u].reshape(len(u), -1)
    kept = (
        (np.abs(window @ residual_maker).max(axis=1) < 0.05)
        & (truth.disparity_px[v, u] > 0.2)
        & (weights > TRUSTED)
    )
    at_px = tracks.prev_px[:, :2].astype(np.float32).reshape(-1, 1, 2)
    flow, true_disparity = (
        cv2.remap(field.astype(np.float32), at_px, None, cv2.INTER_LINEAR)[:, 0]
        for field in (truth.flow_px, truth.disparity_px)
    )
    found = tracks.curr_px[:, :2] - tracks.prev_px[:, :2]
    along = 100.0 * np.sum((found - flow) * flow, axis=1) / np.sum(flow**2, axis=1)
    off_px = tracks.prev_px[:, 0] - tracks.prev_px[:, 2] - true_disparity.reshape(len(u))
    return np.column_stack([v - scene.camera.cv_px, off_px, along])[kept]


def report(name: str, config: SceneConfig) -> None:
    scene = open_scene(config)
    odometry = pv.StereoOdometry(scene.camera, config=pv.OdometryConfig(self_calibration=False))
    rows = []
    steps = []
    for frame in scene:
        motion = odometry.step(frame)
        if frame.index > 2:
            rows.append(errors(scene, frame.index, odometry.tracks, odometry.weights))
            T_world_cam = scene.truth.T_world_cam
            true = np.linalg.solve(T_world_cam[frame.index], T_world_cam[frame.index - 1])
            steps.append((motion.T_curr_prev[2, 3] - true[2, 3], np.linalg.norm(true[:3, 3])))
    table = np.concatenate(rows)
    forward, length = np.mean(steps, axis=0)
    print(f"{name}: mean error of a step forward {-1e3 * forward:+.2f} mm of {length:.2f} m")
    for place, chosen in (
        ("above the horizon", table[:, 0] < 0),
        ("on the ground", table[:, 0] > 15),
    ):
        _, off_px, along = np.nanmedian(table[chosen], axis=0)
        print(
            f"  {chosen.sum():6} {place:18} disparity {off_px:+.4f} px, flow {along:+.2f} %"
            " (medians)"
        )


def main() -> None:
    report("city", SceneConfig(preset="city", distance_m=80.0))
    report("road", SceneConfig(preset="road", distance_m=150.0))
    report("road, full resolution", SceneConfig(preset="road", distance_m=150.0, rig=FULL))


if __name__ == "__main__":
    main()

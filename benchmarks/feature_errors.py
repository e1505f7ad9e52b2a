"""Measure how far features are off in clean scenes, on the ground and above the horizon.

    python benchmarks/feature_errors.py

Prints median errors of disparity and flow against the exact truth, and the mean error of a step.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

import probevo as pv
from probevo.arrays import BoolArray, FloatArray
from probevo.tracking import Tracks
from probevo_sim.scene.config import RigConfig, SceneConfig
from probevo_sim.scene.recording import SceneRecording, open_scene

UNCALIBRATED = pv.OdometryConfig(estimator="two-frame", self_calibration=False)
HALF_PX = 7
"""Half a window, in which features must be on one surface."""
FLAT_PX = 0.05
"""A surface is one whose disparities differ from a plane by less than this."""
MIN_DISPARITY_PX = 0.2
"""Farther points tell nothing."""
GROUND_PX = 15
"""Features count as on the ground from so many rows below the horizon on."""
FULL = RigConfig(width_px=1242, height_px=375, focal_px=720.0)
TRUSTED = 0.5


def residual_maker() -> FloatArray:
    """Return the matrix that takes a window of disparities to its residuals from a fitted plane."""
    place = np.mgrid[-HALF_PX : HALF_PX + 1, -HALF_PX : HALF_PX + 1].reshape(2, -1)
    basis = np.column_stack([np.ones(place.shape[1]), *place])
    return np.eye(len(basis)) - basis @ np.linalg.pinv(basis)


def is_on_one_surface(disparity_px: FloatArray, pixels: FloatArray) -> BoolArray:
    """Return which windows around pixels [N, 2] show a single plane, [N].

    Features at an edge of depth have no one disparity.
    """
    u, v = np.round(pixels).astype(int).T
    size = 2 * HALF_PX + 1
    padded = np.pad(disparity_px, HALF_PX, mode="edge")
    window = sliding_window_view(padded, (size, size))[v, u].reshape(len(u), -1)
    flat: BoolArray = np.abs(window @ residual_maker()).max(axis=1) < FLAT_PX
    return flat & (disparity_px[v, u] > MIN_DISPARITY_PX)


def errors(scene: SceneRecording, index: int, tracks: Tracks, weights: FloatArray) -> FloatArray:
    """Return the errors of trusted features that are on one surface, [K, 3].

    The columns are the row below the horizon, px, the error of the disparity, px, and that of the
    flow along the flow, %.
    """
    truth = scene.pixel_truth(index - 1)
    u, v = np.round(tracks.prev_px[:, :2]).astype(int).T

    is_flat = is_on_one_surface(truth.disparity_px, tracks.prev_px[:, :2])
    kept = is_flat & (weights > TRUSTED)

    # The truth between pixels, where the features are.
    at_px = tracks.prev_px[:, :2].astype(np.float32).reshape(-1, 1, 2)
    true_flow = cv2.remap(truth.flow_px.astype(np.float32), at_px, None, cv2.INTER_LINEAR)[:, 0]
    true_disparity = cv2.remap(
        truth.disparity_px.astype(np.float32), at_px, None, cv2.INTER_LINEAR
    )[:, 0]

    flow = tracks.curr_px[:, :2] - tracks.prev_px[:, :2]
    along = np.sum((flow - true_flow) * true_flow, axis=1)
    along_percent = 100.0 * along / np.sum(true_flow**2, axis=1)
    measured = tracks.prev_px[:, 0] - tracks.prev_px[:, 2]
    disparity_error = measured - true_disparity.reshape(len(u))
    return np.column_stack([v - scene.camera.cv_px, disparity_error, along_percent])[kept]


def report(name: str, config: SceneConfig) -> None:
    """Drive through a scene, and print the errors of its features and of its steps."""
    scene = open_scene(config)
    odometry = pv.StereoOdometry(scene.camera, config=UNCALIBRATED)
    T_world_cam = scene.truth.T_world_cam
    rows = []
    forward_errors_m = []
    lengths_m = []
    for frame in scene:
        motion = odometry.step(frame)
        if frame.index > 2:
            rows.append(errors(scene, frame.index, odometry.tracks, odometry.weights))
            true = np.linalg.solve(T_world_cam[frame.index], T_world_cam[frame.index - 1])
            forward_errors_m.append(motion.T_curr_prev[2, 3] - true[2, 3])
            lengths_m.append(np.linalg.norm(true[:3, 3]))
    table = np.concatenate(rows)
    # A point ahead comes nearer as the camera moves on, hence the sign.
    print(
        f"{name}: mean error of a step forward {-1e3 * np.mean(forward_errors_m):+.2f} mm of"
        f" {np.mean(lengths_m):.2f} m"
    )
    for place, chosen in (
        ("above the horizon", table[:, 0] < 0),
        ("on the ground", table[:, 0] > GROUND_PX),
    ):
        _, disparity_px, flow_percent = np.nanmedian(table[chosen], axis=0)
        print(
            f"  {chosen.sum():6} {place:18} disparity {disparity_px:+.4f} px, flow"
            f" {flow_percent:+.2f} % (medians)"
        )


def main() -> None:
    """Print the errors in the city, and on the road at two resolutions."""
    report("city", SceneConfig(preset="city", distance_m=80.0))
    report("road", SceneConfig(preset="road", distance_m=150.0))
    report("road, full resolution", SceneConfig(preset="road", distance_m=150.0, rig=FULL))


if __name__ == "__main__":
    main()

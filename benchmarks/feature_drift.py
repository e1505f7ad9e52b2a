"""Measure how far features have drifted from the points that they were first seen at.

    python benchmarks/feature_drift.py

On the road of rendered streets, whose truth is exact: the mean error of a feature (u_l, v_l), which
is a bias, and its scatter, by the number of frames since the feature was detected. A window that is
aligned by an affine map alone drifts downwards there, since its lower half comes nearer faster than
its upper one.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from feature_errors import GROUND_PX, HALF_PX, TRUSTED, is_on_one_surface

import probevo as pv
from probevo.arrays import BoolArray, FloatArray
from probevo.geometry import se3
from probevo_sim.scene.config import SceneConfig
from probevo_sim.scene.recording import SceneRecording, open_scene

SCENES = {
    "city": SceneConfig(preset="city", distance_m=60.0),
    "residential": SceneConfig(preset="residential", seed=3, distance_m=60.0),
}
UNCALIBRATED = pv.OdometryConfig(estimator="two-frame", self_calibration=False)
AGES = (1, 2, 3, 4, 6, 8)
"""Frames since the detection."""
LOST_PX = 1.5
"""A feature farther off has been lost, and is another matter."""


@dataclass(frozen=True)
class Detection:
    """Where a feature was detected."""

    frame: int
    point_m: FloatArray
    """The true point in that frame's left camera, [3]."""
    on_surface: bool
    """Whether the window around it shows a single plane."""


def true_points(
    scene: SceneRecording, frame: int, pixels: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Return what is seen at pixels [N, 2], [N, 3], m, and which windows show a single plane."""
    truth = scene.pixel_truth(frame)
    at_px = pixels.astype(np.float32).reshape(-1, 1, 2)
    disparity = cv2.remap(truth.disparity_px.astype(np.float32), at_px, None, cv2.INTER_LINEAR)
    right = pixels[:, 0] - np.maximum(disparity[:, 0], 1e-3)
    points = scene.camera.triangulate(np.column_stack([pixels, right, pixels[:, 1]]))
    return points, is_on_one_surface(truth.disparity_px, pixels)


def drift(scene: SceneRecording) -> dict[int, list[FloatArray]]:
    """Return the errors (u, v), px, of trusted features on the road, by age."""
    camera = scene.camera
    odometry = pv.StereoOdometry(camera, config=UNCALIBRATED)
    T_world_cam = scene.truth.T_world_cam
    detections: dict[int, Detection] = {}
    errors: dict[int, list[FloatArray]] = {age: [] for age in AGES}
    for frame in scene:
        odometry.step(frame)
        if frame.index == len(T_world_cam) - 1:
            break
        alive = odometry.state.tracking
        is_new = np.array([int(feature) not in detections for feature in alive.ids])
        points, on_surface = true_points(scene, frame.index, alive.pixels[is_new, :2])
        for feature, point, flat in zip(alive.ids[is_new], points, on_surface, strict=True):
            detections[int(feature)] = Detection(frame.index, point, bool(flat))
        if frame.index == 0:
            continue
        weights = dict(zip(odometry.tracks.ids.tolist(), odometry.weights.tolist(), strict=True))
        for feature, pixels in zip(alive.ids.tolist(), alive.pixels, strict=True):
            detected = detections[feature]
            age = frame.index - detected.frame
            trusted = weights.get(feature, 0.0) > TRUSTED
            on_ground = pixels[1] - camera.cv_px > GROUND_PX
            if not (age in errors and detected.on_surface and trusted and on_ground):
                continue
            T = se3.inverse(T_world_cam[frame.index]) @ T_world_cam[detected.frame]
            true_px = camera.project((T[:3, :3] @ detected.point_m + T[:3, 3])[None])[0, :2]
            error = pixels[:2] - true_px
            if np.abs(error).max() < LOST_PX:
                errors[age].append(error)
    return errors


def main() -> None:
    """Print a table for each scene."""
    cv2.setNumThreads(1)
    print(f"windows of {2 * HALF_PX + 1} px on one surface, on the road")
    for name, config in SCENES.items():
        print(f"{name:14} age      n   mean u, v, px    ± (of the mean)    scatter u, v, px")
        for age, found in drift(open_scene(config)).items():
            errors = np.array(found)
            scatter = errors.std(axis=0)
            mean = errors.mean(axis=0)
            of_mean = scatter / np.sqrt(len(errors))
            print(
                f"{'':14} {age:3} {len(errors):6}   {mean[0]:+.3f} {mean[1]:+.3f}"
                f"     {of_mean[0]:.3f} {of_mean[1]:.3f}      {scatter[0]:.3f} {scatter[1]:.3f}"
            )


if __name__ == "__main__":
    main()

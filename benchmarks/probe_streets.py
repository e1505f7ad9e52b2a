"""Measure what PROBE gains over a Student-t on small streets, with several trainings.

    python benchmarks/probe_streets.py

Each model is learned from one rendered street, and tested on eight others, with two frames. Prints
the mean step error of PROBE over that of ``student-t``, geometric mean over the streets: what one
training shows is chance to 4 %.
"""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path

import cv2
import numpy as np

import probevo as pv
from probevo.evaluation.trajectory_errors import relative_motions
from probevo_sim.scene.config import Effects, RigConfig, SceneConfig
from probevo_sim.scene.recording import SceneRecording, open_scene

EFFECTS = Effects(traffic=0.5, shadows=0.5, noise=0.3)
RIG = RigConfig(width_px=414, height_px=126, focal_px=240.0)
DISTANCE_M = 24.0
LEARNED_FROM = (1, 10, 11, 12, 13, 14)
"""Seeds of the streets."""
TESTED_ON = range(2, 10)


@cache
def street(seed: int) -> SceneRecording:
    """Open a street, each of whose images is rendered once."""
    config = SceneConfig(preset="city", seed=seed, distance_m=DISTANCE_M, effects=EFFECTS, rig=RIG)
    scene = open_scene(config)
    scene.renderer.pair = cache(scene.renderer.pair)  # type: ignore[method-assign]
    return scene


def step_error_mm(scene: SceneRecording, noise: pv.noise.NoiseModel) -> float:
    """Return the mean error of the translation of a step."""
    odometry = pv.StereoOdometry(
        scene.camera, noise, scene.imu, pv.OdometryConfig(estimator="two-frame")
    )
    motions = np.array([odometry.step(frame).T_curr_prev for frame in scene])[1:]
    true = relative_motions(scene.truth.T_world_cam)
    return float(1e3 * np.linalg.norm(motions[:, :3, 3] - true[:, :3, 3], axis=1).mean())


def learned(seed: int) -> pv.noise.NoiseModel:
    """Return the model that one street teaches."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "street.safetensors")
        pv.train_model([street(seed)], pv.TrainSettings(), path)
        return pv.load_model(path)


def main() -> None:
    """Print a row for each training, and the mean of all."""
    cv2.setNumThreads(1)
    untrained_mm = np.array(
        [step_error_mm(street(seed), pv.noise.StudentT()) for seed in TESTED_ON]
    )
    print(f"student-t: {np.exp(np.log(untrained_mm).mean()):.2f} mm a step")
    ratios = []
    for seed in LEARNED_FROM:
        model = learned(seed)
        trained_mm = np.array([step_error_mm(street(test), model) for test in TESTED_ON])
        ratio = np.log(trained_mm / untrained_mm)
        ratios.append(ratio.mean())
        worse = int((ratio > 0).sum())
        print(
            f"learned from street {seed}: {np.exp(ratio.mean()):.3f}, worse on {worse}", flush=True
        )
    standard_error = np.std(ratios, ddof=1) / np.sqrt(len(ratios))
    print(f"all: {np.exp(np.mean(ratios)):.3f} ± {standard_error:.3f}")


if __name__ == "__main__":
    main()

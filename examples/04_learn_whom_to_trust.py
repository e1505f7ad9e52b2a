"""Learn from one simulated drive how far to trust each feature, and drive through other streets
with what was learned.

python examples/04_learn_whom_to_trust.py METRES      e.g. 40
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

import probevo as pv
from probevo.evaluation.trajectory_errors import relative_motions
from probevo_sim.scene.config import Effects, SceneConfig
from probevo_sim.scene.recording import SceneRecording, open_scene

BAD_DAY = Effects(traffic=0.5, shadows=0.5, noise=0.3)


def step_errors_mm(scene: SceneRecording, noise: pv.noise.NoiseModel) -> np.ndarray:
    """Error of the translation of each step."""
    odometry = pv.StereoOdometry(scene.camera, noise, scene.imu)
    motions = np.array([odometry.step(frame).T_curr_prev for frame in scene])[1:]
    true = relative_motions(scene.truth.T_world_cam)
    return 1e3 * np.linalg.norm(motions[:, :3, 3] - true[:, :3, 3], axis=1)


def main(distance_m: float) -> None:
    """Learn in one street, judge in another."""
    street, another = (
        open_scene(SceneConfig(preset="city", seed=seed, distance_m=distance_m, effects=BAD_DAY))
        for seed in (1, 2)
    )
    with tempfile.TemporaryDirectory() as folder:
        path = pv.train_model([street], pv.TrainSettings(), Path(folder, "street.safetensors"))
        learned = pv.load_model(path)
    print(
        f"learned from {len(learned.samples()[1]):,} samples; K = {learned.neighbors}, γ ="
        f" {learned.exponent:g}"
    )
    for name, noise in {
        "fixed": pv.noise.Fixed(),
        "student-t": pv.noise.StudentT(),
        "learned": learned,
    }.items():
        errors = step_errors_mm(another, noise)
        print(
            f"{name:10} {errors.mean():6.2f} mm a step on average, {errors.max():6.2f} mm at worst"
        )


if __name__ == "__main__":
    if len(sys.argv) != 2:
        print("usage: python examples/04_learn_whom_to_trust.py METRES", file=sys.stderr)
        sys.exit(2)
    main(float(sys.argv[1]))

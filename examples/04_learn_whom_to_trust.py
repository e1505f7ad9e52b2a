"""Learn in one simulated street how far to trust each feature; drive through another with it.

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

EFFECTS = Effects(traffic=0.5, shadows=0.5, noise=0.3)


def street(seed: int, distance_m: float) -> SceneRecording:
    """Open a street, whose images are rendered when they are asked for."""
    return open_scene(SceneConfig(preset="city", seed=seed, distance_m=distance_m, effects=EFFECTS))


def step_errors_mm(scene: SceneRecording, noise: pv.noise.NoiseModel) -> np.ndarray:
    """Return the error of the translation of each step.

    With two frames, since PROBE learns from these; the window finds much of that by itself.
    """
    config = pv.OdometryConfig(estimator="two-frame")
    odometry = pv.StereoOdometry(scene.camera, noise, scene.imu, config)
    motions = np.array([odometry.step(frame).T_curr_prev for frame in scene])[1:]
    true = relative_motions(scene.truth.T_world_cam)
    return 1e3 * np.linalg.norm(motions[:, :3, 3] - true[:, :3, 3], axis=1)


def main(distance_m: float) -> None:
    """Train in the first street, test in the second."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "street.safetensors")
        pv.train_model([street(1, distance_m)], pv.TrainSettings(), path)
        learned = pv.load_model(path)
    _, alphas = learned.samples()
    chosen = f"K = {learned.neighbors}, γ = {learned.exponent:g}"
    print(f"learned from {len(alphas):,} samples; {chosen}")

    models = {"fixed": pv.noise.Fixed(), "student-t": pv.noise.StudentT(), "learned": learned}
    test = street(2, distance_m)
    for name, noise in models.items():
        errors = step_errors_mm(test, noise)
        print(f"{name:10} {errors.mean():6.2f} mm a step on average, {errors.max():6.2f} at worst")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        print("usage: python examples/04_learn_whom_to_trust.py METRES", file=sys.stderr)
        sys.exit(2)
    main(float(sys.argv[1]))

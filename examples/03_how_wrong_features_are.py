"""Drive through a simulated street; see which features are wrong, and whether the solver knew.

python examples/03_how_wrong_features_are.py PRESET [EFFECT=STRENGTH ...]    e.g. city traffic=1
"""

import sys
from typing import get_args

import numpy as np

import probevo as pv
from probevo_sim.scene.config import Effects, PresetName, RigConfig, SceneConfig
from probevo_sim.scene.recording import open_scene

RIG = RigConfig(width_px=310, height_px=94, focal_px=180.0)
"""A quarter of KITTI's resolution, which is quick to render."""


def features(config: SceneConfig) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return for all features of a drive their errors, whether they move, and their weights.

    Errors are those of flow (u, v) and disparity, px, [N, 3]; the others are [N].
    """
    scene = open_scene(config)  # a sequence whose images are rendered when they are asked for
    odometry = pv.StereoOdometry(scene.camera, imu=scene.imu)
    errors = []
    moving = []
    weights = []
    for frame in scene:
        odometry.step(frame)
        if frame.index > 0:
            prev = odometry.tracks.prev_px
            truth = scene.pixel_truth(frame.index - 1)
            u, v = np.round(prev[:, :2]).astype(int).T
            flow = odometry.tracks.curr_px[:, :2] - prev[:, :2] - truth.flow_px[v, u]
            disparity = prev[:, 0] - prev[:, 2] - truth.disparity_px[v, u]
            errors.append(np.column_stack([flow, disparity]))
            moving.append(truth.moving[v, u])
            weights.append(odometry.weights)
    return np.concatenate(errors), np.concatenate(moving), np.concatenate(weights)


def main(preset: PresetName, effects: Effects) -> None:
    """Compare the features that the solver trusts with those that it does not."""
    config = SceneConfig(preset=preset, distance_m=15.0, rig=RIG, effects=effects)
    error, moves, weight = features(config)
    for name, chosen in (("trusted", weight >= 0.5), ("distrusted", weight < 0.5)):
        sigma_px = (1.48 * np.nanmedian(np.abs(error[chosen]), axis=0)).round(2)
        percent = 100.0 * moves[chosen].mean()
        print(f"{chosen.sum():6} {name:10} {percent:3.0f} % on what moves;", end=" ")
        print(f"σ of flow (u, v) and disparity: {sigma_px} px")


if __name__ == "__main__":
    if len(sys.argv) < 2 or sys.argv[1] not in get_args(PresetName):
        words = "PRESET [EFFECT=STRENGTH ...]"
        print(f"usage: python examples/03_how_wrong_features_are.py {words}", file=sys.stderr)
        sys.exit(2)
    pairs = [word.partition("=") for word in sys.argv[2:]]
    main(sys.argv[1], Effects(**{name: float(strength) for name, _, strength in pairs}))

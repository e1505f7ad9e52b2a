"""Drive through a simulated street, and see which features are wrong, and whether the solver knew.

python examples/03_how_wrong_features_are.py PRESET [EFFECT=STRENGTH ...]      e.g. city traffic=1
blur=0.5
"""

import sys
from typing import get_args

import numpy as np

import probevo as pv
from probevo.arrays import BoolArray, FloatArray
from probevo_sim.scene.config import Effects, PresetName, RigConfig, SceneConfig
from probevo_sim.scene.recording import open_scene

DISTANCE_M = 15.0


def features(config: SceneConfig) -> tuple[FloatArray, BoolArray, FloatArray]:
    """Of all features of a drive: errors (flow u, v, disparity), px, [N, 3]; whether they move,
    trust, [N] each."""
    scene = open_scene(config)  # a sequence that is rendered on the way
    odometry = pv.StereoOdometry(scene.camera, imu=scene.imu)
    errors = []
    moving = []
    trusted = []
    for frame in scene:
        odometry.step(frame)
        tracks = odometry.tracks
        if frame.index == 0 or not len(tracks):
            continue
        truth = scene.pixel_truth(frame.index - 1)
        u, v = np.round(tracks.prev_px[:, :2]).astype(int).T
        flow = tracks.curr_px[:, :2] - tracks.prev_px[:, :2] - truth.flow_px[v, u]
        disparity = tracks.prev_px[:, 0] - tracks.prev_px[:, 2] - truth.disparity_px[v, u]
        errors.append(np.column_stack([flow, disparity]))
        moving.append(truth.moving[v, u])
        trusted.append(odometry.weights)
    return np.concatenate(errors), np.concatenate(moving), np.concatenate(trusted)


def main(words: list[str]) -> None:
    """Compare those features that the solver trusts with those that it does not."""
    strengths = {
        name: float(strength) for name, _, strength in (word.partition("=") for word in words[1:])
    }
    rig = RigConfig(
        width_px=310, height_px=94, focal_px=180.0
    )  # a quarter of KITTI's resolution: quick
    config = SceneConfig(
        preset=words[0], distance_m=DISTANCE_M, rig=rig, effects=Effects(**strengths)
    )
    error, moves, weight = features(config)
    for name, chosen in (("trusted", weight >= 0.5), ("distrusted", weight < 0.5)):
        sigma_px = ", ".join(
            f"{px:.2f}" for px in 1.48 * np.nanmedian(np.abs(error[chosen]), axis=0)
        )
        share = 100.0 * moves[chosen].mean()
        print(
            f"{chosen.sum():6} {name:10} {share:3.0f} % on what moves; σ of flow (u, v) and"
            f" disparity: {sigma_px} px"
        )


if __name__ == "__main__":
    if len(sys.argv) < 2 or sys.argv[1] not in get_args(PresetName):
        print(
            "usage: python examples/03_how_wrong_features_are.py PRESET [EFFECT=STRENGTH ...]",
            file=sys.stderr,
        )
        sys.exit(2)
    main(sys.argv[1:])

"""Measure the odometry on rendered streets seen by a rig that is not as calibrated in each frame.

    python benchmarks/loose_rig.py

The right camera turns by 0.05° RMS about each axis, anew in each frame, or it is exposed 5 ms after
the left one. Prints how many steps are OK, the mean NEES of these (6 is consistent), of all and
from the eleventh on, the RMS error of a step, and the jitter that the odometry finds.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

import probevo as pv
from probevo.arrays import Image
from probevo.evaluation.trajectory_errors import relative_motions
from probevo.geometry import se3
from probevo.geometry.uncertainty import normalized_error_squared
from probevo.sequences.frame import Frame
from probevo_sim.scene.config import SceneConfig
from probevo_sim.scene.recording import SceneRecording, open_scene

FRAMES = 100
DISTANCE_M = 250.0
FLEX_RAD = np.deg2rad(0.05)
DELAY_S = 0.005
LEARNED_FROM = 10
"""The first step that counts as one of a known rig."""


def rigid(recording: SceneRecording, index: int) -> tuple[Image, Image]:
    """Return the images as calibrated."""
    return recording.images(index)


def flexing(recording: SceneRecording, index: int) -> tuple[Image, Image]:
    """Return the images of a rig whose right camera has turned."""
    renderer = recording.renderer
    as_calibrated = renderer._T_left_right
    turn_rad = FLEX_RAD * np.random.default_rng(index).normal(size=3)
    renderer._T_left_right = as_calibrated @ se3.exp(np.r_[np.zeros(3), turn_rad])
    images = recording.images(index)
    renderer._T_left_right = as_calibrated
    return images


def delayed(recording: SceneRecording, index: int) -> tuple[Image, Image]:
    """Return the left image, and a right image that is exposed later."""
    left, _ = recording.images(index)
    time_s = index / recording.config.rig.rate_hz
    _, right = recording.renderer.pair(time_s + DELAY_S)
    return left, recording._expose(right, index, side=1)


RIGS: dict[str, Callable[[SceneRecording, int], tuple[Image, Image]]] = {
    "rigid": rigid,
    "flex 0.05°": flexing,
    "delay 5 ms": delayed,
}


def print_rig(name: str) -> None:
    """Print the row of a rig."""
    recording = open_scene(SceneConfig(preset="city", distance_m=DISTANCE_M))
    odometry = pv.StereoOdometry(recording.camera, config={"estimator": "two-frame"})
    motions = []
    for index in range(FRAMES):
        left, right = RIGS[name](recording, index)
        stamp_ns = int(recording.stamps_ns[index])
        motions.append(odometry.step(Frame(index, stamp_ns, left, right=right)))
    steps = motions[1:]
    true = relative_motions(recording.truth.T_world_cam[:FRAMES])
    T_curr_prev = np.array([step.T_curr_prev for step in steps])
    ok = np.array([step.status is pv.Status.OK for step in steps])
    nees = normalized_error_squared(true, T_curr_prev, np.array([step.cov for step in steps]))
    errors_m = np.linalg.norm(T_curr_prev[:, :3, 3] - true[:, :3, 3], axis=1)
    later = np.flatnonzero(ok[LEARNED_FROM:]) + LEARNED_FROM
    jitter_px = odometry.rig.jitter.sigma_rad * recording.camera.fu_px if odometry.rig else None
    print(
        f"{name:12} {ok.sum():3d} of {len(ok)} {nees[ok].mean():8.1f} {nees[later].mean():8.1f}"
        f" {1e3 * np.sqrt(np.mean(errors_m[ok] ** 2)):8.2f}   {np.round(jitter_px, 2)}"
    )


def main() -> None:
    """Print the table."""
    print("rig           steps OK     NEES    later  RMS, mm   pitch, yaw, roll found, px")
    for name in RIGS:
        print_rig(name)


if __name__ == "__main__":
    main()

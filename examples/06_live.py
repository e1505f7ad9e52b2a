"""Odometry of a camera that does not wait: here a simulated one, played at any speed.

python examples/06_live.py SPEED      1 is real time, ten frames a second; at 20, most machines have
to skip frames
"""

import sys
import time
from threading import Thread

import numpy as np

import probevo as pv
from probevo.geometry import se3
from probevo_sim.scene.config import RigConfig, SceneConfig
from probevo_sim.scene.recording import open_scene


def play(frames: list[pv.Frame], live: pv.LiveOdometry, speed: float) -> None:
    """What the driver of a camera does: hand in each frame at its time, then say that there are no
    more."""
    start_s = time.monotonic()
    for frame in frames:
        due_s = start_s + 1e-9 * (frame.stamp_ns - frames[0].stamp_ns) / speed
        time.sleep(max(0.0, due_s - time.monotonic()))
        live.push(frame)
    live.close()


def main(speed: float) -> None:
    """Print where the camera is as soon as it is known."""
    rig = RigConfig(
        width_px=310, height_px=94, focal_px=180.0
    )  # a quarter of KITTI's resolution: quick to render
    scene = open_scene(SceneConfig(preset="city", distance_m=15.0, rig=rig))
    frames = list(scene)
    warm = pv.StereoOdometry(scene.camera, imu=scene.imu)
    for frame in frames[:2]:
        warm.step(
            frame
        )  # loads the compiled code, which takes half a second; the very first time compiles it

    T_world_cam = np.eye(4)
    read = 0
    with pv.LiveOdometry(pv.StereoOdometry(scene.camera, imu=scene.imu)) as live:
        Thread(target=play, args=(frames, live, speed)).start()
        for estimate in live.estimates():
            read += 1
            T_world_cam = T_world_cam @ se3.inverse(
                estimate.motion.T_curr_prev
            )  # since the last one processed
            at_m = ", ".join(f"{metres:.2f}" for metres in T_world_cam[:3, 3])
            skipped = f", after {estimate.num_dropped} skipped" if estimate.num_dropped else ""
            status = estimate.motion.status.name
            late_ms = estimate.latency_ms
            print(f"{estimate.index:4} {status:6} at ({at_m}) m, {late_ms:.0f} ms late{skipped}")
    off_m = np.linalg.norm(T_world_cam[:3, 3] - scene.truth.T_world_cam[estimate.index, :3, 3])
    print(
        f"{len(frames)} frames, {read} processed, {live.num_dropped} dropped; in the end"
        f" {100 * off_m:.1f} cm off"
    )


if __name__ == "__main__":
    if len(sys.argv) != 2:
        print("usage: python examples/06_live.py SPEED", file=sys.stderr)
        sys.exit(2)
    main(float(sys.argv[1]))

"""Run the odometry of a live camera: here a simulated one, played at any speed.

python examples/06_live.py SPEED      1 is real time; at 20, most machines have to skip frames
"""

import sys
import time
from threading import Thread

import numpy as np

import probevo as pv
from probevo.geometry import se3
from probevo_sim.scene.config import RigConfig, SceneConfig
from probevo_sim.scene.recording import open_scene

RIG = RigConfig(width_px=310, height_px=94, focal_px=180.0)
"""A quarter of KITTI's resolution, which is quick to render."""


def play(frames: list[pv.Frame], live: pv.LiveOdometry, speed: float) -> None:
    """Push each frame at its time, as the driver of a camera does, then close, whatever happens."""
    start_s = time.monotonic()
    try:
        for frame in frames:
            due_s = start_s + 1e-9 * (frame.stamp_ns - frames[0].stamp_ns) / speed
            time.sleep(max(0.0, due_s - time.monotonic()))
            try:
                live.push(frame)
            except pv.InputError as error:  # a frame that is refused is left out
                print(error, file=sys.stderr)
    finally:
        live.close()


def main(speed: float) -> None:
    """Print each pose as soon as it is known."""
    scene = open_scene(SceneConfig(preset="city", distance_m=15.0, rig=RIG))
    frames = list(scene)

    # The first steps of a process load the compiled code, which takes half a second.
    warm_up = pv.StereoOdometry(scene.camera, imu=scene.imu)
    for frame in frames[:2]:
        warm_up.step(frame)
    T_world_cam = np.eye(4)
    processed = 0
    with pv.LiveOdometry(pv.StereoOdometry(scene.camera, imu=scene.imu)) as live:
        Thread(target=play, args=(frames, live, speed)).start()
        for estimate in live.estimates():
            # The motion is that since the last frame that was processed.
            T_world_cam = T_world_cam @ se3.inverse(estimate.motion.T_curr_prev)
            processed += 1
            pose = f"{estimate.motion.status.name:6} at {T_world_cam[:3, 3].round(2)} m"
            late = f"{estimate.latency_ms:.0f} ms late, after {estimate.num_dropped} skipped"
            print(f"{estimate.index:4} {pose}, {late}")
    error_m = np.linalg.norm(T_world_cam[:3, 3] - scene.truth.T_world_cam[estimate.index, :3, 3])
    print(f"{len(frames)} frames, {processed} processed, {live.num_dropped} dropped;", end=" ")
    print(f"in the end {100 * error_m:.1f} cm off")


if __name__ == "__main__":
    try:
        speed = float(sys.argv[1])
    except (IndexError, ValueError):
        print("usage: python examples/06_live.py SPEED", file=sys.stderr)
        sys.exit(2)
    main(speed)

"""Time of a frame, from decoded images to motion, on one core: by stage, and as a ratio to the yardstick in one run.

python benchmarks/frame_time.py [--repeats 3]
"""

from __future__ import annotations

import argparse
from time import perf_counter

import cv2
import numpy as np
from opencv_odometry import OpenCvOdometry
from recordings import available

import probevo as pv


def main(repeats: int) -> None:
    cv2.setNumThreads(1)
    print(f"{'recording':12} {'ours, ms':>9} {'p99':>6} {'yardstick, ms':>14} {'ratio':>6}   stages, ms")
    for name, path in available().items():
        sequence = pv.open_sequence(path)
        frames = list(sequence)  # decoded beforehand: what is timed is the odometry
        ours, theirs, stages = [], [], []
        for _ in range(repeats):
            odometry, yardstick = pv.StereoOdometry(sequence.camera, imu=sequence.imu), OpenCvOdometry(sequence.camera)
            for frame in frames:
                start = perf_counter()
                motion = odometry.step(frame)
                middle = perf_counter()
                yardstick.step(frame.left, frame.right)
                ours.append(1e3 * (middle - start))
                theirs.append(1e3 * (perf_counter() - middle))
                stages.append(dict(motion.stage_ms))
        ours, theirs, stages = ours[3:], theirs[3:], stages[3:]  # the first frames load the compiled code
        medians = {k: np.median([s.get(k, 0.0) for s in stages]) for k in stages[-1] if k != "decode"}
        ratio = np.median(np.array(ours) / np.array(theirs))
        row = (
            f"{name:12} {np.median(ours):9.1f} {np.percentile(ours, 99):6.1f} {np.median(theirs):14.1f} {ratio:6.2f}   "
        )
        print(row + "  ".join(f"{k} {v:.2f}" for k, v in medians.items()))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=3)
    main(parser.parse_args().repeats)

"""Drive a recording forwards and back to its first frame, and compare where that is found.

    python benchmarks/there_and_back.py [--of NAME …] [--estimator window]

Forwards on the even frames, back on the odd ones, and at the end the first frame again: the last
pose is the first one, which needs no truth, and no other image is seen twice. Errors of the
calibration are the same on both ways and cancel, as the covariance says that they do. What is left
depends on the direction: features are found far and come near, or are found near and recede. Prints
the error of the last pose with the standard deviation that is claimed for it, and its squared
Mahalanobis distance over its 6 dimensions, 1 if the claim holds. For the whole recording, and for
each half of it. Default settings, images alone.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import cv2
import numpy as np
from other_images import ALL_RECORDINGS, at_hand

import probevo as pv
from probevo.camera.stereo import StereoCamera
from probevo.estimation.motion_estimate import MotionEstimate, Status
from probevo.geometry import se3
from probevo.geometry.uncertainty import normalized_error_squared
from probevo.sequences.frame import Frame

INTERVAL_NS = 1_000_000_000
"""Time between two frames: at the rate of the recording, no vehicle could turn back in one step."""


def there_and_back(frames: list[Frame]) -> list[Frame]:
    """Return the even frames in their order, the odd ones in reverse, and the first one again."""
    last = (len(frames) - 1) // 2 * 2
    order = [*range(0, last + 1, 2), *range(last - 1, 0, -2), 0]
    return [
        replace(frames[at], index=k, stamp_ns=k * INTERVAL_NS, imu=None)
        for k, at in enumerate(order)
    ]


def last_of(
    camera: StereoCamera, frames: list[Frame], estimator: str
) -> tuple[MotionEstimate, int]:
    """Run over frames, and return the last estimate and the number of steps without a solve."""
    odometry = pv.StereoOdometry(camera, config={"estimator": estimator})
    estimates = [odometry.step(frame) for frame in frames]
    return estimates[-1], sum(estimate.status is not Status.OK for estimate in estimates[1:])


def row(name: str, part: str, estimate: MotionEstimate, num_refused: int) -> str:
    """Return a row of the table."""
    T_cam_world = estimate.T_cam_world
    squared = normalized_error_squared(
        T_cam_world[None], np.eye(4)[None], estimate.cov_cam_world[None]
    )
    error = se3.log(T_cam_world)
    sigma = np.sqrt(np.diagonal(estimate.cov_cam_world))
    in_mm = f"{1e3 * np.linalg.norm(error[:3]):.1f} ({1e3 * np.linalg.norm(sigma[:3]):.1f})"
    in_deg = (
        f"{np.rad2deg(np.linalg.norm(error[3:])):.3f} ({np.rad2deg(np.linalg.norm(sigma[3:])):.3f})"
    )
    return f"| {name} | {part} | {num_refused} | {in_mm} | {in_deg} | {squared[0] / 6.0:.2f} |"


def main() -> None:
    """Print a table for each recording."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--of", nargs="+", choices=ALL_RECORDINGS, default=list(ALL_RECORDINGS))
    parser.add_argument("--estimator", choices=["two-frame", "window"], default="window")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    print("| recording | frames | without solve | error, mm (σ) | rotation, ° (σ) | squared / 6 |")
    print("|---|---|---|---|---|---|")
    for recording, sequence, frames in at_hand(given.of):
        half = len(frames) // 2
        parts = {"all": frames, "first half": frames[:half], "second half": frames[half:]}
        for part, chosen in parts.items():
            found = last_of(sequence.camera, there_and_back(chosen), given.estimator)
            print(row(recording, part, *found), flush=True)


if __name__ == "__main__":
    main()

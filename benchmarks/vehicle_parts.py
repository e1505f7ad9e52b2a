"""Drive with a textured part of the vehicle in view, such as a bonnet, an arm or a landing skid.

    python benchmarks/vehicle_parts.py [--of MH_01 06 rover] [--estimator window]

The part is pasted into both images of a recording: at the bottom, over 15, 30 and 45 % of the
image, at the left and the right side, or from below into the middle. Its disparity grows from 6 to
12 % of the width, and stays what it is. Each recording is driven as it is, and once more after a
rest of fifteen frames, from which it starts within one frame. Prints, against the path without the
part: how long the path is, its end error, steps that are refused, and of those that are OK, how
many are off by a fifth of their length, five times their claim and 3 mm.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np
from recordings import ROOT

import probevo as pv
from probevo.arrays import FloatArray, Image
from probevo.camera.stereo import StereoCamera
from probevo.estimation.motion_estimate import MotionEstimate, Status
from probevo.evaluation.trajectory_errors import path_length, relative_motions
from probevo.sequences.frame import Frame
from probevo_sim.scene.config import SceneConfig
from probevo_sim.scene.recording import open_scene

RECORDINGS = {
    "MH_01": ROOT / "euroc" / "MH_01_micro",
    "06": ROOT / "kitti_odometry" / "sequences" / "06",
    "0005": ROOT / "kitti_raw" / "2011_09_26" / "2011_09_26_drive_0005_sync",
    "0039": ROOT / "kitti_0039" / "sequences" / "39",
    "karlsruhe": ROOT / "karlsruhe_2010" / "sequences" / "19",
}
ROVER = SceneConfig(preset="rover", seed=3, distance_m=12.0)
RESTING_FRAMES = 15
CONTRAST = 35.0
"""Standard deviation of the part's texture, grey levels."""
NOISE = 1.0
"""Standard deviation of the noise of each image, grey levels."""
DISPARITY = (0.06, 0.12)
"""Of the upper and the lower border of the part, in widths of the image."""
WRONG_SHARE = 0.2
WRONG_SIGMAS = 5.0
WRONG_M = 0.003


class Region(NamedTuple):
    """Where the part is in the left image, in shares of its size."""

    left: float
    top: float
    right: float
    bottom: float


PARTS = {
    "bottom 15 %": Region(0.0, 0.85, 1.0, 1.0),
    "bottom 30 %": Region(0.0, 0.7, 1.0, 1.0),
    "bottom 45 %": Region(0.0, 0.55, 1.0, 1.0),
    "left 20 %": Region(0.0, 0.0, 0.2, 1.0),
    "right 35 %": Region(0.65, 0.0, 1.0, 1.0),
    "arm": Region(0.35, 0.3, 0.65, 1.0),
}


class Drive(NamedTuple):
    """A recording in memory."""

    camera: StereoCamera
    frames: list[Frame]


def opened(name: str) -> Drive:
    """Return a recording without its IMU."""
    sequence = open_scene(ROVER) if name == "rover" else pv.open_sequence(RECORDINGS[name])
    return Drive(sequence.camera, [replace(frame, imu=None, prepared=None) for frame in sequence])


def noisy(image: FloatArray | Image, rng: np.random.Generator) -> Image:
    """Return an image with noise, [height, width], uint8."""
    values = image + NOISE * rng.normal(size=image.shape)
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def after_rest(drive: Drive) -> Drive:
    """Repeat the first frame, with other noise, before all others."""
    rng = np.random.default_rng(3)
    first = drive.frames[0]
    step_ns = drive.frames[1].stamp_ns - first.stamp_ns
    frames = []
    for index in range(RESTING_FRAMES):
        resting = replace(first, left=noisy(first.left, rng), right=noisy(first.right, rng))
        frames.append(replace(resting, index=index, stamp_ns=first.stamp_ns + index * step_ns))
    for frame in drive.frames:
        stamp_ns = frame.stamp_ns + RESTING_FRAMES * step_ns
        frames.append(replace(frame, index=frame.index + RESTING_FRAMES, stamp_ns=stamp_ns))
    return drive._replace(frames=frames)


def texture(height: int, width: int) -> FloatArray:
    """Return a random texture with details of several sizes, [height, width], grey levels."""
    rng = np.random.default_rng(1)
    total = np.zeros((height, width))
    for sigma_px in (1.2, 3.0, 8.0):
        total += sigma_px * cv2.GaussianBlur(rng.normal(size=(height, width)), (0, 0), sigma_px)
    return np.asarray(110.0 + CONTRAST * (total - total.mean()) / total.std())


def with_part(drive: Drive, part: Region) -> Drive:
    """Paste a part of the vehicle into all images."""
    height, width = drive.frames[0].left.shape
    top = round(part.top * height)
    bottom = round(part.bottom * height)
    rows = np.arange(bottom - top)
    disparity_px = width * np.linspace(*DISPARITY, len(rows))
    look = texture(len(rows), round(1.5 * width))
    # The texture's column that each pixel shows is that of the left image.
    columns = np.arange(width) + np.zeros((len(rows), 1))
    of_sides = (columns, columns + disparity_px[:, None])
    frames = []
    for frame in drive.frames:
        rng = np.random.default_rng(frame.index)
        images = []
        for image, column in zip((frame.left, frame.right), of_sides, strict=True):
            shown = np.array(
                [
                    np.interp(shown_columns, np.arange(look.shape[1]), row)
                    for shown_columns, row in zip(column, look, strict=True)
                ]
            )
            is_part = (column >= part.left * width) & (column < part.right * width)
            is_part |= (part.right == 1.0) & (column >= width)
            pasted = image.copy()
            pasted[top:bottom] = np.where(is_part, noisy(shown, rng), image[top:bottom])
            images.append(pasted)
        frames.append(replace(frame, left=images[0], right=images[1]))
    return drive._replace(frames=frames)


def driven(drive: Drive, estimator: str) -> list[MotionEstimate]:
    """Return the motions of an odometry."""
    odometry = pv.StereoOdometry(drive.camera, config={"estimator": estimator})
    return [odometry.step(frame) for frame in drive.frames]


def poses(motions: list[MotionEstimate]) -> FloatArray:
    """Return T_world_cam, [K, 4, 4], m."""
    return np.array([motion.T_world_cam for motion in motions])


def compared(motions: list[MotionEstimate], T_clean: FloatArray) -> str:
    """Return how a path with a part differs from that without it, [K, 4, 4], m."""
    T_world_cam = poses(motions)
    true_m = relative_motions(T_clean)[:, :3, 3]
    estimated_m = np.array([motion.T_curr_prev[:3, 3] for motion in motions[1:]])
    error_m = np.linalg.norm(estimated_m - true_m, axis=1)
    sigma_m = np.array([np.sqrt(np.trace(motion.cov[:3, :3])) for motion in motions[1:]])
    is_ok = np.array([motion.status is Status.OK for motion in motions[1:]])
    allowed_m = np.maximum(WRONG_SHARE * np.linalg.norm(true_m, axis=1), WRONG_SIGMAS * sigma_m)
    num_wrong = int((is_ok & (error_m > np.maximum(allowed_m, WRONG_M))).sum())
    end_m = np.linalg.norm(T_world_cam[-1, :3, 3] - T_clean[-1, :3, 3])
    return (
        f"{path_length(T_clean):8.2f} {path_length(T_world_cam):8.2f} {end_m:8.3f}"
        f" {int((~is_ok).sum()):8} {num_wrong:9}"
    )


def main() -> None:
    """Parse the command line, and print a line for each recording and part."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--of", nargs="+", default=[*RECORDINGS, "rover"])
    parser.add_argument("--estimator", choices=("window", "two-frame"), default="window")
    arguments = parser.parse_args()
    print(
        "recording  begins     part          clean, m  path, m   end, m  refused  wrong, OK",
        flush=True,
    )
    for name in arguments.of:
        drive = opened(name)
        for begins, world in (("moving", drive), ("from rest", after_rest(drive))):
            T_clean = poses(driven(world, arguments.estimator))
            for part, region in PARTS.items():
                motions = driven(with_part(world, region), arguments.estimator)
                print(f"{name:10} {begins:10} {part:12} {compared(motions, T_clean)}", flush=True)


if __name__ == "__main__":
    main()

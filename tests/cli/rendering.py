"""A tiny recording on which odometry works: a textured, slanted wall, approached while turning.

Others use it too: ``from cli.rendering import write_wall``.
"""

from functools import cache
from pathlib import Path

import cv2
import numpy as np

from probevo.arrays import FloatArray, Image
from probevo.geometry import se3
from sequences.recordings import numbers, write_image, write_lines

WIDTH_PX = 320
HEIGHT_PX = 160
SIZE_PX = (WIDTH_PX, HEIGHT_PX)
FOCAL_PX = 200.0
BASELINE_M = 0.3
K = np.array([[FOCAL_PX, 0.0, 159.5], [0.0, FOCAL_PX, 79.5], [0.0, 0.0, 1.0]])
NORMAL = np.array([0.35, -0.45, 0.82]) / np.linalg.norm([0.35, -0.45, 0.82])
"""Of the wall, in the first camera's frame; the wall is where NORMAL · p = DISTANCE_M."""
DISTANCE_M = 8.0
TEXEL_M = 0.025
FRAME_NS = 100_000_000
STEP = np.array([0.01, 0.0, -0.15, 0.002, -0.004, 0.003])
"""Log(T_curr_prev) of every step."""


@cache
def texture() -> Image:
    """Return an image of noise of several grain sizes."""
    rng = np.random.default_rng(7)
    layers = [
        cv2.resize(rng.normal(size=(n, n)), (1536, 1536), interpolation=cv2.INTER_CUBIC)
        for n in (96, 384, 1536)
    ]
    return np.clip(128 + 40 * np.sum(layers, axis=0), 0, 255).astype(np.uint8)


FINER = 4


def true_poses(frames: int) -> FloatArray:
    """Return T_world_cam, [frames, 4, 4], m."""
    return np.array([se3.inverse(se3.exp(k * STEP)) for k in range(frames)])


def render(wall: Image, T_cam_world: FloatArray) -> Image:
    """Render what a camera at that pose sees; a homography maps the wall to the image."""
    across = np.cross([0.0, 1.0, 0.0], NORMAL) / np.linalg.norm(np.cross([0.0, 1.0, 0.0], NORMAL))
    along = np.cross(NORMAL, across)
    T = T_cam_world
    to_camera = np.column_stack(
        [T[:3, :3] @ across, T[:3, :3] @ along, T[:3, :3] @ (DISTANCE_M * NORMAL) + T[:3, 3]]
    )
    center = 0.5 * (len(wall) - 1)
    to_wall = np.array(
        [[TEXEL_M, 0.0, -TEXEL_M * center], [0.0, TEXEL_M, -TEXEL_M * center], [0.0, 0.0, 1.0]]
    )
    # Rendered at four times the size: a pixel is a mean over its area, as in a camera. Bilinear
    # interpolation of the wall itself would show its texture at places of its own.
    finer = np.diag([FINER, FINER, 1.0])
    finer[:2, 2] = 0.5 * (FINER - 1)
    size_px = (FINER * SIZE_PX[0], FINER * SIZE_PX[1])
    large = cv2.warpPerspective(wall, finer @ K @ to_camera @ to_wall, size_px)
    return np.asarray(cv2.resize(large, SIZE_PX, interpolation=cv2.INTER_AREA), np.uint8)


@cache
def pair(index: int) -> tuple[Image, Image]:
    """Return what the left and the right camera see at a frame."""
    T_cam_world = se3.inverse(true_poses(index + 1)[index])
    T_right_left = np.eye(4)
    T_right_left[0, 3] = -BASELINE_M
    return render(texture(), T_cam_world), render(texture(), T_right_left @ T_cam_world)


def write_wall(root: Path, frames: int = 8, *, truth: bool = True, swapped: bool = False) -> Path:
    """Write a recording of the wall in the folder layout; return its folder."""
    for index in range(frames):
        left, right = pair(index)
        write_image(root / "left" / f"{index:06d}.png", right if swapped else left)
        write_image(root / "right" / f"{index:06d}.png", left if swapped else right)
    calibration = [
        f"fu_px: {FOCAL_PX}",
        f"fv_px: {FOCAL_PX}",
        f"cu_px: {K[0, 2]}",
        f"cv_px: {K[1, 2]}",
    ]
    calibration += [f"baseline_m: {BASELINE_M}", f"width_px: {WIDTH_PX}", f"height_px: {HEIGHT_PX}"]
    write_lines(root / "calib.yaml", calibration)
    write_lines(root / "times.txt", [str(10**18 + k * FRAME_NS) for k in range(frames)])
    if truth:
        write_lines(root / "poses.txt", [numbers(T[:3]) for T in true_poses(frames)])
    return root

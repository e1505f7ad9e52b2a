"""Posts at several depths, seen by a camera that rises: ``from strips import strip_pairs``."""

from pathlib import Path

import cv2
import numpy as np

from probevo.arrays import Image
from sequences.recordings import write_image, write_lines

WIDTH_PX = 320
HEIGHT_PX = 160
STRIP_PX = 40
DISPARITIES_PX = (24, 8, 16, 4, 20, 12, 6, 18)
"""Of the posts from left to right."""
FRAME_NS = 100_000_000


def strip_pairs(
    count: int, *, right_late: int = 0, px_per_disparity: float = 0.25
) -> list[tuple[Image, Image]]:
    """Left and right images of ``count`` frames.

    Args:
        count: number of frames.
        right_late: frames by which the right images are late; negative if the left ones are.
        px_per_disparity: rows by which a point sinks in a frame, for each pixel of its disparity;
            0 for a camera at rest.
    """
    rng = np.random.default_rng(5)
    texture = cv2.GaussianBlur(rng.uniform(0, 255, (2 * HEIGHT_PX, 2 * WIDTH_PX)), (0, 0), 1.5)
    texture = np.clip(128.0 + 4.0 * (texture - texture.mean()), 0, 255).astype(np.uint8)

    def side(k: int, is_right: bool) -> Image:
        """Return an image of frame k."""
        image = np.zeros((HEIGHT_PX, WIDTH_PX), np.uint8)
        for strip, disparity_px in enumerate(DISPARITIES_PX):
            sunk = round(px_per_disparity * disparity_px * k)
            rows = (np.arange(HEIGHT_PX) - sunk) % len(texture)
            columns = strip * STRIP_PX + np.arange(STRIP_PX)
            shown = columns + (disparity_px if is_right else 0)
            image[:, columns] = texture[rows[:, None], shown]
        return image

    return [(side(k, False), side(k - right_late, True)) for k in range(count)]


def write_strips(root: Path, count: int, *, right_late: int = 0) -> Path:
    """Write a recording of the posts in the folder layout; return its folder."""
    for k, (left, right) in enumerate(strip_pairs(count, right_late=right_late)):
        write_image(root / "left" / f"{k:06d}.png", left)
        write_image(root / "right" / f"{k:06d}.png", right)
    calibration = ["fu_px: 200.0", "fv_px: 200.0", "cu_px: 159.5", "cv_px: 79.5"]
    calibration += ["baseline_m: 0.3", f"width_px: {WIDTH_PX}", f"height_px: {HEIGHT_PX}"]
    write_lines(root / "calib.yaml", calibration)
    write_lines(root / "times.txt", [str(10**18 + k * FRAME_NS) for k in range(count)])
    return root

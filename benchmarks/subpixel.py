"""Measure by how much an alignment is off between pixels: docs/accuracy.md.

    python benchmarks/subpixel.py

Real images are reduced to a quarter of their size, once as they are and once from one to three
pixels farther to the right: the same view, moved by a quarter, a half and three quarters of a
pixel, each with noise of one grey level. Corners of the first are aligned with the second, from
their true places. Prints the mean error along the shift, and the robust standard deviation.
"""

from __future__ import annotations

import cv2
import numpy as np
from plain_odometry import RECORDINGS

import probevo as pv
from probevo.arrays import FloatArray, Image
from probevo.config import TrackingConfig
from probevo.tracking.anchor_patches import AnchorPatches
from probevo.tracking.detection import strongest_corners
from probevo.tracking.preparation import high_pass
from probevo.tracking.spline import spline_through
from probevo.tracking.surface_motion import SurfaceMotion

REDUCTION = 4
BLUR_PX = 1.2
"""Of the optics, beside the mean over the area of a pixel, before the reduction."""
NOISE = 1.0
CONFIG = TrackingConfig()


def reduced(image: Image, shift: int, rng: np.random.Generator) -> Image:
    """Return an image of a quarter of the size, moved by ``shift`` quarters of a pixel."""
    over_pixels = cv2.blur(image.astype(np.float32), (REDUCTION, REDUCTION))
    optics = cv2.GaussianBlur(over_pixels, (0, 0), BLUR_PX)
    view = optics[REDUCTION::REDUCTION, REDUCTION - shift :: REDUCTION]
    noisy = np.clip(view + rng.normal(0.0, NOISE, view.shape), 0.0, 255.0)
    return high_pass(np.round(noisy).astype(np.uint8), CONFIG)


def errors_px(image: Image, shift: int, rng: np.random.Generator) -> FloatArray:
    """Return the errors (u, v) of the corners that were aligned, [N, 2], px."""
    first = reduced(image, 0, rng)
    second = reduced(image, shift, rng)
    corners = strongest_corners(first, CONFIG).reshape(-1, 2)
    corners = corners[np.isfinite(corners).all(axis=1)]
    count = len(corners)
    true = corners + np.array([shift / REDUCTION, 0.0])
    patches = AnchorPatches.cut(first, corners, CONFIG.window_px)
    still = SurfaceMotion(
        pixels=true,
        growth=np.ones(count),
        ahead=np.ones(count, np.bool_),
        affine=np.tile(np.eye(2), (count, 1, 1)),
        perspective=np.zeros((count, 2)),
    )
    aligned = patches.align_left(spline_through(second), true, still)
    found: FloatArray = (aligned.pixels - true)[np.isfinite(aligned.difference)]
    return found


def main() -> None:
    """Print a row for each recording."""
    rng = np.random.default_rng(0)
    print(f"{'mean ± scatter, px':26} {'0.25 px':>15} {'0.5 px':>15} {'0.75 px':>15}")
    for name, (path, _) in RECORDINGS.items():
        if not path.is_dir():
            print(f"{name:26} not there")
            continue
        images = [frame.left for frame in pv.open_sequence(path)][::20]
        cells = []
        for shift in range(1, REDUCTION):
            error = np.concatenate(
                [errors_px(image, shift, rng) for image in images if image is not None]
            )[:, 0]
            scatter = 1.4826 * np.median(np.abs(error - np.median(error)))
            cells.append(f"{error.mean():+7.4f} ± {scatter:.3f}")
        print(f"{name:26} {' '.join(cells)}", flush=True)


if __name__ == "__main__":
    main()

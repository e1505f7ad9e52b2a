"""Do two halves of the image agree as they claim? A test of the covariances that needs no truth.

    python benchmarks/image_halves.py

The features of a real recording are divided into two halves, each of which an odometry with a
window follows by itself: at random, or by where they were first seen, in vertical bands a sixth of
the image wide. Prints the difference of both motions in units of the sum of their covariances, over
its 6 dimensions, over one frame and over eight: median, scaled so that 1 is consistent. Errors that
neighbours have in common show in bands, and errors that last show over eight frames. Without and
with the distortion field.

Both halves have the camera, its jitter and the b of the disparity in common, so that less than 1 is
expected.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
from lens_distortion import FLAWLESS_PX, tracked
from recordings import ROOT
from window import SPAN

import probevo as pv
from probevo.arrays import FloatArray
from probevo.camera.image_errors import INITIAL_SIGMA_PX, ImageErrors
from probevo.camera.rig_calibration import RigCalibration
from probevo.camera.stereo import StereoCamera
from probevo.geometry.uncertainty import normalized_error_squared
from probevo.sequences.frame import Frame, StereoFeatures

RECORDINGS = {
    "odometry 06": ROOT / "kitti_odometry" / "sequences" / "06",
    "raw 0005": ROOT / "kitti_raw" / "2011_09_26" / "2011_09_26_drive_0005_sync",
    "kitti_0039": ROOT / "kitti_0039" / "sequences" / "39",
    "karlsruhe_2010": ROOT / "karlsruhe_2010" / "sequences" / "19",
    "EuRoC MH_01": ROOT / "euroc" / "MH_01_micro",
}
BANDS = 6
"""Vertical bands of the image; every other one is of the same half."""
WARM_UP = 10
"""First frames that do not count: nothing is known of the rig yet."""
MEDIAN = 5.348
"""Of χ²(6)."""

Motion = tuple[FloatArray, FloatArray]


def halves(
    seen: list[dict[int, FloatArray]], width_px: float, rng: np.random.Generator
) -> dict[str, dict[int, int]]:
    """Return the half of each feature, 0 or 1: at random, and by bands."""
    first_u: dict[int, float] = {}
    for observations in seen:
        for identity, pixels in observations.items():
            first_u.setdefault(identity, float(pixels[0]))
    return {
        "at random": {identity: int(rng.integers(2)) for identity in first_u},
        "bands": {identity: int(u * BANDS / width_px) % 2 for identity, u in first_u.items()},
    }


def motions(
    frames: list[Frame], camera: StereoCamera, tau_px: float
) -> tuple[list[Motion | None], list[Motion | None]]:
    """Return the motions over one frame and over ``SPAN`` with their covariances, by a window."""
    initial = replace(RigCalibration.initial(), image=ImageErrors.initial(tau_px))
    of_step: list[Motion | None] = []
    of_span: list[Motion | None] = []
    with patch.object(RigCalibration, "initial", return_value=initial):
        odometry = pv.StereoOdometry(camera)
        for k, frame in enumerate(frames):
            estimate = odometry.step(frame)
            is_ok = estimate.status is pv.Status.OK
            of_step.append((estimate.T_curr_prev, estimate.cov) if is_ok else None)
            of_span.append(odometry.relative(k, k - SPAN) if is_ok and k >= SPAN else None)
    return of_step, of_span


def disagreement(one: list[Motion | None], other: list[Motion | None]) -> float:
    """Return the median of the squared differences in units of their covariances, 1 if these
    hold."""
    squared = [
        normalized_error_squared(a[0][None], b[0][None], (a[1] + b[1])[None])[0]
        for a, b in zip(one[WARM_UP:], other[WARM_UP:], strict=True)
        if a is not None and b is not None
    ]
    return float(np.median(squared)) / MEDIAN


def show(name: str, folder: Path) -> None:
    """Print the disagreement of the halves of a recording."""
    sequence = pv.open_sequence(folder)
    seen = tracked(sequence)
    width_px = float((sequence.camera.size_px or (2.0 * sequence.camera.cu_px, 0))[0])
    divided = halves(seen, width_px, np.random.default_rng(1))
    for how, half_of in divided.items():
        texts = []
        for tau_px in (FLAWLESS_PX, INITIAL_SIGMA_PX):
            both = []
            for half in (0, 1):
                frames = []
                for k, observations in enumerate(seen):
                    chosen = [identity for identity in observations if half_of[identity] == half]
                    pixels = np.array([observations[identity] for identity in chosen])
                    features = StereoFeatures(np.array(chosen), pixels.reshape(-1, 4))
                    frames.append(Frame(k, int(sequence.stamps_ns[k]), features=features))
                both.append(motions(frames, sequence.camera, tau_px))
            step, span = (disagreement(*pair) for pair in zip(*both, strict=True))
            texts.append(f"{step:.2f}, {span:.2f}")
        print(f"{name:16} {how:10} without {texts[0]:12} with {texts[1]:12}", flush=True)


if __name__ == "__main__":
    for recording, path in RECORDINGS.items():
        if path.is_dir():
            show(recording, path)
        else:
            print(f"{recording:16} not there")

"""Run the odometry on the recordings at hand as other cameras would have taken them.

    python benchmarks/other_images.py [--of NAME …] [--noise student-t]

Every image is made smaller, cropped, compressed, given another tone or contrast, or frames are left
out, with the calibration to match. Nothing is chosen for it: default settings, no IMU. What an
odometry was tuned to shows in what such changes cost. Prints the steps that are OK, the inliers in
the median, drift and rotation over pieces of 10 to 50 m or else the end error, and the last factor
of the noise's variances.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import cast

import cv2
import numpy as np
from plain_odometry import RECORDINGS
from recordings import ROOT

import probevo as pv
from probevo.arrays import FloatArray, Image
from probevo.camera.stereo import StereoCamera
from probevo.errors import InputError
from probevo.estimation.motion_estimate import Status
from probevo.evaluation.metrics import Metrics, evaluate
from probevo.noise.named import noise_model
from probevo.sequences.frame import Frame
from probevo.sequences.recording import StereoRecording

ALL_RECORDINGS = {
    **RECORDINGS,
    "V1_01_micro": (ROOT / "euroc" / "V1_01_micro", 0),
    "karlsruhe_2010": (ROOT / "karlsruhe_2010" / "sequences" / "19", 0),
}
"""Path, and the first frame that counts."""

Camera = tuple[StereoCamera, list[Frame]]
"""A camera, and the frames that it has taken."""


def at_hand(names: Iterable[str]) -> Iterator[tuple[str, StereoRecording, list[Frame]]]:
    """Open those of the recordings that are there: name, recording, and all its frames."""
    for name in names:
        path, _ = ALL_RECORDINGS[name]
        if not path.is_dir():
            print(f"{name}: not there")
            continue
        sequence = cast("StereoRecording", pv.open_sequence(path))
        yield name, sequence, list(sequence)


def of_tone(change: Callable[[Image], Image]) -> Callable[[StereoCamera, list[Frame]], Camera]:
    """Change the grey levels of all images."""
    return lambda camera, frames: (camera, with_images(frames, change))


def with_images(frames: list[Frame], change: Callable[[Image], Image]) -> list[Frame]:
    """Return the frames with both images changed, and without IMU samples."""
    return [
        replace(
            frame,
            left=np.ascontiguousarray(change(frame.left)),
            right=np.ascontiguousarray(change(frame.right)),
            imu=None,
        )
        for frame in frames
    ]


def smaller(factor: int) -> Callable[[StereoCamera, list[Frame]], Camera]:
    """Images of a fraction of the size; each pixel is the mean of ``factor`` by ``factor``."""

    def change(camera: StereoCamera, frames: list[Frame]) -> Camera:
        height, width = frames[0].left.shape
        size = (width // factor, height // factor)
        # The centre of the first pixel is at 0: its new one covers 0 to factor − 1.
        centre = 0.5 * (factor - 1)
        reduced = replace(
            camera,
            fu_px=camera.fu_px / factor,
            fv_px=camera.fv_px / factor,
            cu_px=(camera.cu_px - centre) / factor,
            cv_px=(camera.cv_px - centre) / factor,
            size_px=size,
        )

        def reduce(image: Image) -> Image:
            whole = image[: size[1] * factor, : size[0] * factor]
            return cv2.resize(whole, size, interpolation=cv2.INTER_AREA)

        return reduced, with_images(frames, reduce)

    return change


def cropped(camera: StereoCamera, frames: list[Frame]) -> Camera:
    """The middle of the images: half the width and three quarters of the height."""
    height, width = frames[0].left.shape
    left = width // 4
    top = height // 8
    size = (width // 2, 3 * height // 4)
    part = replace(camera, cu_px=camera.cu_px - left, cv_px=camera.cv_px - top, size_px=size)
    return part, with_images(
        frames, lambda image: image[top : top + size[1], left : left + size[0]]
    )


def every(step: int) -> Callable[[StereoCamera, list[Frame]], Camera]:
    """A lower frame rate."""
    return lambda camera, frames: (camera, with_images(frames[::step], lambda image: image))


def compressed(image: Image) -> Image:
    """JPEG of quality 20."""
    _, encoded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 20])
    return cv2.imdecode(encoded, cv2.IMREAD_GRAYSCALE)


def darker_corners(image: Image) -> Image:
    """A lens that shows a third of the light in the corners."""
    height, width = image.shape
    y, x = np.mgrid[-1.0 : 1.0 : height * 1j, -1.0 : 1.0 : width * 1j]
    return (image / (1.0 + x * x + y * y)).astype(np.uint8)


def equalised(image: Image) -> Image:
    """Contrast that is made equal from place to place, anew in each frame (CLAHE)."""
    return cv2.createCLAHE(clipLimit=4.0, tileGridSize=(8, 8)).apply(image)


VARIATIONS: dict[str, Callable[[StereoCamera, list[Frame]], Camera]] = {
    "as it is": of_tone(lambda image: image),
    "half the size": smaller(2),
    "a third": smaller(3),
    "a quarter": smaller(4),
    "the middle alone": cropped,
    "JPEG, quality 20": of_tone(compressed),
    "gamma 2.2": of_tone(lambda image: (255.0 * (image / 255.0) ** 2.2).astype(np.uint8)),
    "30 % of the contrast": of_tone(
        lambda image: np.clip(110.0 + 0.3 * (image - 110.0), 0, 255).astype(np.uint8)
    ),
    "dark corners": of_tone(darker_corners),
    "equalised": of_tone(equalised),
    "every second frame": every(2),
    "every third frame": every(3),
}


def row(name: str, camera: StereoCamera, frames: list[Frame], truth: FloatArray, noise: str) -> str:
    """Run over the frames, and return a row of the table.

    Args:
        name: of the variation.
        camera: the camera.
        frames: its frames.
        truth: T_world_cam of those that count, which are the last ones, [K, 4, 4], m.
        noise: kind or file of a noise model.
    """
    odometry = pv.StereoOdometry(camera, noise)
    estimates = [odometry.step(frame) for frame in frames]
    path = np.array([estimate.T_world_cam for estimate in estimates])
    steps = estimates[1:]
    num_ok = sum(estimate.status is Status.OK for estimate in steps)
    inliers = int(np.median([estimate.num_inliers for estimate in steps]))
    found = _found(evaluate(path[-len(truth) :], truth)) if len(truth) else "–"
    factor = estimates[-1].noise_factor
    return f"| {name} | {num_ok} of {len(steps)} | {inliers} | {found} | {factor:.2f} |"


def _found(metrics: Metrics) -> str:
    if metrics.short_t_percent is None:
        return f"{1e3 * metrics.final_error_m:.1f} mm"
    return f"{metrics.short_t_percent:.2f} / {metrics.short_r_deg_per_m:.4f}"


def main() -> None:
    """Print a table for each recording."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--of", nargs="+", choices=ALL_RECORDINGS, default=list(ALL_RECORDINGS))
    parser.add_argument("--noise", default="student-t")
    given = parser.parse_args()
    try:
        noise_model(given.noise)
    except InputError as error:
        parser.error(str(error))
    cv2.setNumThreads(1)
    for recording, sequence, frames in at_hand(given.of):
        _, first = ALL_RECORDINGS[recording]
        print(f"\n{recording}\n\n| | OK | inliers | drift, %, / °/m, or end | noise |")
        print("|---|---|---|---|---|")
        for name, change in VARIATIONS.items():
            camera, changed = change(sequence.camera, frames)
            truth = np.empty((0, 4, 4))
            if sequence.truth is not None:
                counting = [frame.index for frame in changed if frame.index >= first]
                truth = sequence.truth.T_world_cam[counting]
            print(row(name, camera, changed, truth, given.noise), flush=True)


if __name__ == "__main__":
    main()

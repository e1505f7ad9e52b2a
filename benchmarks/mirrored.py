"""Run the odometry on recordings that are flipped, backwards or in a mirror, and compare the paths.

    python benchmarks/mirrored.py [--of NAME …] [--estimator window]

What is changed has the same path but for a known transform, so that this needs no truth. Default
settings, no IMU. Prints by how much length, rotation and place at the end differ from those of the
recording as it is, and the squared Mahalanobis distance of both motions from the first to the last
frame, by the sum of both claimed covariances, divided by its 6 dimensions. The noise of the images
is the same in both, so that it should be below 1; what depends on the direction of the motion, on
the side of a camera, or on chance adds to it.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace

import cv2
import numpy as np
from other_images import ALL_RECORDINGS, at_hand

import probevo as pv
from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.estimation.motion_estimate import Status
from probevo.geometry import se3
from probevo.geometry.uncertainty import normalized_error_squared
from probevo.sequences.frame import Frame


@dataclass(frozen=True)
class Path:
    """What an odometry found."""

    T_last_first: FloatArray
    """Motion from the first to the last frame, [4, 4], m."""
    cov: FloatArray
    """Covariance of its left perturbation, [6, 6]."""
    length_m: float
    num_refused: int


def found(camera: StereoCamera, frames: list[Frame], estimator: str) -> Path:
    """Run over frames, whose stamps and IMU samples are not used."""
    odometry = pv.StereoOdometry(camera, config={"estimator": estimator})
    first_stamp_ns = min(frames[0].stamp_ns, frames[-1].stamp_ns)
    last_stamp_ns = max(frames[0].stamp_ns, frames[-1].stamp_ns)
    interval_ns = (last_stamp_ns - first_stamp_ns) // (len(frames) - 1)
    estimates = [
        odometry.step(replace(frame, index=k, stamp_ns=first_stamp_ns + k * interval_ns, imu=None))
        for k, frame in enumerate(frames)
    ]
    positions = np.array([estimate.T_world_cam[:3, 3] for estimate in estimates])
    return Path(
        T_last_first=se3.inverse(estimates[-1].T_world_cam),
        cov=estimates[-1].cov_cam_world,
        length_m=float(np.linalg.norm(np.diff(positions, axis=0), axis=1).sum()),
        num_refused=sum(estimate.status is not Status.OK for estimate in estimates[1:]),
    )


def flipped(camera: StereoCamera, frames: list[Frame], estimator: str) -> Path:
    """Run on images that are flipped: up is down, and each camera stays on its side."""
    path = found(
        replace(camera, cv_px=camera.size_px[1] - 1 - camera.cv_px),
        [
            replace(
                frame,
                left=np.ascontiguousarray(frame.left[::-1]),
                right=np.ascontiguousarray(frame.right[::-1]),
            )
            for frame in frames
        ],
        estimator,
    )
    return reflected(path, (1.0, -1.0, 1.0))


def mirrored(camera: StereoCamera, frames: list[Frame], estimator: str) -> Path:
    """Run on the recording in a mirror: the cameras have swapped sides."""
    path = found(
        replace(camera, cu_px=camera.size_px[0] - 1 - camera.cu_px),
        [
            replace(
                frame,
                left=np.ascontiguousarray(frame.right[:, ::-1]),
                right=np.ascontiguousarray(frame.left[:, ::-1]),
            )
            for frame in frames
        ],
        estimator,
    )
    path = reflected(path, (-1.0, 1.0, 1.0))
    # From the right camera to the left one, which is a baseline to its left.
    T_left_right = np.eye(4)
    T_left_right[0, 3] = camera.baseline_m
    adjoint = se3.adjoint(T_left_right)
    return replace(
        path,
        T_last_first=T_left_right @ path.T_last_first @ se3.inverse(T_left_right),
        cov=adjoint @ path.cov @ adjoint.T,
    )


def reflected(path: Path, signs: tuple[float, float, float]) -> Path:
    """Return a path with the signs of the camera's axes changed."""
    reflection = np.diag([*signs, 1.0])
    # A rotation is an axial vector: its signs are those of the axes times their product.
    of_twist = np.diag([*signs, *(np.prod(signs) * np.array(signs))])
    return replace(
        path,
        T_last_first=reflection @ path.T_last_first @ reflection,
        cov=of_twist @ path.cov @ of_twist,
    )


def backwards(camera: StereoCamera, frames: list[Frame], estimator: str) -> Path:
    """Run from the last frame to the first."""
    path = found(camera, frames[::-1], estimator)
    T_last_first = se3.inverse(path.T_last_first)
    adjoint = se3.adjoint(T_last_first)
    return replace(path, T_last_first=T_last_first, cov=adjoint @ path.cov @ adjoint.T)


VARIATIONS = {"flipped": flipped, "backwards": backwards, "in a mirror": mirrored}


def row(name: str, path: Path, as_it_is: Path) -> str:
    """Return a row of the table."""
    error = se3.log(path.T_last_first @ se3.inverse(as_it_is.T_last_first))
    squared = normalized_error_squared(
        path.T_last_first[None], as_it_is.T_last_first[None], (path.cov + as_it_is.cov)[None]
    )
    return (
        f"| {name} | {path.num_refused} | {100.0 * (path.length_m / as_it_is.length_m - 1.0):+.2f}"
        f" | {np.rad2deg(np.linalg.norm(error[3:])):.3f} | {1e3 * np.linalg.norm(error[:3]):.1f}"
        f" | {squared[0] / 6.0:.2f} |"
    )


def main() -> None:
    """Print a table for each recording."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--of", nargs="+", choices=ALL_RECORDINGS, default=list(ALL_RECORDINGS))
    parser.add_argument("--estimator", choices=["two-frame", "window"], default="window")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    for recording, sequence, frames in at_hand(given.of):
        as_it_is = found(sequence.camera, frames, given.estimator)
        print(f"\n{recording}, {as_it_is.length_m:.1f} m, {as_it_is.num_refused} steps refused\n")
        print("| | refused | length, % | rotation, ° | place, mm | distance² / 6 |")
        print("|---|---|---|---|---|---|")
        for name, run in VARIATIONS.items():
            print(row(name, run(sequence.camera, frames, given.estimator), as_it_is), flush=True)


if __name__ == "__main__":
    main()

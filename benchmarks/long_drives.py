"""Drive along streets for 350 m, and compare how far off the path is with what it claims.

    python benchmarks/long_drives.py [--out DIR]

Four rendered streets with noise, traffic, shadows, and a rectification that is wrong, by images
alone, noise ``student-t``. For the window and for two frames: drift, %, and rotation, °/m, over
pieces of 10 to 50 m; then, at several distances from the start, the error of position and
attitude, in brackets the claim (root of the summed variances), and the NEES of the pose, divided by
its 6 dimensions. With ``--out``, the rendered drives are kept there, and those that exist are not
rendered again.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

import probevo as pv
from probevo.arrays import FloatArray
from probevo.evaluation.metrics import evaluate
from probevo.geometry import se3
from probevo.geometry.uncertainty import normalized_error_squared
from probevo_sim.scene.config import Effects, RigConfig, SceneConfig
from probevo_sim.scene.writer import write_scene

DISTANCE_M = 350.0
DRIVES = {"residential": (77, 80), "city": (78, 79)}
"""Seeds of the drives through each kind of street."""
RIG = RigConfig(width_px=621, height_px=188, focal_px=360.0, baseline_m=0.54, rate_hz=10.0)
EFFECTS = Effects(noise=0.3, traffic=0.3, shadows=0.3, rectification=0.4)
AT_M = (50.0, 100.0, 200.0, 350.0)
"""Distances from the start at which the pose is compared with the truth."""


def error_and_claim(pose: FloatArray, cov: FloatArray, truth: FloatArray) -> str:
    """Return the error of a pose, its claim and its NEES as a cell.

    Args:
        pose: T_world_cam, [4, 4].
        cov: its covariance, [6, 6].
        truth: the true pose, [4, 4].
    """
    error = se3.log(pose @ se3.inverse(truth))
    place_m = np.linalg.norm(pose[:3, 3] - truth[:3, 3])
    heading_deg = np.rad2deg(np.linalg.norm(error[3:]))
    sigma_m = np.sqrt(np.trace(cov[:3, :3]))
    sigma_deg = np.rad2deg(np.sqrt(np.trace(cov[3:, 3:])))
    squared = normalized_error_squared(
        se3.inverse(pose)[None], se3.inverse(truth)[None], cov[None]
    )[0]
    return (
        f"{place_m:5.2f} ({sigma_m:4.2f}) m {heading_deg:4.2f} ({sigma_deg:4.2f})°"
        f" {squared / 6.0:4.1f}"
    )


def result(sequence: pv.sequences.Sequence, estimator: str) -> str:
    """Run an estimator over a drive, and return its figures as cells."""
    odometry = pv.StereoOdometry(sequence.camera, config={"estimator": estimator})
    path = []
    covariances = []
    for frame in sequence:
        estimate = odometry.step(replace(frame, imu=None))
        path.append(estimate.T_world_cam)
        covariances.append(estimate.cov_cam_world.copy())
    truth = sequence.truth.T_world_cam
    metrics = evaluate(np.array(path), truth)
    steps_m = np.linalg.norm(np.diff(truth[:, :3, 3], axis=0), axis=1)
    distance_m = np.append(0.0, np.cumsum(steps_m))
    cells = [f"{metrics.short_t_percent:6.3f} / {metrics.short_r_deg_per_m:.4f}"]
    for at_m in AT_M:
        k = int(np.abs(distance_m - at_m).argmin())
        since_first = se3.inverse(truth[0]) @ truth[k]
        cells.append(error_and_claim(path[k], covariances[k], since_first))
    return "; ".join(cells)


def main() -> None:
    """Print two lines for each drive."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory() as temporary:
        out = arguments.out or Path(temporary)
        for preset, seeds in DRIVES.items():
            for seed in seeds:
                config = SceneConfig(
                    preset=preset, seed=seed, distance_m=DISTANCE_M, rig=RIG, effects=EFFECTS
                )
                folder = write_scene(config, out / f"{preset}_{seed}")
                for estimator in ("window", "two-frame"):
                    cells = result(pv.open_sequence(folder), estimator)
                    print(f"{preset} {seed} {estimator:9} {cells}", flush=True)


if __name__ == "__main__":
    main()

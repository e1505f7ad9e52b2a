"""Find the readout time of rolling shutters in images, and see what its correction is worth.

    python benchmarks/rolling_shutter.py [--of rendered real]

``rendered``: drives whose images are exposed row by row, by images alone, with the window and noise
``student-t``. For each the readout time that was found, with its σ, the frame from which on it was
corrected, and without and with the correction: the error of the end, m, in brackets the claim (root
of the summed variances), the NEES of the steps, divided by its 6 dimensions, and their share that
is outside of their 99.73 % region. ``real``: what is found in real recordings and tracks,
all of cameras with a global shutter, and the largest distance from zero in σ during each.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from unittest.mock import patch

import cv2
import numpy as np
from recordings import ROOT
from scipy.stats import chi2

import probevo as pv
from probevo.camera.rolling_shutter import ReadoutTime
from probevo.geometry import se3
from probevo.geometry.uncertainty import normalized_error_squared
from probevo_sim.scene.config import Effects, RigConfig, SceneConfig
from probevo_sim.scene.recording import open_scene
from probevo_sim.scene.renderer import FULL_READOUT_S

RIG = RigConfig(width_px=621, height_px=188, focal_px=360.0, baseline_m=0.54, rate_hz=10.0)
BY_HAND = RigConfig(width_px=480, height_px=270, focal_px=330.0, baseline_m=0.12, rate_hz=30.0)
EFFECTS = Effects(noise=0.3, traffic=0.5, shadows=0.5, exposure=0.3, rectification=0.5)
DRIVES = {
    "city": SceneConfig(preset="city", seed=3, distance_m=40.0, rig=RIG),
    "residential": SceneConfig(preset="residential", seed=3, distance_m=40.0, rig=RIG),
    "road": SceneConfig(preset="road", seed=3, distance_m=120.0, rig=RIG),
    "rover": SceneConfig(preset="rover", seed=3, distance_m=8.0, rig=RIG),
    "city, effects": SceneConfig(preset="city", seed=3, distance_m=40.0, rig=RIG, effects=EFFECTS),
    "city, by hand": SceneConfig(preset="city", seed=3, distance_m=4.0, rig=BY_HAND, carried=0.5),
}
RECORDINGS = {
    "odometry 06": "kitti_odometry/sequences/06",
    "raw 0005": "kitti_raw/2011_09_26/2011_09_26_drive_0005_sync",
    "kitti_0039": "kitti_0039/sequences/39",
    "karlsruhe": "karlsruhe_2010/sequences/19",
    "MH_01": "euroc/MH_01_micro",
    "V1_01": "euroc/V1_01_micro",
}
READOUTS_MS = {"city": (0, 5, 10, 15, 30, 60)}
"""Readout times of a drive; 25 ms for all others."""
OUTSIDE = float(chi2.ppf(0.9973, 6))


def rendered() -> None:
    """Print a line for each drive and readout time."""
    for name, scene in DRIVES.items():
        for readout_ms in READOUTS_MS.get(name, (25,)):
            strength = 1e-3 * readout_ms / FULL_READOUT_S
            effects = replaced(scene.effects, strength)
            recording = open_scene(scene.model_copy(update={"effects": effects}))
            frames = [replace(frame, imu=None) for frame in recording]
            with patch.object(ReadoutTime, "noticeable_s", 0.0):
                without, _ = result(recording, frames)
            with_correction, found = result(recording, frames)
            print(
                f"{name:14} {readout_ms:2} ms: {found}; {without} → {with_correction}", flush=True
            )


def replaced(effects: Effects, rolling_shutter: float) -> Effects:
    """Return effects with another rolling shutter."""
    return effects.model_copy(update={"rolling_shutter": rolling_shutter})


def result(recording: pv.sequences.Sequence, frames: list[pv.Frame]) -> tuple[str, str]:
    """Run the window over a drive; return its errors, and what it has found of the shutter."""
    odometry = pv.StereoOdometry(recording.camera)
    truth = recording.truth.T_world_cam
    steps = []
    corrected_from = None
    for k, frame in enumerate(frames):
        steps.append(odometry.step(frame))
        if corrected_from is None and odometry.rig.image.readout_s:
            corrected_from = k + 1
    squared = normalized_error_squared(
        np.array([step.T_curr_prev for step in steps[1:]]),
        se3.inverse(truth[1:]) @ truth[:-1],
        np.array([step.cov for step in steps[1:]]),
    )
    end = se3.inverse(truth[0]) @ truth[-1]
    error_m = np.linalg.norm(steps[-1].T_world_cam[:3, 3] - end[:3, 3])
    claim_m = np.sqrt(np.trace(steps[-1].cov_cam_world[:3, :3]))
    refused = sum(step.status is not pv.Status.OK for step in steps[1:])
    errors = (
        f"{error_m:.3f} ({claim_m:.3f}) m, {squared.mean() / 6.0:.1f},"
        f" {100.0 * np.mean(squared > OUTSIDE):.0f} %, {refused} refused"
    )
    readout = odometry.rig.image.readout
    found = f"{1e3 * readout.mean_s:.1f} ± {1e3 * readout.sigma_s:.1f} ms, from {corrected_from}"
    return errors, found


def real() -> None:
    """Print a line for each recording: what is found at the end, and how far from zero at most."""
    tracks = {path.stem: path for path in sorted((ROOT / "kitti_tracks").glob("*.npz"))}
    for name, path in ({name: ROOT / path for name, path in RECORDINGS.items()} | tracks).items():
        if not path.exists():
            continue
        sequence = pv.open_sequence(path)
        odometry = pv.StereoOdometry(sequence.camera)
        largest = 0.0
        for frame in sequence:
            odometry.step(replace(frame, imu=None))
            readout = odometry.rig.image.readout
            largest = max(largest, abs(readout.mean_s) / readout.sigma_s)
        print(
            f"{name:22} {1e3 * readout.mean_s:+.2f} ± {1e3 * readout.sigma_s:.2f} ms; at most"
            f" {largest:.1f} σ; corrected: {odometry.rig.image.readout_s != 0.0}",
            flush=True,
        )


def main() -> None:
    """Print what is asked for."""
    cv2.setNumThreads(1)
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--of", nargs="+", default=["rendered", "real"])
    asked = parser.parse_args().of
    if "rendered" in asked:
        rendered()
    if "real" in asked:
        real()


if __name__ == "__main__":
    main()

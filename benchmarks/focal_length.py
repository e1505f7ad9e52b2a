"""Give the odometry a focal length that is wrong, and see what it says: docs/degradation.md.

    python benchmarks/focal_length.py [--only NAME …]

Rendered places, and real recordings without their IMU, each with the focal length as calibrated,
3 % too short and 3 % too long. Prints how far the camera turned (yaw and pitch), how many steps are
OK, and the error of the focal length that is found, with its σ.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from recordings import ROOT

import probevo as pv
from probevo.camera.rig_calibration import RigCalibration
from probevo.camera.stereo import StereoCamera
from probevo.geometry import so3
from probevo.sequences.frame import Frame
from probevo_sim.scene.config import SceneConfig
from probevo_sim.scene.recording import open_scene

RATIOS = (1.0, 0.97, 1.03)
"""Focal length that is given over the calibrated one."""
SCENES = {
    "city": (SceneConfig(preset="city", distance_m=250.0), 120),
    "another city": (SceneConfig(preset="city", seed=1, distance_m=250.0), 120),
    "residential": (SceneConfig(preset="residential", distance_m=250.0), 120),
    "rover": (SceneConfig(preset="rover", distance_m=40.0), 150),
    "road": (SceneConfig(preset="road", distance_m=400.0), 120),
}
"""Scene and number of frames."""
RECORDINGS = {
    "raw 0005": "kitti_raw/2011_09_26/2011_09_26_drive_0005_sync",
    "kitti_0039": "kitti_0039/sequences/39",
    "06": "kitti_odometry/sequences/06",
    "karlsruhe": "karlsruhe_2010/sequences/19",
    "MH_01": "euroc/MH_01_micro",
    "V1_01": "euroc/V1_01_micro",
}


def worlds(only: list[str] | None) -> Iterator[tuple[str, StereoCamera, list[Frame]]]:
    """Load one after the other: name, camera and frames."""
    for name, (config, count) in SCENES.items():
        if only is None or name in only:
            scene = open_scene(config)
            yield name, scene.camera, [frame for frame, _ in zip(scene, range(count), strict=False)]
    tracks = {path.stem: path for path in sorted((ROOT / "kitti_tracks").glob("*.npz"))}
    for name, path in ({name: ROOT / path for name, path in RECORDINGS.items()} | tracks).items():
        if (only is None or name in only) and path.exists():
            sequence = pv.open_sequence(path)
            yield name, sequence.camera, list(sequence)


def row(camera: StereoCamera, frames: list[Frame], ratio: float) -> str:
    """Run with a focal length of so many times the calibrated one, and say what is found."""
    wrong = replace(camera, fu_px=ratio * camera.fu_px, fv_px=ratio * camera.fv_px)
    odometry = pv.StereoOdometry(wrong, config={"estimator": "two-frame"})
    motions = [odometry.step(replace(frame, imu=None)) for frame in frames][1:]
    num_ok = sum(motion.status is pv.Status.OK for motion in motions)
    turns = so3.log(np.array([motion.T_curr_prev[:3, :3] for motion in motions]))[:, :2]
    turned_deg = np.rad2deg(np.linalg.norm(turns, axis=1).sum())
    error = (odometry.rig or RigCalibration.initial()).focal.error()
    said = "warned" if error.exceeds_lenses else "said" if error.is_noticeable else ""
    return (
        f"{num_ok:4d} of {len(motions):4d} OK, turned by {turned_deg:4.0f}°,"
        f" {error.percent:+6.2f} ± {100.0 * error.sigma:.2f} % {said}"
    )


def main() -> None:
    """Parse the command line, and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", nargs="+", help="names of scenes and recordings")
    only = parser.parse_args().only
    for name, camera, frames in worlds(only):
        for ratio in RATIOS:
            print(f"{name:24} f × {ratio:.2f}: {row(camera, frames, ratio)}", flush=True)


if __name__ == "__main__":
    main()

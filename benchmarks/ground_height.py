"""Measure the height of the camera above the ground, with baselines that are wrong.

    python benchmarks/ground_height.py [--only NAME …]

Rendered places, whose camera is 1.65 m high (the rover's 0.9 m), and real recordings (KITTI's is
at 1.65 m by its sensor set-up; Karlsruhe's and EuRoC's are not known). Prints the height by the
images, with its σ, for the baseline as calibrated, 5 % too short and 5 % too long, and the
processor time of a frame.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from time import thread_time

from recordings import ROOT

import probevo as pv
from probevo.camera.stereo import StereoCamera
from probevo.evaluation.ground_height import GroundHeights
from probevo.sequences.frame import Frame
from probevo_sim.scene.config import Effects, SceneConfig
from probevo_sim.scene.recording import open_scene

RATIOS = (1.0, 0.95, 1.05)
"""Baseline that is given over the calibrated one."""
SCENES = {
    "city": SceneConfig(preset="city", distance_m=90.0),
    "another city": SceneConfig(preset="city", seed=1, distance_m=90.0),
    "residential": SceneConfig(preset="residential", distance_m=90.0),
    "road": SceneConfig(preset="road", distance_m=250.0),
    "rover": SceneConfig(preset="rover", distance_m=40.0),
    "city, traffic": SceneConfig(preset="city", distance_m=90.0, effects=Effects(traffic=1.0)),
    "city, shadows": SceneConfig(preset="city", distance_m=90.0, effects=Effects(shadows=1.0)),
    "city, bare road": SceneConfig(
        preset="city", distance_m=90.0, effects=Effects(textureless=1.0)
    ),
}
RECORDINGS = {
    "raw 0005": "kitti_raw/2011_09_26/2011_09_26_drive_0005_sync",
    "kitti_0039": "kitti_0039/sequences/39",
    "06": "kitti_odometry/sequences/06",
    "karlsruhe": "karlsruhe_2010/sequences/19",
    "MH_01": "euroc/MH_01_micro",
}


def worlds(only: list[str] | None) -> Iterator[tuple[str, StereoCamera, list[Frame]]]:
    """Load one after the other: name, camera and frames."""
    for name, config in SCENES.items():
        if only is None or name in only:
            scene = open_scene(config)
            yield name, scene.camera, list(scene)
    tracks = {path.stem: path for path in sorted((ROOT / "kitti_tracks").glob("*.npz"))}
    for name, path in ({name: ROOT / path for name, path in RECORDINGS.items()} | tracks).items():
        if (only is None or name in only) and path.exists():
            sequence = pv.open_sequence(path)
            yield name, sequence.camera, list(sequence)


def row(camera: StereoCamera, frames: list[Frame], ratio: float) -> str:
    """Run with a baseline of so many times the calibrated one, and say what is found."""
    wrong = replace(camera, baseline_m=ratio * camera.baseline_m)
    odometry = pv.StereoOdometry(wrong, config={"estimator": "two-frame"})
    heights = GroundHeights(wrong)
    spent_s = 0.0
    for frame in frames:
        motion = odometry.step(replace(frame, imu=None))
        seen = odometry.tracks.subset(odometry.used)
        start_s = thread_time()
        heights.add(
            frame.stamp_ns,
            motion.T_curr_prev,
            seen.ids,
            seen.curr_px,
            is_ok=motion.status is pv.Status.OK,
        )
        spent_s += thread_time() - start_s
    found = heights.height()
    text = "not known"
    if found is not None:
        text = f"{found.height_m:.3f} ± {found.sigma_m:.3f} m, {found.num_blocks} blocks"
    return f"{text}, {1e3 * spent_s / len(frames):.2f} ms a frame"


def main() -> None:
    """Parse the command line, and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", nargs="+", help="names of scenes and recordings")
    only = parser.parse_args().only
    for name, camera, frames in worlds(only):
        for ratio in RATIOS:
            print(f"{name:24} b × {ratio:.2f}: {row(camera, frames, ratio)}", flush=True)


if __name__ == "__main__":
    main()

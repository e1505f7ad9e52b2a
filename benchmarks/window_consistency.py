"""Measure over many drives whether the errors of the window are what its covariances claim.

    python benchmarks/window_consistency.py [NOISE] [--drives 50] [--frames 51] [--seed 8000]
                                            [--imu] [--jobs 1] [--only PLACE …] [--out DIR]
                                            [--picture FILE]

Places are rendered, clean and with effects; beside them there is a world of points whose noise is
known exactly. Of the live path, every ten frames: NEES of the step, and of the motion over nine
frames, the longest that a window of ten frames holds; further that of the pose at frame 10 and at
the last frame, since the first one. It is divided by its 6 dimensions: 1 is consistent. Beside
each, the share of errors within the regions that should hold 50, 90 and 99 % of them. The interval
is that of the mean of so many independent drives, 95 %. The truth of all these drives is exact.

By images alone, unless ``--imu`` is given. NOISE is a kind or a file of a noise model,
``student-t`` by default; points have the true one. No setting was chosen on these seeds: whoever
changes the odometry because of what one of them shows takes another ``--seed``. With ``--out``,
what was found in each drive is kept there, and is not measured again. ``--picture`` draws the
share of errors within the regions of all probabilities.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from itertools import cycle
from pathlib import Path

import cv2
import joblib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.stats import chi2

import probevo as pv
from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.errors import InputError
from probevo.geometry import se3
from probevo.geometry.uncertainty import normalized_error_squared
from probevo.noise.base import StereoNoise
from probevo.noise.named import noise_model
from probevo.output.svg import CYCLE, MUTED, figure_style
from probevo.predictors import prediction_space
from probevo_sim.point_config import PointConfig, PointNoise, PointOutliers
from probevo_sim.point_world import simulate_points
from probevo_sim.scene.config import Effects, SceneConfig
from probevo_sim.scene.recording import open_scene

EFFECTS = Effects(noise=0.5, traffic=0.5, shadows=0.5, blur=0.3, rectification=0.5)
"""As in window.py."""
DISTANCE_M = {"city": 60.0, "residential": 60.0, "rover": 20.0}
"""More than ``--frames`` need."""
POINTS = "points"
PLACES = (POINTS, *DISTANCE_M, *(f"{preset}, effects" for preset in DISTANCE_M))
SIGMA_PX = 0.3
SPAN = 9
"""Frames between the oldest and the newest one of a window of ten."""
EVERY = 10
MOTIONS = ("1 frame", f"{SPAN} frames", f"{EVERY} since the first", "all since the first")
REGIONS = (0.5, 0.9, 0.99)
CLAIMED = np.linspace(0.0, 1.0, 101)
"""Probabilities of the regions of the picture."""


class TrueNoise:
    """Independent Gaussian noise, of the same size in every coordinate."""

    columns = prediction_space(()).columns

    def predict(self, predictors: FloatArray) -> StereoNoise:
        """Return the noise of N features."""
        count = len(predictors)
        scale = np.tile(SIGMA_PX**2 * np.eye(4), (count, 1, 1))
        return StereoNoise(
            scale, np.full(count, np.inf), np.zeros((count, 4)), refers_to="observation"
        )

    def check_camera(self, camera: StereoCamera) -> None:
        """Accept any camera."""


def squared_errors(
    odometry: pv.StereoOdometry, frames: list[pv.Frame], truth: FloatArray
) -> FloatArray:
    """Return squared errors in units of their covariances, [n, 2]: index in ``MOTIONS``, square.

    Args:
        odometry: has seen no frame yet.
        frames: those of the drive.
        truth: their poses T_world_cam, [N, 4, 4], m.
    """
    found = []
    for k, frame in enumerate(frames):
        estimate = odometry.step(frame)
        if k == 0 or k % EVERY:
            continue
        step = se3.inverse(truth[k]) @ truth[k - 1]
        found.append((0, _squared(estimate.T_curr_prev, step, estimate.cov)))
        T, cov = odometry.relative(k, k - SPAN)
        found.append((1, _squared(T, se3.inverse(truth[k]) @ truth[k - SPAN], cov)))
        from_first = se3.inverse(truth[k]) @ truth[0]
        T_cam_world = estimate.T_cam_world
        squared = _squared(T_cam_world, from_first, estimate.cov_cam_world)
        if k == EVERY:
            found.append((2, squared))
        if k == len(frames) - 1:
            found.append((3, squared))
    return np.array(found)


def _squared(T: FloatArray, truth: FloatArray, cov: FloatArray) -> float:
    return float(normalized_error_squared(T[None], truth[None], cov[None])[0])


def of_points(seed: int, num_frames: int) -> FloatArray:
    """Return the squared errors of a drive through the world of points."""
    config = PointConfig(
        seed=seed,
        noise=PointNoise(law="constant", sigma_low_px=SIGMA_PX, sigma_high_px=SIGMA_PX),
        outliers=PointOutliers(fraction=0.0),
    )
    duration_s = (num_frames - 0.5) / config.rate_hz
    world = simulate_points(config, duration_s, np.random.default_rng(seed))
    odometry = pv.StereoOdometry(
        world.camera,
        TrueNoise(),
        config={"self_calibration": False, "window": {"correlation": 0.0}},
    )
    return squared_errors(odometry, list(world.frames())[:num_frames], world.T_world_cam)


def of_scene(place: str, seed: int, num_frames: int, noise: str, *, imu: bool) -> FloatArray:
    """Return the squared errors of a drive through a rendered place."""
    preset, _, effects = place.partition(", ")
    config = SceneConfig(preset=preset, seed=seed, distance_m=DISTANCE_M[preset])
    if effects:
        config = config.model_copy(update={"effects": EFFECTS})
    recording = open_scene(config)
    odometry = pv.StereoOdometry(recording.camera, noise, recording.imu if imu else None)
    frames = []
    for frame in recording:
        frames.append(frame if imu else replace(frame, imu=None))
        if len(frames) == num_frames:
            break
    return squared_errors(odometry, frames, recording.truth.T_world_cam)


def drive(place: str, seed: int, given: argparse.Namespace) -> FloatArray:
    """Return the squared errors of a drive; of an earlier call where it has left them."""
    kept = None
    if given.out is not None:
        # The name says what the numbers depend on.
        noise = "" if place == POINTS else f" {Path(given.noise).stem}"
        imu = " with IMU" if given.imu and place != POINTS else ""
        kept = given.out / f"{place}{noise}{imu} {given.frames} frames {seed}.npy"
        if kept.exists():
            return np.load(kept)
    cv2.setNumThreads(1)
    if place == POINTS:
        found = of_points(seed, given.frames)
    else:
        found = of_scene(place, seed, given.frames, given.noise, imu=given.imu)
    if kept is not None:
        np.save(kept, found)
    return found


def rows(place: str, drives: list[FloatArray]) -> list[str]:
    """Return the lines of the table of a place."""
    lines = []
    for motion, name in enumerate(MOTIONS):
        by_drive = [found[found[:, 0] == motion, 1] for found in drives]
        squared = np.concatenate(by_drive)
        mean = np.mean([values.mean() for values in by_drive]) / 6.0
        median = np.median(squared) / chi2.median(6)
        inside = [f"{100.0 * np.mean(squared < chi2.ppf(share, 6)):.0f}" for share in REGIONS]
        low, high = np.array(chi2.ppf([0.025, 0.975], 6 * len(drives))) / (6 * len(drives))
        lines.append(
            f"| {place} | {name} | {mean:.2f} | {median:.2f} | {low:.2f} – {high:.2f} | "
            f"{', '.join(inside)} |"
        )
    return lines


def draw(found: dict[str, list[FloatArray]], path: Path) -> None:
    """Draw how many errors are inside of the regions that should hold so many, for each motion.

    Args:
        found: the squared errors of each drive, by place.
        path: of the picture.
    """
    with figure_style():
        figure = Figure(figsize=(9.6, 3.0), facecolor="white", layout="constrained")
        panels = figure.subplots(1, len(MOTIONS), sharey=True)
        for motion, (axes, name) in enumerate(zip(panels, MOTIONS, strict=True)):
            _draw_motion(axes, motion, found)
            axes.set_title(name)
        panels[0].set_ylabel("errors inside, %")
        lines, places = panels[0].get_legend_handles_labels()
        figure.legend(lines, places, loc="outside lower center", ncols=len(places))
        figure.savefig(path, dpi=120)


def _draw_motion(axes: Axes, motion: int, found: dict[str, list[FloatArray]]) -> None:
    """Draw a line for each place; on the diagonal, errors are what is claimed."""
    percent = 100.0 * CLAIMED
    axes.plot(percent, percent, color=MUTED, lw=0.8, ls="--")
    bounds = chi2.ppf(CLAIMED, 6)
    for (place, drives), color in zip(found.items(), cycle(CYCLE)):
        errors = np.concatenate(drives)
        squared = np.sort(errors[errors[:, 0] == motion, 1])
        inside = np.searchsorted(squared, bounds) / len(squared)
        style = ":" if place.endswith("effects") else "-"
        axes.plot(percent, 100.0 * inside, color=color, ls=style, label=place)
    axes.set_xlabel("claimed, %")
    axes.set_aspect("equal")


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("noise", nargs="?", default="student-t")
    parser.add_argument("--drives", type=int, default=50)
    parser.add_argument("--frames", type=int, default=51)
    parser.add_argument("--seed", type=int, default=8000)
    parser.add_argument("--imu", action="store_true")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--only", nargs="+", choices=PLACES, default=PLACES)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--picture", type=Path)
    given = parser.parse_args()
    if given.frames <= EVERY or given.frames % EVERY != 1:
        parser.error(f"--frames {given.frames}: give a multiple of {EVERY}, and one more.")
    if given.drives < 1:
        parser.error(f"--drives {given.drives}: give at least 1.")
    try:
        noise_model(given.noise)
    except InputError as error:
        parser.error(str(error))
    if given.out is not None:
        given.out.mkdir(parents=True, exist_ok=True)
    print(f"| place | motion | mean | median | interval | inside of {REGIONS} |")
    print("|---|---|---|---|---|---|")
    found = {}
    for place in given.only:
        seeds = range(given.seed, given.seed + given.drives)
        found[place] = joblib.Parallel(n_jobs=given.jobs)(
            joblib.delayed(drive)(place, seed, given) for seed in seeds
        )
        print("\n".join(rows(place, found[place])), flush=True)
    if given.picture is not None:
        draw(found, given.picture)


if __name__ == "__main__":
    main()

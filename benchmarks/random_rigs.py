"""Run the odometry on rigs and scenes drawn at random.

    python benchmarks/random_rigs.py [--count 20] [--seed 7000] [--carried] [--readout-ms 0]
        [--out DIR]

Each recording is a rendered drive of 15 to 80 m. Its image size, field of view, baseline (6 to
80 cm), frame rate (4 to 30 Hz), sun and effects are drawn independently of each other. With
``--carried``, a person or a drone carries the rig through the place, 120 frames long, and swings it
with 20 to 100 °/s; then baselines are 5 to 20 cm and rates 10 to 30 Hz. With ``--readout-ms``, all
rigs have a rolling shutter. Prints for two frames and for the window, both without IMU, and for the
window with it: steps that were refused, drift and rotation over segments of 10 to 50 m, end error,
and the mean NEES of a step, divided by its 6 dimensions. With ``--out``, the rendered drives are
kept there, and those that exist are not rendered again. Whoever changes the odometry because of
what a seed shows takes another seed for the table of the docs.
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
from probevo.estimation.motion_estimate import Status
from probevo.evaluation.metrics import evaluate
from probevo.geometry import se3
from probevo.geometry.uncertainty import normalized_error_squared
from probevo_sim.scene.config import Daylight, Effects, RigConfig, SceneConfig
from probevo_sim.scene.renderer import FULL_READOUT_S
from probevo_sim.scene.writer import write_scene

PRESETS = ("city", "residential", "road", "rover")
DISTANCE_M = {"city": 40.0, "residential": 35.0, "road": 80.0, "rover": 15.0}
SIZES_PX = (
    (640, 480),
    (752, 480),
    (640, 360),
    (320, 240),
    (848, 480),
    (480, 270),
    (621, 188),
    (1024, 320),
)
RATES_HZ = (4, 5, 8, 10, 15, 20, 30)
ROVER_RATES_HZ = (5, 10, 20)
RUNS = {"two-frame": "two-frame", "window": "window", "window, IMU": "window"}
"""Estimator of each line."""
CARRIED_RATES_HZ = (10, 15, 20, 30)
CARRIED_FRAMES = 120
CARRIED_SPEED_M_S = 1.3
MAX_FAST_FRAMES = 80.0
"""Frames at more than 20 Hz are so many that the drive is shortened."""


def drawn(rng: np.random.Generator, number: int, scene_seed: int) -> SceneConfig:
    """Draw the rig and the scene of a number."""

    def strength(probability: float) -> float:
        """Return the strength of an effect that occurs with a probability."""
        return float(rng.uniform(0.1, 0.8)) if rng.random() < probability else 0.0

    width_px, height_px = SIZES_PX[rng.integers(len(SIZES_PX))]
    field_rad = np.deg2rad(rng.uniform(50.0, 105.0))
    preset = PRESETS[number % len(PRESETS)]
    rate_hz = float(rng.choice(RATES_HZ))
    if preset == "rover":
        rate_hz = float(rng.choice(ROVER_RATES_HZ))
    baseline_m = float(np.exp(rng.uniform(np.log(0.06), np.log(0.8))))
    effects = Effects(
        blur=strength(0.4),
        traffic=strength(0.4),
        shadows=strength(0.4),
        textureless=strength(0.2),
        foliage=strength(0.3),
        exposure=strength(0.3),
        noise=strength(0.6),
        rectification=strength(0.4),
    )
    distance_m = DISTANCE_M[preset]
    if rate_hz > 20.0:
        distance_m = min(distance_m, distance_m * MAX_FAST_FRAMES / (4.0 * rate_hz))
    return SceneConfig(
        preset=preset,
        seed=scene_seed,
        distance_m=distance_m,
        rig=RigConfig(
            width_px=width_px,
            height_px=height_px,
            focal_px=0.5 * width_px / np.tan(0.5 * field_rad),
            baseline_m=baseline_m,
            rate_hz=rate_hz,
        ),
        effects=effects,
        daylight=Daylight(
            azimuth_deg=float(rng.uniform(-180.0, 180.0)),
            elevation_deg=float(rng.uniform(15.0, 80.0)),
            glow=strength(0.5),
        ),
    )


def carried(config: SceneConfig, rng: np.random.Generator) -> SceneConfig:
    """Draw how a rig of a drawn scene is carried instead of driven."""
    rate_hz = float(rng.choice(CARRIED_RATES_HZ))
    baseline_m = float(np.exp(rng.uniform(np.log(0.05), np.log(0.2))))
    # A shutter that is open for up to 15 ms: longer ones show nothing but streaks.
    effects = config.effects.model_copy(
        update={"blur": float(rng.uniform(0.0, 0.3)) if config.effects.blur else 0.0}
    )
    return config.model_copy(
        update={
            "carried": float(rng.uniform(0.2, 1.0)),
            "distance_m": CARRIED_SPEED_M_S * CARRIED_FRAMES / rate_hz,
            "rig": config.rig.model_copy(update={"rate_hz": rate_hz, "baseline_m": baseline_m}),
            "effects": effects,
        }
    )


def result(sequence: pv.sequences.Sequence, estimator: str, *, with_imu: bool) -> str:
    """Run an estimator over a recording, and return its figures as cells."""
    truth = sequence.truth.T_world_cam
    imu = sequence.imu if with_imu else None
    odometry = pv.StereoOdometry(sequence.camera, imu=imu, config={"estimator": estimator})
    path: list[FloatArray] = []
    squared = []
    refused = 0
    for k, frame in enumerate(sequence):
        estimate = odometry.step(frame if with_imu else replace(frame, imu=None))
        path.append(estimate.T_world_cam)
        if k == 0:
            continue
        refused += estimate.status not in (Status.OK, Status.RECOVERED)
        step = se3.inverse(truth[k]) @ truth[k - 1]
        one = normalized_error_squared(estimate.T_curr_prev[None], step[None], estimate.cov[None])
        squared.append(float(one[0]) / 6.0)
    metrics = evaluate(np.array(path), truth)
    drift = metrics.short_t_percent
    rotation = metrics.short_r_deg_per_m
    return (
        f"{refused:3} of {len(squared):3}"
        f"{'–' if drift is None else format(drift, '.3f'):>9}"
        f"{'–' if rotation is None else format(rotation, '.4f'):>9}"
        f"{metrics.final_error_m:9.4f}{np.mean(squared):9.2f}"
    )


def described(config: SceneConfig) -> str:
    """Return a rig and its effects in one line."""
    rig = config.rig
    field_deg = 2.0 * np.rad2deg(np.arctan(0.5 * rig.width_px / rig.focal_px))
    effects = [
        f"{name} {value:.1f}" for name, value in config.effects.model_dump().items() if value
    ]
    if config.carried:
        effects.insert(0, f"carried {config.carried:.1f}")
    return (
        f"{config.preset}, {rig.width_px}×{rig.height_px}, {field_deg:.0f}°,"
        f" {100.0 * rig.baseline_m:.0f} cm, {rig.rate_hz:.0f} Hz: {', '.join(effects)}"
    )


def main() -> None:
    """Print two lines for each recording."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--seed", type=int, default=7000)
    parser.add_argument("--carried", action="store_true")
    parser.add_argument("--readout-ms", type=float, default=0.0)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    rng = np.random.default_rng(arguments.seed)
    print(f"{'':12}   refused     t, %   r, °/m   end, m   NEES 1")
    with tempfile.TemporaryDirectory() as temporary:
        out = arguments.out or Path(temporary)
        for number in range(arguments.count):
            config = drawn(rng, number, scene_seed=arguments.seed + number)
            if arguments.carried:
                config = carried(config, rng)
            rolling = {"rolling_shutter": 1e-3 * arguments.readout_ms / FULL_READOUT_S}
            effects = config.effects.model_copy(update=rolling)
            config = config.model_copy(update={"effects": effects})
            folder = write_scene(config, out / f"{number:02}_{config.preset}")
            print(f"{number:02} {described(config)}")
            for label, estimator in RUNS.items():
                cells = result(pv.open_sequence(folder), estimator, with_imu=label.endswith("IMU"))
                print(f"{label:12} {cells}", flush=True)


if __name__ == "__main__":
    main()

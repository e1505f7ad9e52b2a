"""The sun from images: streets under many suns, learned from, tested on, and fused.

    python benchmarks/sun_streets.py OUT [--scenes 800] [--methods hydra-sigma dropout ensemble]

Renders short drives at a quarter of KITTI's resolution, twice a second, each under another sun;
trains ``--kind sun`` on most of them, calibrates on 60, and tests on the last 50. Then puts streets
of the test one after the other to about a kilometre, sixty times, with an odometry whose heading
drifts by 7°, and fuses what the network says of their images. Last, drives of KITTI, where they
are. About 40 minutes on two cores; what is rendered and trained is kept in OUT. With several
methods, it trains a network by each, compares them on the streets of the test, and ends there.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, NamedTuple, get_args

import joblib
import numpy as np
from recordings import ROOT
from scipy.stats import spearmanr

from probevo.arrays import FloatArray
from probevo.config import NorthConfig
from probevo.config.networks import MethodName, NetworkSettings
from probevo.estimation.motion_estimate import MotionEstimate, Status
from probevo.estimation.sensor_fusion import SensorFusion
from probevo.geometry import se3, so3
from probevo.measurements import sun_in_enu
from probevo.measurements.direction import Direction
from probevo.measurements.sensor import Reading
from probevo.measurements.variables import pose_of
from probevo.nets.covariance_scale import coverage, negative_log_likelihoods
from probevo.nets.domain import FARTHEST
from probevo.nets.sun_network import SunNetwork
from probevo.nets.sun_training import errors_of, train_sun
from probevo.nets.sun_views import SunViews, read_views, sun_field
from probevo.sequences import open_sequence
from probevo.sequences.base import Sequence
from probevo_sim.scene.config import Daylight, Effects, PresetName, RigConfig, SceneConfig
from probevo_sim.scene.writer import write_scene

STREETS: tuple[PresetName, ...] = ("city", "residential", "city", "residential", "road")
NUM_LEFT_OUT = 60
NUM_TESTED = 50
STREETS_OF_A_KILOMETRE = 17
STEP_M = 3.5
DRIFT_DEG = 7.0
"""Of the heading, after a kilometre."""
ORDERS = 60
"""Of the streets of a kilometre: by twelve, a ratio of errors is known to a third only."""
BOOTSTRAPS = 200
RIG = RigConfig(width_px=311, height_px=94, focal_px=180.0, rate_hz=2.0)
NETS = NetworkSettings(learning_rate=1e-3, patience=8, left_out=NUM_LEFT_OUT)


def scene(number: int) -> SceneConfig:
    """Return a short drive under a random sun."""
    rng = np.random.default_rng([77, number])
    preset = STREETS[number % len(STREETS)]
    effects = Effects(
        shadows=rng.uniform(0.5, 1.0),
        traffic=rng.uniform(0.0, 0.4),
        noise=rng.uniform(0.0, 0.3),
        exposure=rng.uniform(0.0, 0.4),
    )
    daylight = Daylight(
        azimuth_deg=rng.uniform(-180.0, 180.0),
        elevation_deg=rng.uniform(15.0, 65.0),
        glow=rng.uniform(0.3, 1.0),
    )
    return SceneConfig(
        preset=preset,
        seed=1000 + number,
        distance_m=140.0 if preset == "road" else 70.0,
        rig=RIG,
        effects=effects,
        daylight=daylight,
    )


def show_errors(name: str, errors: FloatArray, covariances: FloatArray) -> None:
    """Print the distribution of errors, [N, 2], rad, against what was claimed."""
    angles_deg = np.degrees(np.linalg.norm(errors, axis=1))
    low, median, high = np.quantile(angles_deg, [0.1, 0.5, 0.9])
    print(
        f"{name}: {len(errors)} images, median {median:.1f}° ({low:.0f} to {high:.0f}°), 50 % and"
        f" 90 % regions hold {coverage(errors, covariances, 0.5):.0%} and"
        f" {coverage(errors, covariances, 0.9):.0%}",
        flush=True,
    )


class Street(NamedTuple):
    """The errors on one street, [N, 2], rad, and what is claimed without and with calibration."""

    errors: FloatArray
    raw: FloatArray
    """[N, 2, 2]"""
    calibrated: FloatArray
    """[N, 2, 2]"""


def streets_of(network: SunNetwork, views: list[SunViews]) -> list[Street]:
    """Return errors and claims of a network on each street."""
    scale = float(network.facts["scale"])
    claimed = [errors_of(network, each) for each in views]
    return [Street(each.errors, each.covariances / scale, each.covariances) for each in claimed]


def statistics(streets: list[Street]) -> FloatArray:
    """Return median error, and coverage of 90 % regions and NLL without and with calibration.

    The last one is the rank correlation of claimed σ and error. Angles are in degrees.
    """
    errors, raw, calibrated = (np.concatenate(parts) for parts in zip(*streets, strict=True))
    angles = np.linalg.norm(errors, axis=1)
    sigma = np.sqrt(np.trace(calibrated, axis1=1, axis2=2))
    return np.array(
        [
            np.degrees(np.median(angles)),
            100.0 * coverage(errors, raw, 0.9),
            np.mean(negative_log_likelihoods(errors, raw)),
            100.0 * coverage(errors, calibrated, 0.9),
            np.mean(negative_log_likelihoods(errors, calibrated)),
            spearmanr(sigma, angles).statistic,
        ]
    )


def show_methods(networks: dict[str, SunNetwork], views: list[SunViews]) -> None:
    """Print a row for each method, with standard deviations by a bootstrap over the streets."""
    rng = np.random.default_rng(0)
    drawn = rng.integers(len(views), size=(BOOTSTRAPS, len(views)))
    names = ("median °", "raw 90 %", "raw NLL", "90 %", "NLL", "rank correlation")
    print("mean ± standard deviation over streets:", ", ".join(names))
    for name, network in networks.items():
        streets = streets_of(network, views)
        found = statistics(streets)
        again = [statistics([streets[k] for k in row]) for row in drawn]
        values = zip(found, np.std(again, axis=0), strict=True)
        text = ", ".join(f"{value:.2f} ± {sigma:.2f}" for value, sigma in values)
        facts = network.facts
        print(f"{name}: {text}; × {facts['scale']:.2f} and × {facts['correlation']:.2f}")


def trained(method: MethodName, sequences: list[Sequence], out: Path) -> SunNetwork:
    """Return the network of a method, which is trained unless its file is there."""
    model = out / ("sun.safetensors" if method == "hydra-sigma" else f"sun-{method}.safetensors")
    if not model.exists():
        settings = NETS.model_copy(update={"method": method})
        print("\n".join(train_sun(sequences, settings, model)), flush=True)
    return SunNetwork.load(model)


def fused(network: SunNetwork, views: list[SunViews], order: int, *, has_sun: bool) -> FloatArray:
    """Return heading errors and claimed σ of a kilometre, [N, 2], degrees.

    The camera looks ahead all along, so that the sun's direction in it is that in the world.
    """
    chosen = np.random.default_rng(order).permutation(len(views))[:STREETS_OF_A_KILOMETRE]
    rng = np.random.default_rng([order, 1])
    drift_rad = np.radians(DRIFT_DEG) / np.sqrt(1000.0 / STEP_M)
    sigma = np.array([0.05, 0.05, 0.1, np.radians(0.05), drift_rad, np.radians(0.05)])
    T_true = se3.exp(np.array([0.0, 0.0, -STEP_M, 0.0, 0.0, 0.0]))
    fusion = SensorFusion.at_origin(["sun"])
    correlated = float(network.facts["correlation"])
    rows = []
    for street in chosen:
        found = network.estimate(views[street].fields)
        for k, known in enumerate(views[street].directions):
            pose = pose_of(len(rows) + 1)
            T_curr_prev = se3.exp(sigma * rng.normal(size=6)) @ T_true
            motion = MotionEstimate(T_curr_prev, np.diag(sigma**2), Status.OK, num_tracks=100)
            fusion = fusion.after(motion)
            covariance = correlated * found.covariance[k]
            measured = Direction(pose, found.directions[k], known, covariance)
            reading = Reading("sun", (measured,) if has_sun else ())
            fusion, _ = fusion.updated([reading], pose, NorthConfig(), motion_innovations={})
            C_world_cam = fusion.pose.T_world_cam[:3, :3]
            heading = np.arctan2(C_world_cam[0, 2], C_world_cam[2, 2])
            rows.append([heading, np.sqrt(fusion.pose.cov[4, 4])])
    return np.degrees(np.array(rows))


def show_fused(network: SunNetwork, views: list[SunViews]) -> None:
    """Print the heading errors of a kilometre without and with the sun."""
    for has_sun in (False, True):
        rows = np.concatenate(
            [fused(network, views, order, has_sun=has_sun) for order in range(ORDERS)]
        )
        found, claimed = np.sqrt(np.mean(rows**2, axis=0))
        label = "with" if has_sun else "without"
        print(f"a kilometre {label} the sun: heading {found:.2f}° RMS, claimed {claimed:.2f}°")


def show_out_of_domain(network: SunNetwork, folder: Path) -> None:
    """Print by how much covariances are widened at night, in fog, and where nothing is seen."""
    sequence = open_sequence(folder)
    images = [frame.left for frame in sequence]
    rng = np.random.default_rng(0)
    seen: dict[str, list[Any]] = {
        "night (5 % of the light, noise of 3 grey levels)": [
            np.clip(0.05 * image + rng.normal(0.0, 3.0, image.shape), 0, 255) for image in images
        ],
        "fog (10 % of the contrast)": [140.0 + 0.1 * image for image in images],
        "an even grey": [np.full(image.shape, 90.0) for image in images],
    }
    for name, spoiled in seen.items():
        fields = [sun_field(image.astype(np.uint8), sequence.camera) for image in spoiled]
        widening = network.estimate(np.array(fields)).widening
        silent = np.mean(widening > FARTHEST)
        print(f"{name}: covariances × {np.median(widening):.1f}, {silent:.0%} silent")


def show_kitti(network: SunNetwork) -> None:
    """Print errors against the ephemeris on raw 0005, and on others how far estimates scatter.

    Only raw 0005 has an absolute heading. Its stamps are taken once as UTC, once as local time.
    """
    if not ROOT.is_dir():
        return
    drive = ROOT / "kitti_raw/2011_09_26/2011_09_26_drive_0005_sync"
    sequence = open_sequence(drive)
    found = network.estimate(np.array([sun_field(f.left, sequence.camera) for f in sequence]))
    files = sorted((drive / "oxts/data").glob("*.txt"))
    oxts = np.array([[float(word) for word in file.read_text().split()] for file in files])
    C_cam_imu = sequence.imu.T_cam_imu[:3, :3]
    for hours, label in ((0, "UTC"), (2, "local time")):
        stamps_ns = sequence.stamps_ns - hours * 3_600_000_000_000
        directions = []
        for stamp_ns, (latitude, longitude, _, roll, pitch, yaw) in zip(
            stamps_ns.tolist(), oxts[:, :6], strict=True
        ):
            turns = [[0.0, 0.0, yaw], [0.0, pitch, 0.0], [roll, 0.0, 0.0]]
            about_up, about_left, about_forward = so3.exp(np.array(turns))
            C_enu_imu = about_up @ about_left @ about_forward
            directions.append(C_cam_imu @ C_enu_imu.T @ sun_in_enu(stamp_ns, latitude, longitude))
        views = SunViews(np.zeros(0), np.array(directions))
        pose = pose_of(0)
        errors = [
            Direction(pose, seen, known, np.eye(2)).residual({pose: np.eye(4)})
            for seen, known in zip(found.directions, views.directions, strict=True)
        ]
        show_errors(f"raw 0005, its stamps as {label}", np.array(errors), found.covariance)
    for name, path in (
        ("odometry 06", ROOT / "kitti_odometry/sequences/06"),
        ("raw 0039", ROOT / "kitti_0039/sequences/39"),
    ):
        sequence = open_sequence(path)
        found = network.estimate(np.array([sun_field(f.left, sequence.camera) for f in sequence]))
        C_world_cam = sequence.truth.T_world_cam[:, :3, :3]
        in_world = np.einsum("nij,nj->ni", C_world_cam, found.directions)
        mean = in_world.mean(axis=0) / np.linalg.norm(in_world.mean(axis=0))
        spread_deg = np.degrees(np.median(np.arccos(np.clip(in_world @ mean, -1.0, 1.0))))
        elevation_deg = np.degrees(np.quantile(np.arcsin(-in_world[:, 1]), [0.1, 0.5, 0.9]))
        print(f"{name}: elevation {np.round(elevation_deg)}°, {spread_deg:.0f}° from their mean")


def main() -> None:
    """Render, train, test and fuse."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--scenes", type=int, default=800)
    methods = get_args(MethodName)
    parser.add_argument("--methods", nargs="+", choices=methods, default=[methods[0]])
    arguments = parser.parse_args()
    # A street has few frames to share among threads: each process renders its own.
    folders = joblib.Parallel(n_jobs=-1)(
        joblib.delayed(write_scene)(scene(number), arguments.out / f"{number:04d}", jobs=1)
        for number in range(arguments.scenes)
    )
    sequences = [open_sequence(folder) for folder in folders]
    networks = {
        method: trained(method, sequences[:-NUM_TESTED], arguments.out)
        for method in arguments.methods
    }
    views = [read_views(sequence, len(sequence)) for sequence in sequences[-NUM_TESTED:]]
    if len(networks) > 1:
        show_methods(networks, views)
        return
    (network,) = networks.values()
    claimed = [errors_of(network, each) for each in views]
    errors = np.concatenate([each.errors for each in claimed])
    covariances = np.concatenate([each.covariances for each in claimed])
    show_errors("streets not seen before", errors, covariances)
    show_fused(network, views)
    show_out_of_domain(network, folders[-1])
    show_kitti(network)


if __name__ == "__main__":
    main()

"""Thesis section 5.7: what a simulated sun sensor of known noise takes off the drift.

Each pair of frames sees points of its own, so that the errors of the steps are independent, and the
Cramér–Rao bound of the path with the sun has a closed form. The sensor corrects the pose alone, so
that one run of the odometry serves all sensors: its motions are fused with each of them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

import probevo as pv
from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.config import NorthConfig
from probevo.estimation.motion_estimate import MotionEstimate
from probevo.estimation.sensor_fusion import SensorFusion
from probevo.geometry import se3, so3
from probevo.measurements.direction import tangent_axes
from probevo.measurements.sensor import read_sensor
from probevo.measurements.variables import pose_of
from probevo.sequences.frame import Frame, StereoFeatures
from probevo_paper.sun_config import SunConfig
from probevo_sim.sun_sensor import MIN_SIGMA_RAD, Fault, SunSensor

CAMERA = StereoCamera.centered(400.0, 0.5, (640, 480))
DEPTHS_M = (4.0, 20.0)
WITHOUT_OUTLIERS = {
    "estimator": "two-frame",
    "self_calibration": False,
    "ransac": {"threshold_px": 50.0},
}
"""Settings of the odometry. There are no outliers, and a threshold would cut the tails of the
noise."""
FRAME_NS = 100_000_000
TURN_RAD = 1.0
"""The heading swings by so much to either side,"""
TURN_LENGTH_M = 150.0
"""once in so many metres."""
SUN_NOISES_DEG = (0.0, 10.0, 20.0, 30.0)
SUN_EVERY = (1, 5, 10)
FAULTS: tuple[Fault, ...] = ("offset", "inverted", "stuck")
FAULTY_SIGMA_DEG = 10.0
FAULTY_EVERY = 10


@dataclass(frozen=True)
class SunDrive:
    """A drive, and what the odometry without the sun has made of it."""

    frames: tuple[Frame, ...]
    T_world_cam: FloatArray
    """True poses, [K, 4, 4], m."""
    motions: tuple[MotionEstimate, ...]
    """Estimated, of each frame."""
    sun: FloatArray
    """Its direction in the world, [3]."""


@dataclass(frozen=True)
class SunRow:
    """Errors over some drives, with one sensor or none."""

    name: str
    heading_rms_deg: float
    """RMS over all frames."""
    heading_end_deg: float
    """RMS at the ends of the drives."""
    heading_bound_deg: float | None
    """The Cramér–Rao bound, RMS over all frames; None where it does not hold."""
    claimed_deg: float
    """The standard deviation that the estimate claims, RMS over all frames."""
    rot_armse_deg: float
    """ARMSE of the attitude: mean over frames of the RMS over its axes (PROBE, Table I)."""
    trans_armse_m: float
    """The same of the position."""
    excluded_after: float | None = None
    """Number of sightings after which the sensor was excluded, mean over the drives in which it
    was; None if it never was."""
    excluded_drives: int = 0
    """Number of drives in which it was excluded."""
    drives: int = 1
    """Number of all drives."""


def true_path(settings: SunConfig) -> FloatArray:
    """Return T_world_cam of a camera that swings left and right as it drives, [K, 4, 4], m."""
    way_m = settings.step_m * np.arange(settings.frames)
    heading = TURN_RAD * np.sin(2.0 * math.pi * way_m / TURN_LENGTH_M)
    turns = np.diff(heading, prepend=heading[0])
    steps = np.zeros((settings.frames, 6))
    steps[1:, 2] = -settings.step_m
    steps[:, 4] = -turns
    return se3.chain_motions(se3.exp(steps[1:]))


def simulated_frames(
    settings: SunConfig, T_world_cam: FloatArray, rng: np.random.Generator
) -> Iterator[Frame]:
    """Yield frames; each two successive ones see points of their own, with white noise."""
    num_points = settings.points
    ids = np.arange(num_points)
    seen_m = np.zeros((0, 3))
    for index, T in enumerate(T_world_cam):
        new_px = _random_pixels(num_points, rng)
        seen_px = CAMERA.project(se3.transform(se3.inverse(T), seen_m))
        pixels = np.vstack([seen_px, new_px])
        pixels += settings.sigma_px * rng.normal(size=pixels.shape)
        old_ids = ids + (index - 1) * num_points
        new_ids = ids + index * num_points
        features = StereoFeatures(np.concatenate([old_ids[: len(seen_px)], new_ids]), pixels)
        yield Frame(index, index * FRAME_NS, features=features)
        seen_m = se3.transform(T, CAMERA.triangulate(new_px))


def _random_pixels(count: int, rng: np.random.Generator) -> FloatArray:
    """Return noise-free observations, [N, 4], px, uniform in the image and in inverse depth."""
    nearest_m, farthest_m = DEPTHS_M
    disparity = CAMERA.fu_px * CAMERA.baseline_m * rng.uniform(1 / farthest_m, 1 / nearest_m, count)
    u = rng.uniform(0.0, 2.0 * CAMERA.cu_px, count)
    v = rng.uniform(0.0, 2.0 * CAMERA.cv_px, count)
    return np.column_stack([u, v, u - disparity, v])


def simulate_drive(settings: SunConfig, index: int) -> SunDrive:
    """Simulate a drive, and run the odometry over it without a sun.

    Args:
        settings: of the experiment.
        index: of the drive.
    """
    rng = np.random.default_rng([settings.seed, index])
    T_world_cam = true_path(settings)
    frames = tuple(simulated_frames(settings, T_world_cam, rng))
    noise = pv.noise.Fixed(settings.sigma_px**2 * np.eye(4))
    odometry = pv.StereoOdometry(CAMERA, noise, config=WITHOUT_OUTLIERS)
    elevation = math.radians(settings.elevation_deg)
    azimuth = rng.uniform(-math.pi, math.pi)
    level = math.cos(elevation)
    return SunDrive(
        frames=frames,
        T_world_cam=T_world_cam,
        motions=tuple(odometry.step(frame) for frame in frames),
        sun=np.array([level * math.sin(azimuth), -math.sin(elevation), level * math.cos(azimuth)]),
    )


@dataclass(frozen=True)
class SunPath:
    """The poses of a drive as they are fused with a sensor."""

    T_world_cam: FloatArray
    """Poses of the camera, [K, 4, 4], m."""
    cov: FloatArray
    """Covariance of the left perturbation of T_cam_world, [K, 6, 6], m and rad."""
    excluded_at: int | None
    """Frame at which the sensor was excluded; None if it was not."""


def fused_path(drive: SunDrive, sensor: SunSensor | None) -> SunPath:
    """Fuse the motions of a drive with a sensor, as ``StereoOdometry`` does."""
    fusion = SensorFusion.at_origin([] if sensor is None else [sensor.name])
    poses = [fusion.pose]
    excluded_at = None
    for prev_frame, frame, motion in zip(
        drive.frames[:-1], drive.frames[1:], drive.motions[1:], strict=True
    ):
        fusion = fusion.after(motion)
        if sensor is not None and excluded_at is None:
            reading = read_sensor(sensor.name, sensor, prev_frame, frame)
            fusion, _ = fusion.updated(
                [reading], pose_of(frame.index), NorthConfig(), motion_innovations={}
            )
            excluded_at = frame.index if fusion.is_excluded(sensor.name) else None
        poses.append(fusion.pose)
    return SunPath(
        T_world_cam=np.array([pose.T_world_cam for pose in poses]),
        cov=np.array([pose.cov for pose in poses]),
        excluded_at=excluded_at,
    )


def attitude_bound(drive: SunDrive, sigma_rad: float, every: int) -> FloatArray:
    """Return the Cramér–Rao bound of the poses with a sun sensor, [K, 6, 6], m and rad.

    The information of the past comes from the steps, whose errors are independent, and from the
    sightings so far, both at the true poses.
    """
    cov = np.zeros((6, 6))
    bounds = [cov]
    for index, motion in enumerate(drive.motions[1:], start=1):
        T_cam_world = se3.inverse(drive.T_world_cam[index])
        adjoint = se3.adjoint(T_cam_world @ drive.T_world_cam[index - 1])
        cov = adjoint @ cov @ adjoint.T + motion.cov
        if index % every == 0:
            sun_camera = T_cam_world[:3, :3] @ drive.sun
            H = np.zeros((2, 6))
            H[:, 3:] = tangent_axes(sun_camera).T @ so3.wedge(sun_camera)
            gain = cov @ H.T @ np.linalg.inv(H @ cov @ H.T + sigma_rad**2 * np.eye(2))
            cov = cov - gain @ H @ cov
        bounds.append(cov)
    return np.array(bounds)


def row_of(
    name: str,
    drives: Sequence[SunDrive],
    paths: Sequence[SunPath],
    *,
    bounds: Sequence[FloatArray] | None = None,
    every: int = 1,
) -> SunRow:
    """Return the errors over some drives.

    Args:
        name: of the sensor.
        drives: what is true.
        paths: what was estimated, of each drive.
        bounds: of the poses, [K, 6, 6] each, where they are known.
        every: frames from sighting to sighting.
    """
    headings = np.array(
        [heading_errors_rad(path, drive) for path, drive in zip(paths, drives, strict=True)]
    )
    rotations = []
    positions = []
    for path, drive in zip(paths, drives, strict=True):
        turns = so3.log(path.T_world_cam[:, :3, :3] @ drive.T_world_cam[:, :3, :3].mT)
        ways = path.T_world_cam[:, :3, 3] - drive.T_world_cam[:, :3, 3]
        rotations.append(np.mean(np.sqrt(np.mean(turns**2, axis=1))))
        positions.append(np.mean(np.sqrt(np.mean(ways**2, axis=1))))
    bound_deg = None
    if bounds is not None:
        variances = [
            heading_variances(bound, drive) for bound, drive in zip(bounds, drives, strict=True)
        ]
        bound_deg = math.degrees(math.sqrt(float(np.mean(variances))))
    claims = [heading_variances(path.cov, drive) for path, drive in zip(paths, drives, strict=True)]
    excluded = [path.excluded_at / every for path in paths if path.excluded_at is not None]
    return SunRow(
        name=name,
        heading_rms_deg=math.degrees(math.sqrt(float(np.mean(headings**2)))),
        heading_end_deg=math.degrees(math.sqrt(float(np.mean(headings[:, -1] ** 2)))),
        heading_bound_deg=bound_deg,
        claimed_deg=math.degrees(math.sqrt(float(np.mean(claims)))),
        rot_armse_deg=math.degrees(float(np.mean(rotations))),
        trans_armse_m=float(np.mean(positions)),
        excluded_after=float(np.mean(excluded)) if excluded else None,
        excluded_drives=len(excluded),
        drives=len(drives),
    )


def heading_errors_rad(path: SunPath, drive: SunDrive) -> FloatArray:
    """Return the errors of the attitude about the vertical axis of the world, [K], rad."""
    turns = so3.log(path.T_world_cam[:, :3, :3] @ drive.T_world_cam[:, :3, :3].mT)
    errors: FloatArray = turns[:, 1]
    return errors


def heading_variances(cov: FloatArray, drive: SunDrive) -> FloatArray:
    """Return the variances about the vertical axis of covariances of T_cam_world, [K], rad²."""
    down = drive.T_world_cam[:, 1, :3]  # the axis in the camera
    variances: FloatArray = np.einsum("ka,kab,kb->k", down, cov[:, 3:, 3:], down)
    return variances


def experiment(drives: Sequence[SunDrive], seed: int) -> Iterator[SunRow]:
    """Yield the row without a sun, one for each noise and rate, and one for each way to lie."""
    yield row_of("without", drives, [fused_path(drive, None) for drive in drives])
    for sigma_deg in SUN_NOISES_DEG:
        for every in SUN_EVERY:
            yield _row_with(drives, sigma_deg, every, seed=seed)
    for fault in FAULTS:
        yield _row_with(drives, FAULTY_SIGMA_DEG, FAULTY_EVERY, seed=seed, fault=fault)


def _row_with(
    drives: Sequence[SunDrive],
    sigma_deg: float,
    every: int,
    *,
    seed: int,
    fault: Fault | None = None,
) -> SunRow:
    sigma_rad = math.radians(sigma_deg)
    paths = []
    for index, drive in enumerate(drives):
        sensor = SunSensor(
            drive.T_world_cam,
            drive.sun,
            sigma_rad=sigma_rad,
            every=every,
            seed=_sensor_seed(seed, index),
            fault=fault,
        )
        paths.append(fused_path(drive, sensor))
    bounds = None
    if fault is None:
        claimed_rad = max(sigma_rad, MIN_SIGMA_RAD)
        bounds = [attitude_bound(drive, claimed_rad, every) for drive in drives]
    name = f"σ {sigma_deg:g}°, every {every}"
    if fault is not None:
        name += f", {fault}"
    return row_of(name, drives, paths, bounds=bounds, every=every)


def _sensor_seed(seed: int, index: int) -> int:
    """Return the seed of the sensor of a drive, which shares no noise with another drive or seed.

    Nor does it with the drives themselves, whose key is (seed, index).
    """
    return int(np.random.SeedSequence([seed, index, 1]).generate_state(1, np.uint64)[0])

"""The point world: a stereo camera drives a circle among landmarks with known noise.

Source: the synthetic experiment of PROBE-GK; thesis 1.5.3.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from probevo.arrays import AnyArray, BoolArray, FloatArray, IntArray
from probevo.camera.stereo import StereoCamera
from probevo.errors import InputError
from probevo.geometry import se3
from probevo.sequences.frame import Frame, StereoFeatures
from probevo.sequences.stamps import NS_PER_S
from probevo.storage.files import remove_stale, write_atomically
from probevo.storage.npz import write_npz
from probevo.tracking.identity_tracker import IdentityTracker
from probevo.tracking.tracker import TrackingState
from probevo.tracking.tracks import Tracks
from probevo_sim.noise_laws import NoiseLaw
from probevo_sim.point_config import PointConfig

MAX_SIGHTINGS = 30_000_000
"""Largest product of frames and landmarks: about an eighth of them are seen, which takes 1.5 GB at
the peak."""


@dataclass(frozen=True)
class PointStep:
    """A pair of consecutive frames, with the truth about them."""

    tracks: Tracks
    """Observations of the N landmarks seen in both frames, with noise."""
    T_curr_prev: FloatArray
    """The true motion, [4, 4], m."""
    prev_covariance: FloatArray
    """Covariance of the error of each observation in the previous frame, [N, 4, 4], px²."""
    curr_covariance: FloatArray
    """The same in the current frame."""
    inlier: BoolArray
    """Whether each landmark is an inlier, [N]."""


@dataclass(frozen=True)
class PointWorld:
    """A drive: L landmarks, K frames, and the n observations of all frames in their order.

    World axes: x east, y north, z up. The circle lies in z = 0 around the origin and is driven
    anticlockwise.
    """

    camera: StereoCamera
    stamps_ns: IntArray
    """Time of each frame, [K], from 0."""
    T_world_cam: FloatArray
    """True pose of the left camera at each frame, [K, 4, 4], m."""
    landmarks_m: FloatArray
    """Landmarks in the world, [L, 3]."""
    outlier: BoolArray
    """Whether the observations of each landmark have the uniform error, too, [L]."""
    first_of_frame: IntArray
    """Index of each frame's first observation, and the end of the last frame's, [K + 1]."""
    ids: IntArray
    """Index of the landmark of each observation, ascending within a frame, [n]."""
    true_px: FloatArray
    """(u_l, v_l, u_r, v_r) without error, [n, 4]."""
    pixels: FloatArray
    """(u_l, v_l, u_r, v_r) as observed, [n, 4]."""
    covariance: FloatArray
    """Covariance of pixels − true_px, [n, 4, 4], px²; of outliers, with the uniform error."""

    def __len__(self) -> int:
        """Return the number of frames, K."""
        return len(self.stamps_ns)

    @property
    def inlier(self) -> BoolArray:
        """Whether each observation is of an inlier, [n]."""
        return ~self.outlier[self.ids]

    def frames(self) -> Iterator[Frame]:
        """Yield the frames, as the odometry sees them."""
        for index, stamp_ns in enumerate(self.stamps_ns.tolist()):
            rows = slice(self.first_of_frame[index], self.first_of_frame[index + 1])
            features = StereoFeatures(self.ids[rows], self.pixels[rows])
            yield Frame(index, stamp_ns, features=features)

    def steps(self) -> Iterator[PointStep]:
        """Yield the K − 1 pairs of consecutive frames."""
        matcher = IdentityTracker()
        state = TrackingState.none()
        inlier = ~self.outlier
        for frame in self.frames():
            tracked = matcher.track(state, frame, np.eye(4))
            state = tracked.state
            tracks = tracked.tracks
            if frame.index == 0:
                continue
            T_world_prev = self.T_world_cam[frame.index - 1]
            T_world_curr = self.T_world_cam[frame.index]
            yield PointStep(
                tracks=tracks,
                T_curr_prev=se3.inverse(T_world_curr) @ T_world_prev,
                prev_covariance=self.covariance[self._rows(frame.index - 1, tracks.ids)],
                curr_covariance=self.covariance[self._rows(frame.index, tracks.ids)],
                inlier=inlier[tracks.ids],
            )

    def _rows(self, frame: int, ids: IntArray) -> IntArray:
        """Return the indices of the observations of these landmarks in a frame."""
        first, end = self.first_of_frame[frame : frame + 2].tolist()
        rows: IntArray = first + np.searchsorted(self.ids[first:end], ids)
        return rows


def simulate_points(config: PointConfig, duration_s: float, rng: np.random.Generator) -> PointWorld:
    """Simulate a drive through a world of its own.

    Landmarks, uniform in a cylinder as wide as the camera sees, are drawn first, then outliers,
    then noise. So with the same generator another noise law has the same landmarks and outliers.

    Args:
        config: the settings; its durations are not used.
        duration_s: duration of the drive.
        rng: source of all that is random.

    Raises:
        InputError: fewer than two frames, or so many frames and landmarks that they would not fit
            in memory.
    """
    # The drive.
    frames = round(duration_s * config.rate_hz) + 1
    _check_size(config, frames)
    stamps_ns = np.round(np.arange(frames) * (NS_PER_S / config.rate_hz)).astype(np.int64)
    T_world_cam = circle(config, stamps_ns / NS_PER_S)

    # Landmarks, and which of them are outliers.
    landmarks_m = _scatter(config, rng)
    outliers = round(config.outliers.fraction * config.landmarks)
    outlier = np.zeros(config.landmarks, np.bool_)
    outlier[rng.permutation(config.landmarks)[:outliers]] = True

    # True observations of all frames.
    camera = stereo_camera(config)
    seen = [_observe(config, camera, T, landmarks_m=landmarks_m) for T in T_world_cam]
    first_of_frame = np.cumsum([0, *(len(ids) for ids, _ in seen)])
    ids = np.concatenate([ids for ids, _ in seen])
    true_px = np.concatenate([true_px for _, true_px in seen])

    # Noise, and the uniform error of outliers, whose variance is range² / 3.
    law = NoiseLaw.of(config)
    range_px = config.outliers.range_px
    is_outlier = outlier[ids]
    pixels = true_px + law.draw(true_px, rng)
    covariance = law.covariance(true_px)
    pixels[is_outlier] += rng.uniform(-range_px, range_px, (int(is_outlier.sum()), 4))
    covariance[is_outlier] += range_px**2 / 3.0 * np.eye(4)
    return PointWorld(
        camera=camera,
        stamps_ns=stamps_ns,
        T_world_cam=T_world_cam,
        landmarks_m=landmarks_m,
        outlier=outlier,
        first_of_frame=first_of_frame,
        ids=ids,
        true_px=true_px,
        pixels=pixels,
        covariance=covariance,
    )


def training_and_test_world(config: PointConfig) -> tuple[PointWorld, PointWorld]:
    """Simulate two drives through independent worlds, of durations ``train_s`` and ``test_s``."""
    train = simulate_points(config, config.train_s, np.random.default_rng([config.seed, 0]))
    test = simulate_points(config, config.test_s, np.random.default_rng([config.seed, 1]))
    return train, test


def stereo_camera(config: PointConfig) -> StereoCamera:
    """Return the camera that the settings describe."""
    camera = config.camera
    size_px = (camera.width_px, camera.height_px)
    return StereoCamera.centered(camera.focal_px, camera.baseline_m, size_px)


def circle(config: PointConfig, t_s: FloatArray) -> FloatArray:
    """Return T_world_cam of a camera that drives the circle and looks ahead, [K, 4, 4], m.

    Args:
        config: speed and radius.
        t_s: times, [K].
    """
    angle = config.speed_m_s / config.radius_m * t_s
    zero = np.zeros_like(angle)

    # The camera's x, y and z axis in the world.
    outward = np.stack([np.cos(angle), np.sin(angle), zero], axis=-1)
    down = np.stack([zero, zero, zero - 1.0], axis=-1)
    ahead = np.stack([-np.sin(angle), np.cos(angle), zero], axis=-1)
    return se3.from_parts(np.stack([outward, down, ahead], axis=-1), config.radius_m * outward)


def write_points(world: PointWorld, path: Path) -> None:
    """Write a drive as a tracks file with the truth about each observation.

    Beside the arrays that ``open_tracks`` reads, the file holds::

        covariance [n, 4, 4]   covariance of the error of uv, px²
        inlier [n]             whether the landmark is an inlier
        true_uv [n, 4]         uv without error, px

    The same world gives the same bytes.

    Raises:
        InputError: the file cannot be written.
    """
    camera = world.camera
    arrays: dict[str, AnyArray] = {
        "frame": np.repeat(np.arange(len(world)), np.diff(world.first_of_frame)),
        "track": world.ids,
        "uv": world.pixels,
        "t": world.stamps_ns / NS_PER_S,
        "camera": np.array(
            [camera.fu_px, camera.fv_px, camera.cu_px, camera.cv_px, camera.baseline_m]
        ),
        "T_world_cam": se3.inverse(world.T_world_cam[0]) @ world.T_world_cam,
        "covariance": world.covariance,
        "inlier": world.inlier,
        "true_uv": world.true_px,
    }
    write_npz(path, arrays, is_compressed=True)


def write_training_and_test(config: PointConfig, folder: Path) -> tuple[PointWorld, PointWorld]:
    """Write ``train.npz`` and ``test.npz``, and their settings as ``config.yaml``.

    Returns the two worlds.

    Raises:
        InputError: as ``simulate_points`` does, no landmark is ever seen, or the folder cannot be
            written to.
    """
    train, test = training_and_test_world(config)
    if not len(train.ids) or not len(test.ids):
        raise InputError(
            "point world", "no landmark is ever seen.", "Take more landmarks, or a wider camera."
        )

    # The settings are written last, so that they never stand beside the worlds of others.
    remove_stale(folder / "config.yaml")
    write_points(train, folder / "train.npz")
    write_points(test, folder / "test.npz")
    settings = yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False)
    write_atomically(folder / "config.yaml", settings)
    return train, test


def _check_size(config: PointConfig, frames: int) -> None:
    """Check that a drive has at least two frames, and fits in memory.

    Raises:
        InputError: it does not.
    """
    if frames < 2:
        raise InputError(
            "point world",
            "a drive is shorter than two frames.",
            "Drive longer, or with more frames.",
        )
    sightings = frames * config.landmarks
    if sightings <= MAX_SIGHTINGS:
        return
    what = (
        f"{frames} frames × {config.landmarks} landmarks are {sightings:,}; at most"
        f" {MAX_SIGHTINGS:,} are possible."
    )
    raise InputError(
        "point world", what, "Simulate fewer landmarks, a shorter drive, or fewer frames a second."
    )


def _scatter(config: PointConfig, rng: np.random.Generator) -> FloatArray:
    """Draw landmarks, uniform in an upright cylinder around the circle: [L, 3], m, world."""
    # The square root makes the density uniform over the disc.
    reach_m = config.radius_m + config.camera.farthest_m
    distance_m = reach_m * np.sqrt(rng.uniform(size=config.landmarks))
    direction = rng.uniform(0.0, 2.0 * np.pi, config.landmarks)
    height_m = rng.uniform(-config.height_m, config.height_m, config.landmarks)
    return np.column_stack(
        [distance_m * np.cos(direction), distance_m * np.sin(direction), height_m]
    )


def _observe(
    config: PointConfig, camera: StereoCamera, T_world_cam: FloatArray, landmarks_m: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Return the landmarks that lie in both images, and where.

    Args:
        config: range of depths, and size of the images.
        camera: the stereo camera.
        T_world_cam: its pose, [4, 4], m.
        landmarks_m: all landmarks in the world, [L, 3].

    Returns:
        indices of the N landmarks seen, [N], and their observations, [N, 4], px.
    """
    # Within the range of depths.
    points = se3.transform(se3.inverse(T_world_cam), landmarks_m)
    depth_m = points[:, 2]
    ids = np.flatnonzero(
        (depth_m >= config.camera.nearest_m) & (depth_m <= config.camera.farthest_m)
    )

    # Within both images.
    pixels = camera.project(points[ids])
    last_px = np.tile([config.camera.width_px, config.camera.height_px], 2) - 1
    inside = np.all((pixels >= 0.0) & (pixels <= last_px), axis=1)
    return ids[inside], pixels[inside]

"""The point world: a stereo camera drives a circle among landmarks whose noise is known (PROBE-GK;
thesis 1.5.3)."""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from probevo.arrays import AnyArray, BoolArray, FloatArray, IntArray
from probevo.camera.stereo import StereoCamera
from probevo.errors import InputError
from probevo.files import remove_stale, write_atomically
from probevo.geometry import se3
from probevo.sequences.frame import Frame, StereoFeatures
from probevo.sequences.stamps import NS_PER_S
from probevo.tracking.feature_matcher import FeatureMatcher
from probevo.tracking.tracker import TrackingState
from probevo.tracking.tracks import Tracks
from probevo_sim.noise_laws import NoiseLaw
from probevo_sim.point_config import PointConfig

MOST_SIGHTINGS = 30_000_000
"""Frames times landmarks; about an eighth of them are seen and take 400 bytes each at the peak, or
1.5 GB."""


@dataclass(frozen=True)
class PointStep:
    """Two consecutive frames, with all that is true of them."""

    tracks: Tracks
    """The N landmarks seen in both, with noise."""
    T_curr_prev: FloatArray
    """True motion, [4, 4], m."""
    prev_covariance: FloatArray
    """Covariance of the error of each observation in the previous frame, [N, 4, 4], px²."""
    curr_covariance: FloatArray
    """The same in the current frame."""
    inlier: BoolArray
    """Whether each landmark is none of the outliers, [N]."""


@dataclass(frozen=True)
class PointWorld:
    """One drive: L landmarks, K frames, and the n observations of all frames, one frame after
    another.

    World axes: x east, y north, z up; the circle lies in z = 0 around the origin and is driven
    anticlockwise.
    """

    camera: StereoCamera
    stamps_ns: IntArray
    """Time of each frame, [K], from 0."""
    T_world_cam: FloatArray
    """True pose of the left camera at each frame, [K, 4, 4], m."""
    landmarks_m: FloatArray
    """[L, 3], world."""
    outlier: BoolArray
    """Landmarks whose observations have the uniform error too, [L]."""
    first_of_frame: IntArray
    """Where the observations of each frame begin, and the end of the last, [K + 1]."""
    ids: IntArray
    """Index of the landmark of each observation, ascending within a frame, [n]."""
    true_px: FloatArray
    """(u_l, v_l, u_r, v_r) without error, [n, 4]."""
    pixels: FloatArray
    """(u_l, v_l, u_r, v_r) as observed, [n, 4]."""
    covariance: FloatArray
    """Covariance of pixels − true_px, that of the uniform error of outliers included, [n, 4, 4],
    px²."""

    def __len__(self) -> int:
        """Number of frames, K."""
        return len(self.stamps_ns)

    @property
    def inlier(self) -> BoolArray:
        """Whether each observation is of a landmark that is no outlier, [n]."""
        return ~self.outlier[self.ids]

    def frames(self) -> Iterator[Frame]:
        """What the odometry gets to see."""
        for index, stamp_ns in enumerate(self.stamps_ns.tolist()):
            rows = slice(*self.first_of_frame[index : index + 2])
            yield Frame(index, stamp_ns, features=StereoFeatures(self.ids[rows], self.pixels[rows]))

    def steps(self) -> Iterator[PointStep]:
        """The K − 1 pairs of consecutive frames."""
        matcher = FeatureMatcher()
        state = TrackingState.none()
        inlier = ~self.outlier
        for frame in self.frames():
            tracked = matcher.track(state, frame, np.eye(4))
            state = tracked.state
            tracks = tracked.tracks
            if frame.index == 0:
                continue
            previous, current = self.T_world_cam[frame.index - 1 : frame.index + 1]
            yield PointStep(
                tracks,
                se3.inverse(current) @ previous,
                self.covariance[self._rows(frame.index - 1, tracks.ids)],
                curr_covariance=self.covariance[self._rows(frame.index, tracks.ids)],
                inlier=inlier[tracks.ids],
            )

    def _rows(self, frame: int, ids: IntArray) -> IntArray:
        """Where the observations of these landmarks in a frame are."""
        first, end = self.first_of_frame[frame : frame + 2].tolist()
        rows: IntArray = first + np.searchsorted(self.ids[first:end], ids)
        return rows


def simulate_points(config: PointConfig, duration_s: float, rng: np.random.Generator) -> PointWorld:
    """A drive of that duration through a world of its own.

    Landmarks, uniform in a cylinder as wide as the camera sees, are drawn first, then outliers,
        then noise: with the
    same generator, another noise law comes with the same landmarks and outliers.

    Raises:
        InputError: fewer than two frames, or so many frames and landmarks that they would not fit
            in memory.
    """
    frames = round(duration_s * config.rate_hz) + 1
    _check_size(config, frames)
    stamps_ns = np.round(np.arange(frames) * (NS_PER_S / config.rate_hz)).astype(np.int64)
    T_world_cam = circle(config, stamps_ns / NS_PER_S)
    landmarks_m = _scatter(config, rng)
    outlier = np.zeros(config.landmarks, np.bool_)
    outlier[
        rng.permutation(config.landmarks)[: round(config.outliers.fraction * config.landmarks)]
    ] = True
    camera = stereo_camera(config)
    seen = [_observe(config, camera, T, landmarks_m=landmarks_m) for T in T_world_cam]
    first_of_frame = np.cumsum([0, *(len(ids) for ids, _ in seen)])
    ids, true_px = (np.concatenate(parts) for parts in zip(*seen, strict=True))
    law = NoiseLaw.of(config)
    range_px = config.outliers.range_px
    wrong = outlier[ids]
    pixels = true_px + law.draw(true_px, rng)
    covariance = law.covariance(true_px)
    pixels[wrong] += rng.uniform(-range_px, range_px, (int(wrong.sum()), 4))
    covariance[wrong] += range_px**2 / 3.0 * np.eye(4)
    return PointWorld(
        camera,
        stamps_ns,
        T_world_cam,
        landmarks_m=landmarks_m,
        outlier=outlier,
        first_of_frame=first_of_frame,
        ids=ids,
        true_px=true_px,
        pixels=pixels,
        covariance=covariance,
    )


def training_and_test_world(config: PointConfig) -> tuple[PointWorld, PointWorld]:
    """Two drives through independent worlds, of ``train_s`` and of ``test_s``."""
    train, test = (np.random.default_rng([config.seed, world]) for world in (0, 1))
    return simulate_points(config, config.train_s, train), simulate_points(
        config, config.test_s, test
    )


def stereo_camera(config: PointConfig) -> StereoCamera:
    """The camera that the settings describe."""
    c = config.camera
    return StereoCamera.centered(c.focal_px, c.baseline_m, (c.width_px, c.height_px))


def circle(config: PointConfig, t_s: FloatArray) -> FloatArray:
    """T_world_cam at times [K], s, of a camera that drives the circle and looks ahead: [K, 4, 4],
    m."""
    angle = config.speed_m_s / config.radius_m * t_s
    zero = np.zeros_like(angle)
    outward = np.stack([np.cos(angle), np.sin(angle), zero], axis=-1)  # camera x
    down = np.stack([zero, zero, zero - 1.0], axis=-1)
    ahead = np.stack([-np.sin(angle), np.cos(angle), zero], axis=-1)
    return se3.from_parts(np.stack([outward, down, ahead], axis=-1), config.radius_m * outward)


def write_points(world: PointWorld, path: Path) -> None:
    """Write a drive as a tracks file (see ``open_tracks``), with three more arrays about each
    observation::

        covariance [n, 4, 4]   of the error of uv, px²
        inlier [n]             whether the landmark is none of the outliers
        true_uv [n, 4]         uv without error, px

    The same world gives the same bytes. Raises InputError if the file cannot be written.
    """
    c = world.camera
    arrays: dict[str, AnyArray] = {
        "frame": np.repeat(np.arange(len(world)), np.diff(world.first_of_frame)),
        "track": world.ids,
        "uv": world.pixels,
        "t": world.stamps_ns / NS_PER_S,
        "camera": np.array([c.fu_px, c.fv_px, c.cu_px, c.cv_px, c.baseline_m]),
        "T_world_cam": se3.inverse(world.T_world_cam[0]) @ world.T_world_cam,
        "covariance": world.covariance,
        "inlier": world.inlier,
        "true_uv": world.true_px,
    }
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)  # type: ignore[arg-type]  # as in output/motions_file.py
    write_atomically(path, buffer.getvalue())


def write_training_and_test(config: PointConfig, folder: Path) -> tuple[PointWorld, PointWorld]:
    """Write ``train.npz`` and ``test.npz``, and the settings they came from as ``config.yaml``;
    returns the two worlds.

    Raises:
        InputError: as ``simulate_points`` does, no landmark is ever seen, or the folder cannot be
            written to.
    """
    train, test = training_and_test_world(config)
    if not len(train.ids) or not len(test.ids):
        raise InputError(
            "point world", "no landmark is ever seen.", "Take more landmarks, or a wider camera."
        )
    remove_stale(folder / "config.yaml")
    write_points(train, folder / "train.npz")
    write_points(test, folder / "test.npz")
    write_atomically(
        folder / "config.yaml", yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False)
    )
    return train, test


def _check_size(config: PointConfig, frames: int) -> None:
    if frames < 2:
        raise InputError(
            "point world",
            "a drive is shorter than two frames.",
            "Drive longer, or with more frames.",
        )
    if frames * config.landmarks <= MOST_SIGHTINGS:
        return
    what = (
        f"{frames} frames of {config.landmarks} landmarks are too many; together they may make"
        f" {MOST_SIGHTINGS:g}."
    )
    raise InputError(
        "point world", what, "Simulate fewer landmarks, a shorter drive, or fewer frames a second."
    )


def _scatter(config: PointConfig, rng: np.random.Generator) -> FloatArray:
    """Landmarks, uniform in an upright cylinder around the circle, [L, 3], m, world."""
    distance_m = (config.radius_m + config.camera.farthest_m) * np.sqrt(
        rng.uniform(size=config.landmarks)
    )
    direction = rng.uniform(0.0, 2.0 * np.pi, config.landmarks)
    height_m = rng.uniform(-config.height_m, config.height_m, config.landmarks)
    return np.column_stack(
        [distance_m * np.cos(direction), distance_m * np.sin(direction), height_m]
    )


def _observe(
    config: PointConfig, camera: StereoCamera, T_world_cam: FloatArray, landmarks_m: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Indices of the landmarks that lie in both images, [N], and where, [N, 4], px."""
    points = se3.transform(se3.inverse(T_world_cam), landmarks_m)
    depth_m = points[:, 2]
    ids = np.flatnonzero(
        (depth_m >= config.camera.nearest_m) & (depth_m <= config.camera.farthest_m)
    )
    pixels = camera.project(points[ids])
    last_px = np.tile([config.camera.width_px, config.camera.height_px], 2) - 1
    inside = np.all((pixels >= 0.0) & (pixels <= last_px), axis=1)
    return ids[inside], pixels[inside]

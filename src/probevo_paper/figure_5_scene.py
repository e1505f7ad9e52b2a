"""The scene of PROBE Fig. 4: a checkerboard before a slow stereo rig and a fast camera on a bar."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import make_interp_spline

from probevo.arrays import FloatArray, Image
from probevo.camera.stereo import StereoCamera
from probevo.geometry import se3
from probevo_sim.scene.candidates import image_candidates, shadow_candidates
from probevo_sim.scene.drive import Trajectory
from probevo_sim.scene.ray_caster_numba import PixelSampling, add_radiance
from probevo_sim.scene.route import Route
from probevo_sim.scene.scene_arrays import scene_arrays, view_from
from probevo_sim.scene.sensor import expose
from probevo_sim.scene.solids import BOX, join, solid
from probevo_sim.scene.textures import Texture
from probevo_sim.scene.world import Ground, Movers, World

CORNERS = (8, 4)
"""Interior corners of the board along its rows and columns."""
SQUARE_M = 0.06
DISTANCE_M = 1.2
HEIGHT_M = 1.5
FRAME_STEP_S = 0.05
"""Time from one frame of the stereo rig to the next: 20 frames/s."""
INSTANT_STEP_S = 0.2
"""Time between synchronised exposures: every 4th frame of the rig, every 25th of the fast camera at
125 frames/s."""

_SLOW_RATE = 0.12
"""Speed of the first half of the motion over the speed of the second."""
_BLEND_S = 0.5
"""Time constant of the transition between the halves."""
_SINES = 3
_LOW_HZ = 0.5
_HIGH_HZ = 1.1
_MOTION_RMS = np.array([0.05, 0.07, 0.045, 0.06, 0.04, 0.07])
"""RMS of the motion in (x, y, z, yaw, pitch, roll), m and rad."""
_MARGIN_S = 0.5
_KNOT_STEP_S = 0.02
_WINDOW_MARGIN_PX = 24.0
_MIN_RAYS = 4
_MAX_RAYS = 64


@dataclass(frozen=True)
class BoardCamera:
    """A camera of the rig."""

    focal_px: float
    center_px: tuple[float, float]
    size_px: tuple[int, int]
    T_left_cam: FloatArray
    """Pose in the frame of the rig's left camera, [4, 4], m."""
    shutter_s: float
    noise: float
    """Strength of the sensor's noise; see ``sensor.expose``."""

    def project(self, points: FloatArray) -> FloatArray:
        """Project points in the left camera's frame, [..., 3], m, to pixels, [..., 2].

        The points must be in front of the camera.
        """
        T_cam_left = se3.inverse(self.T_left_cam)
        x, y, z = np.moveaxis(points @ T_cam_left[:3, :3].T + T_cam_left[:3, 3], -1, 0)
        return self.focal_px * np.stack([x / z, y / z], axis=-1) + self.center_px


def _beside_left(right_m: float, yaw_left_rad: float = 0.0) -> FloatArray:
    """Return T_left_cam of a camera on the bar, turned towards the left one by the yaw, [4, 4]."""
    T_left_cam = se3.exp(np.array([0.0, 0.0, 0.0, 0.0, -yaw_left_rad, 0.0]))
    T_left_cam[0, 3] = right_m
    return T_left_cam


STEREO = StereoCamera(
    fu_px=460.0, fv_px=460.0, cu_px=375.5, cv_px=239.5, baseline_m=0.11, size_px=(752, 480)
)
"""The stereo camera, similar to a VI-Sensor."""
LEFT = BoardCamera(
    focal_px=460.0,
    center_px=(375.5, 239.5),
    size_px=(752, 480),
    T_left_cam=np.eye(4),
    shutter_s=0.04,
    noise=0.25,
)
RIGHT = BoardCamera(
    focal_px=460.0,
    center_px=(375.5, 239.5),
    size_px=(752, 480),
    T_left_cam=_beside_left(STEREO.baseline_m),
    shutter_s=0.04,
    noise=0.25,
)
FAST = BoardCamera(
    focal_px=500.0,
    center_px=(319.5, 255.5),
    size_px=(640, 512),
    T_left_cam=_beside_left(0.25, yaw_left_rad=0.16),
    shutter_s=0.002,
    noise=0.35,
)
"""The fast camera, similar to a Flea3 with 2 × 2 binning."""


@dataclass(frozen=True)
class Window:
    """The part of an image that is read out."""

    left_px: int
    top_px: int
    width_px: int
    height_px: int

    @property
    def corner_px(self) -> FloatArray:
        """Position (u, v) of the window's first pixel in the image, [2], px."""
        return np.array([self.left_px, self.top_px], dtype=np.float64)


class BoardScene:
    """The board, and the motion of the rig before it: the first half slow, the second fast."""

    def __init__(self, duration_s: float, rng: np.random.Generator) -> None:
        """Build the scene, and draw a motion of the given duration."""
        self.trajectory = _motion(duration_s, rng)
        self._world = _world()
        self._scene = scene_arrays(self._world, shadow=0.0)

    def board(self, camera: BoardCamera, t_s: ArrayLike, *, margin: int = 0) -> FloatArray:
        """Return the true pixels of the corners in a camera at times [...]: [..., 32, 2], px.

        Corners are ordered by rows from the upper left one. ``margin`` adds as many lines of the
        board on each side; the first of these is its edge.
        """
        columns, rows = (
            np.arange(-margin, count + margin) - 0.5 * (count - 1) for count in CORNERS
        )
        # The world has x forward to the board, y left and z up.
        down, across = np.meshgrid(rows, columns, indexing="ij")
        corners = np.column_stack(
            [
                np.full(down.size, DISTANCE_M),
                -SQUARE_M * across.ravel(),
                HEIGHT_M - SQUARE_M * down.ravel(),
            ]
        )
        T_left_world = se3.inverse(self.trajectory.T_world_cam(t_s))
        points = corners @ np.swapaxes(T_left_world[..., :3, :3], -1, -2)
        return camera.project(points + T_left_world[..., None, :3, 3])

    def window(self, camera: BoardCamera, instants_s: Iterable[float]) -> Window:
        """Return the window that holds the board during the exposures around some instants."""
        # The outline of the board at the start and at the end of each exposure.
        half_s = 0.5 * camera.shutter_s
        edges_s = np.array([t_s + side for t_s in instants_s for side in (-half_s, half_s)])
        outline_px = self.board(camera, edges_s, margin=1).reshape(-1, 2)
        # Its bounding box with a margin, cut off at the borders of the image.
        low = np.maximum(np.floor(outline_px.min(axis=0) - _WINDOW_MARGIN_PX), 0.0)
        high = np.minimum(np.ceil(outline_px.max(axis=0) + _WINDOW_MARGIN_PX), camera.size_px)
        width, height = np.maximum(high - low, 1.0)
        return Window(
            left_px=int(low[0]), top_px=int(low[1]), width_px=int(width), height_px=int(height)
        )

    def expose(
        self, camera: BoardCamera, t_s: float, window: Window, rng: np.random.Generator
    ) -> Image:
        """Render a window of the image whose exposure has its middle at ``t_s``, [H, W], uint8.

        Each pixel is the mean of rays through its centre, spread evenly over the time that the
        shutter is open; the texture is averaged over the pixel along each ray. Rays that are spread
        over pixel and time at once would need to be many more: they leave ripples in blurred edges,
        which bias the detected corners.
        """
        # The times of the rays, and the camera of the window alone.
        rays = self._rays(camera, t_s)
        times_s = t_s + camera.shutter_s * ((np.arange(rays) + 0.5) / rays - 0.5)
        image = np.zeros((window.height_px, window.width_px), dtype=np.float32)
        u, v = camera.center_px
        intrinsics = camera.focal_px, u - window.left_px, v - window.top_px
        # Sum the light of one ray a pixel at each of these times.
        for time_s in times_s.tolist():
            T_world_left = self.trajectory.T_world_cam(time_s)
            T_world_object = self._world.poses(time_s, T_world_left)
            view = view_from(
                self._world, T_world_object, T_world_left @ camera.T_left_cam, intrinsics=intrinsics
            )
            candidates = image_candidates(self._scene, view, (window.width_px, window.height_px))
            occluders = shadow_candidates(self._scene, view)
            add_radiance(
                self._scene,
                view,
                candidates,
                occluders=occluders,
                time_s=time_s,
                sampling=PixelSampling(offsets_px=np.zeros((1, 2)), footprint_px=1.0),
                image=image,
            )
        # The sensor adds its noise to the mean, and rounds it to eight bits.
        return expose(image / np.float32(rays), 1.0, camera.noise, rng=rng)

    def _rays(self, camera: BoardCamera, t_s: float) -> int:
        """Return how many rays make the board move by one pixel from each ray to the next."""
        start_px, end_px = self.board(camera, t_s + camera.shutter_s * np.array([-0.5, 0.5]))
        moved_px = float(np.linalg.norm(end_px - start_px, axis=-1).max())
        return int(np.clip(np.ceil(moved_px), _MIN_RAYS, _MAX_RAYS))


def _motion(duration_s: float, rng: np.random.Generator) -> Trajectory:
    """Draw a motion: all six coordinates are sums of sines, first slow, then fast."""
    frequency = rng.uniform(_LOW_HZ, _HIGH_HZ, (6, _SINES, 1))
    phase = rng.uniform(0.0, 2.0 * np.pi, (6, _SINES, 1))
    # The phase advances at a rate that grows from slow to fast in the middle of the motion.
    t_s = np.arange(-_MARGIN_S, duration_s + _MARGIN_S, _KNOT_STEP_S)
    rate = _SLOW_RATE + (1.0 - _SLOW_RATE) * 0.5 * (
        1.0 + np.tanh((t_s - 0.5 * duration_s) / _BLEND_S)
    )
    slowed_s = np.cumsum(rate) * _KNOT_STEP_S
    swing = np.sqrt(2.0 / _SINES) * np.sin(2.0 * np.pi * frequency * slowed_s + phase).sum(axis=1)
    # The rig swings around a place in which the board is before the middle of its baseline.
    middle = np.array([0.0, 0.5 * STEREO.baseline_m, HEIGHT_M, 0.0, 0.0, 0.0])
    return Trajectory(
        duration_s, make_interp_spline(t_s, middle + (_MOTION_RMS[:, None] * swing).T, k=5)
    )


def _world() -> World:
    """Build the board on a larger white sheet, before a wall, lit from behind the camera."""
    columns, rows = (count + 1 for count in CORNERS)
    size_m = np.array([0.01, columns * SQUARE_M, rows * SQUARE_M])
    center_m = np.array([DISTANCE_M + 0.5 * size_m[0], 0.0, HEIGHT_M])
    board = solid(
        BOX,
        size_m,
        center_m,
        texture=Texture.CHECKERBOARD,
        tile_m=8 * SQUARE_M,
        albedo=0.42,
        contrast=0.85,
    )
    sheet_m = size_m + SQUARE_M * np.array([0.0, 1.0, 1.0])
    sheet = solid(
        BOX,
        sheet_m,
        center_m + np.array([0.002, 0.0, 0.0]),
        texture=Texture.PLAIN,
        tile_m=1.0,
        albedo=0.75,
        contrast=0.0,
    )
    wall = solid(
        BOX,
        (0.2, 20.0, 6.0),
        (2.8, 0.0, 3.0),
        texture=Texture.PLASTER,
        tile_m=1.5,
        albedo=0.3,
        contrast=0.6,
    )
    ground = Ground(
        Route.from_turns([(20.0, 0.0)]),
        edge_m=np.array([np.inf]),
        texture=np.array([int(Texture.CONCRETE)]),
        tile_m=np.array([2.0]),
        albedo=np.array([0.35]),
        contrast=np.array([0.5]),
    )
    to_sun = np.array([-0.8, 0.2, 0.5])
    return World(
        join([board, sheet, wall]), Movers.none(), ground, to_sun=to_sun / np.linalg.norm(to_sun)
    )

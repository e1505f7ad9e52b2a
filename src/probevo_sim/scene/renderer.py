"""Images of a place at an instant, and the exact truth about each of their pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from probevo.arrays import BoolArray, FloatArray, IntArray
from probevo.camera.stereo import StereoCamera
from probevo.geometry import se3
from probevo_sim.scene.candidates import image_candidates, shadow_candidates
from probevo_sim.scene.config import Effects
from probevo_sim.scene.drive import Trajectory
from probevo_sim.scene.ray_caster_numba import PixelSampling, add_radiance, first_hits
from probevo_sim.scene.scene_arrays import SceneArrays, View, scene_arrays, view_from
from probevo_sim.scene.world import World

FULL_SHUTTER_S = 0.05
"""Exposure time at full motion blur."""
FULL_READOUT_S = 0.06
"""Time from the first row of an image to the last one, at full rolling shutter."""
ROWS_AT_ONCE = 2
"""Rows of a rolling shutter that are rendered as of one time."""
OFFSETS_PX = np.array([[-0.375, -0.125], [-0.125, 0.375], [0.125, -0.375], [0.375, 0.125]])
"""Rays through a pixel, (u, v) from its centre: each in a column and a row of its own."""
FOOTPRINT_PX = 0.5
"""Side of the square over which each ray sees the mean of a texture."""
MAX_INSTANTS = 32
"""Largest number of instants at which a blurred image is rendered, with one ray a pixel; slow
motion takes fewer."""
NEAR_SCENERY_M = 5.0
"""Nearest depth for which there are enough instants; nearer things may blur in visible steps."""
CORNER_ERROR_PX = (0.35, 0.35, 0.6)
"""Shift by the full rectification error, which turns the right camera about its x, y and z axis.

The first two move rows and columns, the last one the corners."""

FloatImage = NDArray[np.float32]


@dataclass(frozen=True)
class PixelTruth:
    """The truth about the centre of each pixel of a left image at the middle of its exposure.

    All fields are [height, width] unless stated otherwise.
    """

    depth_m: FloatArray
    """Depth along the camera's axis; infinite in the sky."""
    disparity_px: FloatArray
    """Disparity in the rig as its calibration describes it; 0 in the sky."""
    flow_px: FloatArray
    """Motion (du, dv) in the image, until the next frame, of the point that is seen here.

    It is given whether or not the point is occluded there, [height, width, 2]; NaN where the point
    would be behind the camera."""
    moving: BoolArray
    """Whether the pixel shows an object that can move, even if it halts just now.

    Shadows are no objects."""


class Renderer:
    """A renderer of the stereo images of a world along a drive.

    Args:
        world: what there is to see.
        trajectory: motion of the left camera.
        camera: the rig as its calibration describes it, with square pixels.
        effects: the degradations; the renderer looks at blur, shadows, rolling
            shutter and rectification.

    Raises:
        ValueError: the camera has no size.
    """

    def __init__(
        self, world: World, trajectory: Trajectory, camera: StereoCamera, effects: Effects
    ) -> None:
        if camera.size_px is None:
            raise ValueError("a camera needs a size_px to render images")
        self.world = world
        self.trajectory = trajectory
        self.camera = camera
        self.effects = effects
        self.size_px = camera.size_px
        self._scene: SceneArrays = scene_arrays(world, effects.shadows)
        self._T_left_right = _right_camera(camera, camera.size_px, effects.rectification)

    def pair(self, t_s: float) -> tuple[FloatImage, FloatImage]:
        """Render the radiance of the left and right image, [height, width]; 1 is white.

        The middle of the exposure is at ``t_s``. Each pixel is the mean of several rays, spread
        over its area and over the time that the shutter is open. At each instant they go through
        one of the places in the pixel, and the places alternate, so that place and time are
        independent.
        """
        images = np.zeros((2, *self.size_px[::-1]), dtype=np.float32)
        instants = self._instants(t_s)
        if len(instants) == 1:
            self._add(t_s, OFFSETS_PX, images)
        else:
            for k, instant in enumerate(instants):
                self._add(float(instant), OFFSETS_PX[[k % len(OFFSETS_PX)]], images)
        images /= max(len(instants), len(OFFSETS_PX))
        return images[0], images[1]

    def _add(self, t_s: float, offsets_px: FloatArray, images: FloatImage) -> None:
        """Add the radiance of some rays per pixel at one instant to both images.

        Args:
            t_s: the instant.
            offsets_px: rays through a pixel, [K, 2].
            images: left and right, [2, height, width].
        """
        readout_s = FULL_READOUT_S * self.effects.rolling_shutter
        if readout_s == 0.0:
            self._add_rows(t_s, offsets_px, images)
            return
        # The middle row is exposed at the time of the frame.
        height = self.size_px[1]
        for top in range(0, height, ROWS_AT_ONCE):
            rows = images[:, top : top + ROWS_AT_ONCE]
            middle = top + 0.5 * (rows.shape[1] - 1)
            row_time_s = t_s + readout_s * (middle / (height - 1) - 0.5)
            self._add_rows(row_time_s, offsets_px, rows, top=top)

    def _add_rows(
        self, t_s: float, offsets_px: FloatArray, images: FloatImage, top: int = 0
    ) -> None:
        """Add the radiance of some rays per pixel at one instant to rows of both images.

        Args:
            t_s: the instant.
            offsets_px: rays through a pixel, [K, 2].
            images: these rows of left and right image, [2, rows, width].
            top: the first of these rows.
        """
        T_world_left = self.trajectory.T_world_cam(t_s)
        T_world_object = self.world.poses(t_s, T_world_left)
        size_px = (images.shape[2], images.shape[1])
        occluders = None
        for image, T_left_cam in zip(images, (np.eye(4), self._T_left_right), strict=True):
            view = self._view(T_world_object, T_world_left @ T_left_cam, top=top)
            if occluders is None:  # around the left camera, for both images
                occluders = shadow_candidates(self._scene, view)
            add_radiance(
                self._scene,
                view,
                image_candidates(self._scene, view, size_px),
                occluders=occluders,
                time_s=t_s,
                sampling=PixelSampling(offsets_px, FOOTPRINT_PX),
                image=image,
            )

    def _instants(self, t_s: float) -> FloatArray:
        """Return times within the exposure, about one for each pixel that near things move.

        Without blur that is the one time ``t_s``.
        """
        shutter_s = FULL_SHUTTER_S * self.effects.blur
        if shutter_s == 0.0:
            return np.array([t_s])
        angular_rate = float(np.linalg.norm(self.trajectory.angular_rate(t_s)))
        rotation_px_s = self.camera.fu_px * angular_rate
        speed_m_s = (
            float(np.linalg.norm(self.trajectory.velocity(t_s))) + self.world.movers.fastest_m_s
        )
        translation_px_s = self.camera.fu_px * speed_m_s / NEAR_SCENERY_M

        # Whole rounds through the places in a pixel, so that each is used equally often.
        motion_px = shutter_s * (rotation_px_s + translation_px_s)
        rounds = 1 + int(np.ceil(motion_px / len(OFFSETS_PX)))
        count = min(rounds * len(OFFSETS_PX), MAX_INSTANTS)
        return t_s + shutter_s * ((np.arange(count) + 0.5) / count - 0.5)

    def pixel_truth(self, t_s: float, next_s: float) -> PixelTruth:
        """Return the truth of the left image at ``t_s``, and its pixels' flow until ``next_s``."""
        T_world_cam = self.trajectory.T_world_cam(t_s)
        T_world_next = self.trajectory.T_world_cam(next_s)
        T_world_object = self.world.poses(t_s, T_world_cam)
        view = self._view(T_world_object, T_world_cam)
        shape = self.size_px[::-1]
        depth_m = np.empty(shape)
        hits = np.empty(shape, dtype=np.int32)
        first_hits(
            self._scene,
            view,
            image_candidates(self._scene, view, self.size_px),
            depth_m=depth_m,
            hits=hits,
        )
        objects = np.where(hits >= 0, self.world.solids.object_index[np.maximum(hits, 0)], 0)

        # Motion of each object as seen from the camera: to the object's own frame at t_s, and back
        # out at next_s.
        T_next_curr = (
            se3.inverse(T_world_next)
            @ self.world.poses(next_s, T_world_next)
            @ se3.inverse(T_world_object)
            @ T_world_cam
        )
        return PixelTruth(
            depth_m=depth_m,
            disparity_px=self.camera.fu_px * self.camera.baseline_m / depth_m,
            flow_px=_flow(self.camera, depth_m, objects, T_next_curr=T_next_curr),
            moving=objects > 0,
        )

    def _view(self, T_world_object: FloatArray, T_world_cam: FloatArray, top: int = 0) -> View:
        """Return the view from a camera whose image begins at row ``top``."""
        intrinsics = (self.camera.fu_px, self.camera.cu_px, self.camera.cv_px - top)
        return view_from(self.world, T_world_object, T_world_cam, intrinsics=intrinsics)


def _flow(
    camera: StereoCamera, depth_m: FloatArray, objects: IntArray, T_next_curr: FloatArray
) -> FloatArray:
    """Return the optical flow of each pixel, [height, width, 2], px.

    Args:
        camera: the rig.
        depth_m: depth of each pixel, [height, width]; infinite in the sky.
        objects: index of the object that each pixel shows, [height, width].
        T_next_curr: motion of each object as seen from the camera, [2 + G, 4, 4], m.
    """
    v, u = np.mgrid[: depth_m.shape[0], : depth_m.shape[1]].astype(np.float64)
    ray = np.stack(
        [(u - camera.cu_px) / camera.fu_px, (v - camera.cv_px) / camera.fv_px, np.ones_like(u)],
        axis=-1,
    )
    # Points as ray and inverse depth, so that the sky, at infinity, only rotates.
    moved = np.empty_like(ray)
    for index in np.unique(objects):
        shown = objects == index
        T = T_next_curr[index]
        moved[shown] = ray[shown] @ T[:3, :3].T + (1.0 / depth_m[shown])[:, None] * T[:3, 3]
    depth = np.where(moved[..., 2] > 0.0, moved[..., 2], np.nan)
    return np.stack(
        [
            camera.fu_px * moved[..., 0] / depth + camera.cu_px - u,
            camera.fv_px * moved[..., 1] / depth + camera.cv_px - v,
        ],
        axis=-1,
    )


def _right_camera(camera: StereoCamera, size_px: tuple[int, int], error: float) -> FloatArray:
    """Return the true T_left_right, [4, 4], m: as calibrated, but for a small rotation.

    Args:
        camera: the rig as its calibration describes it.
        size_px: width and height of the images.
        error: strength of the rectification error, 0 … 1.
    """
    # Angles whose shift in the image, at this distance from the axis, is that of CORNER_ERROR_PX.
    lever_px = (camera.fu_px, camera.fu_px, 0.5 * float(np.hypot(*size_px)))
    T_left_right = se3.exp(np.r_[0.0, 0.0, 0.0, error * np.array(CORNER_ERROR_PX) / lever_px])
    T_left_right[0, 3] = camera.baseline_m
    return T_left_right

"""Images of a place at an instant, and the exact truth about each of their pixels."""

from __future__ import annotations

from collections.abc import Iterator
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
LANDING_STEPS = 8
"""Largest number of steps in which it is found which row sees a point next; each gains a factor:
the share of a row by which the point moves until the next row is exposed."""
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

    With a rolling shutter, that is the time of its row. All fields are [height, width] unless
    stated otherwise.
    """

    depth_m: FloatArray
    """Depth along the camera's axis; infinite in the sky."""
    disparity_px: FloatArray
    """Disparity in the rig as its calibration describes it; 0 in the sky."""
    flow_px: FloatArray
    """Motion (du, dv) in the image, until the next frame, of the point that is seen here.

    It is given whether or not the point is occluded there, [height, width, 2]; NaN where the point
    would be behind the camera. With a rolling shutter, the point is where the row in which it lies
    then sees it."""
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
        for rows, row_time_s in self._row_blocks(t_s):
            self._add_rows(row_time_s, offsets_px, images[:, rows], top=rows.start)

    def _row_blocks(self, t_s: float) -> Iterator[tuple[slice, float]]:
        """Yield the rows of a frame that are exposed at one time, from the top, and that time, s.

        The middle row is exposed at the time of the frame, ``t_s``.
        """
        height = self.size_px[1]
        readout_s = FULL_READOUT_S * self.effects.rolling_shutter
        if readout_s == 0.0:
            yield slice(0, height), t_s
            return
        for top in range(0, height, ROWS_AT_ONCE):
            rows = slice(top, min(top + ROWS_AT_ONCE, height))
            middle = 0.5 * (rows.start + rows.stop - 1)
            yield rows, t_s + readout_s * (middle / (height - 1) - 0.5)

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
        # Motion of each object from its own frame to the camera, as each row sees it next.
        T_next_object = np.array(
            [se3.inverse(self._T_object_cam(time_s)) for _, time_s in self._row_blocks(next_s)]
        )
        shape = self.size_px[::-1]
        depth_m = np.empty(shape)
        hits = np.empty(shape, dtype=np.int32)
        objects = np.empty(shape, dtype=np.int64)
        flow_px = np.empty((*shape, 2))
        for rows, row_time_s in self._row_blocks(t_s):
            T_world_cam = self.trajectory.T_world_cam(row_time_s)
            view = self._view(
                self.world.poses(row_time_s, T_world_cam), T_world_cam, top=rows.start
            )
            first_hits(
                self._scene,
                view,
                image_candidates(self._scene, view, (shape[1], rows.stop - rows.start)),
                depth_m=depth_m[rows],
                hits=hits[rows],
            )
            solids = np.maximum(hits[rows], 0)
            objects[rows] = np.where(hits[rows] >= 0, self.world.solids.object_index[solids], 0)
            flow_px[rows] = _flow(
                self.camera,
                depth_m[rows],
                objects[rows],
                top=rows.start,
                T_object_curr=self._T_object_cam(row_time_s),
                T_next_object=T_next_object,
            )
        return PixelTruth(
            depth_m=depth_m,
            disparity_px=self.camera.fu_px * self.camera.baseline_m / depth_m,
            flow_px=flow_px,
            moving=objects > 0,
        )

    def _T_object_cam(self, t_s: float) -> FloatArray:
        """Return T_object_cam of each object at a time, [2 + G, 4, 4], m."""
        T_world_cam = self.trajectory.T_world_cam(t_s)
        return se3.inverse(self.world.poses(t_s, T_world_cam)) @ T_world_cam

    def _view(self, T_world_object: FloatArray, T_world_cam: FloatArray, top: int = 0) -> View:
        """Return the view from a camera whose image begins at row ``top``."""
        intrinsics = (self.camera.fu_px, self.camera.cu_px, self.camera.cv_px - top)
        return view_from(self.world, T_world_object, T_world_cam, intrinsics=intrinsics)


def _flow(
    camera: StereoCamera,
    depth_m: FloatArray,
    objects: IntArray,
    *,
    top: int,
    T_object_curr: FloatArray,
    T_next_object: FloatArray,
) -> FloatArray:
    """Return the optical flow of each pixel of rows that are exposed at one time, [R, width, 2],
    px.

    Args:
        camera: the rig.
        depth_m: depth of each pixel, [R, width]; infinite in the sky.
        objects: index of the object that each pixel shows, [R, width].
        top: the first of these rows.
        T_object_curr: from the camera to each object, [2 + G, 4, 4], m.
        T_next_object: from each object to the camera when each of B blocks of rows is exposed next,
            [B, 2 + G, 4, 4], m.
    """
    v, u = np.mgrid[top : top + len(depth_m), : depth_m.shape[1]].astype(np.float64)
    ray = np.stack(
        [(u - camera.cu_px) / camera.fu_px, (v - camera.cv_px) / camera.fv_px, np.ones_like(u)],
        axis=-1,
    )
    # Points as ray and inverse depth, so that the sky, at infinity, only rotates.
    homogeneous = np.concatenate([ray, 1.0 / depth_m[..., None]], axis=-1)
    in_object = np.einsum("rcij,rcj->rci", T_object_curr[objects], homogeneous)
    last = len(T_next_object) - 1
    block = np.full(objects.shape, min(top // ROWS_AT_ONCE, last))
    for _ in range(LANDING_STEPS):
        moved = np.einsum("rcij,rcj->rci", T_next_object[block, objects], in_object)
        depth = np.where(moved[..., 2] > 0.0, moved[..., 2], np.nan)
        next_u = camera.fu_px * moved[..., 0] / depth + camera.cu_px
        next_v = camera.fv_px * moved[..., 1] / depth + camera.cv_px
        # The row in which a point lies says when it is seen, and that says where it lies. Beyond
        # the image, the time is that of the first or last row.
        row = np.where(np.isfinite(next_v), next_v, v)
        landed = np.clip((row + 0.5) // ROWS_AT_ONCE, 0, last).astype(np.int64)
        if np.array_equal(landed, block):
            break
        block = landed
    return np.stack([next_u - u, next_v - v], axis=-1)


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

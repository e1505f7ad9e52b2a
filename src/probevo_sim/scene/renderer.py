"""Images of a place at an instant, and the exact truth about each of their pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from probevo.arrays import BoolArray, FloatArray, IntArray
from probevo.camera.stereo import StereoCamera
from probevo.geometry import se3
from probevo_sim.scene.candidates import in_image, towards_sun
from probevo_sim.scene.config import Effects
from probevo_sim.scene.drive import Trajectory
from probevo_sim.scene.ray_caster import add_radiance, first_hits
from probevo_sim.scene.scene_arrays import SceneArrays, pose_solids, scene_arrays
from probevo_sim.scene.world import World

FULL_SHUTTER_S = 0.05
OFFSETS_PX = np.array([[-0.375, -0.125], [-0.125, 0.375], [0.125, -0.375], [0.375, 0.125]])
"""Where the rays through a pixel go, from its middle: each in a column and a row of its own."""
FOOTPRINT_PX = 0.5
"""Side of the square over which each ray sees the mean of a texture."""
MAX_INSTANTS = 32
"""At which a blurred image is looked at, with one ray a pixel; fewer where a pixel's motion makes
them."""
NEAR_SCENERY_M = 5.0
"""For the choice of the number of instants: what passes nearer than this may be seen in steps."""
CORNER_ERROR_PX = (0.35, 0.35, 0.6)
"""What the full rectification error does by turning the right camera about its x (rows), y and z
axis (corners)."""

FloatImage = NDArray[np.float32]


@dataclass(frozen=True)
class PixelTruth:
    """What is known of each pixel's centre in a left image, each [height, width], at the middle of
    the exposure."""

    depth_m: FloatArray
    """Along the camera's axis; infinite in the sky."""
    disparity_px: FloatArray
    """Of the rig as its calibration describes it; 0 in the sky."""
    flow_px: FloatArray
    """(du, dv) from here to the next frame, of the thing that is seen here, whether or not it is
    hidden there; [height, width, 2], NaN where it would be behind the camera."""
    moving: BoolArray
    """Whether the pixel shows a thing that can move, be it that it halts just now. Shadows are no
    things."""


class Renderer:
    """Renders a world along a drive.

    Args:
        world: what there is to see.
        trajectory: of the left camera.
        camera: the rig, as its calibration describes it, with square pixels.
        effects: what spoils the images; of these the renderer looks at blur, shadows and
            rectification.
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
        """Radiance of the left and right image whose exposure has its middle at ``t_s``, [height,
        width], 1 is white.

        Each pixel is the mean of several rays, spread over its area and over the time that the
            shutter is open: at each
        instant one of the places in the pixel, in turn, so that place and time are independent.
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
        """Add the radiance of some rays a pixel, all at one instant, to both images, [2, height,
        width]."""
        T_world_left = self.trajectory.T_world_cam(t_s)
        T_world_object = self.world.poses(t_s, T_world_left)
        casters = None
        for image, T_left_cam in zip(images, (np.eye(4), self._T_left_right), strict=True):
            posed = pose_solids(
                self.world, T_world_object, T_world_left @ T_left_cam, intrinsics=self._intrinsics
            )
            casters = casters or towards_sun(self._scene, posed)
            lists = in_image(self._scene, posed, self.size_px)
            add_radiance(
                self._scene,
                posed,
                lists,
                casters=casters,
                time_s=t_s,
                offsets_px=offsets_px,
                footprint_px=FOOTPRINT_PX,
                image=image,
            )

    def _instants(self, t_s: float) -> FloatArray:
        """Times within the exposure, about one for each pixel that near things move; one where
        nothing blurs."""
        shutter_s = FULL_SHUTTER_S * self.effects.blur
        if shutter_s == 0.0:
            return np.array([t_s])
        turn_px_s = self.camera.fu_px * float(np.linalg.norm(self.trajectory.angular_rate(t_s)))
        speed_m_s = (
            float(np.linalg.norm(self.trajectory.velocity(t_s))) + self.world.movers.fastest_m_s
        )
        pass_px_s = self.camera.fu_px * speed_m_s / NEAR_SCENERY_M
        rounds = 1 + int(np.ceil(shutter_s * (turn_px_s + pass_px_s) / len(OFFSETS_PX)))
        count = min(rounds * len(OFFSETS_PX), MAX_INSTANTS)
        return t_s + shutter_s * ((np.arange(count) + 0.5) / count - 0.5)

    @property
    def _intrinsics(self) -> tuple[float, float, float]:
        return self.camera.fu_px, self.camera.cu_px, self.camera.cv_px

    def pixel_truth(self, t_s: float, next_s: float) -> PixelTruth:
        """Truth of the left image at ``t_s``, and of how its pixels move until ``next_s``."""
        T_world_cam, T_world_next = (
            self.trajectory.T_world_cam(t_s),
            self.trajectory.T_world_cam(next_s),
        )
        T_world_object = self.world.poses(t_s, T_world_cam)
        posed = pose_solids(self.world, T_world_object, T_world_cam, intrinsics=self._intrinsics)
        shape = self.size_px[::-1]
        depth_m = np.empty(shape)
        hits = np.empty(shape, dtype=np.int32)
        first_hits(
            self._scene,
            posed,
            in_image(self._scene, posed, self.size_px),
            depth_m=depth_m,
            hits=hits,
        )
        objects = np.where(hits >= 0, self.world.solids.object_index[np.maximum(hits, 0)], 0)
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


def _flow(
    camera: StereoCamera, depth_m: FloatArray, objects: IntArray, T_next_curr: FloatArray
) -> FloatArray:
    """Where each pixel goes, [height, width, 2], px, by the motion [G, 4, 4] of the object that it
    shows."""
    v, u = np.mgrid[: depth_m.shape[0], : depth_m.shape[1]].astype(np.float64)
    ray = np.stack(
        [(u - camera.cu_px) / camera.fu_px, (v - camera.cv_px) / camera.fv_px, np.ones_like(u)],
        axis=-1,
    )
    moved = np.empty_like(ray)
    for index in np.unique(objects):  # a point as ray and inverse depth: the sky has none
        shown = objects == index
        T = T_next_curr[index]
        moved[shown] = ray[shown] @ T[:3, :3].T + (1.0 / depth_m[shown])[:, None] * T[:3, 3]
    ahead = np.where(moved[..., 2] > 0.0, moved[..., 2], np.nan)
    return np.stack(
        [
            camera.fu_px * moved[..., 0] / ahead + camera.cu_px - u,
            camera.fv_px * moved[..., 1] / ahead + camera.cv_px - v,
        ],
        axis=-1,
    )


def _right_camera(camera: StereoCamera, size_px: tuple[int, int], error: float) -> FloatArray:
    """T_left_right of the rig as it is: as calibrated, but for a small turn of the right camera."""
    lever_px = (camera.fu_px, camera.fu_px, 0.5 * float(np.hypot(*size_px)))
    T_left_right = se3.exp(np.r_[0.0, 0.0, 0.0, error * np.array(CORNER_ERROR_PX) / lever_px])
    T_left_right[0, 3] = camera.baseline_m
    return T_left_right

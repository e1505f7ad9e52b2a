"""The height of the camera above the ground, estimated from images, to compare with a tape measure.

A point of the ground that the camera saw ahead is below it when it gets there. Its distance from
the path, perpendicular to it and downwards, is then the height of the camera. Only points that the
camera passes over count, within half its height to the left and to the right. So no plane has to be
fitted, and neither pavements beside the lane nor the pitch of the camera matter.

The height is y = (v − c_v) b/d: it has the same relative error as the baseline, and does not depend
on the focal length.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probevo.arrays import BoolArray, FloatArray, IntArray
from probevo.camera.rig_calibration import CONSTANT_SIGMA_PX
from probevo.camera.stereo import StereoCamera
from probevo.evaluation.clustered_regression import two_sided_p

FARTHEST = 12.0
"""Largest distance of a point, in units of its depth below the camera; farther ones are too
uncertain."""
HALF_WIDTH = 0.5
"""Half width of the strip below the camera, in units of its height: about a car's track."""
BLOCK_NS = 500_000_000
"""Smallest duration of a block; heights within a block share the motion of the suspension."""
MIN_POINTS = 3
"""Minimum number of points in a block."""
MIN_BLOCKS = 6
"""Minimum number of blocks for an estimate of the scatter."""
MAX_SIGMA = 0.03
"""Largest relative σ of a height that is reported: a handheld or flying camera has no constant
height."""


@dataclass(frozen=True)
class GroundHeight:
    """The height of the left camera above the ground below it, by the images."""

    height_m: float
    sigma_m: float
    """Standard deviation, from the scatter of blocks and a possible offset of all disparities."""
    num_blocks: int
    known_m: float | None = None
    """The height measured by other means, if it was."""

    @property
    def ratio(self) -> float | None:
        """The height over the known one, which equals the calibrated baseline over the true one;
        None if it is unknown."""
        return None if self.known_m is None else self.height_m / self.known_m

    @property
    def p_value(self) -> float | None:
        """Probability of a height at least as far from the known one, if that is correct."""
        if self.known_m is None:
            return None
        return two_sided_p((self.height_m - self.known_m) / self.sigma_m, self.num_blocks - 1)


class GroundHeights:
    """Collects the heights of a run, frame by frame; keeps 16 bytes of each block.

    Args:
        camera: the rectified camera.
        known_m: the height that was measured otherwise, if it was.
    """

    def __init__(self, camera: StereoCamera, known_m: float | None = None) -> None:
        self._camera = camera
        self._known_m = known_m
        self._ids: IntArray = np.zeros(0, np.int64)
        self._points_m: FloatArray = np.zeros((0, 3))
        """Points ahead as last seen, in the frame of the current camera, [N, 3]."""
        self._disparity_px: FloatArray = np.zeros(0)
        """Disparity of the points when last seen, [N], px."""
        self._start_ns = 0
        """When the current block began."""
        self._block: list[FloatArray] = []
        """Height and disparity of the points that were passed in the current block, [2] each."""
        self._medians: list[FloatArray] = []
        """Medians of the blocks before, [2] each."""

    def add(
        self,
        stamp_ns: int,
        T_curr_prev: FloatArray,
        ids: IntArray,
        pixels: FloatArray,
        *,
        is_ok: bool,
    ) -> None:
        """Process the next frame.

        Args:
            stamp_ns: time of the frame.
            T_curr_prev: the motion to this frame, [4, 4], m.
            ids: identities of the tracks that the solve used, [N].
            pixels: their observations in this frame, corrected, [N, 4], px.
            is_ok: whether the motion was solved; otherwise all points are dropped.
        """
        if is_ok:
            self._pass_over(stamp_ns, T_curr_prev)
        else:
            self._keep(np.zeros(len(self._ids), np.bool_))
        self._see(ids, pixels)

    def height(self) -> GroundHeight | None:
        """Return the median height of all complete blocks.

        None if the camera passed over too few points that it had seen, or if its height varies.
        """
        count = len(self._medians)
        if count < MIN_BLOCKS:
            return None
        height_m, disparity_px = np.array(self._medians).T
        median_m = float(np.median(height_m))
        # For Gaussian errors, the variance of a median is π/2 times the variance of the mean.
        scatter_ratio = np.sqrt(0.5 * np.pi / count) * float(np.std(height_m, ddof=1)) / median_m
        # An offset δ of all disparities changes y = (v − c_v) b/d by −δ/d of itself.
        offset_ratio = CONSTANT_SIGMA_PX / float(np.median(disparity_px))
        sigma = float(np.hypot(scatter_ratio, offset_ratio))
        if not 0.0 < sigma < MAX_SIGMA:
            return None
        return GroundHeight(median_m, sigma * median_m, count, self._known_m)

    def _pass_over(self, stamp_ns: int, T_curr_prev: FloatArray) -> None:
        """Move the points to the current frame, and measure those that the camera has passed."""
        # All of this is in the frame of the current camera, which is at the origin.
        self._points_m = self._points_m @ T_curr_prev[:3, :3].T + T_curr_prev[:3, 3]
        moved_m = -T_curr_prev[:3, 3]  # from the previous place of the camera to the current one
        length_m = float(np.linalg.norm(moved_m))
        if length_m < 1e-6:
            return
        ahead = moved_m / length_m
        # Axes of the path: ahead, aside (the camera's x without its part along the path), and down,
        # which complete a right-handed frame as z, x and y of a camera that looks ahead.
        aside = np.array([1.0, 0.0, 0.0]) - ahead[0] * ahead
        if np.linalg.norm(aside) < HALF_WIDTH:  # it moves sideways
            return
        aside /= np.linalg.norm(aside)
        down = np.cross(ahead, aside)
        along_m = (self._points_m + moved_m) @ ahead  # from the previous place of the camera
        height_m = self._points_m @ down
        # A point counts if the camera has passed its foot on the path in this step, and if it is in
        # the strip below the camera; a point above the path has a negative height, and fails.
        is_below = np.abs(self._points_m @ aside) < HALF_WIDTH * height_m
        is_passed = (along_m >= 0.0) & (along_m < length_m)
        is_measured = is_passed & is_below
        if is_measured.any() and not self._block:
            self._start_ns = stamp_ns
        self._block += list(
            np.column_stack([height_m[is_measured], self._disparity_px[is_measured]])
        )
        # One median a block; points that are still ahead are kept for later steps.
        if len(self._block) >= MIN_POINTS and stamp_ns - self._start_ns >= BLOCK_NS:
            self._medians.append(np.median(self._block, axis=0))
            self._block = []
        self._keep(along_m >= length_m)

    def _see(self, ids: IntArray, pixels: FloatArray) -> None:
        """Store points that may be on the ground ahead; those seen again replace the old ones."""
        disparity_px = pixels[:, 0] - pixels[:, 2]
        is_near = disparity_px > 0.0
        points_m = self._camera.triangulate(pixels[is_near])
        # It fails for points at or above the height of the camera, whose y is not positive.
        is_ground = points_m[:, 2] < FARTHEST * points_m[:, 1]
        near = np.flatnonzero(is_near)[is_ground]
        self._keep(~np.isin(self._ids, ids[near]))
        self._ids = np.concatenate([self._ids, ids[near]])
        self._points_m = np.concatenate([self._points_m, points_m[is_ground]])
        self._disparity_px = np.concatenate([self._disparity_px, disparity_px[near]])

    def _keep(self, kept: BoolArray) -> None:
        """Drop all points except some, given by a mask [N]."""
        self._ids = self._ids[kept]
        self._points_m = self._points_m[kept]
        self._disparity_px = self._disparity_px[kept]

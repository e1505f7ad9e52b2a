"""Features of the rig itself: they stay where they are in both images while the camera moves.

A hood, a bumper, an arm, or a logo in the images looks like a scene at rest. The motion that the
other features agree on tells which do not belong to the scene. Where the odometry takes them for
the scene (``estimation.vehicle_parts``), the path is at rest, with a claim of millimetres.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from probevo.arrays import BoolArray, FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.camera.transfer import transfer
from probevo.tracking.tracks import Tracks

STILL_PX = 0.5
"""A feature stays where it is if none of its four coordinates moves farther than this: two to three
standard deviations of a tracked place."""
MIN_SHIFT_PX = 3.0
"""A feature should have moved if the motion shifts it by this at least in the left image: six times
as far as it may, so that no error of a motion that is about right makes a feature fixed."""


class FixedFeatures(NamedTuple):
    """Features of a run that stayed where they are although the motion should have moved them,
    summed over its steps."""

    num_moving: int
    """Number of features that the motion should have moved, these included."""
    num_fixed: int
    center_px: tuple[float, float]
    """Mean of their places (u, v) in the left image, px."""
    spread_px: tuple[float, float]
    """Standard deviation of these, px."""

    @property
    def share(self) -> float:
        """Their share of the features that should have moved; 0 without any."""
        return self.num_fixed / max(self.num_moving, 1)


class StepsAtRest(NamedTuple):
    """Steps of a run whose motion leaves its features where they are, and what moves in them."""

    num_steps: int
    """Number of all steps that were solved."""
    num_at_rest: int
    """Number of steps that shift half of their features by no more than ``STILL_PX``."""
    num_features: int
    """Sum of the features of the steps at rest."""
    num_passing: int
    """Sum of those features of the steps at rest that moved by ``MIN_SHIFT_PX`` at least, as the
    scene does before a part of the vehicle that holds the path at rest, or traffic before a camera
    at rest."""


class FixedFeatureCount:
    """Counts features that are fixed to the vehicle, and steps at rest, step by step.

    Args:
        camera: the rectified camera.
    """

    def __init__(self, camera: StereoCamera) -> None:
        self._camera = camera
        self._num_moving = 0
        self._num_fixed = 0
        self._sum_px = np.zeros(2)
        self._sum_px2 = np.zeros(2)
        self._steps = StepsAtRest(0, 0, 0, 0)

    def add(
        self, tracks: Tracks, T_curr_prev: FloatArray, vehicle_tracks: Tracks | None = None
    ) -> None:
        """Take the tracks of a step and its motion.

        Args:
            tracks: the tracks that may belong to the scene.
            T_curr_prev: the motion, [4, 4], m.
            vehicle_tracks: the tracks known to be fixed to the vehicle; None for none.
        """
        if vehicle_tracks is not None:
            self._count_fixed(vehicle_tracks, shifts_px(vehicle_tracks, T_curr_prev, self._camera))
        if not len(tracks):
            return
        shift_px = shifts_px(tracks, T_curr_prev, self._camera)
        self._count_fixed(tracks, shift_px)
        is_at_rest = float(np.median(shift_px)) <= STILL_PX
        moved_px = np.linalg.norm(tracks.curr_px[:, :2] - tracks.prev_px[:, :2], axis=1)
        num_passing = int((moved_px >= MIN_SHIFT_PX).sum())
        before = self._steps
        self._steps = StepsAtRest(
            num_steps=before.num_steps + 1,
            num_at_rest=before.num_at_rest + is_at_rest,
            num_features=before.num_features + is_at_rest * len(tracks),
            num_passing=before.num_passing + is_at_rest * num_passing,
        )

    def _count_fixed(self, tracks: Tracks, shift_px: FloatArray) -> None:
        """Count which of N tracks stay where they are although the motion shifts them, [N], px."""
        should_move = shift_px >= MIN_SHIFT_PX
        places_px = tracks.curr_px[should_move & are_still(tracks), :2]
        self._num_moving += int(should_move.sum())
        self._num_fixed += len(places_px)
        self._sum_px += places_px.sum(axis=0)
        self._sum_px2 += (places_px**2).sum(axis=0)

    @property
    def steps_at_rest(self) -> StepsAtRest:
        """Return which steps are at rest, and what moves in them."""
        return self._steps

    def total(self) -> FixedFeatures | None:
        """Return the sum over all steps; None if no feature was fixed."""
        if self._num_fixed == 0:
            return None
        mean_px = self._sum_px / self._num_fixed
        spread_px = np.sqrt(np.maximum(self._sum_px2 / self._num_fixed - mean_px**2, 0.0))
        return FixedFeatures(
            num_moving=self._num_moving,
            num_fixed=self._num_fixed,
            center_px=(float(mean_px[0]), float(mean_px[1])),
            spread_px=(float(spread_px[0]), float(spread_px[1])),
        )


def are_still(tracks: Tracks) -> BoolArray:
    """Return which of N tracks stay where they are in both images, [N]."""
    moved_px = np.abs(tracks.curr_px - tracks.prev_px)
    still: BoolArray = np.all(moved_px <= STILL_PX, axis=1)
    return still


def shifts_px(tracks: Tracks, T_curr_prev: FloatArray, camera: StereoCamera) -> FloatArray:
    """Return how far a motion shifts each of N tracks in the left image, [N], px; 0 where it takes
    them behind the camera.

    Args:
        tracks: their previous observations count.
        T_curr_prev: the motion, [4, 4], m.
        camera: the rectified camera.
    """
    # What has no disparity, as an overlay in both images, is shifted like a point at infinity.
    before_px = tracks.prev_px.copy()
    before_px[:, 2] = np.minimum(before_px[:, 2], before_px[:, 0])
    after_px = transfer(before_px, T_curr_prev, camera)
    shift_px = np.linalg.norm(after_px[:, :2] - before_px[:, :2], axis=1)
    return np.where(np.isnan(shift_px), 0.0, shift_px)

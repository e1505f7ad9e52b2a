"""The smoothed path of a run: each pose as it was when it left the window."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from probevo.arrays import FloatArray
from probevo.estimation.window.window import Window
from probevo.output.rows import Rows


class SmoothedPoses(NamedTuple):
    """Poses of N frames, with the information of all later frames of the window."""

    T_world_cam: FloatArray
    """[N, 4, 4], m."""
    cov: FloatArray
    """Covariance of the left perturbation of T_cam_world, [N, 6, 6], m and rad."""


_SMOOTHED = np.dtype(
    [("frame", np.int64), ("T_world_cam", np.float64, (4, 4)), ("cov", np.float64, (6, 6))]
)
"""A ``SmoothedPose``, 424 bytes."""


class SmoothedPath:
    """Collects the poses that leave the window."""

    def __init__(self) -> None:
        self._left = Rows(_SMOOTHED)

    def add(self, window: Window | None) -> None:
        """Take the poses that left the window in the last step; those taken before may be among
        them."""
        if window is not None:
            for pose in window.marginalized:
                self._left.add(np.array((pose.frame, pose.T_world_cam, pose.cov), _SMOOTHED))

    def poses(
        self, window: Window | None, *, num_frames: int | None = None
    ) -> SmoothedPoses | None:
        """Return the poses of all frames, whether they have left the window or are still in it.

        Args:
            window: the current window; None if there is none, and no poses either.
            num_frames: leave out the frames from this number on; None for all.
        """
        if window is None:
            return None
        poses = [window.pose(slot) for slot in range(len(window))]
        held_poses = [(pose.frame, pose.T_world_cam, pose.cov) for pose in poses]
        rows = np.concatenate([self._left.table(), np.array(held_poses, _SMOOTHED)])
        # One row a frame, in their order: a blind frame leaves before those that features connect,
        # and a pose may have been added again.
        frames, row_indices = np.unique(rows["frame"], return_index=True)
        if num_frames is not None:
            row_indices = row_indices[frames < num_frames]
        chosen = rows[row_indices]
        return SmoothedPoses(T_world_cam=chosen["T_world_cam"], cov=chosen["cov"])

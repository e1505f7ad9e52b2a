"""Drift over segments of given length, as in the KITTI odometry devkit (evaluate_odometry.cpp).

The devkit knows the truth of every frame. A segment then ends at most one frame step beyond its
nominal length, by which its errors are divided. Where the truth is sparser, the next known frame
may be far beyond; such errors are divided by the length that the segment really has.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.evaluation.trajectory_errors import distance_along_path
from probevo.geometry import se3, so3

KITTI_LENGTHS_M = (100.0, 200.0, 300.0, 400.0, 500.0, 600.0, 700.0, 800.0)
"""The devkit's lengths; its segments start at every tenth frame."""
SHORT_LENGTHS_M = (10.0, 20.0, 30.0, 40.0, 50.0)
"""Lengths for recordings too short for the official ones; segments start at every frame."""


@dataclass(frozen=True)
class SegmentErrors:
    """Drift over S segments."""

    first: IntArray
    """Index of the frame at which each segment starts, [S]."""
    length_m: FloatArray
    """Nominal length, [S]."""
    translation: FloatArray
    """Error of the end position over the length (``segment_errors`` says which), [..., S], m/m; the
    leading dimensions enumerate the paths."""
    rotation_rad_m: FloatArray
    """Angle of the rotation error at the end over the length, [..., S]."""

    @property
    def mean_translation_percent(self) -> float | None:
        """Average over all segments; None without one."""
        return float(100.0 * self.translation.mean()) if len(self.first) else None

    @property
    def mean_rotation_deg_per_m(self) -> float | None:
        """Average over all segments; None without one."""
        return float(np.rad2deg(self.rotation_rad_m.mean())) if len(self.first) else None


def segment_errors(
    T_world_cam_est: FloatArray,
    T_world_cam_true: FloatArray,
    lengths_m: tuple[float, ...],
    starts: IntArray,
    *,
    frames: IntArray | None = None,
) -> SegmentErrors:
    """Compute the errors of all segments that fit into the true path of K frames.

    A segment ends at the first frame that is farther from its start along the true path than
    its length, as in the devkit, and its errors are divided by that nominal length. If
    it ends after a gap of the truth, and exceeds the nominal length by more than the mean step of
    the frames in this gap, they are divided by the distance along the true path instead.

    Args:
        T_world_cam_est: estimated poses of one path or of many, [..., K, 4, 4], m.
        T_world_cam_true: true poses, [K, 4, 4], m, all known.
        lengths_m: nominal lengths.
        starts: index of each frame at which segments start, among the K.
        frames: index of each of the K frames in the recording, ascending, [K]; without gaps by
            default.
    """
    # All pairs of a start and a length, and the frame at which each segment ends.
    distance = distance_along_path(T_world_cam_true)
    first = np.repeat(starts, len(lengths_m))
    length = np.tile(np.asarray(lengths_m, dtype=np.float64), len(starts))
    last = np.searchsorted(distance, distance[first] + length, side="right")
    fits = last < len(distance)  # the path does not end before the segment
    first = first[fits]
    last = last[fits]
    nominal = length[fits]
    if frames is None:
        frames = np.arange(len(distance))
    divisor = _divisor(distance, frames, first, last, nominal=nominal)
    # Relative poses over each segment, [..., S, 4, 4], which do not depend on the world frames. The
    # error is the estimated one, inverted, times the true one.
    T_first_last_true = se3.inverse(T_world_cam_true[first]) @ T_world_cam_true[last]
    first_est = T_world_cam_est[..., first, :, :]
    last_est = T_world_cam_est[..., last, :, :]
    T_first_last_est = se3.inverse(first_est) @ last_est
    error = se3.inverse(T_first_last_est) @ T_first_last_true
    return SegmentErrors(
        first=first,
        length_m=nominal,
        translation=np.linalg.norm(error[..., :3, 3], axis=-1) / divisor,
        rotation_rad_m=np.linalg.norm(so3.log(error[..., :3, :3]), axis=-1) / divisor,
    )


def _divisor(
    distance: FloatArray, frames: IntArray, first: IntArray, last: IntArray, *, nominal: FloatArray
) -> FloatArray:
    """Return the length by which the errors of S segments are divided, [S], m.

    Args:
        distance: along the true path at each of the K frames that are known, [K], m.
        frames: their indices in the recording, [K].
        first: the frame at which each segment starts, among the K, [S].
        last: the one at which it ends, [S].
        nominal: length of each segment, [S], m.
    """
    # Number of frame steps since the frame before the end, and their mean length.
    steps = frames[last] - frames[last - 1]
    step_m = (distance[last] - distance[last - 1]) / steps
    length = distance[last] - distance[first]
    is_far_beyond = (steps > 1) & (length - nominal > step_m)
    return np.where(is_far_beyond, length, nominal)

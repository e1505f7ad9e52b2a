"""The stereo matches of a recording's first frames, as the odometry would find them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.run_config import RunConfig
from probevo.sequences.frame import Frame
from probevo.tracking import TrackingState, tracker_for
from probevo.tracking.left_right import count_matches


@dataclass(frozen=True)
class FirstMatches:
    """The matches of some successive frames: N tracks, and those that were rejected."""

    num_frames: int
    num_positive: int
    """Matches with positive disparity."""
    num_negative: int
    """Matches with negative disparity, nearly all of which are rejected."""
    pixels: FloatArray
    """(u_l, v_l, u_r, v_r) of the tracks, [N, 4], px."""

    @property
    def num_per_frame(self) -> float:
        """Tracks per frame; the first frame has none yet."""
        return len(self.pixels) / (self.num_frames - 1)

    @property
    def disparity_px(self) -> FloatArray:
        """Disparity of the tracks, [N], px."""
        return self.pixels[:, 0] - self.pixels[:, 2]

    @property
    def row_offset_px(self) -> FloatArray:
        """Distance by which the tracks are lower in the right image, [N], px."""
        return self.pixels[:, 3] - self.pixels[:, 1]


def first_matches(frames: Sequence[Frame], camera: StereoCamera) -> FirstMatches:
    """Track frames as the odometry would, but without any prediction.

    Args:
        frames: successive frames, at least one.
        camera: the camera that took them.
    """
    tracker = tracker_for(frames[0], camera, RunConfig().tracking_of_estimator)
    state = TrackingState.none()
    pixels = []
    num_positive = 0
    num_negative = 0
    for frame in frames:
        tracked = tracker.track(state, frame, np.eye(4))
        state = tracked.state
        pixels.append(tracked.tracks.curr_px)
        positive, negative = count_matches(tracked.tracks)
        num_positive += positive
        num_negative += negative
    return FirstMatches(len(frames), num_positive, num_negative, pixels=np.concatenate(pixels))

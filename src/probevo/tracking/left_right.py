"""Detection of left and right images that are swapped, or the same.

The calibration does not reveal it. Of swapped images, the first stereo matches do: their disparity
is negative. So it is for most matches of an image with itself, whose disparities are noise.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from probevo.errors import InputError
from probevo.sequences.format_options import BAG_SUFFIXES
from probevo.sequences.frame import Frame
from probevo.tracking.tracks import NEGATIVE_DISPARITY, Tracks

FRAMES_TO_SEE = 3
"""Number of steps whose matches are counted before the check."""
MIN_MATCHES = 30
"""With fewer matches, nothing is decided."""
MAX_BEHIND = 0.8
"""Share of matches with negative disparity beyond which the images count as swapped.

It is over 0.9 for swapped recordings of KITTI and EuRoC, under 0.01 for correct ones, and one half
where everything is too far away for a decision."""

SWAP_COLUMNS = "Exchange columns 0 and 2, and 1 and 3."
"""The cure for features, (u_l, v_l, u_r, v_r)."""


class SwappedImagesError(InputError):
    """The left images come from the right camera, which makes every result wrong."""


class IdenticalImagesError(InputError):
    """The left and right images are the same, which show no depth and no motion."""


def count_matches(tracks: Tracks) -> tuple[int, int]:
    """Count the stereo matches of one step with positive and with negative disparity.

    Matches that the tracker has rejected for their negative disparity are included. Their windows
    look alike: elsewhere, Lucas–Kanade only did not find the true place.
    """
    is_positive = tracks.curr_px[:, 0] >= tracks.curr_px[:, 2]
    num_positive = int(is_positive.sum())
    num_negative = int((~is_positive).sum())
    return num_positive, num_negative + tracks.rejected.get(NEGATIVE_DISPARITY, 0)


def looks_swapped(num_positive: int, num_negative: int) -> bool:
    """Tell whether so many matches of positive and negative disparity mean swapped images."""
    num_matches = num_positive + num_negative
    return num_matches >= MIN_MATCHES and num_negative > MAX_BEHIND * num_matches


def are_identical(frame: Frame) -> bool:
    """Return whether the left and right images of a frame are the same, byte by byte."""
    if frame.left is None or frame.right is None:
        return False
    return np.array_equal(frame.left, frame.right)


class LeftRightCheck:
    """Refuses a recording whose left images come from the right camera, or are its right ones, by
    its first steps.

    Args:
        recording: its path, for the message.
        num_frames: number of frames of the recording; all are counted if it is short.
    """

    def __init__(self, recording: str | Path, num_frames: int) -> None:
        self._recording = recording
        self._decides_at = min(FRAMES_TO_SEE, num_frames - 1)
        self._num_positive = 0
        self._num_negative = 0
        self._num_seen = 0
        self._are_identical = True

    def see(self, frame: Frame, tracks: Tracks) -> None:
        """Count the matches of one more frame, the first one included.

        Raises:
            IdenticalImagesError: the left and right images so far are the same, and have matches.
            SwappedImagesError: nearly all matches so far have negative disparity.
        """
        if self._num_seen > self._decides_at:
            return
        num_positive, num_negative = count_matches(tracks)
        self._num_positive += num_positive
        self._num_negative += num_negative
        self._num_seen += 1
        self._are_identical = self._are_identical and are_identical(frame)
        if self._num_seen <= self._decides_at:
            return
        # Images without matches, such as black ones, may differ later on.
        if self._are_identical and self._num_positive + self._num_negative >= MIN_MATCHES:
            raise IdenticalImagesError(
                self._recording,
                f"left and right images are identical in the first {self._num_seen} frames.",
                "They show no depth and no motion. Is one of the two cameras given twice?",
            )
        check_left_right(self._num_positive, self._num_negative, self._recording)


def check_left_right(
    num_positive: int, num_negative: int, where: str | Path, *, cure: str | None = None
) -> None:
    """Refuse matches of left images that come from the right camera.

    Args:
        num_positive: number of stereo matches with positive disparity.
        num_negative: number of those with negative disparity, as of points behind the camera.
        where: the recording, for the message.
        cure: how to exchange them; by default what applies to a recording of that name.

    Raises:
        SwappedImagesError: nearly all matches have negative disparity.
    """
    if looks_swapped(num_positive, num_negative):
        raise SwappedImagesError(
            where,
            f"{num_negative} of the first {num_positive + num_negative} stereo matches have"
            " negative disparity.",
            f"Are left and right swapped? {cure or how_to_swap(where)}",
        )


def check_features(tracks: Tracks, where: str) -> None:
    """Refuse tracks of features whose left and right are swapped, which have no recording.

    Args:
        tracks: of one step.
        where: what they are, for the message.

    Raises:
        SwappedImagesError: nearly all of them have negative disparity.
    """
    num_positive, num_negative = count_matches(tracks)
    check_left_right(num_positive, num_negative, where, cure=SWAP_COLUMNS)


def how_to_swap(recording: str | Path) -> str:
    """Say how to exchange left and right in a recording of this name."""
    path = Path(recording)
    suffix = path.suffix.lower()
    if suffix == ".npz":
        return f"{SWAP_COLUMNS[:-1]}, of uv."
    if suffix in BAG_SUFFIXES or (path / "metadata.yaml").is_file():
        return "Exchange --topics.left and --topics.right."
    if path.is_file():
        return "Exchange the two halves of the images."
    return "Exchange the two image folders, or the two videos."

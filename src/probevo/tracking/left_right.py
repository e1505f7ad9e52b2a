"""Have left and right been swapped? The calibration cannot tell; the first stereo matches can."""

from __future__ import annotations

from pathlib import Path

from probevo.errors import InputError
from probevo.tracking.tracks import Tracks

FRAMES_TO_SEE = 3
"""Steps after which the matches are judged."""
FEWEST_MATCHES = 30
MOST_BEHIND = 0.8
"""Share of matches with negative disparity beyond which the images are swapped. It is over 0.98 for
swapped recordings of KITTI and EuRoC, under 0.05 for right ones, and one half where everything is
too far away to tell."""


class SwappedImagesError(InputError):
    """The left images come from the right camera: whatever follows from them is worth nothing."""


def count_matches(tracks: Tracks) -> tuple[int, int]:
    """Stereo matches of one step with positive and with negative disparity, those that the tracker
    refused included."""
    in_front = tracks.curr_px[:, 0] >= tracks.curr_px[:, 2]
    return int(in_front.sum()), int((~in_front).sum()) + tracks.rejected.get(
        "negative disparity", 0
    )


def looks_swapped(ahead: int, behind: int) -> bool:
    """Whether the stereo matches with positive (``ahead``) and negative disparity can only come
    from swapped images."""
    return ahead + behind >= FEWEST_MATCHES and behind > MOST_BEHIND * (ahead + behind)


def check_left_right(ahead: int, behind: int, where: str | Path) -> None:
    """Refuse a recording whose left images come from the right camera.

    Args:
        ahead: number of stereo matches with positive disparity.
        behind: number of those with negative disparity, as of points behind the camera.
        where: the recording, for the message.

    Raises:
        SwappedImagesError: nearly all matches have negative disparity.
    """
    if looks_swapped(ahead, behind):
        what = f"{behind} of the first {ahead + behind} stereo matches have negative disparity."
        raise SwappedImagesError(where, what, f"Are left and right swapped? {exchange(where)}")


def exchange(recording: str | Path) -> str:
    """What to do where left and right are swapped; a recording that is a file holds features, not
    images."""
    if Path(recording).is_file():
        return "Exchange columns 0 and 2, and 1 and 3, of uv."
    return "Exchange the two image folders."

"""Detection of swapped left and right images.

The calibration does not reveal it, but the first stereo matches do: their disparity is negative.
"""

from __future__ import annotations

from pathlib import Path

from probevo.errors import InputError
from probevo.tracking.tracks import Tracks

FRAMES_TO_SEE = 3
"""Number of steps whose matches are counted before the check."""
FEWEST_MATCHES = 30
"""With fewer matches, nothing is decided."""
MOST_BEHIND = 0.8
"""Share of matches with negative disparity beyond which the images count as swapped.

It is over 0.9 for swapped recordings of KITTI and EuRoC, under 0.01 for correct ones, and one half
where everything is too far away for a decision."""


class SwappedImagesError(InputError):
    """The left images come from the right camera, which makes every result wrong."""


def count_matches(tracks: Tracks) -> tuple[int, int]:
    """Count the stereo matches of one step with positive and with negative disparity.

    Matches that the tracker has rejected for their negative disparity are included. Their windows
    look alike: elsewhere, Lucas–Kanade only did not find the true place.
    """
    is_positive = tracks.curr_px[:, 0] >= tracks.curr_px[:, 2]
    num_positive = int(is_positive.sum())
    num_negative = int((~is_positive).sum())
    return num_positive, num_negative + tracks.rejected.get("negative disparity", 0)


def looks_swapped(num_positive: int, num_negative: int) -> bool:
    """Tell whether so many matches of positive and negative disparity mean swapped images."""
    num_matches = num_positive + num_negative
    return num_matches >= FEWEST_MATCHES and num_negative > MOST_BEHIND * num_matches


def check_left_right(num_positive: int, num_negative: int, where: str | Path) -> None:
    """Refuse a recording whose left images come from the right camera.

    Args:
        num_positive: number of stereo matches with positive disparity.
        num_negative: number of those with negative disparity, as of points behind the camera.
        where: the recording, for the message.

    Raises:
        SwappedImagesError: nearly all matches have negative disparity.
    """
    if looks_swapped(num_positive, num_negative):
        raise SwappedImagesError(
            where,
            f"{num_negative} of the first {num_positive + num_negative} stereo matches have"
            " negative disparity.",
            f"Are left and right swapped? {how_to_swap(where)}",
        )


def how_to_swap(recording: str | Path) -> str:
    """Say how to exchange left and right in a recording of this name."""
    path = Path(recording)
    suffix = path.suffix.lower()
    if suffix == ".npz":
        return "Exchange columns 0 and 2, and 1 and 3, of uv."
    if suffix in (".bag", ".mcap", ".db3") or (path / "metadata.yaml").is_file():
        return "Exchange --topics.left and --topics.right."
    if path.is_file():
        return "Exchange the two halves of the images."
    return "Exchange the two image folders, or the two videos."

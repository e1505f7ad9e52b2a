"""The frames of a recording, whose indices are their places."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from probevo.errors import InputError
from probevo.sequences.base import first_frames
from probevo.sequences.frame import Frame
from worlds import drive


@dataclass
class Recording:
    """A user's own recording."""

    frames: list[Frame]
    path: Path = Path("mine")

    def __len__(self) -> int:
        return len(self.frames)

    def __iter__(self) -> object:
        return iter(self.frames)


def frames_of(recording: Recording, num_frames: int) -> list[Frame]:
    return list(first_frames(recording, num_frames))  # type: ignore[arg-type]


def test_they_are_those_of_the_recording() -> None:
    frames = drive(np.random.default_rng(0), 5)
    assert frames_of(Recording(frames), 3) == frames[:3]
    assert frames_of(Recording(frames), 9) == frames


@pytest.mark.parametrize(("first", "step", "message"), [(0, 2, "frame 1 of"), (1, 1, "frame 0 of")])
def test_an_index_that_is_not_its_place_is_refused(first: int, step: int, message: str) -> None:
    """The files of results have a row for each frame, in their order."""
    frames = drive(np.random.default_rng(0), 3)
    numbered = [replace(frame, index=first + step * k) for k, frame in enumerate(frames)]
    with pytest.raises(InputError, match=message) as caught:
        frames_of(Recording(numbered), 3)
    assert str(caught.value).startswith("mine: ")

"""Recordings below and above a folder that is no recording, for the message that refuses it."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Protocol

DEEPEST = 3
"""Folders below the given one that are searched; KITTI raw is two deep, below the date."""
HIGHEST = 3
"""Folders above the given one that are looked at; the images of EuRoC are three deep, in mav0."""
MAX_LOOKED_AT = 1000
"""Files and folders after which the search ends: a home folder would take minutes."""
MAX_NAMED = 4


class Recogniser(Protocol):
    """A recording format, as far as it is needed to recognise a recording."""

    @property
    def folder_signs(self) -> tuple[str, ...]:
        """Files or folders by which a folder is recognised."""

    def recognises(self, path: Path) -> bool:
        """Return whether an existing file or folder looks like a recording."""


def recordings_below(path: Path, formats: Iterable[Recogniser]) -> list[Path]:
    """Return the recordings below a folder, the nearest ones first, in the order of their names.

    Folders that cannot be read, and hidden ones, are passed over.

    Args:
        path: the folder.
        formats: the formats to look for. Those without a sign of a folder are left out: a single
            ``.npz`` file may be anything.
    """
    likely = [known for known in formats if known.folder_signs]
    recordings: list[Path] = []
    level = [path]
    looked_at = 0
    for _ in range(DEEPEST):
        following = []
        for entry in (entry for folder in level for entry in _entries(folder)):
            looked_at += 1
            if looked_at > MAX_LOOKED_AT:
                return recordings
            if any(known.recognises(entry) for known in likely):
                recordings.append(entry)
            elif entry.is_dir():
                following.append(entry)
        level = following
    return recordings


def recordings_above(path: Path, formats: Iterable[Recogniser]) -> list[Path]:
    """Return the nearest folder above a folder that is a recording, in a list; [] if none is.

    A folder of images, such as ``left``, is not a recording, but often given as one.

    Args:
        path: the folder.
        formats: the formats to look for.
    """
    likely = [known for known in formats if known.folder_signs]
    for folder in path.absolute().parents[:HIGHEST]:
        if any(known.recognises(folder) for known in likely):
            return [_as_given(folder, path)]
    return []


def _as_given(folder: Path, path: Path) -> Path:
    """Write a folder above ``path`` as the user would, relative if ``path`` is."""
    return next((above for above in path.parents if above.absolute() == folder), folder)


def suggestion(recordings: list[Path]) -> str:
    """Return what a message says of the recordings near a folder."""
    if len(recordings) == 1:
        return f"Did you mean {recordings[0]}?"
    names = ", ".join(str(path) for path in recordings[:MAX_NAMED])
    more = len(recordings) - MAX_NAMED
    return f"Did you mean one of {names}{f' and {more} more below it' if more > 0 else ''}?"


def _entries(folder: Path) -> list[Path]:
    """Return what a folder holds, but for hidden files; nothing if it cannot be read."""
    try:
        return sorted(entry for entry in folder.iterdir() if not entry.name.startswith("."))
    except OSError:
        return []

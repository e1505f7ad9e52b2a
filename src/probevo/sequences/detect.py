"""Finds out which format a recording has, and opens it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from probevo.errors import InputError
from probevo.sequences.base import Sequence
from probevo.sequences.euroc import open_euroc
from probevo.sequences.folder import open_folder
from probevo.sequences.kitti_odometry import open_kitti_odometry
from probevo.sequences.kitti_raw import open_kitti_raw
from probevo.sequences.tracks_file import open_tracks


class Format(NamedTuple):
    """How to know a format and how to open it."""

    signs: tuple[str, ...]
    """A recording of this format holds one of these files or folders."""
    open: Callable[[Path], Sequence]


FORMATS = {
    "kitti-raw": Format(("image_00",), open_kitti_raw),
    "kitti-odometry": Format(("image_0",), open_kitti_odometry),
    "euroc": Format(("mav0", "cam0"), open_euroc),
    "folder": Format(("calib.yaml", "left"), open_folder),
}
TRACKS = "tracks"
FORMAT_NAMES = (*FORMATS, TRACKS)


def open_sequence(path: str | Path, format: str | None = None) -> Sequence:
    """Open a recording and check all of it that can be checked without decoding images.

    Args:
        path: folder of the recording, or the ``.npz`` file of a tracks recording.
        format: one of ``FORMAT_NAMES``; None finds out.

    Raises:
        InputError: nothing is there, no format fits, or the recording is faulty.
    """
    path = Path(path)
    if format is not None and format not in FORMAT_NAMES:
        raise InputError(
            "format", f"{format!r} is not known.", f"Choose one of {', '.join(FORMAT_NAMES)}."
        )
    if not path.exists():
        raise InputError(
            path, "nothing is there.", "Give the folder of a recording, or a tracks file."
        )
    format = format or _detect(path)
    if path.is_dir() == (format == TRACKS):
        kinds = ("an .npz file", "a folder") if format == TRACKS else ("a folder", "a file")
        raise InputError(path, f"the format {format} needs {kinds[0]}, but this is {kinds[1]}.")
    return open_tracks(path) if format == TRACKS else FORMATS[format].open(path)


def _detect(path: Path) -> str:
    if path.is_file():
        if path.suffix == ".npz":
            return TRACKS
        raise InputError(
            path, "this file is no recording.", "Give a folder, or an .npz file of tracks."
        )
    for name, known in FORMATS.items():
        if any((path / sign).exists() for sign in known.signs):
            return name
    looked_for = "; ".join(
        f"{' or '.join(known.signs)} ({name})" for name, known in FORMATS.items()
    )
    inside = ", ".join(sorted(entry.name for entry in path.iterdir())[:8]) or "nothing"
    raise InputError(path, f"no known format; found {inside}.", f"Looked for {looked_for}.")

"""Files that are written: each appears whole or not at all, and a place that cannot be written to
is refused early.

Of files that are read: what a damaged archive raises.
"""

from __future__ import annotations

import os
import zlib
from contextlib import suppress
from pathlib import Path
from tokenize import TokenError
from zipfile import BadZipFile

from probevo.errors import InputError

NO_ARCHIVE = (
    OSError,
    ValueError,
    TypeError,
    EOFError,
    NotImplementedError,
    BadZipFile,
    zlib.error,
    TokenError,
)
"""What NumPy raises at an .npz file that is damaged, or none at all."""


def check_folder(folder: Path, option: str) -> None:
    """Refuse, without making anything, a folder into which files cannot be written.

    Args:
        folder: it may be missing as yet, and its parents too.
        option: how the user names it, for the message.

    Raises:
        InputError: a file is in the way, or the nearest folder that exists cannot be written to.
    """
    place = folder.absolute()
    while not os.path.lexists(place):
        place = place.parent
    if not place.is_dir():
        raise InputError(option, f"{place} is a file.", "Choose another output folder.")
    if not os.access(place, os.W_OK | os.X_OK):
        raise InputError(option, f"{place} cannot be written to.", "Choose another output folder.")


def write_atomically(path: Path, content: bytes | str, writer: str = "") -> None:
    """Write beside ``path`` and rename, so that an interrupted run leaves the old file or the new
    one, never half.

    Missing folders are made. Where two may write the same file at a time, each names itself as
    ``writer``. Raises InputError if the place cannot be written to.
    """
    data = content.encode() if isinstance(content, str) else content
    partial = path.with_name(f"{path.name}{writer}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.write_bytes(data)
        os.replace(partial, path)
    except OSError as error:
        with suppress(OSError):
            partial.unlink()
        raise InputError(
            path, f"cannot be written: {error.strerror}", "Choose another output folder."
        ) from error


def remove_stale(path: Path) -> None:
    """Remove what an earlier run left and this one does not write, lest it pass for a result of
    this one."""
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise InputError(
            path, f"cannot be removed: {error.strerror}", "Choose another output folder."
        ) from error

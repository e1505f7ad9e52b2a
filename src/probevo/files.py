"""Reading of regular files only, and writing of files that appear whole or not at all.

Bad output folders are refused early.
"""

from __future__ import annotations

import os
import stat
import zlib
from contextlib import suppress
from pathlib import Path
from tokenize import TokenError
from zipfile import BadZipFile

from probevo.errors import InputError

CHOOSE_ANOTHER = "Choose another output folder."
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
"""The exceptions that NumPy raises for an .npz file that is damaged or of another kind."""


def check_regular(path: Path, most_bytes: int) -> None:
    """Refuse a file that cannot be read to its end: a pipe, a device, or one of endless size.

    A file that is missing or a folder is left to whoever opens it.

    Args:
        path: the file.
        most_bytes: the largest plausible size.

    Raises:
        InputError: says which.
    """
    try:
        found = path.stat()
    except OSError:
        return
    if not stat.S_ISREG(found.st_mode) and not stat.S_ISDIR(found.st_mode):
        raise InputError(path, "this is a pipe or a device, not a file.", "Copy it to a file.")
    if found.st_size > most_bytes:
        what = f"this file has {found.st_size:,} bytes; expected at most {most_bytes:,}."
        raise InputError(path, what, "Is it the right file?")


def check_folder(folder: Path, option: str) -> None:
    """Refuse a folder into which files cannot be written; nothing is created.

    Args:
        folder: the folder; it and its parents may still be missing.
        option: the flag that names the folder, for the message.

    Raises:
        InputError: the path leads through a file, or the nearest existing folder is not writable.
    """
    place = folder.absolute()
    while not os.path.lexists(place):
        place = place.parent
    if not place.is_dir():
        raise InputError(option, f"{place} is a file.", CHOOSE_ANOTHER)
    if not os.access(place, os.W_OK | os.X_OK):
        raise InputError(option, f"{place} cannot be written to.", CHOOSE_ANOTHER)


def write_atomically(path: Path, content: bytes | str, writer: str = "") -> None:
    """Write a file so that an interruption leaves the old content or the new one, never a part.

    The content goes to a temporary file beside ``path``, which then replaces it.

    Args:
        path: the file; missing folders are created.
        content: text is encoded as UTF-8.
        writer: name of this process, if several may write the same file at once.

    Raises:
        InputError: the place is not writable.
    """
    data = content.encode() if isinstance(content, str) else content
    partial = path.with_name(f"{path.name}{writer}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.write_bytes(data)
        partial.replace(path)
    except OSError as error:
        with suppress(OSError):
            partial.unlink()
        raise InputError(path, f"cannot be written: {error.strerror}", CHOOSE_ANOTHER) from error


def remove_stale(path: Path) -> None:
    """Remove a file of an earlier run that could be mistaken for a result of this one.

    Raises:
        InputError: the file cannot be removed.
    """
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise InputError(path, f"cannot be removed: {error.strerror}", CHOOSE_ANOTHER) from error

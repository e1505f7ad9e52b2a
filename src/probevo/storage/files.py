"""Reading of regular files only, and writing of files that appear whole or not at all.

Bad output folders are refused early.
"""

from __future__ import annotations

import os
import re
import secrets
import shutil
import socket
import stat
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
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
        status = path.stat()
    except OSError:
        return
    if not stat.S_ISREG(status.st_mode) and not stat.S_ISDIR(status.st_mode):
        raise InputError(path, "this is a pipe or a device, not a file.", "Copy it to a file.")
    if status.st_size > most_bytes:
        what = f"this file has {status.st_size:,} bytes; expected at most {most_bytes:,}."
        raise InputError(path, what, "Is it the right file?")


def name_as_text(path: Path) -> str:
    """Return the name of a file or folder, with ? for bytes that are no text: JSON cannot hold
    them, so that a model whose facts had one could not be read."""
    return path.resolve().name.encode("utf-8", "replace").decode()


def check_folder(folder: Path, option: str) -> None:
    """Refuse a folder into which files cannot be written; nothing is created.

    Args:
        folder: the folder; it and its parents may still be missing.
        option: the flag that names the folder, for the message.

    Raises:
        InputError: the path leads through a file, the nearest existing folder is not writable, or
            there is none.
    """
    place = folder.absolute()
    while not os.path.lexists(place):
        if place == place.parent:  # such as a drive of Windows that is not there
            raise InputError(option, f"{place} does not exist.", CHOOSE_ANOTHER)
        place = place.parent
    if not place.is_dir():
        raise InputError(option, f"{place} is a file.", CHOOSE_ANOTHER)
    if not os.access(place, os.W_OK | os.X_OK):
        raise InputError(option, f"{place} cannot be written to.", CHOOSE_ANOTHER)


def write_atomically(path: Path, content: bytes | str) -> None:
    """Write a file so that an interruption leaves the old content or the new one, never a part.

    The content goes to a temporary file beside ``path``, which then replaces it. Its name is of
    this call alone, so that of several writers at once one wins, with the whole of its content.

    Args:
        path: the file; missing folders are created.
        content: text is encoded as UTF-8.

    Raises:
        InputError: the place is not writable.
    """
    # A name of a file that is no text, but other bytes, is written with ? in their place.
    data = content.encode("utf-8", "replace") if isinstance(content, str) else content
    partial = _partial(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _remove_abandoned(path.parent.absolute())
        with partial.open("xb") as file:  # x: follows no link, and opens no file of others
            file.write(data)
        partial.replace(path)
    except OSError as error:
        raise InputError(path, f"cannot be written: {error.strerror}", CHOOSE_ANOTHER) from error
    finally:
        with suppress(OSError):
            partial.unlink(missing_ok=True)


@contextmanager
def written_together(folder: Path) -> Iterator[Path]:
    """Give a temporary folder, and move its files into ``folder`` when all of them are written.

    If anything is raised meanwhile, ``folder`` keeps the files that it had.

    Args:
        folder: folder for the files; created if it is missing.

    Raises:
        InputError: the place is not writable.
    """
    place = folder / "results"
    partial = _partial(place)
    target = folder
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _remove_abandoned(folder.absolute())
        partial.mkdir()
    except OSError as error:
        raise InputError(folder, f"cannot be written: {error.strerror}", CHOOSE_ANOTHER) from error
    try:
        yield partial
        for path in sorted(partial.iterdir()):
            target = folder / path.name
            path.replace(target)
    except OSError as error:
        raise InputError(target, f"cannot be written: {error.strerror}", CHOOSE_ANOTHER) from error
    except InputError as error:
        # A message names the file where it shall be.
        where = error.where.replace(str(partial), str(folder))
        raise InputError(where, error.what, error.cure) from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def _partial(path: Path) -> Path:
    """Return a name beside ``path`` that no other call has: it tells host, process and call."""
    return path.with_name(f"{path.name}.{_host()}-{os.getpid()}-{secrets.token_hex(4)}.part")


def _host() -> str:
    return f"{zlib.crc32(socket.gethostname().encode()):08x}"


@cache
def _remove_abandoned(folder: Path) -> None:
    """Remove the temporary files of a folder whose process on this host was killed.

    Once a process: a folder may hold a hundred thousand images, each written by itself.
    """
    if os.name != "posix":  # elsewhere, there is no harmless way to ask for a process
        return
    pattern = re.compile(rf".+\.{_host()}-(\d{{1,9}})-[0-9a-f]{{8}}\.part")
    for entry in folder.iterdir():
        match = pattern.fullmatch(entry.name)
        if match is None or _is_running(int(match[1])):
            continue
        if entry.is_dir() and not entry.is_symlink():
            shutil.rmtree(entry, ignore_errors=True)
        else:
            with suppress(OSError):
                entry.unlink()


def _is_running(process: int) -> bool:
    try:
        os.kill(process, 0)  # sends no signal
    except ProcessLookupError:
        return False
    except OSError:
        return True  # that of another user
    return True


def remove_stale(path: Path) -> None:
    """Remove a file of an earlier run that could be mistaken for a result of this one.

    Raises:
        InputError: the file cannot be removed.
    """
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise InputError(path, f"cannot be removed: {error.strerror}", CHOOSE_ANOTHER) from error

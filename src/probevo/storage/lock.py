"""A lock on a folder, so that of several processes only one writes its results into it.

The operating system releases the lock when its holder ends, however it ends. The file of the lock
names the holder, for whoever finds the folder in use.
"""

from __future__ import annotations

import errno
import os
import socket
import stat
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path

from probevo.errors import InputError
from probevo.storage.files import CHOOSE_ANOTHER, check_folder

LOCK = ".probevo-lock"
"""Name of the file in the folder; it is there only while the folder is in use, or after a kill."""
LONGEST_HOLDER = 200
"""Bytes of the holder's name that are read."""
LOOKS = 20
"""Number of times that a file without a name is read again."""
LOOK_S = 0.05
_FAR_BEYOND = 1 << 30
"""The byte that is locked on Windows: nobody can read a locked one."""
_UNSUPPORTED = (errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL)


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold the lock of a folder, and remove it afterwards, with the folders that it had to create.

    On a file system without locks, nothing is locked.

    Args:
        folder: the folder; created if it is missing, and removed again if it stays empty.

    Raises:
        InputError: another process, or another thread of this one, holds the lock: the message says
            which and since when; or the folder is not writable.
    """
    check_folder(folder, "--out")
    missing = [place for place in (folder, *folder.parents) if not os.path.lexists(place)]
    path = folder / LOCK
    try:
        file = _taken(path)
    except OSError as error:
        raise InputError(folder, f"cannot be written: {error.strerror}", CHOOSE_ANOTHER) from error
    try:
        yield
    finally:
        _released(file, path)
        for place in missing:
            with suppress(OSError):  # it is not empty
                place.rmdir()


def _taken(path: Path) -> int:
    """Open and lock the file, and write into it who holds it.

    Raises:
        InputError: somebody else holds it.
        OSError: it cannot be written.
    """
    while True:
        path.parent.mkdir(parents=True, exist_ok=True)
        flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
        try:
            file = os.open(path, flags, 0o666)
        except FileNotFoundError:  # whoever held it before has just removed the folder
            continue
        try:
            if not stat.S_ISREG(os.fstat(file).st_mode):
                raise OSError(errno.EEXIST, f"{path.name} is not a file")
            if not _is_locked_now(file):
                raise InputError(
                    path.parent,
                    f"is in use by {_holder(file)}.",
                    "Wait until it ends, or choose another output folder.",
                )
            if _is_same(file, path):
                _sign(file, path)
                return file
        except BaseException:
            os.close(file)
            raise
        # Whoever held it before has removed it since it was opened.
        os.close(file)


def _sign(file: int, path: Path) -> None:
    """Write into the locked file who holds it; remove it where there is no room for that.

    Raises:
        OSError: it cannot be written, as on a full disk.
    """
    try:
        os.ftruncate(file, 0)
        os.write(file, _own_name().encode())
    except OSError:
        with suppress(OSError):
            path.unlink()
        raise


def _released(file: int, path: Path) -> None:
    """Remove the file and unlock it; the other way round where an open file cannot be removed."""
    with suppress(OSError):
        path.unlink()
    os.close(file)
    if os.name != "posix":
        with suppress(OSError):
            path.unlink()


def _is_locked_now(file: int) -> bool:
    """Lock the file without waiting; return False if somebody else holds the lock."""
    try:
        if os.name == "posix":
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        else:
            _lock_on_windows(file)
    except OSError as error:
        return error.errno in _UNSUPPORTED
    return True


def _lock_on_windows(file: int) -> None:
    import msvcrt

    os.lseek(file, _FAR_BEYOND, os.SEEK_SET)
    try:
        msvcrt.locking(file, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined]
    finally:
        os.lseek(file, 0, os.SEEK_SET)


def _is_same(file: int, path: Path) -> bool:
    """Return whether the open file is still the one of that name."""
    try:
        status = path.stat()
    except OSError:
        return False
    return os.path.samestat(os.fstat(file), status)


def _own_name() -> str:
    began = datetime.now(UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
    return f"process {os.getpid()} on {socket.gethostname()}, since {began}"


def _holder(file: int) -> str:
    """Read who holds the lock; the file may come from anybody."""
    for _ in range(LOOKS):
        os.lseek(file, 0, os.SEEK_SET)
        text = os.read(file, LONGEST_HOLDER).decode("utf-8", "replace")
        name = "".join(letter for letter in text if letter.isprintable())
        if name:
            return name
        time.sleep(LOOK_S)  # it has the lock, and is about to write its name
    return "another process"

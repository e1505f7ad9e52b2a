"""Unpacking of archives from elsewhere, into a folder that appears whole or not at all."""

from __future__ import annotations

import shutil
import stat
import tarfile
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import IO, NamedTuple

from probevo.errors import InputError

DAMAGED = "Remove it, and fetch it again."
FAULTS = (zipfile.BadZipFile, tarfile.TarError, zlib.error, EOFError, RuntimeError)
"""Exceptions of the libraries for an archive that is damaged; RuntimeError, or
NotImplementedError, which is one, for an archive that is encrypted or of an unknown kind."""


def unpack_all(
    archives: list[Path],
    target: Path,
    extra: dict[str, str],
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> None:
    """Unpack archives into one folder, which must not exist; zip files inside of them, too.

    Only files and folders are written, and all of them below the folder. It appears when all is
    unpacked.

    Args:
        archives: .zip and .tar files.
        target: the folder.
        extra: content of further files, by their names.
        on_progress: called after each file with the bytes of archives that are done, and with
            those of all archives; zip files inside of others count once they are found.

    Raises:
        InputError: an archive is damaged or leads out of the folder, or there is no room.
    """
    partial = target.with_name(f"{target.name}.part")
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    done = 0
    total = sum(archive.stat().st_size for archive in archives)
    try:
        for archive in archives:
            for size in _unpacked(archive, partial):
                on_progress(done + size, total)
            done += archive.stat().st_size
        inners = sorted(partial.rglob("*.zip"))
        total += sum(inner.stat().st_size for inner in inners)
        for inner in inners:
            for size in _unpacked(inner, inner.parent):
                on_progress(done + size, total)
            done += inner.stat().st_size
            inner.unlink()
        for name, content in extra.items():
            (partial / name).write_text(content, "utf-8")
        partial.replace(target)
    except OSError as error:
        raise InputError(target, f"cannot be written: {error.strerror}") from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def _unpacked(archive: Path, folder: Path) -> Iterator[int]:
    """Unpack an archive, and yield after each file how many of its bytes are done.

    Raises:
        InputError: it is damaged or leads out of the folder, or there is no room.
    """
    done = 0
    try:
        with _opened(archive) as members:
            for member in members:
                place = _place(archive, folder, member.name)
                _check_space(folder, member.size)
                place.parent.mkdir(parents=True, exist_ok=True)
                with member.content() as source, place.open("wb") as out:
                    shutil.copyfileobj(source, out)
                done += member.packed_size
                yield done
    except FAULTS as error:
        raise InputError(archive, f"this archive is damaged: {error}.", DAMAGED) from error


class _Member(NamedTuple):
    """A regular file of an archive."""

    name: str
    size: int
    """Bytes of the unpacked file."""
    packed_size: int
    """Bytes that it takes in the archive."""
    content: Callable[[], IO[bytes]]
    """Opens it."""


@contextmanager
def _opened(archive: Path) -> Iterator[Iterator[_Member]]:
    """Give each regular file of an archive."""
    if zipfile.is_zipfile(archive):
        with zipfile.ZipFile(archive) as packed:
            yield _zip_members(packed)
    else:
        with tarfile.open(archive) as packed_tar:
            yield _tar_members(packed_tar)


def _zip_members(packed: zipfile.ZipFile) -> Iterator[_Member]:
    for info in packed.infolist():
        kind = stat.S_IFMT(info.external_attr >> 16)
        if not info.is_dir() and kind in (0, stat.S_IFREG):

            def content(info: zipfile.ZipInfo = info) -> IO[bytes]:
                """Open this member."""
                return packed.open(info)

            yield _Member(info.filename, info.file_size, info.compress_size, content)


def _tar_members(packed: tarfile.TarFile) -> Iterator[_Member]:
    for info in packed:
        if info.isreg():

            def content(info: tarfile.TarInfo = info) -> IO[bytes]:
                """Open this member; its content follows that of the one before."""
                file = packed.extractfile(info)
                if file is None:  # which cannot be, of a regular file
                    raise tarfile.ReadError(f"{info.name} has no content")
                return file

            yield _Member(info.name, info.size, info.size, content)


def _place(archive: Path, folder: Path, name: str) -> Path:
    """Return where a file of an archive shall be.

    Raises:
        InputError: outside of the folder.
    """
    parts = PurePosixPath(name.replace("\\", "/")).parts
    if not parts or parts[0] == "/" or ".." in parts or ":" in parts[0] or "\0" in name:
        raise InputError(archive, f"it holds the file {name!r}, outside of its folder.", DAMAGED)
    return folder.joinpath(*parts)


def _check_space(folder: Path, size: int) -> None:
    free = shutil.disk_usage(folder).free
    if size > free:
        what = f"{size / 1e9:.1f} GB are needed, and {free / 1e9:.1f} GB are free."
        raise InputError(folder, what, "Choose another folder with --out.")

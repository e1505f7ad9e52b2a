"""Fetching of a data set: all of its archives, checked and unpacked, complete or absent."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from probevo.errors import InputError
from probevo.fetch.catalogue import Dataset
from probevo.fetch.download import Fetched, checked_copy, download
from probevo.fetch.unpack import unpack_all
from probevo.storage.files import check_folder
from probevo.storage.lock import locked

RECORD = "fetched.json"
"""File in the folder of a data set that says from where it came."""
ARCHIVES = "archives"
"""Folder of what is downloaded, until it is unpacked."""
UNPACKING = "unpacking"
"""Name of what is in progress after the files have arrived."""
OnProgress = Callable[[str, int, int], None]
"""A function of what is in progress, of the bytes that are done, and of their number or 0."""


@dataclass(frozen=True)
class Result:
    """A data set on disk."""

    folder: Path
    recordings: tuple[Path, ...]
    """Folders that ``probevo run`` opens."""
    files: tuple[Fetched, ...]
    """Archives of the data set; empty if it was there before."""


def fetch(
    dataset: Dataset,
    out: Path,
    have: Path | None = None,
    on_progress: OnProgress = lambda name, done, total: None,
    *,
    keep_archives: bool = False,
    wait_s: float = 1.0,
) -> Result:
    """Download and unpack a data set into ``out / dataset.name``, unless it is there.

    An interrupted call is continued by the next one.

    Args:
        dataset: what to fetch.
        out: folder for data sets.
        have: an archive of it that is already on disk, or a folder with some of them; they are
            checked and unpacked, and stay.
        on_progress: called as bytes arrive, with the name of their file, and as they are unpacked.
        keep_archives: whether those that were downloaded stay, too.
        wait_s: time before a second attempt.

    Raises:
        InputError: it could not be fetched, or is damaged; nothing is then where it should be.
    """
    target = out / dataset.name
    if (target / RECORD).is_file():
        return Result(target, _recordings(dataset, target), files=())
    if target.exists():
        what = "this folder exists, but was not written by probevo fetch."
        raise InputError(target, what, "Choose another folder with --out, or remove that one.")
    check_folder(out, "--out")
    given = _given(dataset, have)
    with locked(out / ARCHIVES):
        folder = out / ARCHIVES / dataset.name.replace("/", "-")
        files = []
        try:
            for file in dataset.files:
                if file.name in given:
                    files.append(checked_copy(file, given[file.name]))
                else:
                    folder.mkdir(parents=True, exist_ok=True)
                    show = partial(on_progress, file.name)
                    files.append(download(file, folder, show, wait_s))
            _unpack(dataset, files, target, on_progress)
            if not keep_archives:
                for fetched in files:
                    if fetched.path.parent == folder:
                        fetched.path.unlink()
        finally:
            with suppress(OSError):  # it is not there, or holds what has arrived
                folder.rmdir()
    return Result(target, _recordings(dataset, target), files=tuple(files))


def _given(dataset: Dataset, have: Path | None) -> dict[str, Path]:
    """Return the archives that the user has, by their names.

    Raises:
        InputError: the user has none of them.
    """
    if have is None:
        return {}
    folder = have if have.is_dir() else have.parent
    names = [file.name for file in dataset.files]
    archives = {name: folder / name for name in names if (folder / name).is_file()}
    if have.is_file() and have.name not in names and len(names) == 1:
        archives = {names[0]: have}  # under a name of the user's
    if not archives:
        what = f"there is no archive of {dataset.name}."
        raise InputError(have, what, f"Expected {', '.join(names)}, or the folder with it.")
    return archives


def _unpack(dataset: Dataset, files: list[Fetched], target: Path, on_progress: OnProgress) -> None:
    """Unpack all archives, and write from where they came."""
    target.parent.mkdir(parents=True, exist_ok=True)
    record = {
        "name": dataset.name,
        "licence": dataset.licence,
        "page": dataset.page,
        "files": [
            {
                "name": fetched.path.name,
                "url": fetched.url,
                "bytes": fetched.size,
                "sha256": fetched.sha256,
                "matches_a_published_checksum": fetched.is_verified,
            }
            for fetched in files
        ],
    }
    extra = {RECORD: json.dumps(record, indent=1) + "\n"}
    archives = [fetched.path for fetched in files]
    unpack_all(archives, target, extra, partial(on_progress, UNPACKING))


def _recordings(dataset: Dataset, folder: Path) -> tuple[Path, ...]:
    if dataset.recordings == ".":
        return (folder,)
    return tuple(sorted(path for path in folder.glob(dataset.recordings) if path.is_dir()))

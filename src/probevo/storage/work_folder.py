"""Outputs that appear when they are complete: they are written in a work folder beside them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from shutil import rmtree

from probevo.errors import InputError
from probevo.storage.files import CHOOSE_ANOTHER
from probevo.storage.lock import locked


def work_folder_of(out: Path) -> Path:
    """Return the path of the work folder of an output, beside it."""
    whole = out.absolute()  # "." has no name
    return whole.with_name(f"{whole.name}.work")


@contextmanager
def as_only_writer(out: Path, check: Callable[[Path], None]) -> Iterator[Path]:
    """Give the work folder of an output while no other process writes the same output.

    Args:
        out: the output, a file or a folder.
        check: refuses an output that is there already; called once nobody else writes it.

    Raises:
        InputError: another process writes it, or has just finished; or the place is not writable.
    """
    work = work_folder_of(out)
    try:
        with locked(work):
            check(out)
            yield work
    finally:
        with suppress(OSError):  # if a killed process had left it, the lock leaves it, too
            work.rmdir()


@contextmanager
def moved_when_complete(work: Path, out: Path) -> Iterator[Path]:
    """Give the path of a new recording inside ``work``, and move it to ``out`` when it is written.

    If anything is raised meanwhile, it is removed, and ``out`` stays as it was.

    Args:
        work: the work folder, as the only writer.
        out: folder for the recording; missing or empty.

    Raises:
        InputError: another process has put something there meanwhile.
    """
    partial = work / "recording"
    rmtree(partial, ignore_errors=True)  # what a killed process has left
    try:
        yield partial
        _move(partial, out)
    finally:
        rmtree(partial, ignore_errors=True)


def _move(folder: Path, out: Path) -> None:
    """Give a folder its name, which an empty one may have.

    Raises:
        InputError: there is something else of that name.
    """
    try:
        if out.is_dir():
            out.rmdir()
        folder.rename(out)
    except OSError as error:
        raise InputError(out, f"cannot be written: {error.strerror}", CHOOSE_ANOTHER) from error

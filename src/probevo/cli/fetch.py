"""``probevo fetch``: download public recordings, or take those that are on disk."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from probevo.cli.arguments import parse
from probevo.errors import InputError

if TYPE_CHECKING:
    from probevo.fetch.catalogue import Dataset
    from probevo.fetch.fetching import OnProgress, Result

MAX_SHOWN = 5
"""Recordings that are named at the end."""


@dataclass(frozen=True)
class FetchArguments:
    """Downloads public recordings: KITTI, EuRoC, TUM-VI, TartanAir. Without NAME, lists them.

    Their licence is shown, and has to be accepted. An interrupted download is continued by the same
    command. Where the authors publish a checksum, it is compared; where not, the command says so.
    """

    name: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="NAME")] = ""
    """Such as euroc/MH_01_easy."""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("recordings")
    """Folder for recordings; each data set gets a folder of its name in it."""
    have: Annotated[Path | None, tyro.conf.arg(metavar="PATH")] = None
    """An archive of it that you have, or a folder with them: checked and unpacked, not fetched."""
    accept_licence: bool = False
    """Accept the licence without being asked."""
    keep_archives: bool = False
    """Keep what was downloaded beside what was unpacked."""


def main(words: list[str]) -> None:
    """Parse the arguments, ask for the licence, and fetch.

    Raises:
        InputError: there is no such data set, its licence is not accepted, or no host gave it.
    """
    arguments = parse(FetchArguments, words, "fetch")
    if not arguments.name:
        print(_table())
        return
    from probevo.fetch.catalogue import find_dataset
    from probevo.fetch.fetching import fetch

    dataset = find_dataset(arguments.name)
    if arguments.have is not None and not arguments.have.exists():
        raise InputError(
            "--have", f"{arguments.have} does not exist.", "Name an archive, or a folder."
        )
    print(_terms(dataset))
    if not arguments.accept_licence:
        _ask()
    with _progress() as show:
        result = fetch(
            dataset,
            arguments.out,
            arguments.have,
            show,
            keep_archives=arguments.keep_archives,
        )
    print(_summary(result))


def _table() -> str:
    """Return what can be fetched, as text."""
    from probevo.fetch.catalogue import FAMILIES

    lines = []
    for family in FAMILIES:
        lines.append(family.names)
        shown = ", ".join(family.examples[:MAX_SHOWN])
        more = ", …" if len(family.examples) > MAX_SHOWN else ""
        lines.append(f"    names      {shown}{more}")
        lines.append(f"    size       {family.size}")
        lines.append(f"    licence    {family.licence}")
        lines.append(f"    checksums  {family.checksums}")
    return "\n".join(lines)


def _terms(dataset: Dataset) -> str:
    """Return what will be fetched, and under which terms."""
    has_all = all(file.has_checksum for file in dataset.files)
    checksums = "compared with the published ones" if has_all else "none is published"
    return "\n".join(
        [
            f"data set   {dataset.name}{f', {dataset.size}' if dataset.size else ''}",
            f"files      {', '.join(file.name for file in dataset.files)}",
            f"checksums  {checksums}",
            f"licence    {dataset.licence}",
            f"page       {dataset.page}",
        ]
    )


def _ask() -> None:
    """Ask whether the licence is accepted.

    Raises:
        InputError: it is not, or nobody can be asked.
    """
    if not sys.stdin.isatty():
        cure = "Read its terms, and give --accept-licence."
        raise InputError("licence", "has to be accepted, and there is no terminal to ask.", cure)
    print("Do you accept the licence? [y/N] ", end="", flush=True)
    if sys.stdin.readline().strip().lower() not in ("y", "yes"):
        raise InputError("licence", "was not accepted.", "Nothing was fetched.")


@contextmanager
def _progress() -> Iterator[OnProgress]:
    """Show a bar in megabytes, and another one for unpacking; where stderr is no terminal, a line
    every half a minute."""
    from probevo.cli.progress import progress_bar
    from probevo.fetch.fetching import UNPACKING

    with ExitStack() as bars:
        show = bars.enter_context(progress_bar("fetching", "connecting", unit="MB"))
        is_unpacking = False

        def on_progress(name: str, done: int, total: int) -> None:
            """Tell the bytes that are there, or those that are unpacked."""
            nonlocal show, is_unpacking
            if name == UNPACKING and not is_unpacking:
                bars.close()  # one bar at a time
                show = bars.enter_context(progress_bar(UNPACKING, UNPACKING, unit="MB"))
                is_unpacking = True
            if total:
                show(done // 1_000_000, max(1, total // 1_000_000))

        yield on_progress


def _summary(result: Result) -> str:
    """Return where the recordings are, and how far the archives were checked."""
    lines = []
    if not result.files:
        lines.append(f"already there: {result.folder}")
    for file in result.files:
        if file.is_verified:
            lines.append(f"{file.path.name}: its checksum is the published one")
        else:
            lines.append(f"{file.path.name}: no checksum to compare; SHA-256 {file.sha256}")
    count = len(result.recordings)
    lines.append(f"{count} recording{'s' * (count != 1)} in {result.folder}")
    lines += [f"    probevo info {path}" for path in result.recordings[:MAX_SHOWN]]
    if count > MAX_SHOWN:
        lines.append("    …")
    return "\n".join(lines)

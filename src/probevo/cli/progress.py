"""How far long work is, on stderr, where somebody watches it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

Show = Callable[[int, int], None]
"""Takes how many frames are done, and how many there are."""


@contextmanager
def progress_bar(name: str, starting: str) -> Iterator[Show]:
    """A bar that appears at once and is gone in the end, with the rate and the time that is left.

    Args:
        name: what is being worked on.
        starting: said instead until the first frame is done.
    """
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    console = Console(stderr=True)
    rate = TextColumn("{task.fields[rate]}")
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        rate,
        TimeRemainingColumn(),
    )
    with Progress(
        *columns, console=console, transient=True, disable=not console.is_terminal
    ) as progress:
        task = progress.add_task(starting, total=None, rate="")

        def show(done: int, total: int) -> None:
            progress.update(task, description=name, completed=done, total=total)
            speed = progress.tasks[0].speed
            if speed is not None:  # not before the second frame
                progress.update(task, rate=f"{speed:.1f} frames/s")

        yield show

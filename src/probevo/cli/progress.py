"""A progress bar on stderr, shown only on a terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

Show = Callable[[int, int], None]
"""A function of the number of frames done and of their total number."""


@contextmanager
def progress_bar(name: str, starting: str) -> Iterator[Show]:
    """Show a progress bar with the rate and the remaining time; it disappears at the end.

    Args:
        name: what is in progress.
        starting: text shown instead until the first frame is done.
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
    progress = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )
    with progress:
        task = progress.add_task(starting, total=None, rate="")

        def show(done: int, total: int) -> None:
            progress.update(task, description=name, completed=done, total=total)
            speed = progress.tasks[0].speed
            if speed is not None:  # it is known from the second frame on
                progress.update(task, rate=f"{speed:.1f} frames/s")

        yield show

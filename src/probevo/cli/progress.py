"""Progress on stderr: a bar on a terminal, and a line every half a minute elsewhere."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import monotonic

Show = Callable[[int, int], None]
"""A function of the number of frames done and of their total number."""
LINE_EVERY_S = 30.0
"""Time between two lines in a log; what ends sooner writes none."""


@contextmanager
def progress_bar(name: str, starting: str, unit: str = "frames") -> Iterator[Show]:
    """Show a progress bar with the rate and the remaining time; it disappears at the end.

    Where stderr is no terminal, it writes a line with the same every half a minute instead.

    Args:
        name: what is in progress.
        starting: text shown instead until the first frame is done.
        unit: what is counted.
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
    if not console.is_terminal:
        yield _log_lines(name, unit)
        return
    progress = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
        console=console,
        transient=True,
    )
    with progress:
        task = progress.add_task(starting, total=None, rate="")

        def show(done: int, total: int) -> None:
            """Move the bar, and tell the rate from the second frame on."""
            progress.update(task, description=name, completed=done, total=total)
            speed = progress.tasks[0].speed
            if speed is not None:  # it is known from the second frame on
                progress.update(task, rate=f"{speed:.1f} {unit}/s")

        yield show


def _log_lines(name: str, unit: str) -> Show:
    """Return what writes a line to stderr every half a minute."""
    start_s = monotonic()
    last_s = start_s

    def show(done: int, total: int) -> None:
        """Write a line, unless the last one is less than half a minute old."""
        nonlocal last_s
        now_s = monotonic()
        if now_s - last_s < LINE_EVERY_S or done == 0:
            return
        last_s = now_s
        rate = done / (now_s - start_s)
        left_s = (total - done) / rate
        text = f"{done} of {total} {unit}, {rate:.1f} {unit}/s, {left_s:.0f} s left"
        print(f"probevo: {name}: {text}", file=sys.stderr, flush=True)

    return show

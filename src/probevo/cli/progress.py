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
NUM_SLOW = 3
"""Frames at the start that say nothing of the others: meanwhile, code may be compiled."""


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
        num_shown = 0

        def show(done: int, total: int) -> None:
            """Move the bar, and tell the rate once the slow frames at the start are over."""
            nonlocal num_shown
            num_shown += 1
            if num_shown <= NUM_SLOW:
                # This also forgets the times so far.
                progress.reset(task, description=name, completed=done, total=total)
                return
            progress.update(task, description=name, completed=done, total=total)
            speed = progress.tasks[0].speed
            if speed is not None:
                progress.update(task, rate=f"{speed:.1f} {unit}/s")

        yield show


def _log_lines(name: str, unit: str) -> Show:
    """Return what writes a line to stderr every half a minute."""
    last_s = monotonic()
    num_shown = 0
    start = (0, last_s)

    def show(done: int, total: int) -> None:
        """Write a line, unless the last one is less than half a minute old."""
        nonlocal last_s, num_shown, start
        now_s = monotonic()
        num_shown += 1
        if num_shown <= NUM_SLOW:
            start = (done, now_s)
        if now_s - last_s < LINE_EVERY_S or done == 0:
            return
        last_s = now_s
        text = f"{done} of {total} {unit}"
        if done > start[0] and now_s > start[1]:
            rate = (done - start[0]) / (now_s - start[1])
            text += f", {rate:.1f} {unit}/s, {(total - done) / rate:.0f} s left"
        print(f"probevo: {name}: {text}", file=sys.stderr, flush=True)

    return show

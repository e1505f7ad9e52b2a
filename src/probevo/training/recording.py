"""Recordings → drives on disk: each recording is the work of one worker, which tells in a file how
far it is."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from collections.abc import Sequence as Collection
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from threading import Event, Thread
from uuid import uuid4

from probevo.errors import ProbevoError
from probevo.files import write_atomically
from probevo.predictors import PredictionSpace
from probevo.training.extraction import Extraction
from probevo.training.settings import TrainSettings
from probevo.training.sources import Source
from probevo.training.supervised_drive import DriveOnDisk
from probevo.training.supervision import supervision_of
from probevo.training.workers import Workers

OnFrames = Callable[[int], None]
"""Takes how many frames of all recordings are done."""
REPORT_S = 1.0
TICKET = "ticket"


@dataclass(frozen=True)
class _Task:
    source: Source
    drive: DriveOnDisk
    space: PredictionSpace
    settings: TrainSettings
    ticket: str
    """Of this call: a worker that finds another one's goes home, as nobody waits for it any more.
    """


def record_all(
    sources: Collection[Source],
    drives: Collection[DriveOnDisk],
    space: PredictionSpace,
    settings: TrainSettings,
    workers: Workers,
    on_frames: OnFrames,
) -> None:
    """Write, of each recording, what is missing of its drive; in this process, ``on_frames`` hears
    of every frame."""
    left = [n for n, drive in enumerate(drives) if not drive.is_complete]
    before = sum(source.num_frames for source in sources) - sum(sources[n].num_frames for n in left)
    if before:
        on_frames(before)
    if not left:
        return
    if workers.are_here:
        for n in left:
            _record(
                sources[n],
                drives[n],
                space,
                settings=settings,
                on_frame=partial(_on_frame, on_frames, before),
            )
            before += sources[n].num_frames
            on_frames(before)
        return
    left.sort(
        key=lambda n: -sources[n].num_frames
    )  # the longest first, lest all wait for it in the end
    with _issued(drives[0].folder) as ticket:
        tasks = [
            _Task(sources[n], drives[n], space, settings=settings, ticket=ticket) for n in left
        ]
        with _watched(tasks, lambda done: on_frames(before + done)):
            workers.map(_record_elsewhere, tasks, [str(task.source.path) for task in tasks])


def _on_frame(on_frames: OnFrames, before: int, done: int) -> None:
    on_frames(before + done)


def _record(
    source: Source,
    drive: DriveOnDisk,
    space: PredictionSpace,
    settings: TrainSettings,
    on_frame: OnFrames,
) -> None:
    sequence = source.open()
    drive.keep_supervision(
        supervision_of(
            sequence, settings.supervision, settings.every_s, num_frames=source.num_frames
        )
    )
    if not drive.is_whole:
        extraction = Extraction(
            sequence, space, settings.odometry, num_frames=source.num_frames, on_frame=on_frame
        )
        drive.keep_drive(extraction, lambda: extraction.digest, len(space.columns))


class _GoneError(ProbevoError):
    """Nobody waits for this worker any more: the training was stopped, or began anew."""


def _record_elsewhere(task: _Task) -> None:
    due_s = 0.0

    def report(frames: int) -> None:
        nonlocal due_s
        if time.monotonic() < due_s:
            return
        if not _is_good(task.ticket, task.drive.folder):
            raise _GoneError
        task.drive.tell(frames)
        due_s = time.monotonic() + REPORT_S

    if (
        not task.drive.is_complete
    ):  # another worker, given up for lost, may have been through all the same
        _record(task.source, task.drive, task.space, settings=task.settings, on_frame=report)
    task.drive.tell(task.source.num_frames)


@contextmanager
def _issued(folder: Path) -> Iterator[str]:
    """A ticket that is good until the end, or until the next one is issued."""
    ticket = uuid4().hex
    write_atomically(folder / TICKET, ticket)
    try:
        yield ticket
    finally:
        write_atomically(folder / TICKET, "none is good")


def _is_good(ticket: str, folder: Path) -> bool:
    """Whether it is the one that was issued last; if that cannot be told, as on a slow file system,
    it is."""
    try:
        return (folder / TICKET).read_text("utf-8") == ticket
    except OSError:
        return True


@contextmanager
def _watched(tasks: Collection[_Task], on_frames: OnFrames) -> Iterator[None]:
    """Meanwhile another thread tells how far the workers are, and this one in the end."""
    is_over = Event()

    def frames() -> int:
        return sum(task.drive.frames_done for task in tasks)

    def watch() -> None:
        while not is_over.wait(REPORT_S):
            on_frames(frames())

    thread = Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield
    finally:
        is_over.set()
        thread.join()
    on_frames(frames())

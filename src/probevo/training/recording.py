"""Recordings → drives on disk: each recording is one worker's task.

Workers in other processes report their progress in files.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from threading import Event, Thread

from probevo.config.training import TrainSettings
from probevo.errors import ProbevoError
from probevo.predictors import PredictionSpace
from probevo.training.extraction import Extraction
from probevo.training.lease import is_valid, leased
from probevo.training.sources import Source
from probevo.training.supervised_drive import DriveOnDisk
from probevo.training.supervision import supervision_of
from probevo.training.workers import Workers

OnFrames = Callable[[int], None]
"""Takes a number of frames that are done."""
REPORT_S = 1.0
"""Time between two reports of a worker."""


class LeaseExpiredError(ProbevoError):
    """The training that waited for this worker was stopped, or began anew."""


@dataclass(frozen=True)
class _Task:
    source: Source
    drive: DriveOnDisk
    space: PredictionSpace
    settings: TrainSettings
    lease: str
    """Lease of the call that the task belongs to; a worker stops once it has expired."""


def record_all(
    sources: Sequence[Source],
    drives: Sequence[DriveOnDisk],
    space: PredictionSpace,
    settings: TrainSettings,
    *,
    workers: Workers,
    on_frames: OnFrames,
) -> None:
    """Record the drives that are not complete yet.

    Args:
        sources: the recordings.
        drives: the drive of each recording.
        space: the predictors.
        settings: all settings.
        workers: processes that do the work, one recording each at a time.
        on_frames: called with how many frames of all recordings are done: after each frame if this
            process does the work, or else from time to time.
    """
    # Drives of an earlier call count as done.
    missing = [number for number, drive in enumerate(drives) if not drive.is_complete]
    num_frames = sum(source.num_frames for source in sources)
    frames_done = num_frames - sum(sources[number].num_frames for number in missing)
    if frames_done:
        on_frames(frames_done)
    if not missing:
        return

    # Record in this process: one recording after another, reported frame by frame.
    if workers.are_here:
        for number in missing:
            _record(
                sources[number],
                drives[number],
                space,
                settings,
                on_frame=partial(_report_sum, on_frames, frames_done),
            )
            frames_done += sources[number].num_frames
            on_frames(frames_done)
        return

    # Elsewhere: the longest recordings first, so that no worker begins one when others are done.
    missing.sort(key=lambda number: -sources[number].num_frames)
    with leased(drives[0].folder) as lease:
        tasks = [
            _Task(
                source=sources[number],
                drive=drives[number],
                space=space,
                settings=settings,
                lease=lease,
            )
            for number in missing
        ]
        with _reported(tasks, lambda done: on_frames(frames_done + done)):
            workers.map(_record_elsewhere, tasks, [str(task.source.path) for task in tasks])


def _report_sum(on_frames: OnFrames, before: int, done: int) -> None:
    """Report the frames of this recording together with those before it."""
    on_frames(before + done)


def _record(
    source: Source,
    drive: DriveOnDisk,
    space: PredictionSpace,
    settings: TrainSettings,
    on_frame: OnFrames,
) -> None:
    """Record one drive and its supervision."""
    sequence = source.open()
    supervision = supervision_of(
        sequence, settings.supervision, settings.every_s, num_frames=source.num_frames
    )
    drive.keep_supervision(supervision)
    if not drive.is_recorded:
        extraction = Extraction(
            sequence, space, settings.odometry, num_frames=source.num_frames, on_frame=on_frame
        )
        drive.keep_drive(extraction, lambda: extraction.digest, len(space.columns))


def _record_elsewhere(task: _Task) -> None:
    """Record one drive in a process of its own, as long as its lease is valid.

    Raises:
        LeaseExpiredError: nobody waits for the drive any more.
    """
    next_report_s = 0.0

    def report(frames: int) -> None:
        """Report progress now and then, and stop if the lease has expired."""
        nonlocal next_report_s
        # Reports are files, and few of them suffice.
        if time.monotonic() < next_report_s:
            return
        if not is_valid(task.lease, task.drive.folder):
            raise LeaseExpiredError
        task.drive.report_frames(frames)
        next_report_s = time.monotonic() + REPORT_S

    # Another worker, given up as lost, may have completed the drive after all.
    if not task.drive.is_complete:
        _record(task.source, task.drive, task.space, task.settings, on_frame=report)
    task.drive.report_frames(task.source.num_frames)


@contextmanager
def _reported(tasks: Sequence[_Task], on_frames: OnFrames) -> Iterator[None]:
    """Report the progress of all workers from another thread, and once more at the end."""
    is_over = Event()

    def frames_done() -> int:
        """Count the frames that all workers have done."""
        return sum(task.drive.frames_done for task in tasks)

    def watch() -> None:
        """Report every now and then until it is over."""
        while not is_over.wait(REPORT_S):
            on_frames(frames_done())

    thread = Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield
    finally:
        is_over.set()
        thread.join()
    on_frames(frames_done())

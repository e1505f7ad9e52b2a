"""Who does the work: this process, others of this machine, or a Dask cluster. The results are the
same."""

from __future__ import annotations

import os
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import BrokenExecutor
from contextlib import closing, contextmanager
from dataclasses import dataclass
from itertools import islice
from typing import Any, Generic, TypeVar

from probevo.errors import InputError

Task = TypeVar("Task")
Result = TypeVar("Result")
Numbered = list[tuple[int, Any]]
"""Tasks, each with the number that comes back with its result."""
Run = Callable[[Callable[[Any], Any], Numbered], Generator[tuple[int, Any], None, None]]
"""Calls a function with each task, and yields the results as they come."""

MOST_LOSSES = 3
"""Times in a row that a worker may be lost before any task is through; then each gets one to itself
as often."""

MOST_SUBMITTED = 1000
"""To a cluster at a time: each task brings its model along."""
CONNECT_S = 10.0


class LostWorkerError(Exception):
    """A worker of a cluster was killed, again and again, while at the same task."""


@dataclass(frozen=True)
class Workers:
    """This process alone, or ``jobs`` others of this machine, or all of the Dask cluster at an
    address."""

    jobs: int = 1
    """0 takes as many as there are cores."""
    cluster: str = ""
    """Address of a Dask scheduler, whose workers see the same files under the same names."""

    @property
    def are_here(self) -> bool:
        """Whether it is this process that works."""
        return self.jobs == 1 and not self.cluster

    def map(
        self,
        work: Callable[[Task], Result],
        tasks: Sequence[Task],
        names: Sequence[str],
        on_done: Callable[[int], None] | None = None,
    ) -> list[Result]:
        """``[work(task) for task in tasks]``, in whatever order. What was lost with a worker is
        done again.

        Args:
            work: a function of a module: it, the tasks and the results travel between processes.
            tasks: what it is called with.
            names: of the tasks, for a message.
            on_done: called with the number of each task that is through.

        Raises:
            InputError: what a task raised; every worker that had a task to itself was lost; or
                there is no such cluster.
        """
        job = _Job(work, tasks, on_done or (lambda number: None))
        with self._ready() as run:
            losses = 0
            while losses < MOST_LOSSES and job.left:
                before = len(job.found)
                if not job.goes_on(run, job.left):
                    losses = 1 if len(job.found) > before else losses + 1
            for number in job.left:  # alone, so that it shows which of them it is
                any(job.goes_on(run, [number]) for _ in range(MOST_LOSSES))
        if job.left:
            raise _given_up([names[number] for number in job.left])
        return [job.found[number] for number in range(len(tasks))]

    @contextmanager
    def _ready(self) -> Iterator[Run]:
        if self.are_here:
            yield _here
        elif not self.cluster:
            yield lambda work, tasks: _on_this_machine(work, tasks, self.jobs or -1)
        else:
            with _client(self.cluster) as client:
                yield lambda work, tasks: _on_cluster(work, tasks, client)


class _Job(Generic[Task, Result]):
    """Tasks, and the results that are there."""

    def __init__(
        self, work: Callable[[Task], Result], tasks: Sequence[Task], on_done: Callable[[int], None]
    ) -> None:
        self.work = work
        self.tasks = tasks
        self.on_done = on_done
        self.found: dict[int, Result] = {}

    @property
    def left(self) -> list[int]:
        """Numbers of the tasks without a result."""
        return [number for number in range(len(self.tasks)) if number not in self.found]

    def goes_on(self, run: Run, numbers: list[int]) -> bool:
        """Do these tasks; False if a worker was lost meanwhile."""
        try:
            with closing(
                run(self.work, [(number, self.tasks[number]) for number in numbers])
            ) as results:
                for number, result in results:
                    self.found[number] = result
                    self.on_done(number)
        except (BrokenExecutor, LostWorkerError):
            return False
        return True


def _here(work: Callable[[Any], Any], tasks: Numbered) -> Generator[tuple[int, Any], None, None]:
    for number, task in tasks:
        yield number, work(task)


def _on_this_machine(
    work: Callable[[Any], Any], tasks: Numbered, jobs: int
) -> Generator[tuple[int, Any], None, None]:
    import joblib

    os.environ["PYTHONSAFEPATH"] = "1"  # no module of the working directory is imported
    with joblib.parallel_config("loky", inner_max_num_threads=1):
        calls = (joblib.delayed(_numbered)(work, *numbered) for numbered in tasks)
        results = joblib.Parallel(jobs, return_as="generator_unordered", batch_size=1)(calls)
        with closing(results):
            yield from results


def _on_cluster(
    work: Callable[[Any], Any], tasks: Numbered, client: Any
) -> Generator[tuple[int, Any], None, None]:
    # Not joblib's backend for Dask: where a task takes down one worker after another, that waits
    # for ever (1.6.0).
    from distributed import KilledWorker, as_completed

    def submitted(count: int) -> list[Any]:
        return [
            client.submit(_numbered, work, *numbered, pure=False)
            for numbered in islice(waiting, count)
        ]

    waiting = iter(tasks)
    running = as_completed(submitted(MOST_SUBMITTED), loop=client.loop)
    try:
        for future in running:
            yield future.result()
            running.update(submitted(1))
    except KilledWorker as error:
        raise LostWorkerError from error
    finally:
        client.cancel(list(running.futures))


def _numbered(work: Callable[[Any], Any], number: int, task: Any) -> tuple[int, Any]:
    import cv2

    cv2.setNumThreads(1)  # a worker is to be one core's work
    return number, work(task)


def _client(address: str) -> Any:
    try:
        from distributed import Client
    except ImportError as error:
        what = "needs Dask, which is not installed."
        raise InputError(
            "--cluster", what, "Install probevo[cluster], here and where its workers run."
        ) from error
    try:
        return Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        what = f"no Dask scheduler answers at {address!r}."
        raise InputError(
            "--cluster", what, "Give its address, such as tcp://10.0.0.1:8786."
        ) from error


def _given_up(left: list[str]) -> InputError:
    names = ", ".join(left[:3]) + (f" and {len(left) - 3} more" if len(left) > 3 else "")
    what = f"each time of {MOST_LOSSES}, the worker that had it to itself was lost."
    cure = "Did the memory give out? The same command goes on from what is done."
    return InputError(names, what, cure)

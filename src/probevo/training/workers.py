"""Execution of tasks by this process, by other processes of this machine, or by a Dask cluster.

The results are the same.
"""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import BrokenExecutor, ThreadPoolExecutor
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
"""Calls a function with each task, and yields the numbered results as they come."""

MAX_LOSSES = 3
"""How many times in a row a worker may be lost before any task is done. Then each remaining task
gets a worker to itself, as often."""
MAX_SUBMITTED = 1000
"""Tasks that are submitted to a cluster at a time: each brings its model along."""
CONNECT_S = 10.0
"""Time within which the scheduler of a cluster has to answer."""
NO_WORKER_S = 60.0
"""Time for which a cluster may be without any worker after it had one, before the training is given
up. Dask restarts a worker that was killed within seconds, and under load in half a minute; if the
restart fails, no worker comes back, and the scheduler would keep the tasks for ever. A cluster that
never had a worker is waited for, as its workers may still be queued."""
POLL_S = 0.05
"""Time between two looks for results of a cluster."""
WATCH_S = 1.0
"""Time between two looks for its workers while there is no result."""


class LostWorkerError(Exception):
    """A worker of a cluster was killed again and again while it had the same task."""


class NoWorkerError(Exception):
    """A cluster has lost all its workers, and none has come back."""


@dataclass(frozen=True)
class Workers:
    """This process, ``jobs`` other processes of this machine, or all workers of a Dask cluster."""

    jobs: int = 1
    """Number of processes; 0 takes as many as there are cores."""
    cluster: str = ""
    """Address of a Dask scheduler, whose workers see the same files under the same names."""

    @property
    def are_here(self) -> bool:
        """Whether this process does the work."""
        return self.jobs == 1 and not self.cluster

    def map(
        self,
        work: Callable[[Task], Result],
        tasks: Sequence[Task],
        names: Sequence[str],
        on_done: Callable[[int], None] | None = None,
    ) -> list[Result]:
        """Return ``[work(task) for task in tasks]``, computed in any order.

        Tasks that were lost with a worker are done again.

        Args:
            work: a function of a module: it, the tasks and the results travel between processes.
            tasks: what it is called with.
            names: names of the tasks, for a message.
            on_done: called with the number of each task that is done.

        Raises:
            InputError: what a task raised; a task lost every worker that it had to itself; the
                cluster has lost all its workers; or there is no such cluster.
        """
        job = _Job(work, tasks, on_done or (lambda number: None))
        try:
            with self._ready() as run:
                # Do all tasks, and those again that were lost with a worker.
                losses = 0
                while losses < MAX_LOSSES and job.missing:
                    num_done = len(job.results)
                    # A loss after progress may be chance; only losses in a row count.
                    if not job.attempt(run, job.missing):
                        losses = 1 if len(job.results) > num_done else losses + 1
                # One at a time, so that it shows which task it is that takes down its worker.
                for number in job.missing:
                    for _ in range(MAX_LOSSES):
                        if job.attempt(run, [number]):
                            break
        except NoWorkerError as error:
            raise InputError(
                _listed([names[number] for number in job.missing]),
                f"all workers of the cluster at {self.cluster} were lost, and none has come back"
                f" within {NO_WORKER_S:g} s.",
                "Did their memory give out? Start workers again; the same command goes on from what"
                " is done.",
            ) from error
        if job.missing:
            raise InputError(
                _listed([names[number] for number in job.missing]),
                f"its worker was lost {MAX_LOSSES} times, though it ran nothing else.",
                "Did the memory give out? The same command goes on from what is done.",
            )
        return [job.results[number] for number in range(len(tasks))]

    @contextmanager
    def _ready(self) -> Iterator[Run]:
        """Provide what runs the tasks."""
        if self.are_here:
            yield _here
        elif not self.cluster:
            yield lambda work, tasks: _on_this_machine(work, tasks, self.jobs or -1)
        else:
            with _client(self.cluster) as client:
                watch = _WorkerWatch(client)
                yield lambda work, tasks: _on_cluster(work, tasks, client, watch)


class _Job(Generic[Task, Result]):
    """Tasks, and the results that are there."""

    def __init__(
        self, work: Callable[[Task], Result], tasks: Sequence[Task], on_done: Callable[[int], None]
    ) -> None:
        self.work = work
        self.tasks = tasks
        self.on_done = on_done
        self.results: dict[int, Result] = {}

    @property
    def missing(self) -> list[int]:
        """Numbers of the tasks without a result."""
        return [number for number in range(len(self.tasks)) if number not in self.results]

    def attempt(self, run: Run, numbers: list[int]) -> bool:
        """Do these tasks; return False if a worker was lost meanwhile."""
        numbered = [(number, self.tasks[number]) for number in numbers]
        try:
            with closing(run(self.work, numbered)) as results:
                for number, result in results:
                    self.results[number] = result
                    self.on_done(number)
        except (BrokenExecutor, LostWorkerError):
            return False
        return True


def _here(work: Callable[[Any], Any], tasks: Numbered) -> Generator[tuple[int, Any], None, None]:
    """Do the tasks in this process."""
    for number, task in tasks:
        yield number, work(task)


def _on_this_machine(
    work: Callable[[Any], Any], tasks: Numbered, jobs: int
) -> Generator[tuple[int, Any], None, None]:
    """Do the tasks in other processes of this machine.

    Raises:
        InputError: this system does not let joblib start any.
    """
    import joblib
    from joblib.parallel import BACKENDS

    # Joblib would go on with threads of this process, which wait for each other.
    if "loky" not in BACKENDS:
        what = "other processes cannot be used here: the system has no place for semaphores."
        cure = "Is /dev/shm there and writable, and JOBLIB_MULTIPROCESSING not 0? Or take --jobs 1."
        raise InputError("--jobs", what, cure)
    # One thread each: there are as many processes as cores.
    with _safe_path(), joblib.parallel_config("loky", inner_max_num_threads=1):
        calls = (joblib.delayed(_numbered)(work, number, task) for number, task in tasks)
        results = joblib.Parallel(jobs, return_as="generator_unordered", batch_size=1)(calls)
        with closing(results):
            yield from results


@contextmanager
def _safe_path() -> Iterator[None]:
    """Let processes that start meanwhile import no module of the working directory."""
    before = os.environ.get("PYTHONSAFEPATH")
    os.environ["PYTHONSAFEPATH"] = "1"
    try:
        yield
    finally:
        if before is None:
            os.environ.pop("PYTHONSAFEPATH", None)
        else:
            os.environ["PYTHONSAFEPATH"] = before


def _on_cluster(
    work: Callable[[Any], Any], tasks: Numbered, client: Any, watch: _WorkerWatch
) -> Generator[tuple[int, Any], None, None]:
    """Do the tasks on a Dask cluster.

    Joblib's backend for Dask is not used: where a task takes down one worker after another, it
    waits for ever (1.6.0).

    Raises:
        LostWorkerError: a task has taken down several workers.
        NoWorkerError: no worker is left, and none comes back.
    """
    from distributed import KilledWorker, as_completed

    # A task is submitted for each result that has come, so that the scheduler holds few at a time.
    waiting = iter(tasks)

    def submitted(count: int) -> list[Any]:
        """Submit a number of the waiting tasks."""
        return [
            client.submit(_numbered, work, number, task, pure=False)
            for number, task in islice(waiting, count)
        ]

    running = as_completed(submitted(MAX_SUBMITTED), loop=client.loop)
    try:
        while not running.is_empty():
            # Iterating over ``running`` would block as long as no worker is left.
            completed = running.next_batch(block=False)
            if not completed:
                watch.check()
                time.sleep(POLL_S)
                continue
            for future in completed:
                yield _result_of(future, watch)
                running.update(submitted(1))
    except KilledWorker as error:
        raise LostWorkerError from error
    finally:
        # After an error or Ctrl-C, workers need not begin what nobody waits for.
        client.cancel(list(running.futures))


def _result_of(future: Any, watch: _WorkerWatch) -> Any:
    """Fetch the result of a task that is done.

    If its worker was killed since, Dask computes it anew, and would wait for ever where no worker
    is left.

    Raises:
        NoWorkerError: no worker is left, and none comes back.
    """
    timeout_s = WATCH_S
    while True:
        try:
            result = future.result(timeout=timeout_s)
        except TimeoutError:
            if future.status == "error":  # the task itself has raised it
                raise
            watch.check()
            timeout_s *= 2.0  # so that the largest result arrives in the end
        else:
            watch.worker_seen()
            return result


class _WorkerWatch:
    """A watch over the workers of a cluster, for as long as it is worked with."""

    def __init__(self, client: Any) -> None:
        self.client = client
        self.had_worker = False
        """Whether there was a worker since the connection to the scheduler."""
        self.absent_since_s: float | None = None
        """Since when no worker is left; None if there is one."""
        self.next_look_s = 0.0
        # A worker may come and be killed between two looks, which the scheduler's events show.
        client.subscribe_topic("all", self._on_event)

    def worker_seen(self) -> None:
        """Note that there is a worker."""
        self.had_worker = True
        self.absent_since_s = None

    def check(self) -> None:
        """Look whether a worker is left, unless this was done just before.

        Raises:
            NoWorkerError: there was one, but there has been none for NO_WORKER_S.
        """
        if time.monotonic() < self.next_look_s:
            return
        # The time counts from the first look without a worker.
        if self._has_worker():
            self.worker_seen()
        elif self.had_worker:
            now_s = time.monotonic()
            if self.absent_since_s is None:
                self.absent_since_s = now_s
            if now_s - self.absent_since_s > NO_WORKER_S:
                raise NoWorkerError
        self.next_look_s = time.monotonic() + WATCH_S

    def _on_event(self, event: tuple[float, Any]) -> None:
        """Note the arrival or the loss of a worker; called by the client's own thread."""
        _, message = event
        if isinstance(message, dict) and message.get("action") in ("add-worker", "remove-worker"):
            self.had_worker = True

    def _has_worker(self) -> bool:
        try:
            return bool(self.client.nthreads())
        except OSError:  # the scheduler does not answer
            return False


def _numbered(work: Callable[[Any], Any], number: int, task: Any) -> tuple[int, Any]:
    """Do one task on one core."""
    import cv2

    # There are as many workers as cores: OpenCV's own threads would compete with them.
    cv2.setNumThreads(1)
    return number, work(task)


def _client(address: str) -> Any:
    """Connect to the scheduler of a Dask cluster.

    Raises:
        InputError: Dask is not installed, or no scheduler answers.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise InputError(
            "--cluster",
            "needs Dask, which is not installed.",
            "Install probevo[cluster], here and where its workers run.",
        ) from error
    try:
        # Use another thread, since this one may have an event loop of its own, as in a notebook.
        with ThreadPoolExecutor(max_workers=1) as thread:
            thread.submit(asyncio.run, _check_scheduler(address)).result()
        return Client(address, timeout=CONNECT_S, set_as_default=False)
    except Exception as error:
        # Any type may come: Dask takes another service's bytes for lengths, or for its own
        # messages.
        raise InputError(
            "--cluster",
            f"no Dask scheduler answers at {address!r}.",
            "Give its address, such as tcp://10.0.0.1:8786.",
        ) from error


async def _check_scheduler(address: str) -> None:
    """Ask whoever answers at an address whether it is a scheduler.

    Dask's client does not bound this: it may wait for ever for a service that says nothing, and
    after a failure it keeps this process from ending for 20 s.

    Raises:
        ValueError: it is no scheduler, or the address is invalid.
        OSError: nobody answers; TimeoutError if not within CONNECT_S.
        Exception: what Dask raises at the answer of another service.
    """
    from distributed import Security
    from distributed.comm import connect

    async with asyncio.timeout(CONNECT_S):
        security = Security().get_connection_args("client")
        comm = await connect(address, timeout=CONNECT_S, **security)
        try:
            await comm.write({"op": "identity", "reply": True})
            answer = await comm.read()
        finally:
            comm.abort()
    if not isinstance(answer, dict) or answer.get("type") != "Scheduler":
        raise ValueError("not a scheduler")


def _listed(names: list[str]) -> str:
    """Return up to three names, and how many more there are."""
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return ", ".join(names[:3]) + more

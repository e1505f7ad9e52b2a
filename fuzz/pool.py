"""Processes that try mutants with bounds on time and memory, and are replaced when they hang."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import resource
import tempfile
import time
import traceback
from collections.abc import Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any, NamedTuple

from fuzz.targets import Target

TIME_LIMIT_S = 10.0
MEMORY_LIMIT_BYTES = 1 << 30
"""Memory that a mutant may take beyond that of the process before it."""


class Mutant(NamedTuple):
    """Which mutant: the same three values give the same bytes."""

    target: str
    seed: int
    number: int


@dataclass(frozen=True)
class Outcome:
    """What became of a mutant."""

    mutant: Mutant
    kind: str
    """``value``, ``refused``, or a finding: ``traceback``, ``silent``, ``hang``, ``killed``."""
    text: str = ""
    """The message or the traceback."""
    took_s: float = 0.0

    @property
    def is_finding(self) -> bool:
        return self.kind not in ("value", "refused")


def try_mutant(target: Target, mutant: Mutant, folder: Path) -> Outcome:
    """Try one mutant in this process."""
    start = time.monotonic()
    try:
        kind, text = target.attempt(mutant.seed, mutant.number, folder)
    except Exception:  # noqa: BLE001  # whatever it is, it is what we look for
        kind, text = "traceback", traceback.format_exc()
    return Outcome(mutant, kind, text, time.monotonic() - start)


def run(targets: dict[str, Target], mutants: list[Mutant], jobs: int) -> Iterator[Outcome]:
    """Try all mutants in ``jobs`` processes, which are forked from this one."""
    waiting = mutants[::-1]
    workers = [_Worker(targets) for _ in range(jobs)]
    try:
        for worker in workers:
            worker.take(waiting)
        while any(worker.mutant for worker in workers):
            busy = [worker for worker in workers if worker.mutant]
            limit_s = max(0.0, min(worker.until_s for worker in busy) - time.monotonic())
            ready = wait([worker.connection for worker in busy], limit_s)
            for k, worker in enumerate(workers):
                if not worker.mutant:
                    continue
                if worker.connection in ready:
                    outcome = worker.outcome()
                elif time.monotonic() > worker.until_s:
                    outcome = Outcome(worker.mutant, "hang", f"over {TIME_LIMIT_S:g} s")
                else:
                    continue
                if outcome.kind in ("hang", "killed"):
                    worker.end()
                    workers[k] = worker = _Worker(targets)
                worker.take(waiting)
                yield outcome
    finally:
        for worker in workers:
            worker.end()


class _Worker:
    """A process that tries one mutant after another."""

    def __init__(self, targets: dict[str, Target]) -> None:
        context: Any = multiprocessing.get_context("fork")  # all is imported and compiled already
        self.connection, other = context.Pipe()
        self.process = context.Process(target=_work, args=(targets, other), daemon=True)
        self.process.start()
        other.close()
        self.mutant: Mutant | None = None
        self.until_s = 0.0

    def take(self, waiting: list[Mutant]) -> None:
        """Begin the next mutant, if there is one."""
        self.mutant = waiting.pop() if waiting else None
        if self.mutant is not None:
            self.until_s = time.monotonic() + TIME_LIMIT_S
            self.connection.send(self.mutant)

    def outcome(self) -> Outcome:
        assert self.mutant is not None
        try:
            found: Outcome = self.connection.recv()
        except (EOFError, ConnectionError):
            self.process.join()
            return Outcome(self.mutant, "killed", f"exit code {self.process.exitcode}")
        return found

    def end(self) -> None:
        self.process.kill()
        self.process.join()
        self.connection.close()


def _work(targets: dict[str, Target], connection: Connection) -> None:
    """Try mutants until the connection is closed."""
    quiet = os.open(os.devnull, os.O_RDWR)
    for descriptor in (0, 1, 2):
        os.dup2(quiet, descriptor)
    limit = _virtual_bytes() + MEMORY_LIMIT_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    resource.setrlimit(resource.RLIMIT_FSIZE, (MEMORY_LIMIT_BYTES, MEMORY_LIMIT_BYTES))
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder, contextlib.suppress(EOFError):
        while True:
            mutant = connection.recv()
            connection.send(try_mutant(targets[mutant.target], mutant, Path(folder) / "mutant"))


def _virtual_bytes() -> int:
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    return pages * resource.getpagesize()

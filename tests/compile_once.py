"""Processes that run tests at the same time compile each of the loops once, not each for itself.

Numba reads a compiled loop from its cache, or compiles it and writes it there. Processes that start
together find nothing there, and compile the same at the same time. With a lock on each loop, all
but the first wait and then read what that has written.

The garbage collector rests meanwhile: a sixth of the time it looks for garbage among what the
compiler still needs.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import Dispatcher

try:
    import fcntl
except ImportError:  # Windows: each process compiles for itself
    fcntl = None  # type: ignore[assignment]

_compile = Dispatcher.compile


def take_turns() -> None:
    """Lock each loop while it is compiled, in this process from now on."""
    if fcntl is not None:
        setattr(Dispatcher, "compile", _compile_in_turn)  # noqa: B010


def _compile_in_turn(dispatcher: Any, signature: Any) -> Any:
    # The lock of the process comes first: another of its threads may hold it, and want this loop.
    with global_compiler_lock, _locked(dispatcher._cache), _without_collections():
        return _compile(dispatcher, signature)


@contextmanager
def _without_collections() -> Iterator[None]:
    """Let garbage wait until the outermost loop is compiled."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


@contextmanager
def _locked(cache: Any) -> Iterator[None]:
    """Hold the lock of a loop; the system releases it should the process be killed.

    A loop is locked before those that it calls, and no loop calls itself: nobody waits for ever.
    """
    if cache.cache_path is None:  # it is not cached
        yield
        return
    folder = Path(cache.cache_path)
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / f"{cache._impl.filename_base}.lock").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield

"""Settings of the C library that keep the memory of freed images for the next frame, or not."""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable
from functools import cache

_M_TRIM_THRESHOLD = -1
"""Parameter of ``mallopt`` in glibc's malloc.h: keep up to so many free bytes at the top."""
_M_MMAP_THRESHOLD = -3
"""Parameter of ``mallopt``: larger blocks come from the system, and go back to it when freed."""
_M_ARENA_MAX = -8
"""Parameter of ``mallopt``: the number of heaps that threads are spread over."""
KEPT_BYTES = 256 << 20
MAX_BYTES = 32 << 20
"""The largest threshold that glibc allows."""


def keep_freed_memory() -> bool:
    """Make glibc keep freed memory, for all threads of the process; return whether it does.

    Without this, glibc returns freed images to the system, and each frame pays for fresh pages: up
    to 500 page faults and 1.5 ms a frame at KITTI's image size. Both thresholds are needed: setting
    the first one stops glibc from adapting the second, and costs more than it saves.

    Threads take turns with one heap. With one each, what a thread has freed, or left behind when it
    ended, is lost to the others, and memory grows from thread to thread. A thread that has a heap
    of its own by now keeps it: call this at the start.
    """
    mallopt = _of_glibc("mallopt")
    if mallopt is None:
        return False
    values = {_M_MMAP_THRESHOLD: MAX_BYTES, _M_TRIM_THRESHOLD: KEPT_BYTES, _M_ARENA_MAX: 1}
    return all(mallopt(parameter, value) for parameter, value in values.items())


def release_freed_memory() -> bool:
    """Give pages of freed memory back to the system; return whether there were any.

    In a heap that keeps freed memory, small blocks come to lie among the images, and each image
    that no longer fits anywhere makes the heap larger: a few megabytes in a day of frames. A
    process that lives so long calls this every ten seconds, between two frames. It takes about a
    millisecond, and the next frame pays for fresh pages.
    """
    malloc_trim = _of_glibc("malloc_trim")
    return malloc_trim is not None and bool(malloc_trim(0))


@cache
def _of_glibc(name: str) -> Callable[..., int] | None:
    """Return a function of glibc; None on another system, or where musl takes its place."""
    return getattr(ctypes.CDLL(None), name, None) if sys.platform == "linux" else None

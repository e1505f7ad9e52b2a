"""A setting of the C library that keeps the memory of freed images for the next frame."""

from __future__ import annotations

import ctypes
import sys

_M_TRIM_THRESHOLD = -1
"""Parameter of ``mallopt`` in glibc's malloc.h: keep up to so many free bytes at the top."""
_M_MMAP_THRESHOLD = -3
"""Parameter of ``mallopt``: larger blocks come from the system, and go back to it when freed."""
KEPT_BYTES = 256 << 20
LARGEST_BYTES = 32 << 20
"""The largest threshold that glibc allows."""


def keep_freed_memory() -> bool:
    """Make glibc keep freed memory for the whole process; return whether it does.

    Without this, glibc returns freed images to the system, and each frame pays for fresh pages: up
    to 500 page faults and 1.5 ms a frame at KITTI's image size. Both settings are needed: setting
    the first one stops glibc from adapting the second, and costs more than it saves.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    if mallopt is None:  # another system, or musl instead of glibc
        return False
    has_set_largest = bool(mallopt(_M_MMAP_THRESHOLD, LARGEST_BYTES))
    return has_set_largest and bool(mallopt(_M_TRIM_THRESHOLD, KEPT_BYTES))

"""Keeps the memory of images that are freed, for those of the next frame."""

from __future__ import annotations

import ctypes
import sys

_M_TRIM_THRESHOLD = -1
_M_MMAP_THRESHOLD = -3
"""Names of two settings in glibc's malloc.h."""
KEPT_BYTES = 256 << 20
LARGEST_BYTES = 32 << 20
"""Larger blocks still go back to the system; glibc allows no more."""


def keep_freed_memory() -> bool:
    """Tell glibc not to hand freed images back to the system, for the whole process; whether it
    took it.

    Otherwise it does, and each frame pays for fresh pages: up to 500 faults and 1.5 ms a frame at
    KITTI's size. Both
    settings are needed: the first alone stops glibc from raising the second, and costs more than it
    saves.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    if mallopt is None:  # another system, or musl
        return False
    return bool(mallopt(_M_MMAP_THRESHOLD, LARGEST_BYTES)) and bool(
        mallopt(_M_TRIM_THRESHOLD, KEPT_BYTES)
    )

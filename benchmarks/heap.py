"""Memory in use by ``malloc``, without what the C library keeps of freed memory.

Resident memory holds freed blocks and pages of files, too: it grows by fragmentation, and by what
else the machine does. What grows here is held by somebody.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable
from functools import cache

SIZES = (
    *("arena", "ordblks", "smblks", "hblks", "hblkhd"),
    *("usmblks", "fsmblks", "uordblks", "fordblks", "keepcost"),
)


class _MallInfo2(ctypes.Structure):
    """``struct mallinfo2`` of glibc's malloc.h."""

    _fields_ = [(name, ctypes.c_size_t) for name in SIZES]


@cache
def _mallinfo2() -> Callable[[], _MallInfo2] | None:
    """Return the function of the C library; None on another system, musl, or old glibc.

    Each ``CDLL`` leaves a cycle of 26 objects behind: one for all calls, lest a count of objects
    count those.
    """
    c_library = ctypes.CDLL(None) if sys.platform == "linux" else None
    mallinfo2 = getattr(c_library, "mallinfo2", None)  # glibc has it since 2.33
    if mallinfo2 is not None:
        mallinfo2.restype = _MallInfo2
    return mallinfo2


def heap_mb() -> float | None:
    """Return the memory in use by ``malloc`` in all threads, MiB; None where it is not known.

    Arrays and all objects over 512 bytes are in it. Smaller objects are not: Python takes memory
    for them from the system; their number is ``sys.getallocatedblocks()``.
    """
    mallinfo2 = _mallinfo2()
    if mallinfo2 is None:
        return None
    info = mallinfo2()
    return float(info.uordblks + info.hblkhd) / 2**20  # in heaps, and straight from the system

"""Memory in use by ``malloc``, without what the C library keeps of freed memory.

Resident memory holds freed blocks and pages of files, too: it grows by fragmentation, and by what
else the machine does. What grows here is held by somebody.
"""

from __future__ import annotations

import ctypes
import sys

SIZES = (
    *("arena", "ordblks", "smblks", "hblks", "hblkhd"),
    *("usmblks", "fsmblks", "uordblks", "fordblks", "keepcost"),
)


class _MallInfo2(ctypes.Structure):
    """``struct mallinfo2`` of glibc's malloc.h."""

    _fields_ = [(name, ctypes.c_size_t) for name in SIZES]


def heap_mb() -> float | None:
    """Return the memory in use by ``malloc`` in all threads, MiB; None where it is not known.

    Arrays and all objects over 512 bytes are in it. Smaller objects are not: Python takes memory
    for them from the system; their number is ``sys.getallocatedblocks()``.
    """
    c_library = ctypes.CDLL(None) if sys.platform == "linux" else None
    mallinfo2 = getattr(c_library, "mallinfo2", None)
    if mallinfo2 is None:  # another system, musl, or glibc before 2.33
        return None
    mallinfo2.restype = _MallInfo2
    info = mallinfo2()
    return float(info.uordblks + info.hblkhd) / 2**20  # in heaps, and straight from the system

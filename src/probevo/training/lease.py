"""A lease for workers: a worker whose lease has expired stops, since nobody needs its result.

A task on a cluster cannot be interrupted. After Ctrl-C, or when the training is started anew,
workers may still be recording drives; a lease in the folder of the checkpoint tells them to stop.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from uuid import uuid4

from probevo.storage.files import write_atomically

LEASE = "lease"
"""Name of the file in the folder of the checkpoint."""
EXPIRED = "expired"


@contextmanager
def leased(folder: Path) -> Iterator[str]:
    """Grant a lease that is valid until the context ends, or until the next lease is granted."""
    lease = uuid4().hex
    write_atomically(folder / LEASE, lease)
    try:
        yield lease
    finally:
        write_atomically(folder / LEASE, EXPIRED)


def is_valid(lease: str, folder: Path) -> bool:
    """Return whether this lease is the one granted last.

    It counts as valid if the file cannot be read, as may happen on a slow file system.
    """
    try:
        return (folder / LEASE).read_text("utf-8") == lease
    except OSError:
        return True

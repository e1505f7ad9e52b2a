"""Does the slow part of reading a recording in threads, ahead of its consumer."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


def read_ahead(
    read: Callable[[Item], Result], items: Iterable[Item], *, ahead: int = 4, threads: int = 2
) -> Generator[Result, None, None]:
    """``map(read, items)`` with up to ``ahead`` results in the making while the consumer works.

    Results come in order, and an error comes where its result would have. Work is only handed out
    when the consumer asks for a result, so memory is bounded without a queue; once it stops asking
    (``break``, an exception), what has not begun is cancelled.

    Two threads: reading and decoding release the GIL, and a pair decodes (7 ms at KITTI's size)
    faster than it is used.
    """
    pending: deque[Future[Result]] = deque()
    with ThreadPoolExecutor(threads, thread_name_prefix="probevo-read") as pool:
        try:
            for item in items:
                pending.append(pool.submit(read, item))
                if len(pending) > ahead:
                    yield pending.popleft().result()
            while pending:
                yield pending.popleft().result()
        finally:
            pool.shutdown(wait=True, cancel_futures=True)

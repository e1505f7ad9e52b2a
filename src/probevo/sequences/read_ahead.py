"""Reading of a recording in threads, ahead of its consumer."""

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
    """Yield ``map(read, items)``, with up to ``ahead`` results in work while the consumer works.

    Results come in order, and an error is raised where its result would have come. New items are
    only started when the consumer asks for a result, which bounds the memory without a queue. When
    it stops asking (``break``, or an exception), items that have not been started are cancelled.

    Two threads suffice: reading and decoding release the GIL, and a pair is decoded (7 ms at the
    size of KITTI's images) faster than it is processed.
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

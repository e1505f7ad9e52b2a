"""Reading ahead: order, bounds, errors and a clean stop."""

import threading
import time

import pytest

from probevo.sequences.read_ahead import read_ahead


def test_results_keep_their_order_though_later_ones_are_ready_first() -> None:
    def slow_at_first(index: int) -> int:
        time.sleep(0.02 if index % 2 == 0 else 0.0)
        return index

    assert list(read_ahead(slow_at_first, range(9))) == list(range(9))


@pytest.mark.parametrize("count", [0, 1, 4, 5, 6])
def test_every_item_is_read_once(count: int) -> None:
    seen: list[int] = []

    def read(index: int) -> int:
        seen.append(index)
        return index

    assert list(read_ahead(read, range(count))) == list(range(count))
    assert sorted(seen) == list(range(count))


def test_no_more_than_the_bound_is_read_ahead() -> None:
    begun: list[int] = []

    def read(index: int) -> int:
        begun.append(index)
        return index

    results = read_ahead(read, range(100), ahead=4)
    assert next(results) == 0
    time.sleep(0.05)
    assert max(begun) <= 4
    results.close()


def test_error_surfaces_at_its_own_item() -> None:
    def read(index: int) -> int:
        if index == 3:
            raise ValueError("item 3")
        return index

    results = read_ahead(read, range(10))
    assert [next(results) for _ in range(3)] == [0, 1, 2]
    with pytest.raises(ValueError, match="item 3"):
        next(results)


@pytest.mark.parametrize("finish", ["break", "error", "exhaust"])
def test_threads_end_when_the_consumer_does(finish: str) -> None:
    def consume() -> None:
        for result in read_ahead(lambda index: index, range(50)):
            if finish == "break" and result == 2:
                break
            if finish == "error" and result == 2:
                raise RuntimeError

    if finish == "error":
        with pytest.raises(RuntimeError):
            consume()
    else:
        consume()
    assert not [
        thread for thread in threading.enumerate() if thread.name.startswith("probevo-read")
    ]


def test_reading_runs_in_two_threads() -> None:
    """Both must be inside ``read`` at once to pass the barrier."""
    barrier = threading.Barrier(2, timeout=5)
    assert len(list(read_ahead(lambda index: barrier.wait(), range(4)))) == 4

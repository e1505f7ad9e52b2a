"""A growing array holds the rows that were added, at any length, and nothing else."""

import tracemalloc

import numpy as np
import pytest

from probevo.output.rows import Rows

BLOCK = Rows.BLOCK


@pytest.mark.parametrize("count", [0, 1, BLOCK - 1, BLOCK, BLOCK + 1, 3 * BLOCK])
def test_a_table_holds_what_was_added(count: int) -> None:
    expected = np.random.default_rng(0).normal(size=(count, 3))
    rows = Rows(np.float64, (3,))
    for row in expected:
        rows.add(row)
    assert len(rows) == count
    np.testing.assert_array_equal(rows.table(), expected)


@pytest.mark.parametrize("count", [0, 1, BLOCK - 1, BLOCK, 2 * BLOCK + 5])
def test_rows_follow_zeros(count: int) -> None:
    rows = Rows(np.int64, (2,), zeros=count)
    rows.add((1, 2))
    np.testing.assert_array_equal(rows.table(), [*[(0, 0)] * count, (1, 2)])


def test_a_row_is_copied() -> None:
    row = np.ones(2)
    rows = Rows(np.float64, (2,))
    rows.add(row)
    row[:] = 2.0
    table = rows.table()
    table[:] = 3.0
    np.testing.assert_array_equal(rows.table(), [[1.0, 1.0]])


def test_rows_are_as_large_as_their_numbers() -> None:
    rows = Rows(np.float64, (17,))
    row = np.ones(17)
    count = 10 * BLOCK
    tracemalloc.start()
    try:
        for _ in range(count):
            rows.add(row)
        grown, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert grown < 1.1 * 136 * count

"""Fixtures for all tests."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

# Workers of xdist and subprocesses inherit this. With threads, OpenBLAS makes an eigendecomposition
# of size 40 wait for 10 ms instead of 0.1 where all cores are busy, as they are with the tests.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


@pytest.fixture(scope="session")
def data_root() -> Path:
    """Folder of the real recordings; the test is skipped if they are absent."""
    root = Path(os.environ.get("PROBEVO_DATA", Path(__file__).parents[2] / "shared" / "data"))
    if not root.is_dir():
        pytest.skip(f"no real recordings at {root}: set PROBEVO_DATA to their folder")
    return root


@pytest.fixture
def undrawn() -> Iterator[None]:
    """Leave the figures of all pages empty, for a test that does not look at them."""
    from output.undrawn import figures_undrawn

    with figures_undrawn():
        yield

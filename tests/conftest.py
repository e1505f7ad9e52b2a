"""Fixtures for all tests."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest


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

"""Networks of the tests are compiled without optimisations: in a fifth of the time."""

from __future__ import annotations

from collections.abc import Iterator

import pytest


@pytest.fixture(autouse=True, scope="module")
def compiled_quickly() -> Iterator[None]:
    jax = pytest.importorskip("jax", reason="jax is missing: pip install 'probevo[nets]'")
    jax.config.update("jax_disable_most_optimizations", True)
    yield
    jax.config.update("jax_disable_most_optimizations", False)

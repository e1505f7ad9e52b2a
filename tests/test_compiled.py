"""Compiled loops: whatever is compiled when, their arithmetic is that of the source."""

import importlib
import pkgutil
from types import ModuleType

import numpy as np
import pytest
from numba.core.dispatcher import Dispatcher

import probevo
import probevo_sim
from probevo.compiled import (
    dot_float32,
    inner_products_float32,
    invert_symmetric_4,
    multiply_float32,
    sum_float32,
    sum_in_lanes,
    sum_magnitudes_float32,
)


def compiled_functions(package: ModuleType) -> dict[str, Dispatcher]:
    """Return the compiled functions of a package by their full names."""
    found: dict[str, Dispatcher] = {}
    for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
        if module.name.endswith("__main__"):
            continue
        for name, value in vars(importlib.import_module(module.name)).items():
            if isinstance(value, Dispatcher) and value.__module__ == module.name:
                found[f"{module.name}.{name}"] = value
    return found


def test_only_leaf_loops_may_reorder_sums() -> None:
    """Reordered sums differ in their last digits between a cold and a warm compiler cache."""
    functions = compiled_functions(probevo) | compiled_functions(probevo_sim)
    assert len(functions) > 100
    fast = [name for name, one in functions.items() if one.targetoptions.get("fastmath")]
    assert fast == [
        "probevo.compiled.dot_float32",
        "probevo.compiled.multiply_float32",
        "probevo.compiled.inner_products_float32",
        "probevo.compiled.sum_float32",
        "probevo.compiled.sum_magnitudes_float32",
        "probevo.noise.probe.neighbor_index_numba._sum_within",
    ]


@pytest.mark.parametrize("n", [0, 1, 7, 121])
def test_sums_in_single_precision(n: int) -> None:
    rng = np.random.default_rng(0)
    a = rng.normal(size=n).astype(np.float32)
    rows = rng.normal(size=(3, n)).astype(np.float32)
    np.testing.assert_allclose(dot_float32(a, rows[0]), np.dot(a, rows[0]), rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(sum_float32(a), a.sum(), rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(sum_magnitudes_float32(a), np.abs(a).sum(), rtol=1e-5)
    product = np.empty(3)
    multiply_float32(rows, a, product)
    np.testing.assert_allclose(product, rows @ a, rtol=1e-5, atol=1e-5)
    products = np.empty((3, 3))
    inner_products_float32(rows, products)
    np.testing.assert_allclose(products, rows @ rows.T, rtol=1e-5, atol=1e-5)


def test_sum_in_lanes() -> None:
    rng = np.random.default_rng(1)
    for n in (0, 1, 7, 8, 9, 16, 121):
        values = rng.normal(size=n)
        assert abs(sum_in_lanes(values) - values.sum()) < 1e-13
        lanes = np.zeros(8)
        for m, value in enumerate(values):
            lanes[m % 8 if m < n - n % 8 else 0] += value
        a, b, c, d, e, f, g, h = lanes
        assert sum_in_lanes(values) == ((a + e) + (c + g)) + ((b + f) + (d + h))


def test_an_inverse_is_right_or_refused() -> None:
    """A matrix whose smallest eigenvalue is lost in rounding has none: eᵀ Σ⁻¹ e might be
    negative."""
    rng = np.random.default_rng(2)
    inverse = np.empty((4, 4))
    lower = np.zeros((4, 4))
    half = rng.normal(size=(4, 4))
    regular = half @ half.T + np.eye(4)
    assert invert_symmetric_4(regular, inverse, lower)
    np.testing.assert_allclose(inverse @ regular, np.eye(4), atol=1e-12)
    assert not invert_symmetric_4(-regular, inverse, lower)
    for _ in range(100):
        direction = rng.normal(size=4)
        outer = np.outer(direction, direction)
        assert invert_symmetric_4(np.eye(4) + 1e8 * outer, inverse, lower)
        assert not invert_symmetric_4(np.eye(4) + 1e20 * outer, inverse, lower)

"""The error of pose corrections, and the gradient of the loss by which they are learned."""

from __future__ import annotations

from functools import cache, partial
from typing import Any

import numpy as np
import pytest

from probevo.geometry import se3

jax = pytest.importorskip("jax", reason="jax is missing: pip install 'probevo[nets]'")
pytest.importorskip("equinox")

from probevo.nets.corrections import correction_error  # noqa: E402

STEP = 1e-6
SIZES = (0.0, 1e-6, 0.02, 0.5, 1.5)


def tangents(size: float, seed: int) -> np.ndarray:
    return size * np.random.default_rng(seed).uniform(-1.0, 1.0, (10, 6))


def information() -> np.ndarray:
    root = np.random.default_rng(9).normal(size=(6, 6))
    return root @ root.T + np.eye(6)


def loss(xi: Any, xi_true: Any, weight: Any) -> Any:
    """½ gᵀ Σ⁻¹ g (thesis chapter 6)."""
    error = correction_error(xi, xi_true)
    return 0.5 * error @ weight @ error


@cache
def compiled_error() -> Any:
    """Return the error of ten corrections, compiled once for all tests."""
    return jax.jit(jax.vmap(correction_error))


@cache
def compiled_loss() -> Any:
    return jax.jit(loss)


@cache
def compiled_gradient() -> Any:
    return jax.jit(jax.grad(loss))


@pytest.mark.parametrize("size", SIZES)
def test_the_error_is_the_logarithm_of_the_difference(size: float) -> None:
    xi = tangents(size, seed=2)
    xi_true = tangents(0.5, seed=3)
    expected = se3.log(se3.exp(xi) @ se3.inverse(se3.exp(xi_true)))
    with jax.enable_x64(True):
        found = np.asarray(compiled_error()(xi, xi_true))
    assert found == pytest.approx(expected, abs=1e-11)


@pytest.mark.parametrize("size", SIZES)
def test_the_gradient_is_the_derived_one(size: float) -> None:
    """gᵀ Σ⁻¹ J(g)⁻¹ J(ξ), and central differences within 1e-6."""
    weight = information()
    target = tangents(0.5, seed=4)[0]
    with jax.enable_x64(True):
        loss_of = partial(compiled_loss(), xi_true=target, weight=weight)
        gradient_of = partial(compiled_gradient(), xi_true=target, weight=weight)
        for xi in tangents(size, seed=5):
            numerical = [
                (loss_of(xi + step) - loss_of(xi - step)) / (2.0 * STEP)
                for step in STEP * np.eye(6)
            ]
            found = np.asarray(gradient_of(xi))
            scale = max(1.0, float(np.abs(numerical).max()))
            assert found == pytest.approx(np.array(numerical), abs=1e-6 * scale)
            error = se3.log(se3.exp(xi) @ se3.inverse(se3.exp(target)))
            jacobian = np.linalg.solve(se3.left_jacobian(error), se3.left_jacobian(xi))
            assert found == pytest.approx(error @ weight @ jacobian, rel=1e-9)


def test_the_loss_is_zero_at_the_truth_alone() -> None:
    with jax.enable_x64(True):
        loss_of = partial(compiled_loss(), weight=information())
        xi = tangents(0.5, seed=6)[0]
        assert float(loss_of(xi, xi_true=xi)) == pytest.approx(0.0, abs=1e-24)
        other = xi + 1e-3 * np.eye(6)[4]
        assert float(loss_of(other, xi_true=xi)) > 1e-7


def test_descent_by_the_gradient_finds_the_truth() -> None:
    with jax.enable_x64(True):
        target = tangents(0.5, seed=7)[0]
        gradient_of = partial(compiled_gradient(), xi_true=target, weight=np.eye(6))
        xi = np.zeros(6)
        for _ in range(200):
            xi = xi - 0.3 * np.asarray(gradient_of(xi))
        assert xi == pytest.approx(target, abs=1e-9)

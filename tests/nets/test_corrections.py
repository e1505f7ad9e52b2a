"""The loss of pose corrections: errors and Jacobians of SE(3), gradients by central differences."""

from __future__ import annotations

import numpy as np
import pytest

from probevo.geometry import se3

jax = pytest.importorskip("jax", reason="jax is missing: pip install 'probevo[nets]'")
pytest.importorskip("equinox")

from probevo.nets import corrections  # noqa: E402

STEP = 1e-6
SIZES = (0.0, 1e-6, 0.02, 0.5, 1.5)


def tangents(size: float, seed: int) -> np.ndarray:
    return size * np.random.default_rng(seed).uniform(-1.0, 1.0, (10, 6))


def information() -> np.ndarray:
    root = np.random.default_rng(9).normal(size=(6, 6))
    return root @ root.T + np.eye(6)


@pytest.mark.parametrize("size", SIZES)
def test_the_pose_jacobian_is_that_of_the_geometry(size: float) -> None:
    xi = tangents(size, seed=1)
    with jax.enable_x64(True):
        found = np.asarray(jax.jit(jax.vmap(corrections.pose_jacobian))(xi))
    assert found == pytest.approx(se3.left_jacobian(xi), abs=1e-12)


@pytest.mark.parametrize("size", SIZES)
def test_the_error_is_the_logarithm_of_the_difference(size: float) -> None:
    xi = tangents(size, seed=2)
    xi_true = tangents(0.5, seed=3)
    expected = se3.log(se3.exp(xi) @ se3.inverse(se3.exp(xi_true)))
    with jax.enable_x64(True):
        found = np.asarray(jax.jit(jax.vmap(corrections.correction_error))(xi, xi_true))
    assert found == pytest.approx(expected, abs=1e-11)


@pytest.mark.parametrize("size", SIZES)
def test_the_gradient_is_that_of_central_differences(size: float) -> None:
    """gᵀ Σ⁻¹ J(g)⁻¹ J(ξ), and what jax.grad takes for it, within 1e-6."""
    with jax.enable_x64(True):
        weight = jax.numpy.asarray(information())
        target = jax.numpy.asarray(tangents(0.5, seed=4)[0])
        loss = jax.jit(lambda xi: corrections.correction_loss(xi, target, weight))
        gradient_of = jax.jit(jax.grad(loss))
        derive = jax.jit(corrections.correction_gradient)
        for xi in tangents(size, seed=5):
            numerical = [
                (loss(xi + step) - loss(xi - step)) / (2.0 * STEP) for step in STEP * np.eye(6)
            ]
            scale = max(1.0, float(np.abs(numerical).max()))
            derived = derive(xi, target, weight)
            assert np.asarray(derived) == pytest.approx(np.array(numerical), abs=1e-6 * scale)
            taken = np.asarray(gradient_of(xi))
            assert taken == pytest.approx(np.asarray(derived), rel=1e-12)


def test_the_loss_is_zero_at_the_truth_alone() -> None:
    with jax.enable_x64(True):
        weight = jax.numpy.asarray(information())
        xi = jax.numpy.asarray(tangents(0.5, seed=6)[0])
        loss = jax.jit(corrections.correction_loss)
        assert float(loss(xi, xi, weight)) == pytest.approx(0.0, abs=1e-24)
        other = xi.at[4].add(1e-3)
        assert float(loss(other, xi, weight)) > 1e-7


def test_descent_by_the_gradient_finds_the_truth() -> None:
    with jax.enable_x64(True):
        target = jax.numpy.asarray(tangents(0.5, seed=7)[0])
        weight = jax.numpy.eye(6)
        gradient_of = jax.jit(jax.grad(lambda xi: corrections.correction_loss(xi, target, weight)))
        xi = jax.numpy.zeros(6)
        for _ in range(200):
            xi = xi - 0.3 * gradient_of(xi)
        assert np.asarray(xi) == pytest.approx(np.asarray(target), abs=1e-9)

"""The sun as a target: the errors are those of the measurement, covariances positive definite."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

jax = pytest.importorskip("jax", reason="jax is missing: pip install 'probevo[nets]'")
pytest.importorskip("equinox")

from probevo.measurements.direction import Direction  # noqa: E402
from probevo.measurements.variables import pose_of  # noqa: E402
from probevo.nets.sun_space import SunTargets  # noqa: E402

SPACE = SunTargets()


def directions(count: int, seed: int) -> np.ndarray:
    vectors = np.random.default_rng(seed).normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def test_errors_are_those_of_the_measurement() -> None:
    """Also of a sun straight above or below the camera, and of an estimate opposite to it."""
    special = np.array([[0.0, -1.0, 0.0], [0.0, 1.0, 0.0], [1e-5, -1.0, 0.0], [0.0, 0.0, -1.0]])
    estimates = np.concatenate([directions(30, 0), directions(3, 9), [[0.0, 0.0, 1.0]]])
    truths = np.concatenate([directions(30, 1), special])
    with jax.enable_x64(True):
        errors = np.asarray(SPACE.difference(*map(jax.numpy.asarray, (estimates, truths))))
    pose = pose_of(3)
    expected = [
        Direction(pose, estimate, truth, np.eye(2)).residual({pose: np.eye(4)})
        for estimate, truth in zip(estimates, truths, strict=True)
    ]
    np.testing.assert_allclose(errors, expected, atol=1e-6)


def test_a_perturbed_direction_has_that_error() -> None:
    truths = np.concatenate([directions(10, 2), [[0.0, -1.0, 0.0]]])
    errors = np.random.default_rng(3).normal(0.0, 1e-3, (11, 2))
    with jax.enable_x64(True):
        moved = SPACE.perturb(*map(jax.numpy.asarray, (truths, errors)))
        found = np.asarray(SPACE.difference(moved, jax.numpy.asarray(truths)))
    np.testing.assert_allclose(found, errors, atol=1e-5)


def test_derivatives_are_finite_where_there_is_no_azimuth() -> None:
    """By the true direction, too: the derivative of the root is infinite at zero."""
    up = jax.numpy.array([0.0, -1.0, 0.0])
    estimate = jax.numpy.array([0.6, -0.8, 0.0])
    for function in (SPACE.difference, lambda one, other: SPACE.perturb(other, one[:2])):
        for argument in (0, 1):
            assert np.isfinite(jax.jacobian(function, argument)(estimate, up)).all()


def test_whitened_errors_have_the_covariance_of_the_head() -> None:
    rng = np.random.default_rng(4)
    raw = rng.normal(0.0, 20.0, (50, 3))
    errors = rng.normal(size=(50, 2))
    with jax.enable_x64(True):
        whitened, second = SPACE.whiten(*map(jax.numpy.asarray, (raw, errors)))
        found = np.asarray(whitened)
        half_log_det = np.asarray(second)
    covariance = SPACE.covariance(raw)
    np.linalg.cholesky(covariance)
    expected = np.einsum("ni,nij,nj->n", errors, np.linalg.inv(covariance), errors)
    np.testing.assert_allclose(np.sum(found**2, axis=1), expected, rtol=1e-6)
    np.testing.assert_allclose(half_log_det, 0.5 * np.linalg.slogdet(covariance).logabsdet)


def test_without_a_covariance_the_loss_is_the_squared_chord() -> None:
    """Of any angle, the gradient by the vector included, which is that of 2 (1 − u·p)."""
    truth = directions(1, 7)[0]

    def loss(vector: Any) -> Any:
        return SPACE.squared(SPACE.difference(SPACE.estimate(vector), jax.numpy.asarray(truth)))

    with jax.enable_x64(True):
        compiled = jax.jit(jax.value_and_grad(loss))
        for vector in (*directions(5, 8), truth, -truth + 0.01):
            unit = vector / np.linalg.norm(vector)
            value, gradient = compiled(vector)
            assert float(value) == pytest.approx(np.sum((unit - truth) ** 2), abs=1e-6)
            for axis, step in enumerate(1e-5 * np.eye(3)):
                ahead, _ = compiled(vector + step)
                behind, _ = compiled(vector - step)
                numerical = (float(ahead) - float(behind)) / 2e-5
                assert float(gradient[axis]) == pytest.approx(numerical, abs=1e-6)


def test_the_estimate_learns_from_the_chord_and_the_covariance_from_the_likelihood() -> None:
    """The derivative of the loss by the estimate is that of 2 (1 − u·p), by any covariance."""
    truth = directions(1, 5)[0]
    raw = np.array([0.3, -0.7, 0.4])

    def loss(vector: Any, head: Any) -> Any:
        errors = SPACE.difference(SPACE.estimate(vector), jax.numpy.asarray(truth))
        whitened, second = SPACE.whiten(head, errors)
        return 0.5 * jax.numpy.sum(whitened**2) + second

    with jax.enable_x64(True):
        for vector in (*directions(5, 6), -truth + 0.1):
            unit = vector / np.linalg.norm(vector)
            by_vector, by_head = jax.grad(loss, (0, 1))(
                jax.numpy.asarray(vector), jax.numpy.asarray(raw)
            )
            across = np.eye(3) - np.outer(unit, unit)
            expected = -across @ truth / 0.5**2 / np.linalg.norm(vector)
            np.testing.assert_allclose(by_vector, expected, atol=1e-3)
            for axis, unit_step in enumerate(1e-6 * np.eye(3)):
                ahead, behind = (
                    float(loss(jax.numpy.asarray(vector), jax.numpy.asarray(raw + step)))
                    for step in (unit_step, -unit_step)
                )
                assert float(by_head[axis]) == pytest.approx((ahead - behind) / 2e-6, abs=1e-5)

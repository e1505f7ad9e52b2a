"""Covariances of numbers and rotations, positive definite for any weights; gradients of losses."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

jax = pytest.importorskip("jax", reason="jax is missing: pip install 'probevo[nets]'")
pytest.importorskip("equinox")

from probevo.nets.target_space import (  # noqa: E402
    FIRST_SIGMA_RAD,
    NumberTargets,
    RotationTargets,
    TargetSpace,
)

STEP = 1e-6
SPACES = (NumberTargets(), RotationTargets())
each_space = pytest.mark.parametrize("space", SPACES, ids=lambda space: type(space).__name__)


def negative_log_likelihood(
    space: TargetSpace, outputs: np.ndarray, raw: np.ndarray, target: np.ndarray
) -> Any:
    error = space.difference(space.estimate(outputs), target)
    whitened, half_log_det = space.whiten(raw, error)
    return 0.5 * jax.numpy.sum(whitened**2) + half_log_det


@each_space
@pytest.mark.parametrize("scale", [1e-3, 1.0, 30.0, 1e4, 1e12])
def test_the_covariance_is_positive_definite_for_any_weights(
    space: TargetSpace, scale: float
) -> None:
    raw = np.random.default_rng(0).normal(0.0, scale, (2000, space.num_covariance))
    covariance = space.covariance(raw)
    assert np.array_equal(covariance, covariance.mT)
    assert np.linalg.eigvalsh(covariance).min() > 0.0
    assert np.isfinite(np.linalg.cholesky(covariance)).all()


@each_space
@pytest.mark.parametrize("raw_value", [-1e30, 0.0, 1e30])
def test_the_loss_and_its_gradient_are_finite_at_extreme_weights(
    space: TargetSpace, raw_value: float
) -> None:
    raw = jax.numpy.full(space.num_covariance, raw_value)
    error = jax.numpy.full(space.dof, 0.1)

    def loss(values: Any) -> Any:
        whitened, half_log_det = space.whiten(values, error)
        return jax.numpy.sum(whitened**2) + half_log_det

    value, gradient = jax.jit(jax.value_and_grad(loss))(raw)
    assert np.isfinite(value)
    assert np.isfinite(gradient).all()


@each_space
def test_whitening_is_that_of_the_covariance(space: TargetSpace) -> None:
    rng = np.random.default_rng(1)
    raw = rng.normal(0.0, 0.7, (50, space.num_covariance))
    errors = rng.normal(0.0, 0.3, (50, space.dof))
    with jax.enable_x64(True):
        whitened, half_log_det = space.whiten(jax.numpy.asarray(raw), jax.numpy.asarray(errors))
        squared = np.sum(np.asarray(whitened) ** 2, axis=1)
    covariance = space.covariance(raw)
    expected = np.einsum("ni,nij,nj->n", errors, np.linalg.inv(covariance), errors)
    assert squared == pytest.approx(expected, rel=1e-8)
    log_det = np.linalg.slogdet(covariance).logabsdet
    assert np.asarray(half_log_det) == pytest.approx(0.5 * log_det, abs=1e-9)


@each_space
def test_gradients_are_those_of_central_differences(space: TargetSpace) -> None:
    """With respect to the outputs of both heads, within 1e-6."""
    rng = np.random.default_rng(2)
    split = space.num_outputs
    with jax.enable_x64(True):

        def given(values: Any, target: Any) -> Any:
            return negative_log_likelihood(space, values[:split], values[split:], target)

        loss = jax.jit(given)
        gradient_of = jax.jit(jax.grad(given))
        for _ in range(20):
            target = rng.normal(size=split)
            if split == 4:
                target /= np.linalg.norm(target)
            at = rng.normal(size=split + space.num_covariance)
            gradient = np.asarray(gradient_of(at, target))
            steps = STEP * np.eye(len(at))
            numerical = np.array(
                [
                    float(loss(at + step, target) - loss(at - step, target)) / (2.0 * STEP)
                    for step in steps
                ]
            )
            scale = max(1.0, np.abs(numerical).max())
            assert gradient == pytest.approx(numerical, abs=1e-6 * scale)


def test_the_loss_takes_a_quaternion_and_its_negative_as_the_same() -> None:
    rng = np.random.default_rng(3)
    space = RotationTargets()
    outputs = rng.normal(size=4)
    target = np.asarray(space.estimate(jax.numpy.asarray(rng.normal(size=4))))
    raw = rng.normal(size=6)
    losses = {
        float(negative_log_likelihood(space, jax.numpy.asarray(a * outputs), raw, b * target))
        for a in (1.0, -1.0)
        for b in (1.0, -1.0)
    }
    assert len(losses) == 1


def test_a_head_of_zeros_means_the_first_sigma() -> None:
    covariance = RotationTargets().covariance(np.zeros(6))
    assert covariance == pytest.approx(FIRST_SIGMA_RAD**2 * np.eye(3), rel=1e-12)


@each_space
def test_a_perturbed_target_differs_by_the_perturbation(space: TargetSpace) -> None:
    rng = np.random.default_rng(4)
    with jax.enable_x64(True):
        target = space.estimate(jax.numpy.asarray(rng.normal(size=(9, space.num_outputs))))
        errors = jax.numpy.asarray(rng.normal(0.0, 0.5, (9, space.dof)))
        found = space.difference(space.perturb(target, errors), target)
        assert np.asarray(found) == pytest.approx(np.asarray(errors), abs=1e-12)

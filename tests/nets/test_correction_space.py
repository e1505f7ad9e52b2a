"""Corrections as targets: the loss is the thesis's, covariances are positive definite."""

from __future__ import annotations

import numpy as np
import pytest

from probevo.geometry import se3

jax = pytest.importorskip("jax", reason="jax is missing: pip install 'probevo[nets]'")
pytest.importorskip("equinox")

from probevo.nets.correction_space import (  # noqa: E402
    ALL_AXES,
    ROTATION_AXES,
    CorrectionTargets,
)


def space_of(axes: tuple[int, ...]) -> CorrectionTargets:
    """A space whose training data had random covariances."""
    rng = np.random.default_rng(0)
    root = np.tril(rng.normal(0.0, 0.01, (len(axes), len(axes))))
    root[np.diag_indices(len(axes))] = rng.uniform(0.01, 0.05, len(axes))
    return CorrectionTargets(tuple(map(tuple, root.tolist())), axes)


def test_half_the_squared_error_is_the_loss_of_the_thesis() -> None:
    """½ gᵀ Σ⁻¹ g with g = Log(Exp(ξ) T*⁻¹), and Σ = L Lᵀ."""
    space = space_of(ALL_AXES)
    xi, true = np.random.default_rng(1).normal(0.0, 0.1, (2, 4, 6))
    root = np.asarray(space.root)
    g = se3.log(se3.exp(xi) @ se3.inverse(se3.exp(true)))
    losses = 0.5 * np.einsum("ni,ij,nj->n", g, np.linalg.inv(root @ root.T), g)
    with jax.enable_x64(True):
        errors = space.difference(jax.numpy.asarray(xi), jax.numpy.asarray(true))
        squared = np.asarray(space.squared(errors))
    np.testing.assert_allclose(0.5 * squared, losses, rtol=1e-9)


def test_axes_that_are_not_corrected_stay_zero() -> None:
    space = space_of(ROTATION_AXES)
    found = np.asarray(space.estimate(jax.numpy.ones((5, 3))))
    assert found.shape == (5, 6)
    assert (found[:, :3] == 0.0).all()
    np.testing.assert_allclose(found[0, 3:], np.asarray(space.root) @ np.ones(3), rtol=1e-6)
    assert space.num_covariance == 6


@pytest.mark.parametrize("axes", [ALL_AXES, ROTATION_AXES])
def test_whitened_errors_have_the_covariance_of_the_head(axes: tuple[int, ...]) -> None:
    """|whitened|² = eᵀ Σ⁻¹ e, and the second result is ½ log|Σ|, for any outputs of the head."""
    space = space_of(axes)
    rng = np.random.default_rng(2)
    raw = rng.normal(0.0, 20.0, (50, space.num_covariance))
    raw[0] = 0.0
    errors = rng.normal(size=(50, space.dof))
    with jax.enable_x64(True):
        whitened, half_log_det = space.whiten(jax.numpy.asarray(raw), jax.numpy.asarray(errors))
        found = np.asarray(whitened)
        found_log_det = np.asarray(half_log_det)
    covariance = space.covariance(raw)
    np.testing.assert_allclose(covariance[0], np.eye(space.dof), atol=1e-12)
    np.linalg.cholesky(covariance)
    expected = np.einsum("ni,nij,nj->n", errors, np.linalg.inv(covariance), errors)
    np.testing.assert_allclose(np.sum(found**2, axis=1), expected, rtol=1e-4)
    np.testing.assert_allclose(
        found_log_det, 0.5 * np.linalg.slogdet(covariance).logabsdet, rtol=1e-6, atol=1e-9
    )


def test_equal_spaces_are_compiled_once() -> None:
    assert hash(space_of(ALL_AXES)) == hash(space_of(ALL_AXES))
    assert space_of(ALL_AXES) == space_of(ALL_AXES)
    assert space_of(ALL_AXES) != space_of(ROTATION_AXES)

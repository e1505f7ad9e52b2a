"""Networks over fields of flow: they begin as the linear regression, and leave it as it is."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pytest

jax = pytest.importorskip("jax", reason="jax is missing: pip install 'probevo[nets]'")
eqx = pytest.importorskip("equinox")

from nets.small_pairs import small_pairs  # noqa: E402
from probevo.nets import methods  # noqa: E402
from probevo.nets.field_network import (  # noqa: E402
    FieldFit,
    field_network,
    fit_fields,
    pooled_flow,
    ridge_fit,
    standardisation,
)
from probevo.nets.image_pairs import ImagePairs  # noqa: E402
from probevo.nets.networks import Network  # noqa: E402
from probevo.nets.rotation_network import SPACE, method_of  # noqa: E402

METHOD = method_of(5)


def fit_of(pairs: ImagePairs, batch: int = 1000) -> FieldFit:
    """Return the fit to pairs, added up batch by batch."""
    targets = pairs.rotations / SPACE.unit_rad
    parts = [slice(first, first + batch) for first in range(0, len(pairs), batch)]
    return fit_fields((pairs.fields[part], targets[part]) for part in parts)


@pytest.fixture(scope="module")
def pairs() -> ImagePairs:
    return small_pairs(60)


@pytest.fixture(scope="module")
def network(pairs: ImagePairs) -> Network:
    """A network with initial weights, compiled as a whole."""
    build = partial(field_network, METHOD, space=SPACE, fit=fit_of(pairs))
    built: Network = eqx.filter_jit(build)(jax.random.key(0))
    return built


def test_the_regression_finds_the_rotation() -> None:
    """From noisy flow of scenes that it has not seen, better than 0.1° on each axis."""
    others = small_pairs(100, seed=2)
    found = SPACE.unit_rad * fit_of(small_pairs(1600, seed=1)).estimates(others.fields)
    rms = np.sqrt(np.mean((found - others.rotations) ** 2, axis=0))
    assert (np.degrees(rms) < 0.1).all()


def test_the_fit_from_sums_is_that_of_the_standardised_flow() -> None:
    """However the data are cut into batches."""
    pairs = small_pairs(50)
    mean, scale = standardisation(pairs.fields)
    flow = np.asarray(pooled_flow((pairs.fields - mean) * scale))
    linear = ridge_fit(flow, pairs.rotations / SPACE.unit_rad)
    for batch in (50, 7):
        fit = fit_of(pairs, batch)
        np.testing.assert_allclose(fit.mean, mean, rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(fit.scale, scale, rtol=1e-6)
        np.testing.assert_allclose(fit.linear.weights, linear.weights, rtol=1e-4, atol=1e-7)
        np.testing.assert_allclose(fit.linear.offset, linear.offset, rtol=1e-4, atol=1e-6)


def test_a_network_begins_as_the_regression(pairs: ImagePairs, network: Network) -> None:
    call = eqx.filter_jit(network)
    outputs, raw = call(jax.numpy.asarray(pairs.fields[0]), jax.random.key(0))
    expected = fit_of(pairs).estimates(pairs.fields[:1])
    assert outputs.shape == (5, 3)
    assert raw.shape == (6,)
    # Heads differ, each a little from the regression: 0.15 units are 0.1°.
    assert 0.0 < np.abs(np.asarray(outputs) - expected).max() < 0.15


def test_training_leaves_the_regression_as_it_is(pairs: ImagePairs, network: Network) -> None:
    q_true = jax.vmap(SPACE.estimate)(jax.numpy.asarray(pairs.rotations / SPACE.unit_rad))
    targets = jax.numpy.repeat(q_true[:, None], 5, axis=1)

    def loss(trained: Network) -> Any:
        fields = jax.numpy.asarray(pairs.fields)
        return methods.loss(SPACE, trained, fields, targets, key=jax.random.key(0))

    gradient = eqx.filter_jit(jax.grad(loss))(network)
    assert not np.asarray(gradient.trunk.linear.weights).any()
    assert not np.asarray(gradient.trunk.mean).any()
    assert np.asarray(gradient.trunk.last.weight).any()
    assert np.isfinite(np.asarray(gradient.trunk.last.weight)).all()


@pytest.mark.parametrize("size", [0.0, 1e-3, 1.0])
def test_small_rotations_are_those_of_their_vectors(size: float) -> None:
    phi = size * np.array([0.3, -0.2, 0.5])
    q = SPACE.estimate(jax.numpy.asarray(phi / SPACE.unit_rad, jax.numpy.float32))
    one = jax.numpy.asarray([1.0, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(SPACE.difference(q, one), phi, atol=1e-6)


def test_outputs_of_zeros_mean_the_first_sigma() -> None:
    sigma_rad = np.sqrt(np.diag(SPACE.covariance(np.zeros(6))))
    np.testing.assert_allclose(sigma_rad, SPACE.first_sigma_rad)

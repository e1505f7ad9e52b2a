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
    LinearFit,
    field_network,
    linear_estimates,
    linear_fit,
    pooled_flow,
    standardisation,
)
from probevo.nets.image_pairs import ImagePairs  # noqa: E402
from probevo.nets.networks import Network  # noqa: E402
from probevo.nets.rotation_network import SPACE, method_of  # noqa: E402

METHOD = method_of(5)


def network_of(pairs: ImagePairs, linear: LinearFit) -> Network:
    """Return a network with initial weights, compiled as a whole."""
    build = partial(field_network, METHOD, space=SPACE, fields=pairs.fields, linear=linear)
    network: Network = eqx.filter_jit(build)(jax.random.key(0))
    return network


def test_the_regression_finds_the_rotation() -> None:
    """From noisy flow of scenes that it has not seen, better than 0.1° on each axis."""
    learned = small_pairs(400, seed=1).multiplied(2, np.random.default_rng(0))
    linear = linear_fit(learned.fields, learned.rotations)
    others = small_pairs(100, seed=2)
    found = linear_estimates(linear, learned.fields, others.fields)
    rms = np.sqrt(np.mean((found - others.rotations) ** 2, axis=0))
    assert (np.degrees(rms) < 0.1).all()


def test_a_network_begins_as_the_regression() -> None:
    pairs = small_pairs(60)
    linear = linear_fit(pairs.fields, pairs.rotations / SPACE.unit_rad)
    network = network_of(pairs, linear)
    outputs, raw = network(jax.numpy.asarray(pairs.fields[0]), jax.random.key(0))
    mean, scale = standardisation(pairs.fields)
    expected = pooled_flow((pairs.fields[:1] - mean) * scale) @ linear.weights.T + linear.offset
    assert outputs.shape == (5, 3)
    assert raw.shape == (6,)
    # Heads differ, each a little from the regression: 0.15 units are 0.1°.
    assert 0.0 < np.abs(np.asarray(outputs) - expected).max() < 0.15


def test_training_leaves_the_regression_as_it_is() -> None:
    pairs = small_pairs(20)
    linear = linear_fit(pairs.fields, pairs.rotations / SPACE.unit_rad)
    network = network_of(pairs, linear)
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

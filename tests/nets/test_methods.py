"""The five methods: what their covariances consist of, their losses, and the noise of targets."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

jax = pytest.importorskip("jax", reason="jax is missing: pip install 'probevo[nets]'")
eqx = pytest.importorskip("equinox")

from nets.small_networks import INPUTS, METHODS, drawn  # noqa: E402
from probevo.nets import methods  # noqa: E402
from probevo.nets.covariance_scale import negative_log_likelihoods  # noqa: E402
from probevo.nets.methods import Method, Prediction  # noqa: E402
from probevo.nets.networks import SELU_NEGATIVE, alpha_dropout, plain_dropout  # noqa: E402
from probevo.nets.target_space import MIN_SIGMA_RAD, NumberTargets, RotationTargets  # noqa: E402

STEP = 1e-6
each_method = pytest.mark.parametrize("method", METHODS, ids=lambda method: method.name)


def predicted(method: Method) -> Prediction:
    space = RotationTargets()
    rng = np.random.default_rng(0)
    networks = drawn(method, rng, (method.networks,))
    inputs = jax.numpy.asarray(rng.normal(size=(7, INPUTS)), "float32")
    found, raw = methods.estimates(method, space, networks, inputs, jax.random.key(1))
    assert found.shape == (7, method.num_estimates, 4)
    return methods.prediction(space, found, raw)


@each_method
def test_covariances_are_learned_or_spread_or_both(method: Method) -> None:
    result = predicted(method)
    has_spread = method.num_estimates > 1
    assert (np.linalg.eigvalsh(result.spread).max(axis=-1) > 0.0).all() == has_spread
    assert result.spread.any() == has_spread
    least = MIN_SIGMA_RAD**2 * np.eye(3)
    assert np.array_equal(result.learned, np.tile(least, (7, 1, 1))) != method.learns_covariance
    assert np.linalg.eigvalsh(result.covariance).min() > 0.0
    assert result.covariance == pytest.approx(result.learned + result.spread)
    assert np.linalg.norm(result.mean, axis=-1) == pytest.approx(1.0, abs=1e-5)


def test_the_spread_is_the_sample_covariance_about_the_mean() -> None:
    space = NumberTargets()
    found = np.random.default_rng(0).normal(3.0, 2.0, (6, 11, 1))
    result = methods.prediction(space, jax.numpy.asarray(found), None)
    assert result.mean[:, 0] == pytest.approx(found[..., 0].mean(axis=1), rel=1e-5)
    expected = found[..., 0].var(axis=1, ddof=1)
    assert result.spread[:, 0, 0] == pytest.approx(expected, rel=1e-5)


def test_the_prediction_does_not_depend_on_the_signs_of_the_heads() -> None:
    rng = np.random.default_rng(1)
    space = RotationTargets()
    around = jax.numpy.asarray(rng.normal(0.0, 0.2, (7, 5, 3)))
    found = np.asarray(space.perturb(jax.numpy.array([0.5, 0.5, -0.5, 0.5]), around))
    raw = jax.numpy.asarray(rng.normal(size=(7, 1, 6)))
    signs = rng.choice([-1.0, 1.0], (7, 5, 1))
    one = methods.prediction(space, jax.numpy.asarray(found), raw)
    other = methods.prediction(space, jax.numpy.asarray(signs * found), raw)
    assert other.mean == pytest.approx(one.mean, abs=1e-5)
    assert other.covariance == pytest.approx(one.covariance, abs=1e-5)


@pytest.mark.parametrize("method", [METHODS[0], METHODS[2]], ids=lambda method: method.name)
def test_the_calibrated_loss_is_the_least_of_all_factors(method: Method) -> None:
    """Against the covariances as they are predicted, times a factor of a grid; where no covariance
    is learned, it is the loss. Of one head and without dropout, all methods are one of these."""
    space = RotationTargets()
    rng = np.random.default_rng(3)
    network = drawn(replace(method, heads=1), rng)
    inputs = jax.numpy.asarray(rng.normal(size=(40, INPUTS)), "float32")
    true = space.estimate(jax.numpy.asarray(rng.normal(size=(40, 1, 4)), "float32"))
    found = eqx.filter_jit(methods.calibrated_loss)(space, network, inputs, true, None)
    if not method.learns_covariance:
        assert found == eqx.filter_jit(methods.loss)(space, network, inputs, true, None)
        return
    outputs, raw = jax.jit(jax.vmap(lambda one: network(one, None)))(inputs)
    errors = np.asarray(space.difference(space.estimate(outputs), true), np.float64)[:, 0]
    covariances = space.covariance(np.asarray(raw))
    losses = [
        np.mean(negative_log_likelihoods(errors, factor * covariances))
        for factor in np.geomspace(1e-3, 1e6, 2000)
    ]
    assert float(found) == pytest.approx(min(losses), abs=1e-4)


@pytest.mark.parametrize(
    "method", [METHODS[0], METHODS[3], METHODS[4]], ids=lambda method: method.name
)
def test_gradients_of_the_loss_are_those_of_central_differences(method: Method) -> None:
    """Along random directions in the space of all weights, within 1e-6. The other two methods have
    the losses of hydra and of hydra-sigma, with one head."""
    space = RotationTargets()
    rng = np.random.default_rng(2)
    with jax.enable_x64(True):
        network = jax.tree.map(
            lambda leaf: jax.numpy.asarray(np.asarray(leaf, "float64")), drawn(method, rng)
        )
        inputs = jax.numpy.asarray(rng.normal(size=(9, INPUTS)))
        targets = space.estimate(jax.numpy.asarray(rng.normal(size=(9, method.heads, 4))))

        def given(at: Any) -> Any:
            return methods.loss(space, at, inputs, targets, key=jax.random.key(5))

        loss = jax.jit(given)
        gradient = jax.jit(jax.grad(given))(network)
        leaves, structure = jax.tree.flatten(network)
        for _ in range(5):
            direction = [rng.normal(size=leaf.shape) for leaf in leaves]
            ends = []
            for sign in (1.0, -1.0):
                pairs = zip(leaves, direction, strict=True)
                moved = [np.asarray(leaf) + sign * STEP * step for leaf, step in pairs]
                ends.append(float(loss(jax.tree.unflatten(structure, moved))))
            numerical = (ends[0] - ends[1]) / (2.0 * STEP)
            pairs = zip(jax.tree.leaves(gradient), direction, strict=True)
            derived = sum(float(np.sum(np.asarray(leaf) * step)) for leaf, step in pairs)
            assert derived == pytest.approx(numerical, abs=1e-6 * max(1.0, abs(numerical)))


def test_each_head_has_noise_of_its_own() -> None:
    method = Method("hydra", heads=3, target_sigma=0.1)
    truth = np.zeros((5000, 1))
    targets = methods.head_targets(method, NumberTargets(), truth, np.random.default_rng(0))
    assert targets.shape == (1, 5000, 3, 1)
    covariance = np.cov(targets[0, ..., 0].T)
    assert covariance == pytest.approx(0.01 * np.eye(3), abs=6e-4)


def test_bootstrap_samples_are_drawn_with_replacement() -> None:
    ensemble = Method("ensemble", networks=20, bootstrap=True)
    drawn = methods.samples(ensemble, 1000, np.random.default_rng(0))
    share = np.mean([len(np.unique(row)) / 1000 for row in drawn])
    assert share == pytest.approx(1.0 - np.exp(-1.0), abs=0.01)
    plain = methods.samples(Method("sigma"), 10, np.random.default_rng(0))
    assert plain.tolist() == [list(range(10))]


def test_dropout_keeps_the_moments() -> None:
    """The mean, and for alpha dropout of standard normal features the variance, too."""
    features = jax.random.normal(jax.random.key(0), (400_000,))
    for dropped in (
        plain_dropout(features + 1.0, 0.2, jax.random.key(1)) - 1.0,
        alpha_dropout(features, 0.2, jax.random.key(1)),
    ):
        assert float(dropped.mean()) == pytest.approx(0.0, abs=0.01)
    assert float(dropped.std()) == pytest.approx(1.0, abs=0.01)
    assert float(jax.nn.selu(-1e9)) == pytest.approx(SELU_NEGATIVE, rel=1e-6)

"""Dropout and an ensemble for the sun: their spread is a covariance, also of few estimates."""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

jax = pytest.importorskip("jax", reason="jax is missing: pip install 'probevo[nets]'")
eqx = pytest.importorskip("equinox")

from probevo.config.networks import MethodName, NetworkSettings  # noqa: E402
from probevo.errors import InputError  # noqa: E402
from probevo.nets import methods  # noqa: E402
from probevo.nets.domain import FARTHEST, Domain  # noqa: E402
from probevo.nets.field_network import FieldFit, field_network, fit_fields  # noqa: E402
from probevo.nets.flow_field import CELLS  # noqa: E402
from probevo.nets.learning import LearningPlan, TrainingData, learn  # noqa: E402
from probevo.nets.methods import Method  # noqa: E402
from probevo.nets.network_file import write_network_file  # noqa: E402
from probevo.nets.networks import Network  # noqa: E402
from probevo.nets.sun_network import SPACE, SunNetwork, method_of, method_text  # noqa: E402
from probevo.nets.sun_space import MIN_SIGMA_RAD  # noqa: E402
from probevo.nets.sun_views import CHANNELS, SunViews, image_statistics  # noqa: E402
from probevo.nets.trained_network import first_facts, saliency, trunk_features  # noqa: E402

IMAGES = 12
ESTIMATED = 4
"""Images of which estimates are made: of always as many, these are compiled once."""
SCALE = 2.0
FEWEST = {
    "dropout": NetworkSettings(method="dropout", passes=2, dropout=0.5),
    "ensemble": NetworkSettings(method="ensemble", networks=2),
}
"""Two estimates of one image, whose covariance alone is singular."""
each_method = pytest.mark.parametrize("name", list(FEWEST))


def small_views(count: int = IMAGES, seed: int = 0) -> SunViews:
    """Fields of noise, and directions without a relation to them."""
    rng = np.random.default_rng(seed)
    fields = rng.normal(size=(count, CHANNELS, *CELLS)).astype(np.float32)
    vectors = rng.normal(size=(count, 3))
    return SunViews(fields, vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def fit_of(views: SunViews) -> FieldFit:
    return fit_fields([(views.fields, views.directions)], ridge=1.0)


@cache
def untrained(name: str) -> SunNetwork:
    """Return networks with initial weights, and the domain of some views."""
    method = method_of(FEWEST[name])
    views = small_views()
    networks = initial_networks(method, views)
    features = image_statistics(views.fields)
    facts = {**first_facts("sun", method), "scale": SCALE, "correlation": 1.0}
    return SunNetwork(networks, Domain.of(features, features), facts)


def initial_networks(method: Method, views: SunViews) -> Any:
    """Return networks that begin as the linear regression of these views."""
    one = partial(field_network, method, space=SPACE, fit=fit_of(views))
    keys = jax.random.split(jax.random.key(0), method.networks)
    return eqx.filter_jit(eqx.filter_vmap(one))(keys)


def call_each(network: Network, fields: Any, key: Any) -> Any:
    """Return the estimate of one network of each field, all with the same dropout, [N, 3]."""
    outputs = jax.vmap(lambda field: network(field, key)[0])(fields)
    return SPACE.estimate(outputs)[:, 0]


@each_method
def test_the_covariance_of_two_estimates_is_positive_definite(name: str) -> None:
    """Also where both agree: on an even grey, where all channels are zero."""
    network = untrained(name)
    fields = small_views(ESTIMATED, seed=1).fields
    fields[0] = 0.0
    found = network.estimate(fields)
    assert network.method.num_estimates == 2
    np.linalg.cholesky(found.covariance)
    least = SCALE * found.widening * MIN_SIGMA_RAD**2
    assert (np.linalg.eigvalsh(found.covariance)[:, 0] > 0.999 * least).all()
    assert (np.linalg.eigvalsh(found.covariance)[:, 1] > 1.01 * least).any()
    np.testing.assert_allclose(np.linalg.norm(found.directions, axis=1), 1.0, atol=1e-6)


def test_an_image_of_nothing_or_of_less_contrast_is_out_of_the_domain() -> None:
    """Others than those that the domain was made of are in it."""
    learned = image_statistics(small_views(400, seed=1).fields)
    domain = Domain.of(learned, image_statistics(small_views(400, seed=2).fields))
    usual = small_views(100, seed=3).fields
    assert np.mean(domain.widening(image_statistics(usual)) > 1.0) < 0.1
    for factor in (0.0, 0.1, 3.0):
        assert (domain.widening(image_statistics(factor * usual)) > FARTHEST).all()


@each_method
def test_the_spread_is_that_of_the_single_estimates(name: str) -> None:
    """Those of the networks, or of the masks, called one by one."""
    network = untrained(name)
    views = small_views(ESTIMATED, seed=2)
    keys = jax.random.split(jax.random.key(0), (network.method.networks, network.method.passes))
    estimates = []
    for member in range(network.method.networks):
        one = jax.tree.map(lambda array, member=member: array[member], network.networks)
        for key in keys[member]:
            estimates.append(eqx.filter_jit(call_each)(one, jax.numpy.asarray(views.fields), key))
    by_image = jax.numpy.stack(estimates, axis=1)
    assert by_image.shape == (ESTIMATED, 2, 3)
    mean = SPACE.mean(by_image)
    errors = np.asarray(SPACE.difference(by_image, mean[:, None]), np.float64)
    expected = errors.mT @ errors + MIN_SIGMA_RAD**2 * np.eye(2)
    found = network.estimate(views.fields)
    np.testing.assert_allclose(found.directions, mean, atol=1e-5)
    factor = SCALE * found.widening[:, None, None]
    np.testing.assert_allclose(found.covariance, factor * expected, rtol=1e-3, atol=1e-7)


@each_method
def test_an_estimate_depends_on_its_image_alone(name: str) -> None:
    """Not on how often it was asked, nor on which other images were handed in with it."""
    network = untrained(name)
    fields = small_views(ESTIMATED, seed=3).fields
    together = network.estimate(fields)
    again = network.estimate(fields)
    np.testing.assert_array_equal(together.covariance, again.covariance)
    for k in range(ESTIMATED):
        alone = network.estimate(fields[k : k + 1])
        np.testing.assert_allclose(alone.directions[0], together.directions[k], atol=1e-5)
        np.testing.assert_allclose(alone.covariance[0], together.covariance[k], rtol=1e-3)


def test_an_ensemble_that_was_stopped_ends_with_the_same_bytes(tmp_path: Path) -> None:
    method = method_of(FEWEST["ensemble"])
    views = small_views(16)
    rng = np.random.default_rng(0)
    targets = methods.head_targets(method, SPACE, views.directions, rng)
    data = TrainingData(
        inputs=jax.numpy.asarray(views.fields[None]),
        targets=jax.numpy.asarray(targets[None], "float32"),
        samples=jax.numpy.asarray(methods.samples(method, len(views), rng)[None]),
        held_out_inputs=jax.numpy.asarray(views.fields[None, :4]),
        held_out_targets=jax.numpy.asarray(views.directions[None, :4], "float32"),
    )
    one = partial(field_network, space=SPACE, fit=fit_of(views))

    def train(file: Path, stop_after: int | None = None) -> None:
        """Train, perhaps until it is stopped."""

        def stop(epoch: int, total: int) -> None:
            if epoch == stop_after:
                raise KeyboardInterrupt

        plan = LearningPlan(epochs=3, batch=8, learning_rate=1e-3, patience=3, keep_every=1)
        learn(method, SPACE, one, data=data, plan=plan, file=file, show=stop)

    train(tmp_path / "whole.safetensors")
    for epoch in (1, 2):
        with pytest.raises(KeyboardInterrupt):
            train(tmp_path / "parts.safetensors", epoch)
    train(tmp_path / "parts.safetensors")
    whole = (tmp_path / "whole.safetensors").read_bytes()
    assert (tmp_path / "parts.safetensors").read_bytes() == whole


@each_method
def test_the_file_gives_the_networks_back(name: str, tmp_path: Path) -> None:
    network = untrained(name)
    file = tmp_path / "sun.safetensors"
    network.save(file)
    again = SunNetwork.load(file)
    fields = small_views(ESTIMATED, seed=4).fields
    np.testing.assert_array_equal(
        again.estimate(fields).covariance, network.estimate(fields).covariance
    )
    again.save(tmp_path / "copy.safetensors")
    assert (tmp_path / "copy.safetensors").read_bytes() == file.read_bytes()


def test_domain_and_saliency_do_not_depend_on_the_dropout() -> None:
    """With the same weights, they are those of a network that drops nothing."""
    dropping = untrained("dropout")
    views = small_views(4, seed=5)
    plain_method = replace(dropping.method, dropout=0.0)
    plain = SunNetwork(
        initial_networks(plain_method, small_views()),
        dropping.domain,
        {**dropping.facts, **first_facts("sun", plain_method)},
    )
    features = trunk_features(dropping.networks, views.fields)
    np.testing.assert_array_equal(features, trunk_features(plain.networks, views.fields))
    np.testing.assert_array_equal(
        saliency(dropping, SPACE, views.fields, views.directions),
        saliency(plain, SPACE, views.fields, views.directions),
    )


def test_without_a_covariance_the_loss_is_the_squared_chord() -> None:
    network = untrained("dropout")
    views = small_views(4, seed=6)
    one = jax.tree.map(lambda array: array[0], network.networks)
    fields = jax.numpy.asarray(views.fields)
    targets = jax.numpy.asarray(views.directions, "float32")
    loss = eqx.filter_jit(methods.loss)(SPACE, one, fields, targets[:, None], key=None)
    estimates = np.asarray(eqx.filter_jit(call_each)(one, fields, None))
    chords = np.sum((estimates - views.directions) ** 2, axis=1)
    assert float(loss) == pytest.approx(chords.mean(), rel=1e-4)


@pytest.mark.parametrize(
    "change",
    [
        {"passes": 0},
        {"passes": 1_000_000_000},
        {"passes": 2.0},
        {"passes": "2"},
        {"networks": 100, "passes": 100},
        {"heads": -3},
        {"dropout": 1.0},
        {"dropout": -0.1},
        {"dropout": None},
    ],
)
def test_a_file_that_asks_for_too_much_is_refused(tmp_path: Path, change: dict[str, Any]) -> None:
    method = method_of(FEWEST["dropout"])
    facts = {**first_facts("sun", method), "scale": 1.0}
    file = tmp_path / "sun.safetensors"
    write_network_file(file, (), {**facts, "method": {**facts["method"], **change}})
    with pytest.raises(InputError, match="not a complete network of kind sun"):
        SunNetwork.load(file)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("hydra-sigma", "hydra-sigma, 5 networks, 10 heads"),
        ("dropout", "dropout of 50 %, 25 passes"),
        ("ensemble", "ensemble, 5 networks"),
    ],
)
def test_settings_choose_the_method(name: MethodName, text: str) -> None:
    method = method_of(NetworkSettings(method=name))
    assert method.learns_covariance == (name == "hydra-sigma")
    assert method_text(method) == text

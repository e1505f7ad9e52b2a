"""HydraNet's 1-D regression: how likely true values are far from the training data (thesis 7).

Networks learn y = x + sin 4(x + w) + sin 13(x + w) + w, with w ~ N(0, 0.03²), from x in [0, 0.6]
and [0.8, 1], and are tested without noise on 100 points of [−2, 2]: most of them far from any data.
Sizes, rates and optimisers are taken from the authors' public code.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from probevo.arrays import FloatArray
from probevo.nets import methods
from probevo.nets.covariance_scale import negative_log_likelihoods
from probevo.nets.learning import LearningPlan, TrainingData, learn
from probevo.nets.methods import Method
from probevo.nets.networks import Network, SeluHead, SeluLayers
from probevo.nets.target_space import NumberTargets
from probevo_paper.hydranet_config import HydranetConfig

NUM_DATA = 1000
NUM_TESTS = 100
NOISE_SIGMA = 0.03
TARGET_SIGMA = 0.05
"""Noise on the targets of heads and of networks of the ensemble."""
UNITS = 20
BATCH = 50
METHODS = (
    Method("dropout", passes=50, dropout=0.01),
    Method("ensemble", networks=10, bootstrap=True, target_sigma=TARGET_SIGMA),
    Method("sigma", learns_covariance=True),
    Method("hydra", heads=10, target_sigma=TARGET_SIGMA),
    Method("hydra-sigma", heads=10, learns_covariance=True, target_sigma=TARGET_SIGMA),
)
PUBLISHED_NLL = {
    "dropout": 5.55,
    "ensemble": 1.54,
    "sigma": 2.60,
    "hydra": 14.2,
    "hydra-sigma": 1.64,
}
"""Medians over 100 repetitions."""
MOMENTUM = {"dropout": 0.5, "ensemble": 0.9, "hydra": 0.9, "hydra-sigma": 0.1}
"""Momentum of stochastic gradient descent at a rate of 0.01; sigma is trained by Adam at 1e-4."""


@dataclass(frozen=True, eq=False)
class NumbersResult:
    """A method's predictions in all repetitions."""

    method: str
    nll: FloatArray
    """Mean negative log-likelihood of the test values, nats, [S]."""
    squared_error: FloatArray
    """Mean squared error, [S]."""


def regress(
    method: Method, settings: HydranetConfig, file: Path, show: Callable[[int, int], None]
) -> NumbersResult:
    """Train a method in all repetitions at once, and test it.

    Args:
        method: one of ``METHODS``.
        settings: of the experiment.
        file: where the networks are kept.
        show: called after each epoch.

    Raises:
        InputError: the file is damaged or cannot be written.
    """
    space = NumberTargets()
    trained = learn(
        method,
        space,
        build,
        data=training_data(method, settings),
        plan=plan_of(method, settings),
        file=file,
        show=show,
    )
    tests = np.linspace(-2.0, 2.0, NUM_TESTS)[:, None]
    inputs = jnp.asarray(tests, jnp.float32)

    def estimate(networks: Network, key: jax.Array) -> tuple[jax.Array, jax.Array | None]:
        """Return the estimates of the networks of one repetition."""
        return methods.estimates(method, space, networks, inputs, key)

    keys = jax.random.split(jax.random.key(settings.seed), settings.repetitions)
    estimated, raw = eqx.filter_vmap(estimate)(trained.networks, keys)
    predicted = methods.prediction(space, estimated, raw)
    errors = predicted.mean - curve(tests, np.zeros_like(tests))
    # The published figures have the constant ½ log 2π.
    nll = negative_log_likelihoods(errors, predicted.covariance) + 0.5 * np.log(2.0 * np.pi)
    return NumbersResult(method.name, nll.mean(axis=-1), np.mean(errors**2, axis=(-2, -1)))


def build(method: Method, key: jax.Array) -> Network:
    """Return one network: two layers of 20 units, and heads with one more."""
    key_of_trunk, key_of_heads, key_of_covariance = jax.random.split(key, 3)

    def head(head_key: jax.Array) -> SeluHead:
        """Return one head with initial weights."""
        return SeluHead((UNITS, UNITS, 1), method.dropout, key=head_key)

    return Network(
        trunk=SeluLayers((1, UNITS, UNITS), method.dropout, key=key_of_trunk),
        heads=eqx.filter_vmap(head)(jax.random.split(key_of_heads, method.heads)),
        covariance_head=head(key_of_covariance) if method.learns_covariance else None,
    )


def plan_of(method: Method, settings: HydranetConfig) -> LearningPlan:
    """Return how a method is trained: in the order of the data, as published."""
    momentum = MOMENTUM.get(method.name)
    return LearningPlan(
        epochs=settings.epochs,
        batch=BATCH,
        optimizer="adam" if momentum is None else "sgd",
        learning_rate=1e-4 if momentum is None else 0.01,
        momentum=momentum or 0.0,
        shuffle=False,
        keep_every=100,
        seed=settings.seed,
    )


def training_data(method: Method, settings: HydranetConfig) -> TrainingData:
    """Return the data of all repetitions; they are the same for all methods."""
    inputs = []
    targets = []
    samples = []
    for repetition in range(settings.repetitions):
        rng = np.random.default_rng([settings.seed, repetition])
        half = NUM_DATA // 2
        x = np.concatenate([rng.uniform(0.0, 0.6, half), rng.uniform(0.8, 1.0, half)])[:, None]
        y = curve(x, rng.normal(0.0, NOISE_SIGMA, x.shape))
        inputs.append(x)
        targets.append(methods.head_targets(method, NumberTargets(), y, rng))
        samples.append(methods.samples(method, NUM_DATA, rng))
    none_left_out = jnp.zeros((settings.repetitions, 0, 1), jnp.float32)
    return TrainingData(
        inputs=jnp.asarray(np.array(inputs), jnp.float32),
        targets=jnp.asarray(np.array(targets), jnp.float32),
        samples=jnp.asarray(np.array(samples)),
        held_out_inputs=none_left_out,
        held_out_targets=none_left_out,
    )


def curve(x: FloatArray, w: FloatArray) -> FloatArray:
    """Return y = x + sin 4(x + w) + sin 13(x + w) + w."""
    y: FloatArray = x + np.sin(4.0 * (x + w)) + np.sin(13.0 * (x + w)) + w
    return y

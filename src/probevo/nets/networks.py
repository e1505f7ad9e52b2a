"""Networks of one shape: a trunk, some heads that estimate, and one that says how well."""

from __future__ import annotations

from typing import Any, Protocol

import equinox as eqx
import jax
import jax.numpy as jnp

SELU_NEGATIVE = -1.7580993408473766
"""The limit of SELU at −∞, to which alpha dropout sets what it drops."""


class Trunk(Protocol):
    """A part of a network that maps a single input, [i], to features, [f]."""

    def __call__(self, inputs: jax.Array, key: jax.Array | None) -> jax.Array:
        """Return the features; the key is for the dropout, None for none."""


class Network(eqx.Module):
    """A trunk, H heads and perhaps a covariance head; called with one input at a time."""

    trunk: Any
    heads: Any
    """One head, whose arrays have a leading dimension [H, ...]."""
    covariance_head: Any
    """None if the method does not learn a covariance."""

    def __call__(
        self, inputs: jax.Array, key: jax.Array | None
    ) -> tuple[jax.Array, jax.Array | None]:
        """Return the outputs of the heads, [H, o], and of the covariance head, [c] or None.

        Args:
            inputs: one input, [i].
            key: of the dropout; two calls with the same key drop the same, and with None nothing is
                dropped.
        """
        keys = (None, None, None) if key is None else jax.random.split(key, 3)
        key_of_trunk, key_of_heads, key_of_covariance = keys
        features = self.trunk(inputs, key_of_trunk)

        def call(head: Any) -> jax.Array:
            """Return what one head makes of the features."""
            outputs: jax.Array = head(features, key_of_heads)
            return outputs

        # All heads at once, [H, o]; they share one key, and with it what the dropout drops.
        outputs = eqx.filter_vmap(call)(self.heads)
        if self.covariance_head is None:
            return outputs, None
        return outputs, self.covariance_head(features, key_of_covariance)


class SeluLayers(eqx.Module):
    """Fully connected layers, each with SELU and alpha dropout: a trunk of the 1-D experiment."""

    layers: list[eqx.nn.Linear]
    dropout: float = eqx.field(static=True)

    def __init__(self, sizes: tuple[int, ...], dropout: float, *, key: jax.Array) -> None:
        keys = jax.random.split(key, len(sizes) - 1)
        self.layers = [
            eqx.nn.Linear(sizes[k], sizes[k + 1], key=keys[k]) for k in range(len(sizes) - 1)
        ]
        self.dropout = dropout

    def __call__(self, inputs: jax.Array, key: jax.Array | None) -> jax.Array:
        """Return the features, [f]."""
        features = inputs
        for k, layer in enumerate(self.layers):
            active = jax.nn.selu(layer(features))
            features = alpha_dropout(active, self.dropout, key_of_layer(key, k))
        return features


class SeluHead(eqx.Module):
    """A hidden layer with SELU, and outputs: a head of the 1-D experiment."""

    hidden: SeluLayers
    last: eqx.nn.Linear

    def __init__(self, sizes: tuple[int, int, int], dropout: float, *, key: jax.Array) -> None:
        key_of_hidden, key_of_last = jax.random.split(key)
        self.hidden = SeluLayers(sizes[:2], dropout, key=key_of_hidden)
        self.last = eqx.nn.Linear(sizes[1], sizes[2], key=key_of_last)

    def __call__(self, features: jax.Array, key: jax.Array | None) -> jax.Array:
        """Return the outputs, [o]."""
        return self.last(self.hidden(features, key))


class ResidualLayers(eqx.Module):
    """Fully connected residual blocks, x + ReLU(A x + b): the trunk of the orbital simulation."""

    layers: list[eqx.nn.Linear]
    dropout: float = eqx.field(static=True)

    def __init__(self, size: int, num_layers: int, dropout: float, *, key: jax.Array) -> None:
        keys = jax.random.split(key, num_layers)
        self.layers = [eqx.nn.Linear(size, size, key=each) for each in keys]
        self.dropout = dropout

    def __call__(self, inputs: jax.Array, key: jax.Array | None) -> jax.Array:
        """Return the features, [f]."""
        features = inputs
        for k, layer in enumerate(self.layers):
            active = jax.nn.relu(layer(features))
            features = features + plain_dropout(active, self.dropout, key_of_layer(key, k))
        return features


class PReluHead(eqx.Module):
    """A hidden layer with PReLU, and outputs: a head of the orbital simulation."""

    first: eqx.nn.Linear
    slope: jax.Array
    last: eqx.nn.Linear
    dropout: float = eqx.field(static=True)

    def __init__(self, sizes: tuple[int, int, int], dropout: float, *, key: jax.Array) -> None:
        key_of_first, key_of_last = jax.random.split(key)
        self.first = eqx.nn.Linear(sizes[0], sizes[1], key=key_of_first)
        self.slope = jnp.array(0.25)
        self.last = eqx.nn.Linear(sizes[1], sizes[2], key=key_of_last)
        self.dropout = dropout

    def __call__(self, features: jax.Array, key: jax.Array | None) -> jax.Array:
        """Return the outputs, [o]."""
        hidden = self.first(features)
        # PReLU, whose slope for negative values is learned
        active = jnp.where(hidden < 0.0, self.slope * hidden, hidden)
        return self.last(plain_dropout(active, self.dropout, key))


def key_of_layer(key: jax.Array | None, number: int) -> jax.Array | None:
    """Return the key of the dropout of a layer, None for none."""
    return None if key is None else jax.random.fold_in(key, number)


def plain_dropout(features: jax.Array, rate: float, key: jax.Array | None) -> jax.Array:
    """Set features to zero at random, and enlarge the others, so that the mean is kept.

    Without a key, nothing is dropped.
    """
    if rate == 0.0 or key is None:
        return features
    is_kept = jax.random.bernoulli(key, 1.0 - rate, features.shape)
    return jnp.where(is_kept, features / (1.0 - rate), 0.0)


def alpha_dropout(features: jax.Array, rate: float, key: jax.Array | None) -> jax.Array:
    """Set features to SELU's limit at random; mean 0 and variance 1 are kept.

    Without a key, nothing is dropped.

    Source: Klambauer et al. 2017.
    """
    if rate == 0.0 or key is None:
        return features
    # With α' the limit and q = 1 − rate, the mean of what is set and kept is rate α', its variance
    # q (1 + rate α'²): an affine map takes both back to 0 and 1.
    is_kept = jax.random.bernoulli(key, 1.0 - rate, features.shape)
    scale: float = ((1.0 - rate) * (1.0 + rate * SELU_NEGATIVE**2)) ** -0.5
    return scale * (jnp.where(is_kept, features, SELU_NEGATIVE) - rate * SELU_NEGATIVE)

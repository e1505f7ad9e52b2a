"""A small network over a field of cells, which begins as a linear regression.

The flow of a camera that turns is nearly a linear function of its rotation, so that a linear
regression on the flow comes close already. It is fitted in closed form, and stays as it is. The
trained part is what the heads add to it, and the covariance.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from probevo.arrays import FloatArray
from probevo.nets.flow_field import CELLS
from probevo.nets.methods import Method
from probevo.nets.networks import Network, PReluHead, Trunk, plain_dropout
from probevo.nets.target_space import TargetSpace
from probevo.nets.trained_network import empty_networks

PATCH = 4
"""Rows and columns of cells that the first layer sees at once."""
POOL = 2
"""Rows and columns of cells that the linear regression takes the mean of."""
NUM_FLOW = 2
"""Channels of the flow, which come first; the linear regression takes no others."""
PATCH_UNITS = (32, 16)
"""Units of the two layers that each patch goes through."""
FEATURES = 64
HIDDEN = 32
"""Units of the hidden layer of each head."""
SMALL = 0.1
"""Factor on the first weights of the last layers: the heads begin near the regression."""
MIN_SPREAD = 1e-6
"""Added to the standard deviation of a channel."""
RIDGE = 1e-3
"""Ridge penalty of the linear regression, per sample, for standardised flow."""


class LinearFit(NamedTuple):
    """A linear regression on the standardised flow, in arrays of NumPy or JAX."""

    weights: Any
    """Weights of each output, [o, 2 · rows/2 · columns/2]."""
    offset: Any
    """Offset of each output, [o]."""


class FieldFit(NamedTuple):
    """What a network begins with: the statistics of its inputs, and the regression."""

    mean: FloatArray
    """Mean of each channel over the training data, [C, 1, 1]."""
    scale: FloatArray
    """One over the standard deviation, [C, 1, 1]."""
    linear: LinearFit

    def estimates(self, fields: FloatArray) -> FloatArray:
        """Return what the regression makes of fields, [N, C, rows, columns]: [N, o]."""
        flow = _pooled(fields).reshape(len(fields), NUM_FLOW, -1)
        standardised = (flow - self.mean[:NUM_FLOW, :, 0]) * self.scale[:NUM_FLOW, :, 0]
        estimates: FloatArray = (
            standardised.reshape(len(fields), -1) @ self.linear.weights.T + self.linear.offset
        )
        return estimates


class FieldTrunk(eqx.Module):
    """Two layers over each patch of cells, the same for all, and one over all of them, with ReLU.

    The last layer has separate weights for each place, since the meaning of a flow depends on where
    in the image it is. The first features belong to the linear regression.
    """

    mean: jax.Array
    """Mean of each input channel over the training data, [C, 1, 1]."""
    scale: jax.Array
    """One over the standard deviation, [C, 1, 1]."""
    linear: LinearFit
    patch_layers: list[eqx.nn.Linear]
    last: eqx.nn.Linear
    dropout: float = eqx.field(static=True)

    def __init__(
        self, shape: tuple[int, int, int], num_linear: int, dropout: float, *, key: jax.Array
    ) -> None:
        channels, rows, columns = shape
        patches = (rows // PATCH) * (columns // PATCH)
        sizes = (channels * PATCH**2, *PATCH_UNITS)
        keys = jax.random.split(key, len(sizes))
        self.mean = jnp.zeros((channels, 1, 1))
        self.scale = jnp.ones((channels, 1, 1))
        pooled = NUM_FLOW * (rows // POOL) * (columns // POOL)
        self.linear = LinearFit(jnp.zeros((num_linear, pooled)), jnp.zeros(num_linear))
        self.patch_layers = [
            eqx.nn.Linear(sizes[k], sizes[k + 1], key=keys[k]) for k in range(len(sizes) - 1)
        ]
        self.last = eqx.nn.Linear(patches * sizes[-1], FEATURES, key=keys[-1])
        self.dropout = dropout

    def __call__(self, inputs: jax.Array, key: jax.Array | None) -> jax.Array:
        """Return the features of one field [C, rows, columns]: the linear ones, then 64 others."""
        # Statistics of the data, and what was fitted to them, are no weights.
        mean, scale, linear = jax.lax.stop_gradient((self.mean, self.scale, self.linear))
        field = (inputs - mean) * scale
        # The linear features, in the units of the outputs
        first = linear.weights @ pooled_flow(field[None])[0] + linear.offset
        # [patches, C · 16] → [patches, 32] → [patches, 16], with the same weights for all patches
        features = patches_of(field)
        for layer in self.patch_layers:
            features = jax.nn.relu(jax.vmap(layer)(features))
        active = jax.nn.relu(self.last(features.ravel()))
        return jnp.concatenate([first, plain_dropout(active, self.dropout, key)])


class FieldHead(eqx.Module):
    """A head: the output that is added to the linear regression."""

    correction: PReluHead
    num_linear: int = eqx.field(static=True)

    def __call__(self, features: jax.Array, key: jax.Array | None) -> jax.Array:
        """Return the outputs, [o]."""
        return features[: self.num_linear] + self.correction(features, key)


def field_network(method: Method, key: jax.Array, *, space: TargetSpace, fit: FieldFit) -> Network:
    """Return a network over fields, with initial weights.

    Args:
        method: says how many heads it has, and whether one gives the covariance.
        key: of the weights.
        space: says how many numbers they give.
        fit: what all heads begin with.
    """
    key_of_trunk, key_of_heads, key_of_covariance = jax.random.split(key, 3)
    num_linear = space.num_outputs
    shape = (len(fit.mean), *CELLS)
    trunk = FieldTrunk(shape, num_linear, method.dropout, key=key_of_trunk)
    trunk = eqx.tree_at(
        lambda tree: (tree.mean, tree.scale, tree.linear),
        trunk,
        jax.tree.map(lambda array: jnp.asarray(array, jnp.float32), tuple(fit)),
    )
    keys = (key_of_heads, key_of_covariance)
    return network_on(trunk, method, space, keys=keys, num_features=num_linear + FEATURES)


def empty_field_networks(method: Method, space: TargetSpace, num_channels: int) -> Network:
    """Return a structure to read the networks of a file into."""
    rows, columns = CELLS
    pooled = NUM_FLOW * (rows // POOL) * (columns // POOL)
    linear = LinearFit(np.zeros((space.num_outputs, pooled)), np.zeros(space.num_outputs))
    channel_zeros = np.zeros((num_channels, 1, 1))
    fit = FieldFit(mean=channel_zeros, scale=channel_zeros, linear=linear)
    build_one = partial(field_network, method, space=space, fit=fit)
    return empty_networks(build_one, method.networks)


def network_on(
    trunk: Trunk,
    method: Method,
    space: TargetSpace,
    *,
    keys: tuple[jax.Array, jax.Array],
    num_features: int,
) -> Network:
    """Return a network of a trunk whose first features are a linear regression, and new heads.

    Args:
        trunk: its first features are as many as the space has outputs.
        method: says how many heads there are, and whether one gives the covariance.
        space: says how many numbers they give.
        keys: of the weights of the heads, and of the covariance head.
        num_features: that the trunk gives.
    """

    def head(head_key: jax.Array) -> FieldHead:
        """Return one head with initial weights, near the regression."""
        sizes = (num_features, HIDDEN, space.num_outputs)
        correction = small_at_first(PReluHead(sizes, method.dropout, key=head_key))
        return FieldHead(correction, space.num_outputs)

    covariance_head = None
    if method.learns_covariance:
        sizes = (num_features, HIDDEN, space.num_covariance)
        covariance_head = small_at_first(PReluHead(sizes, 0.0, key=keys[1]))
    return Network(
        trunk=trunk,
        heads=eqx.filter_vmap(head)(jax.random.split(keys[0], method.heads)),
        covariance_head=covariance_head,
    )


def fit_fields(batches: Iterable[tuple[FloatArray, FloatArray]], ridge: float = RIDGE) -> FieldFit:
    """Return the statistics of fields, and the ridge regression of targets on their flow.

    All of it follows from sums, so that the data are gone through once, and are never in memory
    together.

    Args:
        batches: fields, [B, C, rows, columns], and targets, [B, o].
        ridge: penalty per datum, for standardised flow.
    """
    count = 0
    moments: Any = 0.0  # of each channel: sum and sum of squares, [2, C]
    normal: Any = 0.0  # DᵀD of flow and offset, [i + 1, i + 1]
    right: Any = 0.0  # Dᵀy, [i + 1, o]
    for fields, targets in batches:
        values = np.asarray(fields, np.float64)
        moments = moments + np.stack([values.sum((0, 2, 3)), (values**2).sum((0, 2, 3))])
        design = np.hstack([_pooled(values), np.ones((len(values), 1))])
        normal = normal + design.T @ design
        right = right + design.T @ targets
        count += len(values)
    mean, square = moments / (count * CELLS[0] * CELLS[1])
    scale = 1.0 / (np.sqrt(np.maximum(square - mean**2, 0.0)) + MIN_SPREAD)
    # Standardised flow is (f − m) s: the design is D A, with A = [[diag(s), 0], [−m s, 1]].
    per_channel = (len(normal) - 1) // NUM_FLOW
    factor = np.append(np.repeat(scale[:NUM_FLOW], per_channel), 1.0)
    to_standard = np.diag(factor)
    to_standard[-1, :-1] = -np.repeat(mean[:NUM_FLOW], per_channel) * factor[:-1]
    linear = _solved_ridge(
        to_standard.T @ normal @ to_standard, to_standard.T @ right, ridge=ridge * count
    )
    return FieldFit(mean[:, None, None], scale[:, None, None], linear)


def ridge_fit(inputs: FloatArray, targets: FloatArray) -> LinearFit:
    """Return the ridge regression of targets, [N, o], on standardised inputs, [N, i]."""
    design = np.hstack([inputs, np.ones((len(inputs), 1))])
    return _solved_ridge(design.T @ design, design.T @ targets, ridge=RIDGE * len(design))


def _solved_ridge(normal: FloatArray, right: FloatArray, *, ridge: float) -> LinearFit:
    """Solve (DᵀD + λ I) w = Dᵀ y, where the offset, the last column of D, is not penalised."""
    penalty = ridge * np.eye(len(normal))
    penalty[-1, -1] = 0.0
    solved = np.linalg.solve(normal + penalty, right)
    return LinearFit(solved[:-1].T, solved[-1])


def standardisation(fields: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the mean of each channel, and one over its standard deviation, [C, 1, 1] each."""
    mean = fields.mean(axis=(0, 2, 3), dtype=np.float64)
    # One channel at a time: gigabytes of images should not be there twice in double precision.
    channels = range(fields.shape[1])
    spread = np.array([fields[:, channel].std(dtype=np.float64) for channel in channels])
    return mean[:, None, None], 1.0 / (spread[:, None, None] + MIN_SPREAD)


def _pooled(fields: FloatArray) -> FloatArray:
    """Return the flow of fields as means of 2 × 2 cells, [N, *], in double precision."""
    return np.asarray(pooled_flow(fields), np.float64)


def pooled_flow(fields: FloatArray | jax.Array) -> FloatArray | jax.Array:
    """Return the flow of fields, [N, C, rows, columns], as means of 2 × 2 cells, [N, *]."""
    # [N, 2, rows/2, 2, columns/2, 2], of which the mean is taken over both axes of length 2
    flow = fields[:, :NUM_FLOW]
    count, channels, rows, columns = flow.shape
    shape = (count, channels, rows // POOL, POOL, columns // POOL, POOL)
    return flow.reshape(shape).mean(axis=(3, 5)).reshape(count, -1)


def patches_of(field: jax.Array) -> jax.Array:
    """Return the patches of a field [C, rows, columns], [patches, C · 16]."""
    channels, rows, columns = field.shape
    # [C, rows/4, 4, columns/4, 4] to [rows/4 · columns/4, C · 4 · 4]
    parts = field.reshape(channels, rows // PATCH, PATCH, columns // PATCH, PATCH)
    return parts.transpose(1, 3, 0, 2, 4).reshape(-1, channels * PATCH**2)


def small_at_first(head: PReluHead) -> PReluHead:
    """Return a head whose last layer has small weights, and no offset."""
    last = head.last
    small: PReluHead = eqx.tree_at(
        lambda tree: (tree.last.weight, tree.last.bias),
        head,
        (SMALL * last.weight, jnp.zeros(last.weight.shape[0])),
    )
    return small

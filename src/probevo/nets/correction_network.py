"""DPC-Net: how far the motion of a step is off, with the covariance of what remains (thesis 6).

The network begins as a linear regression of the correction on the estimated motion, in closed form:
a wrong focal length lengthens all motions by the same share. Heads over the fields of flow and
disparity add to it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from probevo.arrays import FloatArray
from probevo.errors import InputError
from probevo.nets.correction_space import CorrectionTargets
from probevo.nets.estimated_steps import NUM_STEREO
from probevo.nets.field_network import (
    FEATURES,
    PATCH,
    PATCH_UNITS,
    LinearFit,
    network_on,
    patches_of,
    ridge_fit,
    standardisation,
)
from probevo.nets.flow_field import CELLS, CHANNELS
from probevo.nets.methods import Method
from probevo.nets.networks import Network, plain_dropout
from probevo.nets.trained_network import (
    TrainedNetwork,
    cure_of,
    empty_networks,
    facts_of_kind,
    read_arrays,
)

KIND = "correction"
SHAPE = (CHANNELS + NUM_STEREO, *CELLS)
NUM_REGRESSORS = 15
NUM_NUMBERS = NUM_REGRESSORS + 6
"""Numbers beside the field: regressors, and the logarithms of the odometry's own σ."""


class Corrections(NamedTuple):
    """The output of a network for N steps."""

    xi: FloatArray
    """Corrections, [N, 6], m and rad; axes that are not corrected are zero."""
    covariance: FloatArray
    """Covariance of the remaining error along the corrected axes, calibrated and widened, [N, d,
    d]."""
    widening: FloatArray
    """Factor by which the covariance was widened because the input is unlike the training data,
    [N]."""


@dataclass(frozen=True, eq=False)
class CorrectionNetwork(TrainedNetwork):
    """A trained network of corrections."""

    @cached_property
    def space(self) -> CorrectionTargets:
        """The space of its targets."""
        return space_of(self.facts)

    def estimate(self, inputs: FloatArray) -> Corrections:
        """Return corrections and covariances of N steps.

        Args:
            inputs: as ``inputs_of`` gives them, [N, i].
        """
        predicted, widening = self.evaluate(self.space, inputs)
        # Σ in m and rad, times the calibration and the widening out of the domain
        factor = float(self.facts["scale"]) * widening
        covariance = self.space.in_metres_and_rad(predicted.covariance)
        return Corrections(
            float(self.facts["gain"]) * predicted.mean,
            factor[:, None, None] * covariance,
            widening,
        )

    def linear(self, inputs: FloatArray) -> FloatArray:
        """Return the corrections by the linear regression alone, [N, 6], m and rad."""
        trunk = jax.tree.map(lambda array: np.asarray(array[0], np.float64), self.networks.trunk)
        outputs = linear_estimates(inputs, trunk.standard, trunk.linear)
        xi = np.zeros((len(inputs), 6))
        # Outputs o are in units of L: ξ = L o
        xi[:, self.space.axes] = outputs @ np.asarray(self.space.root).T
        return xi

    @staticmethod
    def load(path: Path) -> CorrectionNetwork:
        """Read one. A file holds data only; nothing in it is ever executed.

        Raises:
            InputError: the file cannot be read, is damaged, or holds something else.
        """
        facts = facts_of_kind(path, KIND, numbers=("gain",))
        method = Method(**facts["method"])
        try:
            space = space_of(facts)
        except (KeyError, TypeError, ValueError) as error:
            what = f"it does not say in which units it corrects what ({error!r})."
            raise InputError(path, what, cure_of(KIND)) from error
        networks, domain = read_arrays(path, _empty(method, space), space.dof + FEATURES)
        return CorrectionNetwork(networks, domain, facts)


class Standardisation(NamedTuple):
    """Means of the training data, and one over their standard deviations."""

    field_mean: Any
    """[6, 1, 1]"""
    field_scale: Any
    number_mean: Any
    """[21]"""
    number_scale: Any


class CorrectionTrunk(eqx.Module):
    """A linear regression on the motion, and layers over patches of the field, with ReLU."""

    standard: Standardisation
    linear: LinearFit
    patch_layers: list[eqx.nn.Linear]
    last: eqx.nn.Linear
    dropout: float = eqx.field(static=True)

    def __init__(
        self, standard: Standardisation, linear: LinearFit, dropout: float, *, key: jax.Array
    ) -> None:
        channels, rows, columns = SHAPE
        sizes = (channels * PATCH**2, *PATCH_UNITS)
        keys = jax.random.split(key, len(sizes))
        self.standard = _as_jax(standard)
        self.linear = _as_jax(linear)
        self.patch_layers = [
            eqx.nn.Linear(sizes[k], sizes[k + 1], key=keys[k]) for k in range(len(sizes) - 1)
        ]
        patches = (rows // PATCH) * (columns // PATCH)
        self.last = eqx.nn.Linear(patches * sizes[-1] + NUM_NUMBERS, FEATURES, key=keys[-1])
        self.dropout = dropout

    def __call__(self, inputs: jax.Array, key: jax.Array | None) -> jax.Array:
        """Return the features of one input, [i]: the linear ones, then 64 others."""
        # Statistics of the data, and what was fitted to them, are no weights.
        standard, linear = jax.lax.stop_gradient((self.standard, self.linear))
        # An input is the field, flattened, then 15 regressors and 6 values of ln σ.
        numbers = (inputs[-NUM_NUMBERS:] - standard.number_mean) * standard.number_scale
        first = linear.weights @ numbers[:NUM_REGRESSORS] + linear.offset
        field = inputs[:-NUM_NUMBERS].reshape(SHAPE)
        features = patches_of((field - standard.field_mean) * standard.field_scale)
        for layer in self.patch_layers:
            features = jax.nn.relu(jax.vmap(layer)(features))
        active = jax.nn.relu(self.last(jnp.concatenate([features.ravel(), numbers])))
        return jnp.concatenate([first, plain_dropout(active, self.dropout, key)])


def inputs_of(fields: FloatArray, motions: FloatArray, covariances: FloatArray) -> FloatArray:
    """Return the inputs of N steps, [N, i], float32.

    Args:
        fields: as ``stereo_field`` gives them, [N, 6, rows, columns].
        motions: Log of the estimated T_curr_prev, [N, 6], m and rad.
        covariances: that the odometry claims of them, [N, 6, 6].
    """
    log_sigma = 0.5 * np.log(np.diagonal(covariances, axis1=1, axis2=2))
    parts = [fields.reshape(len(fields), -1), regressors(motions), log_sigma]
    return np.concatenate(parts, axis=1).astype(np.float32)


def regressors(motions: FloatArray) -> FloatArray:
    """Return the regressors of the linear part: ξ, its squares, and φ times the distance, [N, 15].

    Calibration errors act on the motion and on its products: in a turn, the translational flow is
    in another part of the image, where the distortion is different.
    """
    distance = np.linalg.norm(motions[:, :3], axis=1, keepdims=True)
    return np.hstack([motions, motions**2, distance * motions[:, 3:]])


def standardised(inputs: FloatArray) -> Standardisation:
    """Return the means and scales of the training data, [N, i]."""
    fields = inputs[:, :-NUM_NUMBERS].reshape(-1, *SHAPE)
    numbers = np.asarray(inputs[:, -NUM_NUMBERS:], np.float64)
    spread = numbers.std(axis=0)
    return Standardisation(
        *standardisation(fields), numbers.mean(axis=0), 1.0 / np.maximum(spread, 1e-9)
    )


def linear_fit(inputs: FloatArray, standard: Standardisation, targets: FloatArray) -> LinearFit:
    """Return the ridge regression of targets, [N, o], on the motions within inputs, [N, i]."""
    return ridge_fit(_regressed(inputs, standard), targets)


def linear_estimates(
    inputs: FloatArray, standard: Standardisation, linear: LinearFit
) -> FloatArray:
    """Return what the linear regression makes of inputs, [N, o]."""
    estimates: FloatArray = _regressed(inputs, standard) @ linear.weights.T + linear.offset
    return estimates


def build(
    method: Method,
    space: CorrectionTargets,
    standard: Standardisation,
    *,
    linear: LinearFit,
    key: jax.Array,
) -> Network:
    """Return a network with initial weights, which begins as the linear regression."""
    key_of_trunk, *keys = jax.random.split(key, 3)
    trunk = CorrectionTrunk(standard, linear, method.dropout, key=key_of_trunk)
    return network_on(
        trunk, method, space, keys=(keys[0], keys[1]), num_features=space.dof + FEATURES
    )


def space_of(facts: dict[str, Any]) -> CorrectionTargets:
    """Return what the network of these facts regresses."""
    root = tuple(tuple(float(value) for value in row) for row in facts["root"])
    return CorrectionTargets(root, tuple(int(axis) for axis in facts["axes"]))


def _regressed(inputs: FloatArray, standard: Standardisation) -> FloatArray:
    numbers = np.asarray(inputs[:, -NUM_NUMBERS:], np.float64)
    standardised_numbers: FloatArray = (numbers - standard.number_mean) * standard.number_scale
    return standardised_numbers[:, :NUM_REGRESSORS]


def _as_jax(arrays: Any) -> Any:
    return jax.tree.map(lambda array: jnp.asarray(array, jnp.float32), arrays)


def _empty(method: Method, space: CorrectionTargets) -> Network:
    """Return a structure to read a file into."""
    standard = standardised(np.zeros((1, int(np.prod(SHAPE)) + NUM_NUMBERS)))
    linear = LinearFit(np.zeros((space.dof, NUM_REGRESSORS)), np.zeros(space.dof))

    def one(key: jax.Array) -> Network:
        """Return one network with random weights."""
        return build(method, space, standard, linear=linear, key=key)

    return empty_networks(one)

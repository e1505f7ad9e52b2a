"""HydraNet on images: the rotation from one image to the next, with its covariance (thesis 7)."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from probevo import __version__
from probevo.arrays import FloatArray
from probevo.errors import InputError
from probevo.nets import methods
from probevo.nets.domain import FARTHEST, Domain
from probevo.nets.field_network import FEATURES, LinearFit, field_network
from probevo.nets.flow_field import CELLS, CHANNELS
from probevo.nets.methods import Method
from probevo.nets.network_file import read_facts, read_network_file, write_network_file
from probevo.nets.networks import Network
from probevo.nets.target_space import SmallRotationTargets

KIND = "rotation"
SPACE = SmallRotationTargets()
CURE = "Train it again: probevo train … --kind rotation."


class RotationEstimates(NamedTuple):
    """What a network says of N pairs of images."""

    q_curr_prev: FloatArray
    """Rotations as unit quaternions, scalar first, [N, 4]."""
    covariance: FloatArray
    """Of their left perturbations, calibrated and widened, [N, 3, 3], rad²."""
    widening: FloatArray
    """By how much the covariance was multiplied since the input is unlike the training data, [N]"""


@dataclass(frozen=True, eq=False)
class RotationNetwork:
    """A trained network, the domain it was trained on, and the calibration of its covariance."""

    networks: Network
    """Arrays have a leading dimension of 1: one network."""
    domain: Domain
    facts: dict[str, Any]
    """``method``, ``scale`` and how it was trained; JSON values."""

    @cached_property
    def method(self) -> Method:
        """How many heads it has."""
        return Method(**self.facts["method"])

    def estimate(self, fields: FloatArray) -> RotationEstimates:
        """Return rotations and covariances of N pairs of images.

        Args:
            fields: as ``flow_field`` gives them, [N, 4, rows, columns].
        """
        found, raw, features = _call(
            self.method, self.networks, jnp.asarray(fields, jnp.float32), jax.random.key(0)
        )
        predicted = methods.prediction(SPACE, found, raw)
        widening = self.domain.widening(np.asarray(features, np.float64))
        factor = float(self.facts["scale"]) * widening
        return RotationEstimates(
            predicted.mean, factor[:, None, None] * predicted.covariance, widening
        )

    def save(self, path: Path) -> None:
        """Write it; the same network gives the same bytes.

        Raises:
            InputError: the file cannot be written.
        """
        write_network_file(path, (self.networks, self.domain), self.facts)

    @staticmethod
    def load(path: Path) -> RotationNetwork:
        """Read one. A file holds data only; nothing in it is ever executed.

        Raises:
            InputError: the file cannot be read, is damaged, or holds something else.
        """
        facts = read_facts(path)
        try:
            is_of_kind = facts["kind"] == KIND and float(facts["scale"]) > 0.0
            method = Method(**facts["method"])
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(
                path, f"it is no whole network of rotations ({error}).", CURE
            ) from error
        if not is_of_kind:
            raise InputError(path, f"it is of kind {facts['kind']!r}, not {KIND}.", CURE)
        empty = (empty_networks(method), empty_domain())
        networks, domain = read_network_file(path, empty)
        return RotationNetwork(networks, Domain(*(np.asarray(part) for part in domain)), facts)


def method_of(num_heads: int) -> Method:
    """Return the method: hydra-sigma without noise on its targets, as the authors had on KITTI."""
    return Method("hydra-sigma", heads=num_heads, learns_covariance=True)


def first_facts(method: Method) -> dict[str, Any]:
    """Return the facts that every file has."""
    return {"kind": KIND, "method": asdict(method), "probevo": __version__}


def build(method: Method, fields: FloatArray, linear: LinearFit, key: jax.Array) -> Network:
    """Return a network with initial weights."""
    return field_network(method, SPACE, fields, linear, key=key)


def empty_networks(method: Method) -> Network:
    """Return a structure to read a file into."""
    rows, columns = CELLS
    fields = np.zeros((1, CHANNELS, rows, columns))
    weights = np.zeros((SPACE.num_outputs, rows * columns // 2))
    linear = LinearFit(weights, np.zeros(SPACE.num_outputs))

    def one(key: jax.Array) -> Network:
        """Return one network with random weights."""
        return build(method, fields, linear, key)

    networks: Network = eqx.filter_vmap(one)(jax.random.split(jax.random.key(0), 1))
    return networks


def empty_domain() -> Domain:
    """Return a structure to read a file into."""
    num_features = SPACE.num_outputs + FEATURES
    single = (
        np.asarray(array, np.float32)
        for array in (np.zeros(num_features), np.eye(num_features), np.ones(()))
    )
    return Domain(*single)


def trunk_features(networks: Network, fields: FloatArray) -> FloatArray:
    """Return the features, [N, f], that the trunk of one network gives of fields."""
    return np.asarray(_features(networks, jnp.asarray(fields, jnp.float32)), np.float64)


def has_nothing_to_say(widening: float) -> bool:
    """Return whether an input is so far out of the domain that no covariance holds."""
    return widening > FARTHEST


@eqx.filter_jit
def _call(
    method: Method, networks: Network, fields: jax.Array, key: jax.Array
) -> tuple[jax.Array, jax.Array | None, jax.Array]:
    """Return estimates, outputs of the covariance head, and features."""
    found, raw = methods.estimates(method, SPACE, networks, fields, key)
    return found, raw, _features(networks, fields)


@eqx.filter_jit
def _features(networks: Network, fields: jax.Array) -> jax.Array:
    first = jax.tree.map(lambda array: array[0], networks)
    features: jax.Array = jax.vmap(lambda field: first.trunk(field, jax.random.key(0)))(fields)
    return features

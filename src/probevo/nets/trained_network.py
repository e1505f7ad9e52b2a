"""What all trained networks of sensors have in common: evaluation, domain, file."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
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
from probevo.nets.calibration import Claimed
from probevo.nets.domain import FARTHEST, Domain
from probevo.nets.methods import Method, Prediction
from probevo.nets.network_file import (
    named_arrays,
    read_facts,
    read_network_file,
    write_network_file,
)
from probevo.nets.networks import Network
from probevo.nets.target_space import TargetSpace
from probevo.sensor_kinds import SensorErrors

MAX_ESTIMATES = 1000
"""Estimates of one input that a file may ask for: networks × passes × heads."""


class Evaluation(NamedTuple):
    """The predictions of a network for N inputs."""

    predicted: Prediction
    """Predictions before calibration."""
    widening: FloatArray
    """Factor by which covariances are widened because the input is unlike the training data,
    [N]."""


@dataclass(frozen=True, eq=False)
class TrainedNetwork:
    """A trained network, the domain it was trained on, and the calibration of its covariance."""

    networks: Network
    """Arrays have a leading dimension: networks of an ensemble, or 1."""
    domain: Domain
    facts: dict[str, Any]
    """``kind``, ``method``, ``scale``, ``epochs``, ``kept_epoch`` and how it was trained; JSON
    values."""

    @cached_property
    def method(self) -> Method:
        """How many networks, passes and heads it has, and whether it learns a covariance."""
        return Method(**self.facts["method"])

    def evaluate(self, space: TargetSpace, inputs: FloatArray) -> Evaluation:
        """Return what it makes of N inputs, [N, ...]."""
        estimated, raw, features = _call(
            self.method, space, self.networks, jnp.asarray(inputs, jnp.float32)
        )
        widening = self.domain.widening(
            self.domain_features(inputs, np.asarray(features, np.float64))
        )
        return Evaluation(methods.prediction(space, estimated, raw), widening)

    def domain_features(self, inputs: FloatArray, trunk_output: FloatArray) -> FloatArray:
        """Return the features by which the domain tells whether N inputs are like those learned.

        Args:
            inputs: [N, ...].
            trunk_output: what the trunk makes of them, which is what is returned; [N, f].
        """
        return trunk_output

    def save(self, path: Path) -> None:
        """Write it; the same network gives the same bytes.

        Raises:
            InputError: the file cannot be written.
        """
        write_network_file(path, (self.networks, self.domain), self.facts)


def first_facts(kind: str, method: Method) -> dict[str, Any]:
    """Return the facts that every file has."""
    return {"kind": kind, "method": asdict(method), "probevo": __version__}


def facts_of_kind(path: Path, kind: str, numbers: Collection[str] = ()) -> dict[str, Any]:
    """Read what a file says of itself, and check that it holds a network of this kind.

    Args:
        path: the file.
        kind: the kind.
        numbers: the facts that this kind has besides the common ones, each a finite number from 0
            on.

    Raises:
        InputError: the file cannot be read, is damaged, or holds something else.
    """
    facts = read_facts(path)
    try:
        is_of_kind = facts["kind"] == kind
        _check_method(Method(**facts["method"]))
        _check_epochs(facts)
        for name in ("scale", *numbers):
            if type(facts[name]) not in (int, float) or not 0.0 <= float(facts[name]) < np.inf:
                raise ValueError(f"{name} is {facts[name]!r}")
        if facts["scale"] == 0.0:
            raise ValueError("scale is 0")
    except (KeyError, OverflowError, TypeError, ValueError) as error:
        what = f"it is not a complete network of kind {kind} ({error})."
        raise InputError(path, what, cure_of(kind)) from error
    if not is_of_kind:
        raise InputError(path, f"it is of kind {facts['kind']!r}, not {kind}.", cure_of(kind))
    return facts


def kept_text(facts: Mapping[str, Any]) -> str:
    """Say after which epoch the network was taken, and why; empty if its file does not say."""
    kept = facts.get("kept_epoch")
    if kept is None:
        return ""
    if kept == 0:
        return "the initial network; no epoch had a finite loss on what was left out"
    network = f"the network after {_count_of_epochs(kept)}"
    more = facts["epochs"] - kept
    text = f"{network}, the last"
    if more > 0:
        text = f"{network}; {more} more did not lower the loss on what was left out"
    if _was_ended_by_limit(facts):
        text += "; it ended at --nets.epochs, and more may lower it"
    return text


def _was_ended_by_limit(facts: Mapping[str, Any]) -> bool:
    """Return whether a training ended because of the largest number of epochs alone."""
    settings = facts.get("settings")
    if not isinstance(settings, dict) or settings.get("epochs") != facts["epochs"]:
        return False
    patience = settings.get("patience")
    return type(patience) is int and facts["epochs"] - facts["kept_epoch"] < patience


def kept_lines(facts: Mapping[str, Any]) -> list[str]:
    """Return the line of the summary of a training that says which epoch was kept, if any does."""
    text = kept_text(facts)
    return [f"kept:         {text}"] if text else []


def _count_of_epochs(count: int) -> str:
    return "1 epoch" if count == 1 else f"{count} epochs"


def _check_method(method: Method) -> None:
    """Refuse values that are not numbers, or would fill the memory.

    Raises:
        ValueError: says which.
    """
    for name in ("networks", "passes", "heads"):
        count = getattr(method, name)
        if type(count) is not int or not 1 <= count <= MAX_ESTIMATES:
            raise ValueError(f"{name} is {count!r}")
    if method.num_estimates > MAX_ESTIMATES:
        raise ValueError(f"{method.num_estimates} estimates of each input")
    if type(method.dropout) not in (int, float) or not 0.0 <= method.dropout < 1.0:
        raise ValueError(f"dropout is {method.dropout!r}")


def _check_epochs(facts: Mapping[str, Any]) -> None:
    """Refuse numbers of epochs that contradict each other; both may be absent.

    Raises:
        ValueError: says which.
        KeyError: only one of both is there.
    """
    if "kept_epoch" not in facts and "epochs" not in facts:
        return
    for name in ("kept_epoch", "epochs"):
        if type(facts[name]) is not int or facts[name] < 0:
            raise ValueError(f"{name} is {facts[name]!r}")
    if facts["kept_epoch"] > facts["epochs"]:
        raise ValueError(f"kept_epoch is {facts['kept_epoch']} of {facts['epochs']} epochs")


def read_arrays(path: Path, empty: Network, num_features: int) -> tuple[Network, Domain]:
    """Return networks and domain of a file.

    Args:
        path: the file.
        empty: networks of the same structure, with their leading dimension.
        num_features: that the trunk gives.

    Raises:
        InputError: the file cannot be read, is damaged, or has other arrays or numbers that are
            not finite.
    """
    tree = read_network_file(path, (empty, empty_domain(num_features)))
    for name, array in named_arrays(tree).items():
        if not np.isfinite(array).all():
            raise InputError(f"{path}: {name}", "it is not finite.", "Train it again.")
    networks, domain = tree
    return networks, Domain(*(np.asarray(part) for part in domain))


def empty_networks(build_one: Callable[[jax.Array], Network], count: int = 1) -> Network:
    """Return a structure to read networks into, of a function that builds one of a key.

    All of its numbers are zero: to draw them, JAX would compile hundreds of operations.
    """
    keys = jax.random.split(jax.random.key(0), count)
    shapes = eqx.filter_eval_shape(eqx.filter_vmap(build_one), keys)
    networks: Network = jax.tree.map(lambda leaf: np.zeros(leaf.shape, leaf.dtype), shapes)
    return networks


def empty_domain(num_features: int) -> Domain:
    """Return a structure to read a file into."""
    single = (
        np.asarray(array, np.float32)
        for array in (np.zeros(num_features), np.eye(num_features), np.ones(()))
    )
    return Domain(*single)


def trunk_features(networks: Network, inputs: FloatArray) -> FloatArray:
    """Return the features, [N, f], that the trunk of the first network gives, without dropout."""
    return np.asarray(_features(networks, jnp.asarray(inputs, jnp.float32)), np.float64)


def saliency(
    network: TrainedNetwork, space: TargetSpace, fields: FloatArray, targets: FloatArray
) -> FloatArray:
    """Return how much the loss depends on each cell, [rows, columns]: |∂loss/∂field|.

    Channels are in units of their standard deviation over these data, and added up; the result is
    the mean over the data. The loss is the first network's, without dropout.

    Args:
        network: of fields.
        space: what it regresses.
        fields: [N, C, rows, columns].
        targets: true values, [N, o].
    """
    gradients = _loss_gradients(
        space,
        network.networks,
        jnp.asarray(fields, jnp.float32),
        jnp.asarray(targets, jnp.float32),
    )
    # ∂loss/∂(field/σ_channel), [N, C, rows, columns]: summed over channels, averaged over data
    spread = fields.std(axis=(0, 2, 3))[:, None, None]
    mean_gradients: FloatArray = np.mean(np.sum(np.abs(gradients) * spread, axis=1), axis=0)
    return np.asarray(mean_gradients, np.float64)


def sensor_errors(
    claimed: Claimed,
    facts: Mapping[str, Any],
    *,
    path: Path,
    num_lengths: int = 0,
    saliency: FloatArray | None = None,
) -> SensorErrors:
    """Return the errors of the measurements that a run would use.

    Args:
        claimed: errors and covariances of all inputs.
        facts: what the file of the network says of it.
        path: the recording.
        num_lengths: leading components of an error that are lengths.
        saliency: as ``saliency`` returns it.

    Raises:
        InputError: no input is within the domain: there are no errors to be shown.
    """
    is_used = claimed.widening <= FARTHEST
    if not is_used.any():
        what = "all of it is so unlike what the network has learned that it measures nothing."
        raise InputError(path, what, "Take another recording, or learn from ones like this.")
    return SensorErrors(
        claimed.errors[is_used],
        claimed.covariances[is_used],
        num_out_of_domain=int(np.sum(claimed.widening[is_used] > 1.0)),
        num_silent=int(np.sum(~is_used)),
        num_lengths=num_lengths,
        saliency=saliency,
        kept=kept_text(facts),
    )


def is_beyond_domain(widening: float) -> bool:
    """Return whether an input is so far out of the domain that no covariance holds."""
    return widening > FARTHEST


def cure_of(kind: str) -> str:
    """Return what to do about a file that does not fit."""
    return f"Train it again: probevo train … --kind {kind}."


@eqx.filter_jit
def _call(
    method: Method, space: TargetSpace, networks: Network, inputs: jax.Array
) -> tuple[jax.Array, jax.Array | None, jax.Array]:
    """Return estimates, outputs of the covariance head, and features."""
    # A fixed key: the same input always gives the same estimates, with dropout, too.
    estimated, raw = methods.estimates(
        method, space, networks, inputs, jax.random.key(0), same_dropout=True
    )
    return estimated, raw, _features(networks, inputs)


@eqx.filter_jit
def _features(networks: Network, inputs: jax.Array) -> jax.Array:
    # The trunk of the first network stands for all of an ensemble.
    first = jax.tree.map(lambda array: array[0], networks)
    features: jax.Array = jax.vmap(lambda one: first.trunk(one, None))(inputs)
    return features


@eqx.filter_jit
def _loss_gradients(
    space: TargetSpace, networks: Network, fields: jax.Array, targets: jax.Array
) -> jax.Array:
    """Return ∂loss/∂field of each datum, [N, C, rows, columns]."""
    first = jax.tree.map(lambda array: array[0], networks)

    def loss(field: jax.Array, target: jax.Array) -> jax.Array:
        """Return the loss of one datum."""
        return methods.loss(space, first, field[None], target[None, None], key=None)

    gradients: jax.Array = jax.vmap(jax.grad(loss))(fields, targets)
    return gradients

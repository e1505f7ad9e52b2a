"""Training of networks: seeded, with the same bytes on a CPU however often it was stopped.

Several experiments, each with its own data, are trained at once, and so are the networks of an
ensemble: all arrays of networks and optimiser have leading dimensions [S, M, ...], for S
experiments of M networks. What is random in an epoch depends on the seed and its number alone, so
that networks, optimiser and the number of epochs are all that a training has to remember.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import optax

from probevo import __version__
from probevo.errors import InputError
from probevo.nets import methods
from probevo.nets.methods import Build, Method
from probevo.nets.network_file import read_facts, read_network_file, write_network_file
from probevo.nets.networks import Network
from probevo.nets.target_space import TargetSpace

Augment = Callable[[jax.Array, jax.Array, jax.Array], tuple[jax.Array, jax.Array]]
"""Takes inputs [B, …], targets of H heads [B, H, o] and a key; returns one random copy of each."""
Show = Callable[[int, int], None]
"""A function of the number of epochs done and of their total number."""
_INITIAL, _EPOCHS, _HELD_OUT = range(3)
"""Which stream of random numbers a key is for."""


@dataclass(frozen=True)
class LearningPlan:
    """Length and optimiser of a training."""

    epochs: int
    batch: int
    optimizer: Literal["adam", "sgd"] = "adam"
    learning_rate: float = 1e-4
    momentum: float = 0.0
    """Momentum; only with "sgd"."""
    copies: int = 1
    """Times that an epoch uses each datum, or random copies of it."""
    shuffle: bool = True
    """Whether each epoch has another order of the data. What does not fill a batch is left out."""
    patience: int | None = None
    """Epochs without a smaller loss on the data left out after which the training stops; then, and
    at the end, the best networks so far count. None: all epochs, and the last networks count."""
    calibrated_after: bool = False
    """Whether the covariances are calibrated after the training: the loss on the data left out is
    then that with calibrated ones."""
    keep_every: int = 10
    """Epochs between two writings of the file."""
    seed: int = 0


class TrainingData(eqx.Module):
    """Training and validation data of S experiments with M networks each."""

    inputs: jax.Array
    """Training inputs of each experiment, [S, N, i]."""
    targets: jax.Array
    """Targets of each network and head, [S, M, N, H, o]."""
    samples: jax.Array
    """Which of the data each network is trained on, in this order, [S, M, N], int32."""
    held_out_inputs: jax.Array
    """Validation inputs, [S, N', i]; N' may be 0 where there is no ``patience``."""
    held_out_targets: jax.Array
    """True values, [S, N', o]."""
    augment: Augment | None = eqx.field(static=True, default=None)
    """Makes the random copies that networks learn from in place of the data; None for none."""


class LearningState(NamedTuple):
    """The state of a training between two epochs."""

    networks: Network
    optimizer: optax.OptState
    best: Network
    epoch: jax.Array
    """Number of epochs that are done, int32."""
    best_loss: jax.Array
    """Smallest loss on the data left out."""
    num_worse: jax.Array
    """Epochs since then, int32."""


class Learned(NamedTuple):
    """Trained networks, and which epoch they are from."""

    networks: Network
    """With leading dimensions [S, M, ...]."""
    epochs: int | None
    """Number of epochs that were done; None if the file of a finished training does not say."""
    kept_epoch: int | None
    """Number of epochs after which the networks were taken; 0 for the initial ones."""


def learn(
    method: Method,
    space: TargetSpace,
    build: Build,
    *,
    data: TrainingData,
    plan: LearningPlan,
    file: Path | None = None,
    show: Show | None = None,
) -> Learned:
    """Train the networks of a method; return them, and the epoch that was kept.

    Args:
        method: the method.
        space: what is regressed.
        build: makes one network of the method.
        data: training data, and data left out.
        plan: how long, and with which optimiser.
        file: where to keep the work so far, and in the end the networks alone. A training that was
            stopped goes on from there, and one that is finished is not repeated.
        show: called after each epoch, for the progress on screen.

    Raises:
        InputError: the file is of another plan or method, damaged, or cannot be written.
    """
    _check(data, plan)
    optimizer = _optimizer(plan)
    state = _initial_state(method, build, optimizer, data=data, plan=plan)
    facts = {"method": asdict(method), "plan": asdict(plan), "probevo": __version__}
    # Resume from the file, if it is of the same training.
    if file is not None and file.exists():
        stored = read_facts(file)
        if {name: stored.get(name) for name in facts} != facts:
            what = "holds networks of another method, plan or version of probevo."
            raise InputError(file, what, "Delete it, or name another file.")
        if stored.get("is_finished"):
            networks = read_network_file(file, state.networks)
            return Learned(networks, stored.get("epochs"), stored.get("kept_epoch"))
        state = read_network_file(file, state)

    # Epoch by epoch; the next one depends on the state, the data and the seed alone.
    run_epoch = _compiled_epoch(space, _same_epochs(plan))
    while not _is_finished(state, plan):
        state = run_epoch(state, data, jax.random.key(plan.seed))
        epoch = int(state.epoch)
        if file is not None and epoch % plan.keep_every == 0 and not _is_finished(state, plan):
            write_network_file(file, state, {**facts, "is_finished": False})
        if show is not None:
            show(epoch, plan.epochs)
    # The best networks count where a loss on data left out says which these are.
    epochs = int(state.epoch)
    learned = Learned(state.networks, epochs, kept_epoch=epochs)
    if plan.patience is not None:
        learned = Learned(state.best, epochs, kept_epoch=epochs - int(state.num_worse))
    if file is not None:
        ended = {"is_finished": True, "epochs": epochs, "kept_epoch": learned.kept_epoch}
        write_network_file(file, learned.networks, {**facts, **ended})
    return learned


def _check(data: TrainingData, plan: LearningPlan) -> None:
    """Refuse a plan that the data do not allow."""
    num_data = data.inputs.shape[1] * plan.copies
    if not 1 <= plan.batch <= num_data:
        what = f"is {plan.batch}; there are {num_data} data to train on."
        raise InputError("batch", what, "Take a smaller batch, or more data.")
    if plan.patience is not None and data.held_out_inputs.shape[1] == 0:
        raise InputError("patience", "is given, but no data are left out.", "Leave some out.")


def _optimizer(plan: LearningPlan) -> optax.GradientTransformation:
    if plan.optimizer == "adam":
        return optax.adam(plan.learning_rate)
    return optax.sgd(plan.learning_rate, momentum=plan.momentum)


def _initial_state(
    method: Method,
    build: Build,
    optimizer: optax.GradientTransformation,
    *,
    data: TrainingData,
    plan: LearningPlan,
) -> LearningState:
    """Return the state before the first epoch."""
    # Initial weights of each network of each experiment, by keys of the seed.
    num_experiments, num_networks = data.samples.shape[:2]
    key = jax.random.fold_in(jax.random.key(plan.seed), _INITIAL)
    keys = jax.random.split(key, (num_experiments, num_networks))
    networks = eqx.filter_vmap(eqx.filter_vmap(partial(build, method)))(keys)
    # JAX's weak types would become strong in the first epoch, and the second epoch would be
    # compiled again.
    networks = jax.tree.map(lambda array: jnp.asarray(array, array.dtype), networks)
    initialize = jax.vmap(jax.vmap(optimizer.init))
    return LearningState(
        networks,
        initialize(networks),
        best=networks,
        epoch=jnp.zeros((), jnp.int32),
        best_loss=jnp.array(jnp.inf, jnp.float32),
        num_worse=jnp.zeros((), jnp.int32),
    )


def _is_finished(state: LearningState, plan: LearningPlan) -> bool:
    is_stale = plan.patience is not None and int(state.num_worse) >= plan.patience
    return is_stale or int(state.epoch) >= plan.epochs


def _same_epochs(plan: LearningPlan) -> LearningPlan:
    """Return the plan that stands for all those whose epochs are compiled to the same."""
    patience = None if plan.patience is None else 0
    return replace(plan, epochs=0, keep_every=0, seed=0, patience=patience)


@cache
def _compiled_epoch(
    space: TargetSpace, plan: LearningPlan
) -> Callable[[LearningState, TrainingData, jax.Array], LearningState]:
    """Return a compiled function of state, data and key of the seed: the state an epoch later.

    It is kept for other trainings in the same process, since compiling takes seconds.
    """
    optimizer = _optimizer(plan)

    def train_one(
        network: Network,
        optimizer_state: Any,
        data: tuple[jax.Array, ...],
        key: jax.Array,
        *,
        augment: Augment | None,
    ) -> tuple[Network, Any]:
        """Train one network for an epoch."""
        # Inputs [N, i], targets [N, H, o], and which data the network has, [N]
        inputs, targets, chosen = data
        chosen = jnp.tile(chosen, plan.copies)
        num_batches = len(chosen) // plan.batch
        # Batches of the data in a random order; what does not fill the last one is left out.
        key_of_order, key_of_dropout = jax.random.split(key)
        order = chosen
        if plan.shuffle:
            order = jax.random.permutation(key_of_order, chosen)
        batches = order[: num_batches * plan.batch].reshape(num_batches, plan.batch)
        keys = jax.random.split(key_of_dropout, num_batches)

        def step(carry: Any, batch: Any) -> tuple[Any, None]:
            """Take one step of the optimiser, by one batch."""
            current, current_state = carry
            rows, batch_key = batch
            seen = inputs[rows]
            wanted = targets[rows]
            if augment is not None:
                seen, wanted = augment(seen, wanted, jax.random.fold_in(batch_key, 1))
            gradient = jax.grad(
                lambda trained: methods.loss(space, trained, seen, wanted, key=batch_key)
            )(current)
            update, new_state = optimizer.update(gradient, current_state, current)
            return (optax.apply_updates(current, update), new_state), None

        (trained, trained_state), _ = jax.lax.scan(
            step, (network, optimizer_state), (batches, keys)
        )
        return trained, trained_state

    @jax.jit
    def run_epoch(state: LearningState, data: TrainingData, key: jax.Array) -> LearningState:
        """Train all networks for an epoch, and evaluate them on the data left out."""
        # The keys depend on the seed and the number of the epoch alone.
        epoch_key = jax.random.fold_in(jax.random.fold_in(key, _EPOCHS), state.epoch)
        keys = jax.random.split(epoch_key, data.samples.shape[:2])
        # Networks of an experiment share its inputs.
        train = partial(train_one, augment=data.augment)
        over_networks = jax.vmap(train, in_axes=(0, 0, (None, 0, 0), 0))
        networks, optimizer_state = jax.vmap(over_networks)(
            state.networks,
            state.optimizer,
            (data.inputs, data.targets, data.samples),
            keys,
        )
        following = state._replace(
            networks=networks, optimizer=optimizer_state, epoch=state.epoch + 1
        )
        if plan.patience is None:
            return following
        held_out_key = jax.random.fold_in(key, _HELD_OUT)
        loss = methods.calibrated_loss if plan.calibrated_after else methods.loss
        held_out_loss = _held_out_loss(space, networks, data, loss=loss, key=held_out_key)
        # A loss of NaN is never better. The best networks date from ``num_worse`` epochs ago.
        is_better = held_out_loss < state.best_loss
        best = jax.tree.map(lambda new, old: jnp.where(is_better, new, old), networks, state.best)
        return following._replace(
            best=best,
            best_loss=jnp.where(is_better, held_out_loss, state.best_loss),
            num_worse=jnp.where(is_better, 0, state.num_worse + 1),
        )

    return run_epoch


def _held_out_loss(
    space: TargetSpace,
    networks: Network,
    data: TrainingData,
    *,
    loss: Callable[..., jax.Array],
    key: jax.Array,
) -> jax.Array:
    """Return the mean loss of all networks on the data left out, whose targets have no noise."""

    def one(network: Network, inputs: jax.Array, targets: jax.Array) -> jax.Array:
        """Return the loss of one network."""
        # All heads have the same target, [N', 1, o].
        return loss(space, network, inputs, targets[:, None, :], key=key)

    over_networks = jax.vmap(one, in_axes=(0, None, None))
    over_experiments = jax.vmap(over_networks)
    losses = over_experiments(networks, data.held_out_inputs, data.held_out_targets)
    return jnp.mean(losses)

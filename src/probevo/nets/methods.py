"""Ways to learn how uncertain an estimate is, as values of one kind: loss and prediction of each.

All of them predict several estimates for one input: of networks trained apart, of passes with
different dropout, or of heads. The mean of these is the estimate. Its covariance is their spread,
plus the covariance that the network has learned to give, if it has.

===========  ==================================================================================
dropout      one network with dropout in the prediction, too (Gal & Ghahramani 2016)
ensemble     networks trained apart, each on a bootstrap sample (Lakshminarayanan et al. 2017)
sigma        one network that learns a covariance (Nix & Weigend 1994)
hydra        one trunk with several heads, each with targets of its own noise (thesis chapter 7)
hydra-sigma  hydra with a head that learns a covariance (thesis chapter 7)
===========  ==================================================================================
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from probevo.arrays import FloatArray
from probevo.nets.networks import Network
from probevo.nets.target_space import TargetSpace


@dataclass(frozen=True)
class Method:
    """How a network is trained, and what of its estimates makes the covariance."""

    name: str
    networks: int = 1
    """Networks trained apart."""
    bootstrap: bool = False
    """Whether each is trained on a bootstrap sample of the data, drawn with replacement."""
    passes: int = 1
    """Predictions with different dropout."""
    dropout: float = 0.0
    """Rate of the dropout."""
    heads: int = 1
    learns_covariance: bool = False
    target_sigma: float = 0.0
    """Standard deviation of the noise that is added to the targets of each head or network."""

    @property
    def num_estimates(self) -> int:
        """Number K of estimates for one input."""
        return self.networks * self.passes * self.heads


class Build(Protocol):
    """A function that makes the network of a method."""

    def __call__(self, method: Method, key: jax.Array) -> Network:
        """Return the network with initial weights."""


@dataclass(frozen=True, eq=False)
class Prediction:
    """Estimates with covariances, [..., N]."""

    mean: FloatArray
    """Estimates, [..., N, o]."""
    learned: FloatArray
    """Covariance that the network gives, [..., N, d, d]; where it learns none, the least one, so
    that few estimates do not make a singular Σ."""
    spread: FloatArray
    """Covariance of the K estimates about their mean, [..., N, d, d]; zero if K is 1."""

    @property
    def covariance(self) -> FloatArray:
        """Σ = Σ_d + 1/(K−1) Σ φ φᵀ, [..., N, d, d]."""
        return self.learned + self.spread


def loss(
    space: TargetSpace,
    network: Network,
    inputs: jax.Array,
    targets: jax.Array,
    key: jax.Array | None,
) -> jax.Array:
    """Return the mean loss of one network over a batch.

    It is ½ φᵀ Σ⁻¹ φ + ½ log|Σ| where the network learns a covariance, and where it does not the
    square that the space has for it: φᵀ φ, or of directions the squared chord.

    Args:
        space: what is regressed.
        network: the network.
        inputs: [B, i].
        targets: of each head, [B, H, o].
        key: of the dropout, which differs from input to input; None for none.
    """
    errors, raw = _errors(space, network, inputs, targets, key=key)
    if raw is None:
        return jnp.mean(space.squared(errors))
    whitened, half_log_det = space.whiten(raw, errors)
    return jnp.mean(0.5 * jnp.sum(whitened**2, axis=-1) + half_log_det)


def calibrated_loss(
    space: TargetSpace,
    network: Network,
    inputs: jax.Array,
    targets: jax.Array,
    key: jax.Array | None,
) -> jax.Array:
    """Return the mean loss of one network over data left out, once its covariances are calibrated.

    Calibration multiplies all of them by one factor s, which is the likeliest at
    s = 1/(N d) Σ φᵀ Σ⁻¹ φ (``covariance_scale``). The loss is then ½ d (1 + ln s) + ½ log|Σ|. By
    the loss without it a training would stop as soon as the errors on data that it learns from are
    smaller than on data left out, while the estimate is still getting better.

    Args:
        space: what is regressed.
        network: the network.
        inputs: [N, i].
        targets: true values, [N, 1, o].
        key: of the dropout; None for none.
    """
    errors, raw = _errors(space, network, inputs, targets, key=key)
    if raw is None:
        return jnp.mean(space.squared(errors))
    whitened, half_log_det = space.whiten(raw, errors)
    scale = jnp.mean(whitened**2)
    return 0.5 * space.dof * (1.0 + jnp.log(scale)) + jnp.mean(half_log_det)


def _errors(
    space: TargetSpace,
    network: Network,
    inputs: jax.Array,
    targets: jax.Array,
    *,
    key: jax.Array | None,
) -> tuple[jax.Array, jax.Array | None]:
    """Return the errors of each head in the tangent space, [B, H, d], and the outputs of the
    covariance head, which all heads have in common, [B, 1, c], or None."""
    if key is None:
        outputs, raw = jax.vmap(network, in_axes=(0, None))(inputs, None)
    else:
        outputs, raw = jax.vmap(network)(inputs, jax.random.split(key, len(inputs)))
    errors = space.difference(space.estimate(outputs), targets)
    return errors, None if raw is None else raw[:, None, :]


def head_targets(
    method: Method, space: TargetSpace, targets: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Return the targets of each head, with the noise that this method adds to them.

    Args:
        method: the method.
        space: what is regressed.
        targets: true values, [N, o].
        rng: of the noise, which is drawn once and stays the same through the training.

    Returns:
        Targets [networks, N, H, o].
    """
    # The same targets for all networks and heads, [networks, N, H, o]; noise makes them differ.
    shape = (method.networks, len(targets), method.heads)
    repeated = np.broadcast_to(targets[None, :, None, :], (*shape, targets.shape[1]))
    if method.target_sigma == 0.0:
        return repeated
    errors = rng.normal(0.0, method.target_sigma, (*shape, space.dof))
    return np.asarray(space.perturb(jnp.asarray(repeated), jnp.asarray(errors)))


def samples(method: Method, num_data: int, rng: np.random.Generator) -> np.ndarray:
    """Return which of the data each network is trained on, [networks, N], int32."""
    if method.bootstrap:
        drawn = rng.integers(num_data, size=(method.networks, num_data))
        return drawn.astype(np.int32)
    return np.tile(np.arange(num_data, dtype=np.int32), (method.networks, 1))


@eqx.filter_jit
def estimates(
    method: Method,
    space: TargetSpace,
    networks: Network,
    inputs: jax.Array,
    key: jax.Array,
    *,
    same_dropout: bool = False,
) -> tuple[jax.Array, jax.Array | None]:
    """Return all estimates of each input, [N, K, o], and outputs of covariance heads or None.

    Args:
        method: the method.
        space: what is regressed.
        networks: its networks; their arrays have a leading dimension [networks, ...].
        inputs: [N, i].
        key: of the dropout.
        same_dropout: whether a pass drops the same in all inputs, so that the estimates of an input
            do not depend on which others there are.

    Returns:
        Estimates [N, K, o], and the outputs of covariance heads [N, networks × passes, c].
    """

    def one(network: Network, x: jax.Array, pass_key: jax.Array) -> tuple[jax.Array, ...]:
        """Return what one pass through one network makes of one input."""
        outputs, raw = network(x, pass_key)
        return (space.estimate(outputs),) if raw is None else (space.estimate(outputs), raw)

    shape = (method.networks, method.passes, len(inputs))
    if same_dropout:
        keys = jnp.broadcast_to(jax.random.split(key, shape[:2])[..., None], shape)
    else:
        keys = jax.random.split(key, shape)
    over_inputs = eqx.filter_vmap(one, in_axes=(None, 0, 0))
    over_passes = eqx.filter_vmap(over_inputs, in_axes=(None, None, 0))
    over_networks = eqx.filter_vmap(over_passes, in_axes=(eqx.if_array(0), None, 0))
    # [networks, passes, N, H, o] of estimates, and [networks, passes, N, c] of covariance heads
    estimated, *raw = over_networks(networks, inputs, keys)
    estimated_by_input = jnp.moveaxis(estimated, 2, 0).reshape(len(inputs), -1, space.size)
    if not raw:
        return estimated_by_input, None
    return estimated_by_input, jnp.moveaxis(raw[0], 2, 0).reshape(
        len(inputs), -1, space.num_covariance
    )


def prediction(space: TargetSpace, estimated: jax.Array, raw: jax.Array | None) -> Prediction:
    """Return mean and covariance of the estimates of each input, in float64.

    Args:
        space: what is regressed.
        estimated: estimates, [..., N, K, o].
        raw: outputs of covariance heads, [..., N, *, c]; their covariances are averaged.
    """
    # Mean over the K estimates, [..., N, o]
    mean = space.mean(estimated)
    errors = np.asarray(space.difference(estimated, mean[..., None, :]), np.float64)
    num_estimates = errors.shape[-2]
    # 1/(K − 1) Σ φ φᵀ, with φ the errors of the estimates against their mean, [..., N, K, d]
    spread = errors.mT @ errors / max(num_estimates - 1, 1)
    if raw is None:
        learned = np.broadcast_to(space.least_variance * np.eye(space.dof), spread.shape)
    else:
        learned = space.covariance(np.asarray(raw)).mean(axis=-3)
    if num_estimates == 1:
        spread = np.zeros_like(spread)
    return Prediction(np.asarray(mean, np.float64), learned, spread)

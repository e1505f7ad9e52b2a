"""Small networks and data for the tests of methods and of their training."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from probevo.nets import methods
from probevo.nets.learning import LearningPlan, TrainingData
from probevo.nets.methods import Method
from probevo.nets.networks import Network, PReluHead, ResidualLayers
from probevo.nets.target_space import RotationTargets

INPUTS = 3
METHODS = (
    Method("dropout", passes=5, dropout=0.2),
    Method("ensemble", networks=5, bootstrap=True, target_sigma=0.02),
    Method("sigma", learns_covariance=True),
    Method("hydra", heads=5, target_sigma=0.05),
    Method("hydra-sigma", heads=5, learns_covariance=True, target_sigma=0.05),
)
PLAN = LearningPlan(epochs=6, batch=16, learning_rate=3e-3, keep_every=2)


def build(method: Method, key: jax.Array) -> Network:
    first, second, third = jax.random.split(key, 3)
    space = RotationTargets()

    def head(head_key: jax.Array) -> PReluHead:
        return PReluHead((INPUTS, 16, space.num_outputs), method.dropout, key=head_key)

    covariance_head = None
    if method.learns_covariance:
        covariance_head = PReluHead((INPUTS, 16, space.num_covariance), 0.0, key=third)
    return Network(
        trunk=ResidualLayers(INPUTS, 2, method.dropout, key=first),
        heads=eqx.filter_vmap(head)(jax.random.split(second, method.heads)),
        covariance_head=covariance_head,
    )


def drawn(method: Method, rng: np.random.Generator, shape: tuple[int, ...] = ()) -> Network:
    """Return networks, with leading dimensions, whose weights are from NumPy: the random numbers of
    JAX have to be compiled for each size."""
    structure = eqx.filter_eval_shape(build, method, jax.random.key(0))

    def draw(leaf: jax.ShapeDtypeStruct) -> jax.Array:
        return jnp.asarray(rng.normal(0.0, 0.3, (*shape, *leaf.shape)), leaf.dtype)

    network: Network = jax.tree.map(draw, structure)
    return network


def data(method: Method, seed: int = 0, count: int = 300) -> TrainingData:
    """Rotation vectors with noise as inputs, their quaternions as targets."""
    rng = np.random.default_rng(seed)
    space = RotationTargets()
    phi = rng.uniform(-1.0, 1.0, (count + 20, 3))
    q = np.asarray(space.perturb(jnp.array([1.0, 0.0, 0.0, 0.0]), jnp.asarray(phi)))
    inputs = phi + rng.normal(0.0, 0.02, phi.shape)
    return TrainingData(
        inputs=jnp.asarray(inputs[None, :count], jnp.float32),
        targets=jnp.asarray(methods.head_targets(method, space, q[:count], rng)[None], jnp.float32),
        samples=jnp.asarray(methods.samples(method, count, rng)[None]),
        held_out_inputs=jnp.asarray(inputs[None, count:], jnp.float32),
        held_out_targets=jnp.asarray(q[None, count:], jnp.float32),
    )

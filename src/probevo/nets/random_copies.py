"""Random copies of training data: a camera that turns further, a world that is mirrored.

Both change images in a known way, whatever they show, so that a copy has an exact target. A network
learns from other copies in each epoch. They are made batch by batch where they are used: their
number costs time, but no memory.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from probevo.arrays import FloatArray
from probevo.nets import quaternions
from probevo.nets.flow_field import CELL_PX, FOCAL_PX, mirrored, rotated
from probevo.nets.learning import Augment

FURTHER_SIGMA_RAD = np.radians([0.15, 0.5, 0.15])
"""Standard deviations by which copies are rotated further, about x, y and z."""
FURTHER_SPREAD = 1.0
"""Standard deviation of the logarithm of a random factor on these: many small rotations, few large
ones."""
MAX_FURTHER_RAD = 0.06
"""No axis is rotated more: at a tenth of a second, a turn of 34° a second."""
MAX_CELLS = 8
"""Largest sideways shift of a single image, in cells: a rotation by 10°."""
BATCH = 1024
"""Copies that are made at once where all of them are gone through."""


@dataclass(frozen=True, eq=False)
class RandomCopies:
    """Random copies of N data, the same ones each time that they are gone through."""

    augment: Augment
    inputs: FloatArray
    """Inputs that are copied, [N, …]."""
    targets: FloatArray
    """Target of each input, [N, o]."""
    count: int
    """Copies of each."""
    seed: int

    def __iter__(self) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Return inputs [B, …] and targets [B, o], batch by batch."""
        augment = jax.jit(self.augment)
        keys = iter(jax.random.split(jax.random.key(self.seed), self.count * self._num_batches))
        for _ in range(self.count):
            for first in range(0, len(self.inputs), BATCH):
                rows = slice(first, first + BATCH)
                inputs = jnp.asarray(self.inputs[rows], jnp.float32)
                targets = jnp.asarray(self.targets[rows, None], jnp.float32)
                copies, copied_targets = augment(inputs, targets, next(keys))
                yield np.asarray(copies), np.asarray(copied_targets[:, 0], np.float64)

    @property
    def _num_batches(self) -> int:
        return -(-len(self.inputs) // BATCH)


def turned_pairs(
    fields: jax.Array, q_curr_prev: jax.Array, key: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Return pairs of images as if the camera had turned further, half of them mirrored.

    Args:
        fields: as ``flow_field`` gives them, [B, 4, rows, columns].
        q_curr_prev: their rotations, unit quaternions, [B, H, 4].
        key: of the rotations, and of which are mirrored.
    """
    mirror_key, factor_key, turn_key = jax.random.split(key, 3)
    count = len(fields)
    # Mirrored, a rotation (φ_x, φ_y, φ_z) is (φ_x, −φ_y, −φ_z).
    is_mirrored = jax.random.bernoulli(mirror_key, 0.5, (count, 1, 1))
    fields = jnp.where(is_mirrored[..., None], mirrored(fields), fields)
    sign = jnp.array([1.0, 1.0, -1.0, -1.0])
    q_curr_prev = jnp.where(is_mirrored, sign * q_curr_prev, q_curr_prev)
    # C' = C C_curr_prev: the copy has turned by C after the step.
    factor = jnp.exp(FURTHER_SPREAD * jax.random.normal(factor_key, (count, 1)))
    further = factor * FURTHER_SIGMA_RAD * jax.random.normal(turn_key, (count, 3))
    q = quaternions.exp(jnp.clip(further, -MAX_FURTHER_RAD, MAX_FURTHER_RAD))
    axes = jnp.eye(3)[None]
    C = jnp.moveaxis(quaternions.rotate(q[:, None], axes), 1, 2)
    return rotated(fields, C), quaternions.product(q[:, None], q_curr_prev)


def turned_views(
    fields: jax.Array, directions: jax.Array, key: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Return single images as if the camera had looked aside, half of them mirrored.

    A camera that turns about its vertical axis sees a distant street moved sideways, and the sun
    turned by the same angle. Columns that come into view repeat the last one.

    Args:
        fields: as ``sun_field`` gives them, [B, 4, rows, columns].
        directions: towards the sun in the camera, unit vectors, [B, H, 3].
        key: of the angles, and of which are mirrored.
    """
    mirror_key, turn_key = jax.random.split(key)
    count, _, _, num_columns = fields.shape
    # Channel 2 is the gradient along x, which changes its sign as x does.
    flipped = fields[..., ::-1] * jnp.array([1.0, 1.0, -1.0, 1.0])[:, None, None]
    is_mirrored = jax.random.bernoulli(mirror_key, 0.5, (count, 1, 1))
    fields = jnp.where(is_mirrored[..., None], flipped, fields)
    directions = jnp.where(is_mirrored, jnp.array([-1.0, 1.0, 1.0]) * directions, directions)
    # Content that moves to larger x has a camera that turns to the left: the sun turns about +y,
    # from z to x.
    cells = jax.random.randint(turn_key, (count,), -MAX_CELLS, MAX_CELLS + 1)
    columns = jnp.clip(jnp.arange(num_columns) - cells[:, None], 0, num_columns - 1)
    moved = jnp.take_along_axis(fields, columns[:, None, None], axis=-1)
    angles = jnp.arctan(cells * CELL_PX / FOCAL_PX)[:, None]
    x, y, z = jnp.moveaxis(directions, -1, 0)
    cosine = jnp.cos(angles)
    sine = jnp.sin(angles)
    turned = jnp.stack([cosine * x + sine * z, y, cosine * z - sine * x], axis=-1)
    return moved, turned

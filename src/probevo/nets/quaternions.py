"""Unit quaternions in JAX, [..., 4], scalar first: q and −q are the same rotation.

All functions are batched over leading dimensions, and their derivatives are finite everywhere but
at a rotation by π, where the logarithm jumps.
"""

from __future__ import annotations

from math import factorial

import jax
import jax.numpy as jnp

TERMS = 24
"""Terms of each series. Up to an angle of 2π, the first omitted term is below 1e-17."""
SMALL_SQ = 1e-8
"""sin²(θ/2) up to which the logarithm is a series; what it omits is below 1e-17."""
MIN_LENGTH_SQ = 1e-12
"""Added to a squared length before a vector is divided by it."""


def stumpff(order: int, angle_sq: jax.Array) -> jax.Array:
    """Return the Stumpff function c_n = Σ_k (−1)^k θ^{2k} / (2k + n)!.

    Args:
        order: n.
        angle_sq: θ², [...], rad²; accurate up to θ = 2π.
    """
    # Horner's rule needs no case distinction, and so gives no NaN in derivatives.
    total = jnp.zeros_like(angle_sq)
    for k in reversed(range(TERMS)):
        total = total * angle_sq + (-1) ** k / factorial(2 * k + order)
    return total


def normalized(vectors: jax.Array) -> jax.Array:
    """Return vectors, [..., 4], divided by their lengths; a vector of zeros stays one."""
    length_sq = jnp.sum(vectors**2, axis=-1, keepdims=True)
    return vectors * jax.lax.rsqrt(length_sq + MIN_LENGTH_SQ)


def exp(phi: jax.Array) -> jax.Array:
    """Return q = Exp(φ), [..., 4], of rotation vectors [..., 3], rad."""
    # (cos θ/2, sin θ/2 · φ/θ): c₀ of (θ/2)² is the cosine, and c₁ the sine over its argument.
    half_sq = jnp.sum(phi**2, axis=-1, keepdims=True) / 4.0
    scalar = stumpff(0, half_sq)
    vector = 0.5 * stumpff(1, half_sq) * phi
    return jnp.concatenate([scalar, vector], axis=-1)


def log(q: jax.Array) -> jax.Array:
    """Return φ = Log(q), [..., 3], rad, the shorter of the two: the same for q and −q."""
    positive = jnp.where(q[..., :1] < 0.0, -q, q)
    scalar = positive[..., :1]
    vector = positive[..., 1:]
    sine_sq = jnp.sum(vector**2, axis=-1, keepdims=True)
    is_small = sine_sq < SMALL_SQ

    # φ = 2 atan2(s, w)/s · vector, with s = sin θ/2 its length and w = cos θ/2. Near s = 0 it is
    # 2/w (1 − s²/(3 w²)) · vector. Each case gets arguments for which its derivative is finite,
    # also where it is not chosen.
    scalar_near_one = jnp.where(is_small, scalar, 1.0)
    series = 2.0 / scalar_near_one * (1.0 - sine_sq / (3.0 * scalar_near_one**2))
    sine = jnp.sqrt(jnp.where(is_small, 1.0, sine_sq))
    closed_form = 2.0 * jnp.arctan2(sine, scalar) / sine
    return jnp.where(is_small, series, closed_form) * vector


def product(p: jax.Array, q: jax.Array) -> jax.Array:
    """Return p ⊗ q, [..., 4]: the rotation q, and then p."""
    p_0, p_1, p_2, p_3 = (p[..., k] for k in range(4))
    q_0, q_1, q_2, q_3 = (q[..., k] for k in range(4))
    parts = [
        p_0 * q_0 - p_1 * q_1 - p_2 * q_2 - p_3 * q_3,
        p_0 * q_1 + p_1 * q_0 + p_2 * q_3 - p_3 * q_2,
        p_0 * q_2 - p_1 * q_3 + p_2 * q_0 + p_3 * q_1,
        p_0 * q_3 + p_1 * q_2 - p_2 * q_1 + p_3 * q_0,
    ]
    return jnp.stack(parts, axis=-1)


def inverse(q: jax.Array) -> jax.Array:
    """Return q⁻¹ of unit quaternions, [..., 4]."""
    return jnp.concatenate([q[..., :1], -q[..., 1:]], axis=-1)


def rotate(q: jax.Array, points: jax.Array) -> jax.Array:
    """Return the points C(q) p, [..., 3]."""
    scalar = q[..., :1]
    vector = q[..., 1:]
    # C(q) p = p + 2 w (v × p) + 2 v × (v × p) of q = (w, v)
    twice = 2.0 * jnp.cross(vector, points)
    return points + scalar * twice + jnp.cross(vector, twice)


def mean(quaternions: jax.Array) -> jax.Array:
    """Return the mean of H quaternions each, [..., H, 4] to [..., 4]; w ≥ 0.

    It is the eigenvector of Σ q qᵀ with the largest eigenvalue (Markley et al. 2007), which
    minimises the sum of squared chordal distances between rotations, and takes q and −q as the
    same.
    """
    outer = jnp.einsum("...hi,...hj->...ij", quaternions, quaternions)
    vectors = jnp.linalg.eigh(outer)[1]
    largest = vectors[..., -1]
    return jnp.where(largest[..., :1] < 0.0, -largest, largest)

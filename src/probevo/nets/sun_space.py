"""The direction of the sun as what a network regresses: a unit vector, with errors in two angles.

The error of u is Bᵀ Log_p(u) in the tangent plane at the true direction p, along its azimuth and
zenith angle, as the residual of ``measurements.direction.Direction``.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from probevo.arrays import AnyArray, FloatArray
from probevo.nets.triangular_covariance import TriangularCovariance

MIN_SIGMA_RAD = 0.01
MAX_SIGMA_RAD = 2.0
"""Standard deviations before the axes are mixed lie between these two."""
FIRST_SIGMA_RAD = 0.5
"""Standard deviation that an output of zero stands for."""
COVARIANCE = TriangularCovariance(
    dof=2, least=MIN_SIGMA_RAD, most=MAX_SIGMA_RAD, first=FIRST_SIGMA_RAD
)
MIN_LENGTH = 1e-9
"""Added to squared lengths, which may be zero where there is no error."""
MIN_LEVEL_SQ = 1e-24
"""Squared sine of the zenith angle below which a direction has no azimuth."""


@dataclass(frozen=True)
class SunTargets:
    """Unit vectors in the camera."""

    num_outputs = 3
    size = 3
    dof = 2
    num_covariance = 3
    least_variance = MIN_SIGMA_RAD**2

    def estimate(self, outputs: jax.Array) -> jax.Array:
        """Return the outputs as unit vectors."""
        return _unit(outputs)

    def difference(self, estimates: jax.Array, targets: jax.Array) -> jax.Array:
        """Return the errors along azimuth and zenith angle, [..., 2], rad."""
        x = targets[..., 0]
        y = targets[..., 1]
        z = targets[..., 2]
        sine, cosine, level = _azimuth(x, z)
        u = estimates[..., 0]
        v = estimates[..., 1]
        w = estimates[..., 2]
        # Parts of the estimate along the tangent vectors at p = (x, y, z), y down: (z, 0, −x)/level
        # of the azimuth, and (−y x/level, level, −y z/level) of the zenith angle.
        azimuth_part = cosine * u - sine * w
        zenith_part = -y * sine * u + level * v - y * cosine * w
        across = jnp.sqrt(azimuth_part**2 + zenith_part**2 + MIN_LENGTH)
        along = u * x + v * y + w * z
        # Log: the angle between both, along the direction of the tangential part
        factor = jnp.arctan2(across, along) / across
        errors = jnp.stack([factor * azimuth_part, factor * zenith_part], axis=-1)
        # The opposite direction is off by π in any direction: choose one.
        is_opposite = (azimuth_part**2 + zenith_part**2 < MIN_LENGTH) & (along < 0.0)
        return jnp.where(is_opposite[..., None], jnp.array([jnp.pi, 0.0]), errors)

    def perturb(self, targets: jax.Array, errors: jax.Array) -> jax.Array:
        """Return the directions moved by errors along azimuth and zenith angle, to first order."""
        x = targets[..., 0]
        y = targets[..., 1]
        z = targets[..., 2]
        sine, cosine, level = _azimuth(x, z)
        azimuth = errors[..., 0]
        zenith = errors[..., 1]
        moved = [
            x + azimuth * cosine - zenith * y * sine,
            y + zenith * level,
            z - azimuth * sine - zenith * y * cosine,
        ]
        return _unit(jnp.stack(moved, axis=-1))

    def mean(self, estimates: jax.Array) -> jax.Array:
        """Return the direction of the mean vector."""
        return _unit(jnp.mean(estimates, axis=-2))

    def squared(self, errors: jax.Array) -> jax.Array:
        """Return the squared chord between estimate and truth, which is bounded by 4."""
        return 2.0 - 2.0 * jnp.cos(jnp.sqrt(jnp.sum(errors**2, axis=-1) + MIN_LENGTH))

    def whiten(self, raw: jax.Array, errors: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Return the errors in units of their σ, and ½ ln |Σ|, as ``TriangularCovariance`` does.

        Their sum, the loss, teaches the covariance alone. The estimate learns from the squared
        chord between it and the truth, as in Sun-BCNN: by the likelihood, the images that show
        least of the sun, and are off by up to 180°, would weigh most at first. What is added for
        that to the second result has a derivative, but is zero.
        """
        chord_sq = self.squared(errors)
        estimate_loss = 0.5 * (chord_sq - jax.lax.stop_gradient(chord_sq)) / FIRST_SIGMA_RAD**2
        whitened, half_log_det = COVARIANCE.whiten(raw, jax.lax.stop_gradient(errors))
        return whitened, half_log_det + estimate_loss

    def covariance(self, raw: AnyArray) -> FloatArray:
        """Return Σ, [..., 2, 2], rad²."""
        return COVARIANCE.covariance(raw)


def _azimuth(x: jax.Array, z: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return sine and cosine of the azimuth of unit vectors, and the sine of their zenith angle.

    Straight up and straight down the azimuth is zero, as in ``measurements.direction``.
    """
    level_sq = x**2 + z**2
    has_azimuth = level_sq > MIN_LEVEL_SQ
    # The root of a number other than zero also where it is not used: its derivative is finite.
    level = jnp.sqrt(jnp.where(has_azimuth, level_sq, 1.0))
    return (
        jnp.where(has_azimuth, x / level, 0.0),
        jnp.where(has_azimuth, z / level, 1.0),
        jnp.where(has_azimuth, level, 0.0),
    )


def _unit(vectors: jax.Array) -> jax.Array:
    """Return vectors, [..., 3], divided by their lengths."""
    return vectors * jax.lax.rsqrt(jnp.sum(vectors**2, axis=-1, keepdims=True) + MIN_LENGTH)

"""Pose corrections in JAX: the loss ½ gᵀ Σ⁻¹ g over SE(3) of DPC-Net, with its Jacobian.

A network estimates the correction T_corr = T_true T_est⁻¹ of another estimator's motion as
ξ = [ρ; φ], [6], m and rad. Its error is g = Log(Exp(ξ) T*⁻¹), with T* = Exp(ξ*) the true one.

With the left Jacobian J, Exp(ξ + δ) ≈ Exp(J(ξ) δ) Exp(ξ). So Exp(ξ + δ) T*⁻¹ ≈ Exp(J(ξ) δ) Exp(g),
whose logarithm is g + J(g)⁻¹ J(ξ) δ. The derivative of the loss with respect to ξ is therefore
gᵀ Σ⁻¹ J(g)⁻¹ J(ξ); ``correction_loss`` has it as its own.

The training uses ``correction_error`` alone (``CorrectionTargets.difference``), and differentiates
it automatically: the same gradient, in 0.6 to 0.7 of the time on a CPU. What is derived here checks
that in the tests.
"""

from __future__ import annotations

from math import factorial

import jax
import jax.numpy as jnp

from probevo.nets import quaternions
from probevo.nets.quaternions import TERMS, entire_series, stumpff


def wedge(phi: jax.Array) -> jax.Array:
    """Return φ^, [3, 3], the skew-symmetric matrix with φ^ p = φ × p."""
    return jnp.cross(phi[None, :], jnp.eye(3, dtype=phi.dtype)).T


def rotation_jacobian(phi: jax.Array) -> jax.Array:
    """Return the left Jacobian of SO(3), [3, 3] (thesis eq. 2.15)."""
    angle_sq = phi @ phi
    phi_wedge = wedge(phi)
    linear = stumpff(2, angle_sq) * phi_wedge
    return jnp.eye(3, dtype=phi.dtype) + linear + stumpff(3, angle_sq) * phi_wedge @ phi_wedge


def pose_jacobian(xi: jax.Array) -> jax.Array:
    """Return the left Jacobian of SE(3), [6, 6], Σ_n ad(ξ)^n / (n + 1)! (Barfoot 2017 eq. 7.86).

    Since ad⁵ = −2 θ² ad³ − θ⁴ ad, powers up to the fourth remain. Their coefficients are power
    series in θ²: of (4 − θ sin θ − 4 cos θ) / (2 θ²), (4 θ − 5 sin θ + θ cos θ) / (2 θ³),
    (2 − θ sin θ − 2 cos θ) / (2 θ⁴) and (2 θ − 3 sin θ + θ cos θ) / (2 θ⁵).
    """
    ad = _adjoint(xi)
    angle_sq = xi[3:] @ xi[3:]
    # J = 1 + Σ aₙ(θ²) ad(ξ)ⁿ, n = 1 … 4
    power = jnp.eye(6, dtype=xi.dtype)
    jacobian = power
    for coefficients in _ADJOINT_SERIES:
        power = power @ ad
        jacobian = jacobian + entire_series(coefficients, angle_sq) * power
    return jacobian


def correction_error(xi: jax.Array, xi_true: jax.Array) -> jax.Array:
    """Return g = Log(Exp(ξ) Exp(ξ*)⁻¹), [6], of tangent vectors [6], m and rad."""
    # Exp(ξ) T*⁻¹ has the rotation C C*ᵀ and the translation t − C C*ᵀ t*, with t = J(φ) ρ; its
    # logarithm inverts the last relation.
    q_error = quaternions.product(quaternions.exp(xi[3:]), _inverse_rotation(xi_true))
    t = rotation_jacobian(xi[3:]) @ xi[:3]
    t_true = rotation_jacobian(xi_true[3:]) @ xi_true[:3]
    t_error = t - quaternions.rotate(q_error, t_true)
    phi_error = quaternions.log(q_error)
    rho_error = jnp.linalg.solve(rotation_jacobian(phi_error), t_error)
    return jnp.concatenate([rho_error, phi_error])


@jax.custom_vjp
def correction_loss(xi: jax.Array, xi_true: jax.Array, information: jax.Array) -> jax.Array:
    """Return ½ gᵀ Σ⁻¹ g; only its derivative with respect to ξ is defined.

    Args:
        xi: estimated correction, [6], m and rad.
        xi_true: true correction, [6].
        information: Σ⁻¹, [6, 6], of the training set's corrections.
    """
    error = correction_error(xi, xi_true)
    return 0.5 * error @ information @ error


def correction_gradient(xi: jax.Array, xi_true: jax.Array, information: jax.Array) -> jax.Array:
    """Return gᵀ Σ⁻¹ J(g)⁻¹ J(ξ), [6], the derivative of the loss with respect to ξ."""
    error = correction_error(xi, xi_true)
    weighted = information @ error
    # J(g)⁻ᵀ Σ⁻¹ g by a solve, then the row vector times J(ξ)
    by_error = jnp.linalg.solve(pose_jacobian(error).T, weighted)
    gradient: jax.Array = by_error @ pose_jacobian(xi)
    return gradient


def _forward(
    xi: jax.Array, xi_true: jax.Array, information: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Return the loss, and its gradient to keep for the backward pass."""
    gradient = correction_gradient(xi, xi_true, information)
    return correction_loss(xi, xi_true, information), gradient


def _backward(gradient: jax.Array, cotangent: jax.Array) -> tuple[jax.Array, None, None]:
    """Return the derivatives with respect to the three arguments; targets are constants."""
    return cotangent * gradient, None, None


correction_loss.defvjp(_forward, _backward)


def _inverse_rotation(xi: jax.Array) -> jax.Array:
    return quaternions.inverse(quaternions.exp(xi[3:]))


def _adjoint(xi: jax.Array) -> jax.Array:
    """Return ad(ξ) = [[φ^, ρ^], [0, φ^]], [6, 6]."""
    phi_wedge = wedge(xi[3:])
    zeros = jnp.zeros_like(phi_wedge)
    return jnp.block([[phi_wedge, wedge(xi[:3])], [zeros, phi_wedge]])


def _series(first: int, offset: int, odd: int) -> tuple[float, ...]:
    """Return the coefficients ½ (−1)^k (2k − offset) / (2k + odd)! for k from ``first`` on."""
    return tuple(
        0.5 * (-1) ** k * (2 * k - offset) / factorial(2 * k + odd)
        for k in range(first, first + TERMS)
    )


_ADJOINT_SERIES = (
    _series(1, offset=4, odd=0),
    _series(1, offset=4, odd=1),
    _series(2, offset=2, odd=0),
    _series(2, offset=2, odd=1),
)
"""Coefficients of θ^{2j} in those of ad, ad², ad³ and ad⁴."""

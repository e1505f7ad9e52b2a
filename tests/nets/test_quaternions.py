"""Quaternions in JAX: SciPy's rotations, one rotation for q and −q, the mean."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

jax = pytest.importorskip("jax", reason="jax is missing: pip install 'probevo[nets]'")
pytest.importorskip("equinox")

from probevo.nets import quaternions  # noqa: E402

ANGLES = (0.0, 1e-9, 1e-5, 1e-4, 0.3, 2.0, 3.1)


def rotation_vectors(angle_rad: float, count: int = 40) -> np.ndarray:
    axes = np.random.default_rng(3).normal(size=(count, 3))
    return angle_rad * axes / np.linalg.norm(axes, axis=1, keepdims=True)


@pytest.mark.parametrize("angle_rad", ANGLES)
def test_log_is_the_inverse_of_exp(angle_rad: float) -> None:
    phi = rotation_vectors(angle_rad)
    with jax.enable_x64(True):
        q = quaternions.exp(phi)
        expected = Rotation.from_rotvec(phi).as_quat(scalar_first=True)
        assert np.abs(np.sum(np.asarray(q) * expected, axis=1)) == pytest.approx(1.0, abs=1e-14)
        assert np.asarray(quaternions.log(q)) == pytest.approx(phi, rel=1e-11, abs=1e-14)


@pytest.mark.parametrize("angle_rad", ANGLES)
def test_a_quaternion_and_its_negative_have_one_logarithm(angle_rad: float) -> None:
    with jax.enable_x64(True):
        q = quaternions.exp(rotation_vectors(angle_rad))
        assert np.array_equal(quaternions.log(q), quaternions.log(-q))


def test_product_inverse_and_rotate_are_those_of_scipy() -> None:
    rng = np.random.default_rng(0)
    first = Rotation.random(30, rng=rng)
    second = Rotation.random(30, rng=rng)
    points = rng.normal(size=(30, 3))
    with jax.enable_x64(True):
        p = jax.numpy.asarray(first.as_quat(scalar_first=True))
        q = jax.numpy.asarray(second.as_quat(scalar_first=True))
        both = quaternions.log(quaternions.product(p, quaternions.inverse(q)))
        assert np.asarray(both) == pytest.approx((first * second.inv()).as_rotvec(), abs=1e-13)
        moved = np.asarray(quaternions.rotate(p, points))
        assert moved == pytest.approx(first.apply(points), abs=1e-13)


def test_the_derivative_of_the_logarithm_is_finite_at_the_identity() -> None:
    """Log(Exp(φ)) is φ, whose derivative is 1, also where closed forms divide by zero."""
    with jax.enable_x64(True):
        jacobian_of = jax.jit(jax.jacobian(lambda x: quaternions.log(quaternions.exp(x))))
        for angle_rad in ANGLES:
            phi = rotation_vectors(angle_rad, count=1)[0]
            assert np.asarray(jacobian_of(phi)) == pytest.approx(np.eye(3), abs=1e-9)


def test_the_mean_does_not_depend_on_signs() -> None:
    rng = np.random.default_rng(5)
    found = Rotation.from_rotvec(rng.normal(0.0, 0.3, (25, 3))) * Rotation.random(rng=rng)
    q = found.as_quat(scalar_first=True)
    signs = rng.choice([-1.0, 1.0], (25, 1))
    with jax.enable_x64(True):
        mean = np.asarray(quaternions.mean(jax.numpy.asarray(q)))
        assert np.asarray(quaternions.mean(jax.numpy.asarray(signs * q))) == pytest.approx(mean)
    # SciPy's mean minimises the same sum of squared chordal distances.
    difference = Rotation.from_quat(mean, scalar_first=True) * found.mean().inv()
    assert difference.magnitude() < 1e-7


def test_the_mean_of_equal_rotations_is_that_rotation() -> None:
    q = Rotation.from_rotvec([0.4, -1.0, 2.0]).as_quat(scalar_first=True)
    with jax.enable_x64(True):
        repeated = jax.numpy.tile(jax.numpy.asarray(q), (7, 1))
        mean = np.asarray(quaternions.mean(repeated))
    assert np.abs(mean @ q) == pytest.approx(1.0, abs=1e-14)

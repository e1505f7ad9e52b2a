from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from probevo.arrays import FloatArray
from probevo.geometry import so3

STEPS = 1e-6 * np.eye(3)


def relative_error(actual: FloatArray, expected: FloatArray) -> float:
    return float(
        np.max(
            np.linalg.norm(actual - expected, axis=(1, 2)) / np.linalg.norm(expected, axis=(1, 2))
        )
    )


def test_wedge_is_the_cross_product(rotation_vectors: FloatArray) -> None:
    p = np.array([1.0, -2.0, 0.5])
    np.testing.assert_allclose(
        so3.wedge(rotation_vectors) @ p, np.cross(rotation_vectors, p), atol=1e-14
    )


def test_exp_is_the_matrix_exponential(rotation_vectors: FloatArray) -> None:
    np.testing.assert_allclose(
        so3.exp(rotation_vectors), expm(so3.wedge(rotation_vectors)), atol=1e-13
    )


def test_exp_yields_rotations(rotation_vectors: FloatArray) -> None:
    C = so3.exp(rotation_vectors)
    np.testing.assert_allclose(C @ C.mT, np.broadcast_to(np.eye(3), C.shape), atol=1e-14)
    np.testing.assert_allclose(np.linalg.det(C), 1.0, atol=1e-14)


def test_exp_of_minus_phi_is_the_inverse(rotation_vectors: FloatArray) -> None:
    np.testing.assert_allclose(so3.exp(-rotation_vectors), so3.exp(rotation_vectors).mT, atol=1e-15)


def test_log_inverts_exp(rotation_vectors: FloatArray) -> None:
    """To 1e-12 of the angle, however small."""
    error = np.linalg.norm(so3.log(so3.exp(rotation_vectors)) - rotation_vectors, axis=1)
    assert np.all(error <= 1e-12 * np.linalg.norm(rotation_vectors, axis=1))


def test_exp_inverts_log_beyond_pi(rotation_vectors: FloatArray) -> None:
    """Exp(Log(C)) = C for every C, also where φ itself, up to 3π here, is not the shortest; and at
    π exactly."""
    C = np.concatenate(
        [
            so3.exp(3.0 * rotation_vectors),
            so3.exp(np.pi * np.eye(3)),
            np.diag([-1.0, 1.0, -1.0])[None],
        ]
    )
    np.testing.assert_allclose(so3.exp(so3.log(C)), C, atol=1e-12)


def test_log_of_an_unknown_rotation_is_nan() -> None:
    assert np.isnan(so3.log(np.full((2, 3, 3), np.nan))).all()


def test_left_jacobian_against_central_differences(rotation_vectors: FloatArray) -> None:
    """Exp(φ + h) Exp(φ − h)⁻¹ = Exp(2 J h), thesis eq. (2.20)."""
    phi = rotation_vectors[:, None, :]
    differences = so3.log(so3.exp(phi + STEPS) @ so3.exp(phi - STEPS).mT) / 2e-6
    assert relative_error(so3.left_jacobian(rotation_vectors), differences.mT) < 1e-6


def test_the_rotation_is_its_own_adjoint(rotation_vectors: FloatArray) -> None:
    """Exp(Cφ) = C Exp(φ) Cᵀ."""
    C = so3.exp(rotation_vectors)
    phi = rotation_vectors[::-1]
    np.testing.assert_allclose(
        so3.exp((C @ phi[..., None])[..., 0]), C @ so3.exp(phi) @ C.mT, atol=1e-14
    )


def test_batches_of_any_shape() -> None:
    phi = np.random.default_rng(2).normal(size=(2, 0, 5, 3))
    for function in (so3.exp, so3.wedge, so3.left_jacobian):
        assert function(phi).shape == (2, 0, 5, 3, 3)
    assert so3.log(so3.exp(phi)).shape == phi.shape


@pytest.mark.parametrize("dtype", [np.float16, np.longdouble, np.int8, bool])
def test_a_rotation_may_be_of_any_type_of_number(dtype: type) -> None:
    C = np.eye(3)[[1, 2, 0]]
    checked = so3.check_rotation(C.astype(dtype), "C")
    assert checked.dtype == np.float64
    np.testing.assert_array_equal(checked, C)

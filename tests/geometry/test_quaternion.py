from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.geometry import quaternion, so3

IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])


def test_exp_is_of_unit_length_scalar_first(rotation_vectors: FloatArray) -> None:
    """Thesis eq. (2.8)."""
    q = quaternion.exp(rotation_vectors)
    np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1.0, atol=1e-15)
    np.testing.assert_allclose(q[:, 0], np.cos(np.linalg.norm(rotation_vectors, axis=1) / 2.0), atol=1e-15)


def test_log_inverts_exp_on_both_covers(rotation_vectors: FloatArray) -> None:
    q = quaternion.exp(rotation_vectors)
    np.testing.assert_allclose(quaternion.log(q), rotation_vectors, rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(quaternion.log(-q), rotation_vectors, rtol=1e-12, atol=1e-14)


def test_exp_inverts_log_up_to_sign(rotation_vectors: FloatArray) -> None:
    q = quaternion.exp(3.0 * rotation_vectors)
    again = quaternion.exp(quaternion.log(q))
    np.testing.assert_allclose(np.abs(np.sum(q * again, axis=1)), 1.0, atol=1e-12)


def test_exp_and_log_agree_with_those_of_matrices(rotation_vectors: FloatArray) -> None:
    q, C = quaternion.exp(rotation_vectors), so3.exp(rotation_vectors)
    np.testing.assert_allclose(quaternion.to_matrix(q), C, atol=1e-14)
    np.testing.assert_allclose(quaternion.log(q), so3.log(C), atol=1e-12)


def test_from_matrix_inverts_to_matrix_with_positive_scalar(rotation_vectors: FloatArray) -> None:
    q = quaternion.exp(rotation_vectors)  # w ≥ 0, as the angles are below π
    np.testing.assert_allclose(quaternion.from_matrix(quaternion.to_matrix(-q)), q, atol=1e-14)


def test_group_axioms(rotation_vectors: FloatArray) -> None:
    p, q, r = np.split(quaternion.exp(rotation_vectors[:999]), 3)
    product, inverse = quaternion.product, quaternion.inverse
    np.testing.assert_allclose(product(product(p, q), r), product(p, product(q, r)), atol=1e-15)
    np.testing.assert_allclose(product(IDENTITY, p), p)
    np.testing.assert_allclose(product(p, IDENTITY), p)
    np.testing.assert_allclose(product(p, inverse(p)), np.broadcast_to(IDENTITY, p.shape), atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(product(p, q), axis=1), 1.0, atol=1e-15)


def test_product_composes_as_matrices_do(rotation_vectors: FloatArray) -> None:
    p, q = np.split(quaternion.exp(rotation_vectors), 2)
    composed = quaternion.to_matrix(p) @ quaternion.to_matrix(q)
    np.testing.assert_allclose(quaternion.to_matrix(quaternion.product(p, q)), composed, atol=1e-14)

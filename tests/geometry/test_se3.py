from __future__ import annotations

import numpy as np
from scipy.linalg import expm

from probevo.arrays import FloatArray
from probevo.geometry import se3, so3

STEPS = 1e-6 * np.eye(6)


def relative_error(actual: FloatArray, expected: FloatArray) -> float:
    return float(
        np.max(
            np.linalg.norm(actual - expected, axis=(1, 2)) / np.linalg.norm(expected, axis=(1, 2))
        )
    )


def wedge(xi: FloatArray) -> FloatArray:
    """ξ^ = [[φ^, ρ], [0, 0]]: [..., 6] to [..., 4, 4] (thesis eq. 2.13)."""
    matrix = np.zeros((*xi.shape[:-1], 4, 4))
    matrix[..., :3, :3] = so3.wedge(xi[..., 3:])
    matrix[..., :3, 3] = xi[..., :3]
    return matrix


def test_exp_is_the_matrix_exponential(twists: FloatArray) -> None:
    np.testing.assert_allclose(se3.exp(twists), expm(wedge(twists)), atol=1e-12)


def test_log_inverts_exp(twists: FloatArray) -> None:
    np.testing.assert_allclose(se3.log(se3.exp(twists)), twists, rtol=1e-12, atol=1e-13)


def test_exp_inverts_log_beyond_pi(twists: FloatArray) -> None:
    """Exp(Log(T)) = T for every T, the half turn among them."""
    half_turn = se3.from_parts(np.diag([1.0, -1.0, -1.0]), np.array([[1.0, 2.0, 3.0]]))
    T = np.concatenate([se3.exp(3.0 * twists), half_turn])
    np.testing.assert_allclose(se3.exp(se3.log(T)), T, rtol=1e-12, atol=1e-12)


def test_log_of_an_unknown_pose_is_nan() -> None:
    assert np.isnan(se3.log(np.full((2, 4, 4), np.nan))).all()


def test_group_axioms(twists: FloatArray) -> None:
    T = se3.exp(twists)
    identity = np.broadcast_to(np.eye(4), T.shape)
    np.testing.assert_allclose(se3.inverse(T) @ T, identity, atol=1e-13)
    np.testing.assert_allclose(T @ se3.inverse(T), identity, atol=1e-13)
    np.testing.assert_allclose(se3.exp(-twists), se3.inverse(T), atol=1e-13)
    np.testing.assert_array_equal(se3.exp(np.zeros(6)), np.eye(4))


def test_transforms_compose(twists: FloatArray) -> None:
    T_b_a, T_c_b = np.split(se3.exp(twists), 2)
    points_a = np.random.default_rng(2).normal(size=(500, 3))
    points_c = se3.transform(T_c_b, se3.transform(T_b_a, points_a))
    np.testing.assert_allclose(se3.transform(T_c_b @ T_b_a, points_a), points_c, atol=1e-13)


def test_transform_moves_all_points_by_one_pose() -> None:
    T_b_a = se3.from_parts(
        np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), np.array([1.0, 2.0, 3.0])
    )
    np.testing.assert_allclose(
        se3.transform(T_b_a, np.eye(3)), [[1.0, 3.0, 3.0], [0.0, 2.0, 3.0], [1.0, 2.0, 4.0]]
    )


def test_adjoint_against_central_differences(twists: FloatArray) -> None:
    """T Exp(±h) T⁻¹ = Exp(±Ad(T) h)."""
    T = se3.exp(twists)[:, None]
    differences = (
        se3.log(T @ se3.exp(STEPS) @ se3.inverse(T)) - se3.log(T @ se3.exp(-STEPS) @ se3.inverse(T))
    ) / 2e-6
    assert relative_error(se3.adjoint(T[:, 0]), differences.mT) < 1e-6


def test_left_jacobian_against_central_differences(twists: FloatArray) -> None:
    """Exp(ξ ± h) Exp(ξ)⁻¹ ≈ Exp(±J h); within 3 rad, where the logarithm is smooth."""
    xi = twists[::10][:, None]
    xi = xi[np.linalg.norm(xi[..., 3:], axis=-1)[:, 0] < 3.0]
    back = se3.inverse(se3.exp(xi))
    ahead = se3.log(se3.exp(xi + STEPS) @ back)
    behind = se3.log(se3.exp(xi - STEPS) @ back)
    assert relative_error(se3.left_jacobian(xi[:, 0]), ((ahead - behind) / 2e-6).mT) < 1e-6


def test_batches_of_any_shape() -> None:
    xi = np.random.default_rng(2).normal(size=(2, 0, 5, 6))
    assert se3.adjoint(se3.exp(xi)).shape == (2, 0, 5, 6, 6)
    assert se3.log(se3.inverse(se3.exp(xi))).shape == xi.shape

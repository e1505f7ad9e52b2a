"""The closed-form motion: exact on exact points, least squares on noisy ones."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from probevo.arrays import FloatArray
from probevo.geometry import se3, so3
from probevo.motion.direct import direct_motion


def scenes(num_scenes: int, num_points: int, sigma_m: float = 0.0) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Points in the previous and current frames, [S, N, 3] each, and the motions between, [S, 4, 4]."""
    rng = np.random.default_rng(0)
    T = se3.exp(rng.normal(scale=[3, 3, 3, 1.5, 1.5, 1.5], size=(num_scenes, 6)))
    prev = rng.normal(scale=10.0, size=(num_scenes, num_points, 3))
    curr = se3.transform(T[:, None], prev)
    return prev, curr + sigma_m * rng.normal(size=curr.shape), T


@pytest.mark.parametrize("num_points", [3, 4, 100])
def test_exact_points_give_the_exact_motion(num_points: int) -> None:
    """Three points too, whose centred coordinates span a plane only, and rotations up to π."""
    prev, curr, T = scenes(1000, num_points)
    np.testing.assert_allclose(direct_motion(prev, curr), T, atol=1e-9)


@pytest.mark.parametrize("num_points", [1, 5])
def test_known_rotation_needs_one_point(num_points: int) -> None:
    prev, curr, T = scenes(100, num_points)
    np.testing.assert_allclose(direct_motion(prev, curr, T[:, :3, :3]), T, atol=1e-12)


def test_translation_is_that_of_probe() -> None:
    """r_a^ba = −Cᵀ u_b + u_a (PROBE eq. 5) is the camera's new place seen from its old frame, −Cᵀ t."""
    prev, curr, T = scenes(1, 50, sigma_m=0.1)
    C = T[0, :3, :3]
    r = -C.T @ curr[0].mean(axis=0) + prev[0].mean(axis=0)
    np.testing.assert_allclose(se3.inverse(direct_motion(prev[0], curr[0], C))[:3, 3], r, atol=1e-12)


def test_noisy_points_give_the_least_squares_rotation() -> None:
    prev, curr, _ = scenes(20, 30, sigma_m=1.0)
    for p, q, C in zip(prev, curr, direct_motion(prev, curr)[:, :3, :3], strict=True):
        expected, _ = Rotation.align_vectors(q - q.mean(axis=0), p - p.mean(axis=0))
        np.testing.assert_allclose(C, expected.as_matrix(), atol=1e-12)


@pytest.mark.parametrize("known_rotation", [False, True])
def test_no_neighbouring_motion_fits_better(known_rotation: bool) -> None:
    prev, curr, T = (array[0] for array in scenes(1, 30, sigma_m=0.5))
    C = T[:3, :3] if known_rotation else None
    best = direct_motion(prev, curr, C)
    nudges = 1e-3 * np.random.default_rng(1).normal(size=(100, 6)) * np.repeat([1.0, not known_rotation], 3)
    costs = np.sum((curr - se3.transform((se3.exp(nudges) @ best)[:, None], prev)) ** 2, axis=(1, 2))
    assert (costs > np.sum((curr - se3.transform(best, prev)) ** 2)).all()


def test_mirrored_points_give_a_rotation() -> None:
    prev, _, _ = scenes(50, 10)
    C = direct_motion(prev, prev * [1.0, 1.0, -1.0])[:, :3, :3]
    np.testing.assert_allclose(np.linalg.det(C), 1.0, rtol=1e-12)
    np.testing.assert_allclose(so3.exp(so3.log(C)), C, atol=1e-12)

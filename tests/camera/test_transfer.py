"""Transfer of observations by a motion: against f(T g(y)) point by point, and at its limits."""

from __future__ import annotations

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.camera.transfer import transfer
from probevo.camera.transfer_numba import NEAREST
from probevo.geometry import se3

CAMERA = StereoCamera(
    fu_px=718.9, fv_px=720.1, cu_px=607.2, cv_px=185.2, baseline_m=0.54, size_px=(1241, 376)
)
T_B_A = se3.exp(np.array([0.1, -0.2, -0.8, 0.02, -0.05, 0.01]))


@pytest.fixture
def pixels() -> FloatArray:
    """Noisy observations of 1,000 points from 2 to 80 m away, [1000, 4]."""
    rng = np.random.default_rng(0)
    z = np.geomspace(2.0, 80.0, 1000)
    points = np.stack(
        [rng.uniform(-0.8, 0.8, 1000) * z, rng.uniform(-0.25, 0.25, 1000) * z, z], axis=1
    )
    return CAMERA.project(points) + rng.uniform(-1.0, 1.0, (1000, 4))


def test_transfer_is_projection_after_motion_after_triangulation(pixels: FloatArray) -> None:
    points_b = se3.transform(T_B_A, CAMERA.triangulate(pixels))
    np.testing.assert_allclose(
        transfer(pixels, T_B_A, CAMERA), CAMERA.project(points_b), rtol=1e-11
    )


def test_transfer_by_the_identity_averages_the_rows(pixels: FloatArray) -> None:
    mean_row = 0.5 * (pixels[:, 1] + pixels[:, 3])
    expected = np.stack([pixels[:, 0], mean_row, pixels[:, 2], mean_row], axis=1)
    np.testing.assert_allclose(transfer(pixels, np.eye(4), CAMERA), expected, atol=1e-10)


def test_transfer_there_and_back_changes_nothing(pixels: FloatArray) -> None:
    pixels[:, 3] = pixels[:, 1]
    there = transfer(pixels, T_B_A, CAMERA)
    np.testing.assert_allclose(transfer(there, se3.inverse(T_B_A), CAMERA), pixels, atol=1e-9)


def test_a_point_at_infinity_is_moved_by_the_rotation_alone() -> None:
    at_infinity = np.array([[CAMERA.cu_px, CAMERA.cv_px, CAMERA.cu_px, CAMERA.cv_px]])
    ray = T_B_A[:3, 2]  # the optical axis, turned
    u = CAMERA.fu_px * ray[0] / ray[2] + CAMERA.cu_px
    v = CAMERA.fv_px * ray[1] / ray[2] + CAMERA.cv_px
    np.testing.assert_allclose(transfer(at_infinity, T_B_A, CAMERA), [[u, v, u, v]], rtol=1e-12)


def test_transfer_is_continuous_through_infinity() -> None:
    """Noise may make a disparity slightly negative."""
    u, v = 700.0, 150.0
    at_infinity = transfer(np.array([[u, v, u, v]]), T_B_A, CAMERA)
    for change_px in (1e-6, -1e-6):
        near = transfer(np.array([[u, v, u + change_px, v]]), T_B_A, CAMERA)
        np.testing.assert_allclose(near, at_infinity, atol=1e-5)


@pytest.mark.parametrize(
    ("ratio", "in_front"),
    [
        (1.0, True),
        (1.1 * NEAREST, True),
        (0.9 * NEAREST, False),
        (0.0, False),
        (-1.0, False),
    ],
)
def test_a_point_is_in_front_by_the_ratio_of_its_depths(ratio: float, in_front: bool) -> None:
    pixels = CAMERA.project(np.array([[1.0, 0.5, 10.0]]))
    forward = se3.from_parts(np.eye(3), np.array([0.0, 0.0, 10.0 * (ratio - 1.0)]))
    assert np.isfinite(transfer(pixels, forward, CAMERA)).all() == in_front


def test_no_points_give_none() -> None:
    assert transfer(np.zeros((0, 4)), T_B_A, CAMERA).shape == (0, 4)

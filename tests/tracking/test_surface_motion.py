"""The motion of windows against that of the planes that they show."""

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.geometry import se3
from probevo.tracking.surface_motion import MIN_SCALED_DEPTH, move_surfaces

CAMERA = StereoCamera(
    fu_px=700.0, fv_px=650.0, cu_px=600.0, cv_px=180.0, baseline_m=0.5, size_px=(1200, 360)
)
T_B_A = se3.exp(np.array([[0.1, -0.05, -1.0, 0.02, 0.03, -0.01]]))[0]
"""One metre forward, with a turn."""
PLANES = {
    "the road": np.array([0.0, 1.0, 0.0, 1.6]),
    "a wall beside it": np.array([1.0, 0.0, 0.0, 4.0]),
    "a wall ahead": np.array([0.0, 0.0, 1.0, 12.0]),
    "a slope": np.array([0.3, 0.6, 0.4, 6.0]),
}
"""(n, c) of the plane n·p = c, m."""


def inverse_depth(pixels: FloatArray, plane: FloatArray) -> FloatArray:
    """1/z of what is seen of a plane at (u, v), [N, 2]: n·(x, y, 1) / c."""
    x, y = CAMERA.normalized(pixels[:, 0], pixels[:, 1])
    found: FloatArray = np.column_stack([x, y, np.ones(len(x))]) @ plane[:3] / plane[3]
    return found


def observed(pixels: FloatArray, plane: FloatArray) -> FloatArray:
    disparity = CAMERA.fu_px * CAMERA.baseline_m * inverse_depth(pixels, plane)
    return np.column_stack([pixels, pixels[:, 0] - disparity, pixels[:, 1]])


@pytest.mark.parametrize("name", PLANES)
def test_the_window_moves_as_the_plane_does(name: str) -> None:
    """Each pixel of the window, to rounding: the map of a plane is exact, whatever the motion."""
    plane = PLANES[name]
    feature = np.array([[840.0, 260.0]])
    offsets = np.array([[-5.0, -5.0], [5.0, -5.0], [0.0, 5.0], [5.0, 5.0], [-3.0, 1.0]])
    scale = CAMERA.fu_px * CAMERA.baseline_m
    slope = np.array(
        [
            [
                scale * (inverse_depth(feature + step, plane) - inverse_depth(feature, plane))[0]
                for step in np.eye(2)
            ]
        ]
    )
    motion = move_surfaces(observed(feature, plane), slope, T_B_A, CAMERA)
    shrunk = offsets / (1.0 + offsets @ motion.perspective[0])[:, None]
    moved = motion.pixels[0] + shrunk @ motion.affine[0].T
    points = CAMERA.triangulate(observed(feature + offsets, plane))
    true = CAMERA.project(points @ T_B_A[:3, :3].T + T_B_A[:3, 3])[:, :2]
    np.testing.assert_allclose(moved, true, rtol=0, atol=1e-9)


def test_a_surface_that_faces_the_camera_grows() -> None:
    """Straight ahead the map is the growth alone, without perspective."""
    T = np.eye(4)
    T[2, 3] = -1.0
    seen = observed(np.array([[CAMERA.cu_px, CAMERA.cv_px]]), PLANES["a wall ahead"])
    motion = move_surfaces(seen, np.zeros((1, 2)), T, CAMERA)
    np.testing.assert_allclose(motion.growth, 12.0 / 11.0)
    np.testing.assert_allclose(motion.affine[0], 12.0 / 11.0 * np.eye(2))
    np.testing.assert_array_equal(motion.perspective[0], np.zeros(2))


def test_what_would_pass_the_camera_is_not_ahead() -> None:
    T = np.eye(4)
    T[2, 3] = -12.0 * (1.0 - 0.5 * MIN_SCALED_DEPTH)
    seen = observed(np.array([[CAMERA.cu_px, CAMERA.cv_px]]), PLANES["a wall ahead"])
    motion = move_surfaces(seen, np.zeros((1, 2)), T, CAMERA)
    assert not motion.ahead[0]
    assert np.isfinite(motion.affine).all()


def test_selected_features_keep_all_of_theirs() -> None:
    pixels = observed(np.array([[300.0, 200.0], [500.0, 300.0], [900.0, 250.0]]), PLANES["a slope"])
    motion = move_surfaces(pixels, np.full((3, 2), 0.1), T_B_A, CAMERA)
    few = motion.subset(np.array([False, True, True]))
    for whole, part in zip(motion, few, strict=True):
        np.testing.assert_array_equal(part, whole[1:])

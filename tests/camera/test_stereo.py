from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera, check_camera
from probevo.errors import InputError
from probevo.geometry import se3

CAMERA = StereoCamera(
    fu_px=718.9, fv_px=720.1, cu_px=607.2, cv_px=185.2, baseline_m=0.54, size_px=(1241, 376)
)


@pytest.fixture
def points() -> FloatArray:
    """1,000 points in view, from 2 to 80 m away, [1000, 3]."""
    rng = np.random.default_rng(0)
    z = np.geomspace(2.0, 80.0, 1000)
    return np.stack(
        [rng.uniform(-0.8, 0.8, 1000) * z, rng.uniform(-0.25, 0.25, 1000) * z, z], axis=1
    )


@pytest.fixture
def pixels(points: FloatArray) -> FloatArray:
    """What the camera sees of them, with a pixel or so of noise that keeps the disparity positive,
    [1000, 4]."""
    return CAMERA.project(points) + np.random.default_rng(1).uniform(-1.0, 1.0, (1000, 4))


def relative_error(actual: FloatArray, expected: FloatArray) -> float:
    return float(
        np.max(
            np.linalg.norm(actual - expected, axis=(1, 2)) / np.linalg.norm(expected, axis=(1, 2))
        )
    )


def test_triangulate_inverts_project(points: FloatArray) -> None:
    np.testing.assert_allclose(CAMERA.triangulate(CAMERA.project(points)), points, rtol=1e-11)


def test_project_inverts_triangulate_where_rows_agree(pixels: FloatArray) -> None:
    pixels[:, 3] = pixels[:, 1]
    np.testing.assert_allclose(CAMERA.project(CAMERA.triangulate(pixels)), pixels, rtol=1e-12)


def test_triangulate_is_the_least_squares_inverse(pixels: FloatArray) -> None:
    """Where the rows differ, each is off by half their difference."""
    residual = pixels - CAMERA.project(CAMERA.triangulate(pixels))
    half = 0.5 * (pixels[:, 1] - pixels[:, 3])
    np.testing.assert_allclose(
        residual, np.stack([0 * half, half, 0 * half, -half], axis=1), atol=1e-10
    )


def test_the_right_camera_sees_what_a_camera_moved_by_the_baseline_sees(points: FloatArray) -> None:
    moved = CAMERA.project(points - [CAMERA.baseline_m, 0.0, 0.0])
    np.testing.assert_allclose(CAMERA.project(points)[:, 2:], moved[:, :2], rtol=1e-13)


def test_normalized_coordinates_are_those_of_the_point(points: FloatArray) -> None:
    seen = CAMERA.project(points)
    x, y = CAMERA.normalized(seen[:, 0], seen[:, 1])
    np.testing.assert_allclose(np.column_stack([x, y]), points[:, :2] / points[:, 2:], atol=1e-14)


def test_moved_rays_are_the_moved_points_over_their_depth(points: FloatArray) -> None:
    """And a point without disparity is at infinity, where the rotation alone moves it."""
    T = se3.exp(np.array([0.1, -0.2, 0.8, 0.02, -0.05, 0.01]))
    q, rho = CAMERA.moved_rays(CAMERA.project(points), T)
    np.testing.assert_allclose(
        q.T, se3.transform(T, points) / points[:, 2:], rtol=1e-10, atol=1e-12
    )
    np.testing.assert_allclose(rho, 1.0 / points[:, 2], rtol=1e-10)
    q, rho = CAMERA.moved_rays(
        np.array([[CAMERA.cu_px, CAMERA.cv_px, CAMERA.cu_px + 1.0, CAMERA.cv_px]]), T
    )
    np.testing.assert_array_equal(rho, [0.0])
    np.testing.assert_allclose(q[:, 0], T[:3, 2])


def test_triangulate_jacobian_against_central_differences(pixels: FloatArray) -> None:
    steps = 1e-4 * np.eye(4)
    y = pixels[:, None, :]
    differences = (CAMERA.triangulate(y + steps) - CAMERA.triangulate(y - steps)) / 2e-4
    assert relative_error(CAMERA.triangulate_jacobian(pixels), differences.mT) < 1e-6


def test_check_accepts_a_sound_camera() -> None:
    """With and without a known size; one just inside each bound passes, so that the refusals below
    mean something."""
    at_the_edge = dataclasses.replace(CAMERA, cu_px=-0.49 * CAMERA.size_px[0], baseline_m=1e-6)
    for camera in (CAMERA, dataclasses.replace(CAMERA, size_px=None), at_the_edge):
        assert check_camera(camera, "calib.txt") is None  # type: ignore[func-returns-value]


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("fu_px", np.nan, "fu_px is nan"),
        ("cv_px", np.inf, "cv_px is inf"),
        ("baseline_m", np.nan, "baseline_m is nan"),
        ("fu_px", 10**400, "fu_px is 1000"),
        ("cv_px", -1e300, r"cv_px is -1e\+300"),
        ("baseline_m", 10**400, "baseline_m is 1000"),
        ("fu_px", 0.0, "fu_px is 0 px"),
        ("fv_px", -718.9, r"fv_px is -718\.9 px"),
        ("baseline_m", 0.0, "Are the left and right calibration the same file"),
        ("baseline_m", -0.54, "Are the left and right cameras swapped"),
        ("cu_px", 5000.0, "cu_px is 5000 px, far outside the image of 1241 × 376 px"),
        ("cv_px", -300.0, "cv_px is -300 px, far outside"),
        ("size_px", (10**400, 376), r"size_px is \(1000"),
        ("size_px", (1241, 0), "size_px is 1241 × 0"),
        ("fu_px", "718.9", "fu_px is '718.9'"),
        ("cv_px", None, "cv_px is None"),
        ("fv_px", np.array([718.9, 1.0]), "fv_px is array"),
        ("baseline_m", None, "baseline_m is None"),
        ("readout_s", "0.02", "readout_s is '0.02'"),
        ("size_px", (1241,), r"size_px is \(1241,\)(.|\n)*both whole numbers"),
        ("size_px", (1241, 376, 3), "size_px is"),
        ("size_px", [1241.5, 376], r"size_px is \(1241.5, 376\)"),
        ("size_px", (None, 376), r"size_px is \(None, 376\)"),
        ("size_px", "1241x376", "size_px is '1241x376'"),
        ("size_px", 1241, "size_px is 1241"),
    ],
)
def test_check_refuses_an_impossible_camera(field: str, value: object, message: str) -> None:
    with pytest.raises(InputError, match=rf"calib\.txt: (.|\n)*{message}"):
        check_camera(dataclasses.replace(CAMERA, **{field: value}), "calib.txt")  # type: ignore[arg-type]


def test_a_principal_point_a_hundred_focal_lengths_away_is_refused() -> None:
    """Nothing bounds that of a tracks file, which knows no image size; the fit of the row offsets
    was singular."""
    camera = dataclasses.replace(CAMERA, size_px=None)
    check_camera(dataclasses.replace(camera, cu_px=99.0 * CAMERA.fu_px), "tracks.npz")
    with pytest.raises(InputError, match=r"tracks\.npz: cu_px is 1e\+09 px, with a focal length"):
        check_camera(dataclasses.replace(camera, cu_px=1e9), "tracks.npz")


@pytest.mark.parametrize("size_px", [[1241, 376], np.array([1241, 376]), (1241.0, 376.0)])
def test_a_size_may_be_a_list(size_px: Any) -> None:
    """As in a file of Kalibr."""
    assert dataclasses.replace(CAMERA, size_px=size_px) == CAMERA

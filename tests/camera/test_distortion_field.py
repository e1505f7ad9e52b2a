"""The distortion field over the image: its polynomials, its size, and what a camera's extent is."""

from dataclasses import replace

import numpy as np
from numpy.polynomial import legendre

from probevo.camera.distortion_field import (
    DISPARITY_MODES,
    DISPLACEMENT_MODES,
    NUM_COEFFICIENTS,
    image_plane,
    modes_at,
    root_mean_square_px,
)
from probevo.camera.distortion_field_numba import MODE_COLUMNS, MODE_ROWS
from probevo.camera.rig_calibration import RigCalibration
from worlds import CAMERA, image_errors


def pixels_over_the_image(rng: np.random.Generator, count: int) -> np.ndarray:
    plane = image_plane(CAMERA)
    u = rng.uniform(0.0, plane.width, count)
    v = rng.uniform(0.0, plane.height, count)
    return np.column_stack([u, v, u - 10.0, v])


def test_modes_are_products_of_legendre_polynomials() -> None:
    pixels = pixels_over_the_image(np.random.default_rng(0), 50)
    plane = image_plane(CAMERA)
    of_x = legendre.legvander(2.0 * pixels[:, 0] / plane.width - 1.0, MODE_COLUMNS - 1)
    of_y = legendre.legvander(2.0 * pixels[:, 1] / plane.height - 1.0, MODE_ROWS - 1)
    expected = (of_x[:, :, None] * of_y[:, None, :]).reshape(len(pixels), -1)
    np.testing.assert_allclose(modes_at(pixels, CAMERA), expected, atol=1e-12)


def test_outside_of_the_image_the_field_is_that_at_its_edge() -> None:
    plane = image_plane(CAMERA)
    outside = np.array([[-50.0, 0.5 * plane.height, 0.0, 0.0], [plane.width + 9.0, 1e4, 0.0, 0.0]])
    edge = np.array([[0.0, 0.5 * plane.height, 0.0, 0.0], [plane.width, plane.height, 0.0, 0.0]])
    np.testing.assert_array_equal(modes_at(outside, CAMERA), modes_at(edge, CAMERA))


def test_fields_have_no_mode_that_another_estimate_has() -> None:
    """Neither shift nor scale of both views; of the disparity, only what depends on x, and not its
    parabola."""
    pixels = pixels_over_the_image(np.random.default_rng(1), 4000)
    modes = modes_at(pixels, CAMERA)
    x, y = CAMERA.normalized(pixels[:, 0], pixels[:, 1])
    one = np.ones_like(x)
    affine = np.column_stack([one, x, y])
    parabola = np.column_stack([one, x, x * x])
    for basis, chosen in ((affine, DISPLACEMENT_MODES), (parabola, DISPARITY_MODES)):
        # Independent of what is left out: neither set can be made of the other.
        both = np.column_stack([basis, modes[:, chosen]])
        assert np.linalg.matrix_rank(both) == basis.shape[1] + len(chosen)
    same_x = pixels.copy()
    same_x[:, 1] = 0.0
    of_disparity = modes[:, DISPARITY_MODES]
    np.testing.assert_allclose(
        modes_at(same_x, CAMERA)[:, DISPARITY_MODES], of_disparity, atol=1e-12
    )


def test_the_size_of_the_field_is_that_of_its_corrections() -> None:
    rng = np.random.default_rng(2)
    coefficients = rng.normal(scale=0.2, size=NUM_COEFFICIENTS)
    rig = replace(RigCalibration.initial(), image=image_errors(distortion_px=coefficients))
    pixels = pixels_over_the_image(rng, 20000)
    moved = rig.corrected(pixels, CAMERA) - pixels
    common_px, disparity_px = root_mean_square_px(coefficients)
    of_common = np.sqrt(np.mean(moved[:, 0] ** 2 + moved[:, 1] ** 2))
    of_disparity = np.sqrt(np.mean((moved[:, 0] - moved[:, 2]) ** 2))
    np.testing.assert_allclose([of_common, of_disparity], [common_px, disparity_px], rtol=0.03)
    np.testing.assert_allclose(moved[:, 3], moved[:, 1], atol=1e-12)


def test_without_the_size_of_the_images_the_principal_point_is_in_the_middle() -> None:
    plane = image_plane(replace(CAMERA, size_px=None))
    assert (plane.width, plane.height) == (2.0 * CAMERA.cu_px, 2.0 * CAMERA.cv_px)

"""What spoils an image, against closed forms."""

import numpy as np
import pytest

from probevo.arrays import Image
from probevo.camera.stereo import StereoCamera
from probevo_sim.spoiling import effects

SHAPE = (60, 90)


def ramp() -> Image:
    """Grey that grows by two levels a column."""
    return np.tile(np.arange(SHAPE[1]) * 2, (SHAPE[0], 1)).astype(np.uint8)


def edge() -> Image:
    """Black to the left, white to the right of column 45."""
    return np.where(np.arange(SHAPE[1]) < 45, 0, 255)[None].repeat(SHAPE[0], 0).astype(np.uint8)


def test_a_shake_blurs_across_its_way_only() -> None:
    along = effects.shaken(edge(), np.array([0.0, 12.0]))
    np.testing.assert_array_equal(along, edge())
    across = effects.shaken(edge(), np.array([12.0, 0.0]))[30]
    grey = np.flatnonzero((across > 0) & (across < 255))
    assert 10 <= len(grey) <= 13
    assert (np.diff(across.astype(int)) >= 0).all()
    # Inside of a ramp, the mean over a symmetric way is the middle.
    inside = np.s_[10:-10, 10:-10]
    blurred = effects.shaken(ramp(), np.array([8.0, 0.0]))
    np.testing.assert_array_equal(blurred[inside], ramp()[inside])


def test_blur_along_the_flow_is_longest_where_the_flow_is() -> None:
    flow = np.zeros((*SHAPE, 2))
    flow[:30, :, 0] = 20.0
    blurred = effects.blurred_along(edge(), flow, 0.5)
    np.testing.assert_array_equal(blurred[31:], edge()[31:])
    grey = np.flatnonzero((blurred[10] > 0) & (blurred[10] < 255))
    assert len(grey) == pytest.approx(10, abs=2)


def test_optical_flow_finds_a_shift() -> None:
    image = effects.texture((120, 160), np.random.default_rng(0))
    flow = effects.optical_flow(image, np.roll(image, 3, axis=1))
    np.testing.assert_allclose(np.median(flow.reshape(-1, 2), axis=0), [3.0, 0.0], atol=0.2)


def test_exposure_scales_and_noise_has_its_standard_deviation() -> None:
    image = np.full((200, 200), 100, np.uint8)
    rng = np.random.default_rng(0)
    assert (effects.exposed(image, 0.5, 0.0, rng) == 50).all()
    assert (effects.exposed(image, 4.0, 0.0, rng) == 255).all()
    noisy = effects.exposed(image, 1.0, 5.0, rng)
    assert noisy.std() == pytest.approx(5.0, rel=0.03)
    assert noisy.mean() == pytest.approx(100.0, abs=0.2)


def test_a_patch_covers_its_place_and_nothing_else() -> None:
    patch = np.full((10, 20), 200, np.uint8)
    covered = effects.pasted(ramp(), patch, (30.0, 5.0))
    assert (covered[5:15, 30:50] == 200).all()
    covered[5:15, 30:50] = ramp()[5:15, 30:50]
    np.testing.assert_array_equal(covered, ramp())
    outside = effects.pasted(ramp(), patch, (-100.0, 5.0))
    np.testing.assert_array_equal(outside, ramp())


def test_dirt_takes_contrast_where_it_is() -> None:
    mask = effects.dirt_mask(SHAPE, 0.5, np.random.default_rng(1))
    assert mask.min() < 0.6
    assert mask.max() == pytest.approx(1.0)
    soiled = effects.soiled(edge(), mask).astype(float)
    np.testing.assert_allclose(soiled, mask * edge() + (1.0 - mask) * 60.0, atol=0.6)


def test_jpeg_loses_more_at_a_lower_quality() -> None:
    image = effects.texture((64, 64), np.random.default_rng(2))
    lost = [
        np.mean((effects.compressed(image, quality).astype(float) - image) ** 2)
        for quality in (90, 40, 8)
    ]
    assert lost[0] < lost[1] < lost[2]


def test_a_distortion_moves_points_by_its_formula() -> None:
    """A bright dot at x in the image without distortion is seen at x (1 + k1 r²)."""
    camera = StereoCamera.centered(100.0, 0.3, (SHAPE[1], SHAPE[0]))
    image = np.zeros(SHAPE, np.uint8)
    u, v = 70, 15
    image[v - 1 : v + 2, u - 1 : u + 2] = 200
    k1 = 0.2
    seen = effects.distorted(image, effects.distortion_map(camera, k1)).astype(float)
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    x = np.array([u - camera.cu_px, v - camera.cv_px]) / 100.0
    expected = np.array([camera.cu_px, camera.cv_px]) + 100.0 * x * (1.0 + k1 * x @ x)
    found = np.array([(columns * seen).sum(), (rows * seen).sum()]) / seen.sum()
    np.testing.assert_allclose(found, expected, atol=0.1)
    assert np.linalg.norm(expected - [u, v]) > 0.5


def test_every_pixel_of_a_distorted_image_has_its_place_up_to_the_strongest_barrel() -> None:
    for focal_px, k1 in ((100.0, 0.2), (40.0, 0.2), (100.0, None), (40.0, None)):
        camera = StereoCamera.centered(focal_px, 0.3, (SHAPE[1], SHAPE[0]))
        coefficient = -effects.strongest_barrel(camera) if k1 is None else k1
        u, v = effects.distortion_map(camera, coefficient).astype(float)
        x = (u - camera.cu_px) / focal_px
        y = (v - camera.cv_px) / focal_px
        factor = 1.0 + coefficient * (x**2 + y**2)
        rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
        np.testing.assert_allclose(camera.cu_px + focal_px * x * factor, columns, atol=1e-4)
        np.testing.assert_allclose(camera.cv_px + focal_px * y * factor, rows, atol=1e-4)

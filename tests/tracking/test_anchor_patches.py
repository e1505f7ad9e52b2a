"""Anchor patches aligned by affine maps, on a texture that is known everywhere."""

from dataclasses import replace

import numpy as np
import pytest

from probevo.arrays import FloatArray, Image
from probevo.tracking.anchor_patches import MAX_GROWTH, AnchorPatches
from probevo.tracking.anchor_patches_numba import brightness_variance, step_scale
from probevo.tracking.preparation import saturated_pixels
from probevo.tracking.spline import spline_through as spline
from probevo.tracking.surface_motion import SurfaceMotion

HEIGHT_PX = 160
WIDTH_PX = 240
SIDE = 11
GRID = np.stack(
    np.meshgrid(np.arange(30.0, 210.0, 20.0), np.arange(30.0, 130.0, 20.0)), axis=-1
).reshape(-1, 2)
"""Features, in the middle of the image."""
MIDDLE = np.array([120.0, 80.0])


def texture(points: FloatArray, shortest_px: float = 6.0, longest_px: float = 60.0) -> FloatArray:
    """Smooth and random brightness at points [..., 2]: 50 waves of these lengths."""
    rng = np.random.default_rng(1)
    wave, direction, phase = (
        2 * np.pi / np.geomspace(shortest_px, longest_px, 50),
        *rng.uniform(0, 2 * np.pi, (2, 50)),
    )
    along = points @ np.stack([wave * np.cos(direction), wave * np.sin(direction)])
    return 128.0 + 8.0 * np.sin(along + phase).sum(axis=-1)


def fine(shift_px: float) -> Image:
    """Texture as around corners, waves of 3 to 12 px, shifted along the rows."""
    v, u = np.mgrid[:HEIGHT_PX, :WIDTH_PX].astype(float)
    grey = texture(np.stack([u - shift_px, v], axis=-1), 3.0, 12.0)
    return np.clip(np.round(grey), 0, 255).astype(np.uint8)


def shown(A: FloatArray, shift: FloatArray) -> Image:
    """The image of which the texture's point x is at A (x − MIDDLE) + MIDDLE + shift."""
    v, u = np.mgrid[:HEIGHT_PX, :WIDTH_PX].astype(float)
    pixels = np.stack([u, v], axis=-1)
    points = (pixels - MIDDLE - shift) @ np.linalg.inv(A).T + MIDDLE
    return np.clip(np.round(texture(points)), 0, 255).astype(np.uint8)


def moved(pixels: FloatArray, A: FloatArray, shift: FloatArray) -> FloatArray:
    return (pixels - MIDDLE) @ A.T + MIDDLE + shift


def grown(pixels: FloatArray, growth: float) -> SurfaceMotion:
    """The motion of surfaces at pixels [N, 2] that face the camera, and grow."""
    number = len(pixels)
    return SurfaceMotion(
        pixels=pixels,
        growth=np.full(number, growth),
        ahead=np.ones(number, np.bool_),
        affine=np.tile(growth * np.eye(2), (number, 1, 1)),
        perspective=np.zeros((number, 2)),
    )


FIRST = shown(np.eye(2), np.zeros(2))


@pytest.fixture
def patches() -> AnchorPatches:
    return AnchorPatches.cut(FIRST, GRID, SIDE)


@pytest.mark.parametrize(
    ("A", "growth"),
    [
        (np.eye(2), 1.0),
        (1.2 * np.eye(2), 1.2),
        (np.array([[1.0, 0.03], [0.0, 1.03]]), 1.0),
        (0.9 * np.array([[np.cos(0.05), -np.sin(0.05)], [np.sin(0.05), np.cos(0.05)]]), 0.9),
    ],
    ids=["shift", "approach", "shear", "turn"],
)
def test_a_patch_is_found_under_an_affine_map(
    patches: AnchorPatches, A: FloatArray, growth: float
) -> None:
    """From half a pixel off, with only the scale predicted: to a few hundredths of a pixel."""
    shift = np.array([0.4, -0.3])
    true = moved(GRID, A, shift)
    found, difference, after, _ = patches.align_left(
        spline(shown(A, shift)), true + 0.5, grown(GRID, growth)
    )
    assert np.median(np.abs(found - true)) < 0.03
    assert np.median(np.abs(after.affine - A)) < 0.02
    assert np.median(difference) < 2.0


@pytest.mark.parametrize(("gain", "offset"), [(0.6, 50.0), (1.0, 30.0), (1.3, -40.0)])
def test_an_image_of_another_exposure_is_aligned_as_well(
    patches: AnchorPatches, gain: float, offset: float
) -> None:
    """As patch and image differ by gain and offset, from camera to camera and frame to frame."""
    A = np.array([[1.05, 0.02], [-0.01, 1.0]])
    shift = np.array([0.4, -0.3])
    exposed = np.round(gain * shown(A, shift) + offset)
    image = np.clip(exposed, 0.0, 255.0).astype(np.uint8)
    true = moved(GRID, A, shift)
    found, difference, _, _ = patches.align_left(spline(image), true + 0.5, grown(GRID, 1.0))
    assert np.isfinite(difference).mean() > 0.95
    assert np.median(np.abs(found - true)) < 0.03


@pytest.mark.parametrize(
    ("curvature", "scale"), [(1.0, 1.0), (0.8, 1.25), (1.6, 0.625), (0.2, 2.0), (5.0, 0.5)]
)
def test_a_step_is_scaled_by_the_curvature_that_the_last_one_met(
    curvature: float, scale: float
) -> None:
    """The next step is what the last one left over: d − s J d."""
    last_step = np.array([0.5, -0.2, 0.01, 0.02, 0.0, -0.03])
    for last_scale in (0.7, 1.0):
        step = (1.0 - last_scale * curvature) * last_step
        assert np.isclose(step_scale(last_scale, step, last_step, 5.5), scale)


def test_the_subpixel_offset_of_the_anchor_is_kept() -> None:
    """A feature between pixels is that point of its patch, whatever the map."""
    features = GRID + np.array([0.37, -0.21])
    A = 1.15 * np.eye(2)
    patches = AnchorPatches.cut(FIRST, features, SIDE)
    true = moved(features, A, np.zeros(2))
    found, _, _, _ = patches.align_left(spline(shown(A, np.zeros(2))), true + 0.3, grown(GRID, 1.1))
    assert np.median(np.abs(found - true)) < 0.03


def test_errors_do_not_accumulate_over_many_frames(patches: AnchorPatches) -> None:
    """Fifteen steps of 2 %, each started where the last one ended: the error of a single one."""
    pixels = GRID
    previous = np.eye(2)
    for k in range(1, 16):
        A = 1.02**k * np.eye(2)
        pixels, _, patches, _ = patches.align_left(
            spline(shown(A, np.zeros(2))),
            moved(pixels, A @ np.linalg.inv(previous), np.zeros(2)),
            grown(GRID, 1.02),
        )
        previous = A
    inside = ((pixels > 12) & (pixels < np.array([WIDTH_PX, HEIGHT_PX]) - 12)).all(axis=1)
    assert inside.sum() > 20
    assert np.median(np.abs(pixels - moved(GRID, previous, np.zeros(2)))[inside]) < 0.03


@pytest.mark.parametrize("with_perspective", [True, False], ids=["perspective", "affine"])
def test_the_road_is_found_where_it_is(patches: AnchorPatches, with_perspective: bool) -> None:
    """The lower half of a window on the road grows more than the upper one.

    Under the perspective that this gives, features are found to hundredths of a pixel; an affine
    map alone finds nearly all of them too far down.
    """
    g = np.array([0.0, -0.012])
    v, u = np.mgrid[:HEIGHT_PX, :WIDTH_PX].astype(float)
    errors = []
    for k, feature in enumerate(GRID):
        # y = p + x / (1 + g·x), solved for x
        y = np.stack([u, v], axis=-1) - feature
        points = feature + y / (1.0 - y @ g)[..., None]
        image = np.clip(np.round(texture(points)), 0, 255).astype(np.uint8)
        motion = grown(feature[None], 1.0)
        if with_perspective:
            motion = motion._replace(perspective=g[None])
        found, _, after, _ = patches.subset(np.array([k])).align_left(
            spline(image), feature[None], motion
        )
        errors.append(found[0] - feature)
        if with_perspective:
            np.testing.assert_array_equal(after.perspective[0], g)
    down = np.array(errors)[:, 1]
    if with_perspective:
        assert abs(np.mean(down)) < 0.01
        assert np.median(np.abs(down)) < 0.03
    else:
        assert np.mean(down) > 0.05
        assert np.mean(down > 0) > 0.9


def test_perspectives_add_up_along_a_track(patches: AnchorPatches) -> None:
    """Two small steps have the perspective of their product: that of the first, and that of the
    second through the affine map of the first."""
    first = np.tile([0.002, -0.003], (len(GRID), 1))
    second = np.tile([-0.001, -0.004], (len(GRID), 1))
    _, _, after, _ = patches.align_left(
        spline(FIRST), GRID, grown(GRID, 1.0)._replace(perspective=first)
    )
    np.testing.assert_array_equal(after.perspective, first)
    affine = after.affine
    _, _, after, _ = after.align_left(
        spline(FIRST), GRID, grown(GRID, 1.0)._replace(perspective=second)
    )
    expected = first + np.einsum("nji,nj->ni", affine, second)
    np.testing.assert_allclose(after.perspective, expected, rtol=1e-12)


def test_a_slant_too_large_to_be_true_is_not_used(patches: AnchorPatches) -> None:
    absurd = grown(GRID, 1.0)._replace(perspective=np.full((len(GRID), 2), 1.0))
    plain = patches.align_left(spline(FIRST), GRID + 0.2, grown(GRID, 1.0))
    np.testing.assert_array_equal(
        patches.align_left(spline(FIRST), GRID + 0.2, absurd)[0], plain[0]
    )


def test_the_right_image_shows_the_left_one_slanted(patches: AnchorPatches) -> None:
    """A disparity that grows by 0.1 px a row is found with its slope, as the next prediction."""
    A = np.array([[1.0, -0.1], [0.0, 1.0]])
    shift = np.array([-9.0, 0.0])
    true = moved(GRID, A, shift)
    found, _, after, _ = patches.align_right(spline(shown(A, shift)), true + np.array([0.6, 0.0]))
    assert np.median(np.abs(found - true)) < 0.03
    assert np.median(np.abs(after.right_from_left - A)) < 0.02
    again, _, _, _ = after.align_right(spline(shown(A, shift)), true + np.array([0.6, 0.0]))
    assert np.median(np.abs(again - true)) <= np.median(np.abs(found - true)) + 1e-3


def test_features_whose_alignment_fails_stay(patches: AnchorPatches) -> None:
    """Another texture: nothing converges nearby, and the difference says so."""
    other = np.random.default_rng(0).integers(0, 256, (HEIGHT_PX, WIDTH_PX)).astype(np.uint8)
    found, difference, _, _ = patches.align_left(spline(other), GRID, grown(GRID, 1.0))
    stayed = (found == GRID).all(axis=1)
    assert stayed.mean() > 0.8
    np.testing.assert_array_equal(np.isinf(difference), stayed)
    right, _, unchanged, _ = patches.align_right(spline(other), GRID)
    there = (right == GRID).all(axis=1)
    np.testing.assert_array_equal(unchanged.right_from_left[there], patches.right_from_left[there])


def test_a_patch_that_has_grown_much_is_cut_anew(patches: AnchorPatches) -> None:
    A = 1.2 * MAX_GROWTH * np.eye(2)
    true = moved(GRID, A, np.zeros(2))
    inside = ((true > 12) & (true < np.array([WIDTH_PX, HEIGHT_PX]) - 12)).all(axis=1)
    patches = AnchorPatches.cut(FIRST, GRID[inside], SIDE)
    patches = replace(patches, affine=1.2 * patches.affine)
    _, _, after, _ = patches.align_left(
        spline(shown(A, np.zeros(2))), true[inside], grown(true[inside], MAX_GROWTH)
    )
    np.testing.assert_array_equal(after.affine, np.broadcast_to(np.eye(2), after.affine.shape))


def test_features_at_the_border_and_without_texture_stay() -> None:
    at_border = np.array([[1.0, 80.0], [238.5, 3.0], [120.0, 159.0]])
    found, _, _, _ = AnchorPatches.cut(FIRST, at_border, SIDE).align_left(
        spline(FIRST), at_border, grown(at_border, 1.0)
    )
    np.testing.assert_array_equal(found, at_border)
    grey = np.full((HEIGHT_PX, WIDTH_PX), 128, np.uint8)
    found, _, after, _ = AnchorPatches.cut(grey, GRID, SIDE).align_left(
        spline(grey), GRID, grown(GRID, 1.0)
    )
    np.testing.assert_array_equal(found, GRID)
    assert np.isfinite(after.affine).all()


def test_patches_are_selected_and_joined(patches: AnchorPatches) -> None:
    few = patches.subset(np.arange(len(GRID)) < 7)
    both = few.joined(patches.subset(np.array([8, 9])))
    assert len(few) == 7
    assert len(both) == 9
    np.testing.assert_array_equal(both.patch[7:], patches.patch[8:10])


def test_no_features() -> None:
    nothing = AnchorPatches.cut(FIRST, np.zeros((0, 2)), SIDE)
    found, _, after, _ = nothing.align_left(
        spline(FIRST), np.zeros((0, 2)), grown(np.zeros((0, 2)), 1.0)
    )
    assert found.shape == (0, 2)
    assert len(after.align_right(spline(FIRST), found)[2]) == 0


def noisy(image: Image, sigma: float, rng: np.random.Generator) -> Image:
    """The image with white noise of a standard deviation, grey levels."""
    grey = image + sigma * rng.normal(size=image.shape)
    return np.clip(np.round(grey), 0, 255).astype(np.uint8)


def test_brightness_that_does_not_match_is_what_regression_leaves() -> None:
    """The same as by least squares: I = a P + b + ε, in units of the patch."""
    rng = np.random.default_rng(3)
    patch = rng.uniform(50.0, 200.0, 121)
    image = 0.7 * patch + 20.0 + rng.normal(0.0, 5.0, 121)
    design = np.column_stack([patch, np.ones(121)])
    (gain, _), squares, *_ = np.linalg.lstsq(design, image)
    contrast = patch - patch.mean()
    contrast /= np.linalg.norm(contrast)
    found = variance_in_single_precision(patch, contrast, image)
    np.testing.assert_allclose(found, squares[0] / gain**2 / (121 - 8), rtol=1e-4)
    # Another exposure changes nothing; a negative is no match.
    again = variance_in_single_precision(patch, contrast, 3.0 * image - 100.0)
    np.testing.assert_allclose(again, found, rtol=1e-4)
    assert variance_in_single_precision(patch, contrast, -image) == np.inf
    assert variance_in_single_precision(patch, np.zeros(121), image) == np.inf


def variance_in_single_precision(
    patch: FloatArray, contrast: FloatArray, image: FloatArray
) -> float:
    """The variance of the brightness, from single precision as in the alignment."""
    error = image - patch
    return brightness_variance(
        patch.astype(np.float32),
        contrast.astype(np.float32),
        error.astype(np.float32),
        num_counted=len(error),
    )


@pytest.mark.parametrize("shift_px", [0.2, 0.5, 0.8])
def test_a_fraction_of_a_pixel_is_found_without_bias(shift_px: float) -> None:
    """With bilinear interpolation, such texture is found 0.03 px too far at 0.2 px, as much too
    near at 0.8 px, and scatters by 0.01 px."""
    true = GRID + np.array([shift_px, 0.0])
    patches = AnchorPatches.cut(fine(0.0), GRID, SIDE)
    found, difference, _, _ = patches.align_left(spline(fine(shift_px)), true, grown(GRID, 1.0))
    error = (found - true)[np.isfinite(difference)]
    assert len(error) > 40
    assert np.abs(error.mean(axis=0)).max() < 0.008
    assert error.std(axis=0).max() < 0.004


def test_places_scatter_as_their_covariance_says(patches: AnchorPatches) -> None:
    """Monte Carlo, white noise: the mean NEES of 45 features and 40 images is 2."""
    rng = np.random.default_rng(4)
    shift = np.array([0.3, 0.2])
    image = shown(np.eye(2), shift)
    squared = []
    for _ in range(40):
        found, difference, _, cov_px2 = patches.align_left(
            spline(noisy(image, 4.0, rng)), GRID + shift, grown(GRID, 1.0)
        )
        fits = np.isfinite(difference)
        assert fits.mean() > 0.9
        error = (found - GRID - shift)[fits]
        squared.append(np.einsum("ni,nij,nj->n", error, np.linalg.inv(cov_px2[fits]), error))
    assert 1.7 < np.concatenate(squared).mean() < 2.3


def test_the_covariance_does_not_depend_on_the_exposure(patches: AnchorPatches) -> None:
    image = noisy(FIRST, 6.0, np.random.default_rng(5))
    *_, as_it_is = patches.align_left(spline(image), GRID, grown(GRID, 1.0))
    darker = np.round(0.7 * image.astype(float) + 10.0).astype(np.uint8)
    *_, exposed = patches.align_left(spline(darker), GRID, grown(GRID, 1.0))
    both = np.isfinite(as_it_is).all(axis=(1, 2)) & np.isfinite(exposed).all(axis=(1, 2))
    assert both.mean() > 0.9
    np.testing.assert_allclose(exposed[both], as_it_is[both], rtol=0.15, atol=1e-4)


@pytest.mark.parametrize("angle_deg", [0.0, 45.0, 90.0, 135.0])
def test_along_an_edge_the_place_is_uncertain(angle_deg: float) -> None:
    """The axis of the largest variance is that of the edge."""
    along = np.array([np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))])
    v, u = np.mgrid[:HEIGHT_PX, :WIDTH_PX].astype(float)
    distance = (u - MIDDLE[0]) * -along[1] + (v - MIDDLE[1]) * along[0]
    # Some texture along the edge, without which there would be no information at all
    grey = 128.0 + 60.0 * np.tanh(0.8 * distance) + 0.25 * (texture(np.dstack([u, v])) - 128.0)
    edge = np.clip(np.round(grey), 0, 255).astype(np.uint8)
    patch = AnchorPatches.cut(edge, MIDDLE[None], SIDE)
    image = noisy(edge, 3.0, np.random.default_rng(6))
    *_, cov_px2 = patch.align_left(spline(image), MIDDLE[None], grown(MIDDLE[None], 1.0))
    variance, axes = np.linalg.eigh(cov_px2[0])
    assert variance[1] > 9.0 * variance[0]
    assert abs(axes[:, 1] @ along) > np.cos(np.deg2rad(15.0))


def test_what_fails_has_no_covariance(patches: AnchorPatches) -> None:
    other = np.random.default_rng(2).integers(0, 255, (HEIGHT_PX, WIDTH_PX), dtype=np.uint8)
    _, difference, _, cov_px2 = patches.align_left(spline(other), GRID, grown(GRID, 1.0))
    failed = np.isinf(difference)
    assert failed.any()
    assert np.isnan(cov_px2[failed]).all()
    assert not np.isnan(cov_px2[~failed]).any()


SKYLINE = np.column_stack([np.arange(30.0, 210.0, 8.0), np.full(23, MIDDLE[1])])
"""Features on the border of ``below_the_sky``."""


def below_the_sky(gain: float, shift: FloatArray, sky: float) -> Image:
    """Texture whose upper half is sky of that brightness, as a camera exposes it.

    The border between them is as sharp as a lens makes it.
    """
    v, u = np.mgrid[:HEIGHT_PX, :WIDTH_PX].astype(float)
    points = np.stack([u - shift[0], v - shift[1]], axis=-1)
    share = 1.0 / (1.0 + np.exp((points[..., 1] - MIDDLE[1]) / 0.5))
    radiance = share * sky + (1.0 - share) * 0.6 * texture(points)
    return np.clip(np.round(gain * radiance), 0, 255).astype(np.uint8)


def test_saturated_pixels_of_a_rotated_view_lie_row_by_row() -> None:
    """Else each window would copy the whole image."""
    view = np.rot90(np.full((40, 60), 255, np.uint8))
    saturated = saturated_pixels(view)
    assert saturated.flags.c_contiguous
    np.testing.assert_array_equal(saturated, np.ones((60, 40), np.uint8))


def skyline_error(gain: float, sky: float, *, leaves_out: bool) -> FloatArray:
    """The mean error of features on the border of the sky, in an image of another exposure."""
    shift = np.array([0.4, -0.3])
    first = below_the_sky(1.0, np.zeros(2), sky)
    image = below_the_sky(gain, shift, sky)
    if not leaves_out:
        patches = AnchorPatches.cut(first, SKYLINE, SIDE)
        again = spline(image)
    else:
        patches = AnchorPatches.cut(first, SKYLINE, SIDE, saturated=saturated_pixels(first))
        again = spline(image, saturated_pixels(image))
    true = SKYLINE + shift
    found, difference, _, _ = patches.align_left(again, true, grown(SKYLINE, 1.0))
    fits = np.isfinite(difference)
    assert fits.mean() > 0.8
    error: FloatArray = np.mean((found - true)[fits], axis=0)
    return error


@pytest.mark.parametrize("gain", [0.7, 0.85, 0.95])
def test_the_border_of_an_overexposed_sky_hardly_moves(gain: float) -> None:
    """A darker image shows a smaller part of the border as white: the border seems to rise.

    Less than 0.1 px are left, by the spline: beside white pixels, it swings.
    """
    rise_px = skyline_error(gain, 400.0, leaves_out=False)[1]
    assert rise_px < -0.2
    assert abs(skyline_error(gain, 400.0, leaves_out=True)[1]) < 0.35 * abs(rise_px)


def test_a_sky_that_is_not_saturated_is_aligned_as_before() -> None:
    before = skyline_error(0.9, 180.0, leaves_out=False)
    np.testing.assert_array_equal(skyline_error(0.9, 180.0, leaves_out=True), before)


def test_a_patch_of_which_hardly_a_pixel_counts_is_no_match() -> None:
    """White, but for a few dark pixels around each feature."""
    image = np.full((HEIGHT_PX, WIDTH_PX), 255, np.uint8)
    for u, v in GRID.astype(int):
        image[v - 1 : v + 2, u - 1 : u + 2] = FIRST[v - 1 : v + 2, u - 1 : u + 2]
    patches = AnchorPatches.cut(image, GRID, SIDE, saturated=saturated_pixels(image))
    _, difference, _, _ = patches.align_left(
        spline(image, saturated_pixels(image)), GRID, grown(GRID, 1.0)
    )
    assert np.isinf(difference).all()


def test_as_many_pixels_as_parameters_show_nothing() -> None:
    """Eight of the 25 pixels of a small window tell nothing of the scatter of the brightness."""
    image = FIRST.copy()
    for u, v in GRID.astype(int):
        image[v - 2 : v + 3, u - 2 : u + 3] = 255
        image[v - 2 : v + 2, u - 1 : u + 1] = FIRST[v - 2 : v + 2, u - 1 : u + 1]
    patches = AnchorPatches.cut(image, GRID, 5, saturated=saturated_pixels(image))
    assert (patches.saturated == 0).sum(axis=(1, 2)).max() == 8
    _, difference, _, cov_px2 = patches.align_left(spline(FIRST), GRID, grown(GRID, 1.0))
    assert np.isinf(difference).all()
    assert np.isnan(cov_px2).all()


def test_an_anchor_that_is_cut_anew_knows_its_saturated_pixels() -> None:
    """Behind a growth beyond ``MAX_GROWTH``, the patch is that of the new image."""
    image = below_the_sky(1.0, np.zeros(2), 400.0)
    growth = 1.1 * MAX_GROWTH
    small = AnchorPatches.cut(FIRST, SKYLINE, SIDE)
    prepared = spline(image, saturated_pixels(image))
    outgrown = replace(small, affine=growth * small.affine)
    _, _, after, _ = outgrown.align_left(prepared, SKYLINE, grown(SKYLINE, 1.0))
    is_new = np.isclose(after.affine, np.eye(2)).all(axis=(1, 2))
    assert is_new.any()
    share = after.saturated[is_new].mean(axis=(1, 2))
    assert ((share > 0.3) & (share < 0.6)).all()
    assert not after.saturated[~is_new].any()

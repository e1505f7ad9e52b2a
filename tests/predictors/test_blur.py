"""The blur metric against its definition, and what it must do when an image gets blurred."""

import cv2
import numpy as np
import pytest

from probevo.arrays import FloatArray, Image
from probevo.predictors.blur import HALF_SIZE_PX, TAPS, blur

CENTER = np.array([[40.0, 30.0]])


def slow_blur(left: Image, u: int, v: int, half: int) -> float:
    """Crete et al. 2007, pixel by pixel."""
    padded = np.pad(left.astype(float), TAPS, mode="edge")
    shares = []
    for du, dv in ((1, 0), (0, 1)):

        def box(x: int, y: int, du: int = du, dv: int = dv) -> float:
            taps = [
                padded[y + TAPS + k * dv, x + TAPS + k * du]
                for k in range(-(TAPS // 2), TAPS // 2 + 1)
            ]
            return float(np.mean(taps))

        before = 0.0
        lost = 0.0
        for y in range(v - half + dv, v + half + 1):
            for x in range(u - half + du, u + half + 1):
                difference = abs(float(left[y, x]) - float(left[y - dv, x - du]))
                before += difference
                lost += max(0.0, difference - abs(box(x, y) - box(x - du, y - dv)))
        if before > 0:
            shares.append((before - lost) / before)
    return max(shares, default=1.0)


def textured(seed: int) -> FloatArray:
    """Texture with detail at every scale, [60, 80], grey levels."""
    rng = np.random.default_rng(seed)
    layers = [
        cv2.GaussianBlur(rng.normal(size=(60, 80)), (0, 0), s) * s for s in (0.5, 1.0, 2.0, 4.0)
    ]
    return np.clip(128 + 60 * np.sum(layers, axis=0), 0, 255)


def checkerboard(square_px: int) -> FloatArray:
    """With a corner of four squares at ``CENTER``."""
    rows, columns = (np.indices((60, 80)) - CENTER[0, ::-1, None, None].astype(int)) // square_px
    return 40 + 170.0 * ((rows + columns) % 2)


def test_it_is_the_slow_definition() -> None:
    """Patches everywhere in the image, up to its border."""
    image = textured(0).astype(np.uint8)
    half = HALF_SIZE_PX
    rng = np.random.default_rng(1)
    inner = rng.integers([half, half], [80 - half, 60 - half], size=(20, 2))
    uv = np.concatenate([inner, [[half, half], [79 - half, 59 - half]]])
    expected = [slow_blur(image, u, v, half) for u, v in uv.tolist()]
    np.testing.assert_allclose(blur(image, uv.astype(float)), expected, rtol=1e-12)


@pytest.mark.parametrize("sharp", [textured(2), checkerboard(23)], ids=["texture", "checkerboard"])
def test_it_grows_with_the_blur(sharp: FloatArray) -> None:
    values = [blur(sharp.astype(np.uint8), CENTER)[0]]
    for sigma_px in (0.5, 1.0, 1.5, 2.0, 3.0, 4.0):
        values += blur(cv2.GaussianBlur(sharp, (0, 0), sigma_px).astype(np.uint8), CENTER).tolist()
    assert np.all(np.diff(values) > 0)
    assert 0.0 <= values[0] < 0.5
    assert 0.7 < values[-1] <= 1.0


@pytest.mark.parametrize("along", [(1, 0), (0, 1)])
def test_motion_along_either_axis_counts(along: tuple[int, int]) -> None:
    sharp = textured(3)
    moved = [
        cv2.blur(sharp, (1 + n * along[0], 1 + n * along[1])).astype(np.uint8)
        for n in (0, 2, 4, 8, 12)
    ]
    assert np.all(np.diff([blur(image, CENTER)[0] for image in moved]) > 0)


def test_turning_the_image_changes_nothing() -> None:
    image = textured(4).astype(np.uint8)
    turned = np.ascontiguousarray(image.T)
    assert blur(turned, CENTER[:, ::-1])[0] == pytest.approx(blur(image, CENTER)[0], abs=1e-15)


def test_contrast_and_brightness_change_nothing() -> None:
    image = (textured(5) / 4).astype(np.uint8)
    assert blur(3 * image + 20, CENTER)[0] == pytest.approx(blur(image, CENTER)[0], abs=1e-15)


def test_patches_that_leave_the_image_are_unknown() -> None:
    image = textured(6).astype(np.uint8)
    inside = np.array([[10.0, 10.0], [69.0, 49.0], [9.5, 49.49]])
    outside = np.array(
        [[9.4, 30.0], [40.0, 9.0], [69.5, 30.0], [40.0, 50.0], [-1e9, 1e9], [np.nan, 30.0]]
    )
    values = blur(image, np.concatenate([inside, outside]))
    np.testing.assert_array_equal(np.isnan(values), [False] * len(inside) + [True] * len(outside))


def test_an_axis_without_change_does_not_count() -> None:
    """A sharp edge down the image is sharp, although its columns are constant; a grey patch is
    blurred."""
    edge = np.zeros((60, 80), dtype=np.uint8)
    edge[:, 40:] = 200
    assert blur(edge, CENTER)[0] == pytest.approx(1 / 9)
    assert blur(np.full((60, 80), 90, dtype=np.uint8), CENTER)[0] == 1.0


def test_no_features_no_values() -> None:
    assert blur(textured(7).astype(np.uint8), np.zeros((0, 2))).shape == (0,)

import cv2
import numpy as np
import pytest

from probevo.arrays import AnyArray, FloatArray, Image
from probevo.output.inspection.feature_pictures import (
    Shades,
    draw_features,
    enlargement,
    legend_height,
    value_shades,
    weight_shades,
)
from probevo.output.table import readable

SIZE_PX = 1000, 300
GRAY = np.full((300, 1000), 128, dtype=np.uint8)
UV = np.array([[200.0, 150.0], [500.0, 150.0], [800.0, 150.0]])


def drawn(
    shades: Shades,
    left: Image | None = GRAY,
    size_px: tuple[int, int] = SIZE_PX,
    uv: FloatArray = UV,
) -> AnyArray:
    jpeg = draw_features(left, size_px, uv, shades=shades)
    return cv2.imdecode(np.frombuffer(jpeg, dtype=np.uint8), cv2.IMREAD_COLOR).astype(float)


@pytest.mark.parametrize(
    ("size_px", "factor"), [((1242, 375), 1), ((621, 188), 2), ((320, 128), 3), ((3000, 90), 1)]
)
def test_picture_is_a_whole_multiple_of_the_image_and_a_legend(
    size_px: tuple[int, int], factor: int
) -> None:
    width, height = size_px
    picture = drawn(value_shades("blur", "1", np.arange(3.0)), None, size_px)
    assert enlargement(size_px) == factor
    assert picture.shape == (factor * height + legend_height(factor * width), factor * width, 3)


def test_low_is_blue_and_high_is_yellow() -> None:
    picture = drawn(value_shades("blur", "1", np.array([0.0, 0.5, 1.0])))
    blue, _, red = np.moveaxis(picture, -1, 0)
    assert blue[150, 200] > red[150, 200]
    assert red[150, 800] > blue[150, 800] + 100
    legend = picture[300:]
    assert legend[48, 150, 0] > legend[48, 150, 2]  # the bar runs the same way
    assert legend[48, 850, 2] > legend[48, 850, 0] + 100


def test_dots_follow_the_enlargement() -> None:
    """At twice the size a point at u = 100 lands on column 200.5."""
    uv = np.array([[100.0, 50.0], [400.0, 50.0]])
    picture = drawn(value_shades("x", "", np.array([0.0, 1.0])), GRAY[:100, :500], (500, 100), uv)
    blue, _, red = np.moveaxis(picture[:200], -1, 0)
    rows, columns = np.nonzero(red > blue + 100)
    np.testing.assert_allclose([columns.mean(), rows.mean()], [800.5, 100.5], atol=0.6)


def test_undefined_is_a_hollow_grey_ring() -> None:
    picture = drawn(value_shades("blur", "1", np.array([0.0, np.nan, 1.0])))
    around = picture[140:161, 490:511]
    assert np.ptp(around, axis=2).max() < 30
    assert around.max() > 150
    np.testing.assert_allclose(around[10, 10], 0.75 * 128, atol=12)


def test_numbers_at_the_ends_are_those_of_the_data() -> None:
    values = np.r_[np.random.default_rng(0).normal(5.0, 2.0, 400), np.nan]
    low, high = np.nanquantile(values, [0.02, 0.98])
    shades = value_shades("flow", "px", values)
    assert shades.ends == (f"≤ {readable(low)}", f"≥ {readable(high)}")
    assert shades.name == "flow, px"
    assert (shades.place[values <= low] == 0.0).all()
    assert (shades.place[values >= high] == 1.0).all()
    inside = np.nanargmin(np.abs(values - 0.5 * (low + high)))
    np.testing.assert_allclose(shades.place[inside], 0.5, atol=0.02)


def test_constant_and_unknown_columns() -> None:
    constant = value_shades("turn_rate", "rad/s", np.full(3, 0.2))
    assert constant.ends == ("0.200", "0.200")
    assert np.ptp(constant.colors_bgr, axis=0).max() == 0.0
    nothing = value_shades("blur", "1", np.full(3, np.nan))
    assert nothing.ends == ("", "")
    assert drawn(nothing).shape == drawn(constant).shape
    empty = value_shades("blur", "1", np.zeros(0))
    assert drawn(empty, uv=np.zeros((0, 2))).shape == drawn(constant).shape


def test_weights_diverge_around_one() -> None:
    shades = weight_shades(np.array([0.1, 1.0, 10.0]))
    np.testing.assert_allclose(shades.place[1], 0.5)
    np.testing.assert_allclose(shades.place[0], 1.0 - shades.place[2], atol=1e-12)
    assert shades.middle == "1"
    blue, _, red = np.moveaxis(drawn(shades), -1, 0)
    assert blue[150, 200] > red[150, 200] + 60
    assert red[150, 800] > blue[150, 800] + 60
    assert weight_shades(np.ones(4)).place.tolist() == [0.5] * 4


def test_the_same_bytes_again() -> None:
    shades = value_shades("blur", "1", np.array([0.0, np.nan, 1.0]))
    assert draw_features(GRAY, SIZE_PX, UV, shades=shades) == draw_features(
        GRAY, SIZE_PX, UV, shades=shades
    )

"""Textures: their mip levels, that they wrap around, and the tools that draw them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo_sim.scene.texture_patterns.canvas import (
    SIDE,
    Tile,
    blank,
    downsampled,
    ellipse,
    noise,
    polygon,
    rectangle,
    stroke,
)
from probevo_sim.scene.textures import SIZE, Texture, make_textures

LEVELS = 10
IRREGULAR = [
    *(Texture.ASPHALT, Texture.GRASS, Texture.DIRT, Texture.ROCK, Texture.FOLIAGE, Texture.BARK),
    *(Texture.CLOTH, Texture.PLASTER, Texture.CLOUDS, Texture.BLOTCHES, Texture.DAPPLE),
]
FACADES = [Texture.FACADE_OFFICE, Texture.FACADE_FLATS, Texture.FACADE_OLD, Texture.FACADE_HOUSE]


def level_of(texture: Texture, level: int = 0) -> FloatArray:
    """Return one mip level of a texture, 0 … 255."""
    mipmaps = make_textures()
    side = SIZE >> level
    start = mipmaps.level_start[level]
    return mipmaps.texels[texture, start : start + side**2].reshape(side, side).astype(np.float64)


def test_levels_lie_one_after_another_down_to_one_texel() -> None:
    mipmaps = make_textures()
    assert SIZE == 512
    np.testing.assert_array_equal(
        mipmaps.level_start, [sum((SIZE >> k) ** 2 for k in range(n)) for n in range(LEVELS)]
    )
    assert mipmaps.texels.shape == (len(Texture), mipmaps.level_start[-1] + 1)
    assert mipmaps.texels.dtype == np.uint8


def test_layers_are_numbered_without_a_gap() -> None:
    assert [int(texture) for texture in Texture] == list(range(len(Texture)))


@pytest.mark.parametrize("texture", Texture)
def test_mean_is_one_half(texture: Texture) -> None:
    assert level_of(texture).mean() == pytest.approx(127.5, abs=0.02 * 255)


@pytest.mark.parametrize("texture", Texture)
def test_each_level_is_the_box_mean_of_the_one_before(texture: Texture) -> None:
    """Both are rounded, each by at most half a grey level; so are the means of any level and of the
    finest."""
    finest = level_of(texture)
    for level in range(1, LEVELS):
        coarse = level_of(texture, level)
        side = SIZE >> level
        before = level_of(texture, level - 1).reshape(side, 2, side, 2).mean(axis=(1, 3))
        assert np.abs(coarse - before).max() <= 1.0
        assert abs(coarse.mean() - finest.mean()) <= 1.0


@pytest.mark.parametrize("texture", [texture for texture in Texture if texture != Texture.PLAIN])
def test_texture_has_contrast(texture: Texture) -> None:
    assert 0.07 <= level_of(texture).std() / 255 <= 0.5


@pytest.mark.parametrize("axis", [0, 1], ids=["upward", "across"])
@pytest.mark.parametrize("texture", Texture)
def test_no_line_of_a_tile_is_sharper_at_its_edge_than_inside(texture: Texture, axis: int) -> None:
    """Mean step from each line of texels to the next: that across the seam against the largest
    inside."""
    tile = level_of(texture)
    steps = np.abs(tile - np.roll(tile, 1, axis)).mean(axis=1 - axis)
    assert steps[0] <= 1.02 * steps[1:].max()


@pytest.mark.parametrize("texture", IRREGULAR)
def test_seam_of_an_irregular_texture_is_like_any_other_line(texture: Texture) -> None:
    """The mean step across the seam lies within the spread of the steps inside, on both axes."""
    tile = level_of(texture)
    for axis in (0, 1):
        steps = np.abs(tile - np.roll(tile, 1, axis)).mean(axis=1 - axis)
        assert steps[0] <= steps[1:].mean() + 4 * steps[1:].std()


def test_checkerboard_is_eight_squares_a_side() -> None:
    rows, columns = np.indices((SIZE, SIZE)) // (SIZE // 8)
    np.testing.assert_array_equal(level_of(Texture.CHECKERBOARD), 255 * ((rows + columns) % 2))


def test_plain_is_one_grey_at_all_scales() -> None:
    assert len(np.unique(make_textures().texels[Texture.PLAIN])) == 1


def test_hedge_repeats_itself_every_32_texels_and_no_sooner() -> None:
    hedge = level_of(Texture.HEDGE_REPEATED)
    for axis in (0, 1):
        for shift in range(1, 33):
            differs = np.any(hedge != np.roll(hedge, shift, axis))
            assert differs == (shift < 32)


@pytest.mark.parametrize("texture", FACADES)
def test_no_quarter_of_a_facade_is_like_another(texture: Texture) -> None:
    """Ambiguous matches are an effect of their own, and facades must not cause them."""
    half = SIZE // 2
    quarters = level_of(texture).reshape(2, half, 2, half).swapaxes(1, 2).reshape(4, half, half)
    for i in range(4):
        for j in range(i):
            assert np.abs(quarters[i] - quarters[j]).mean() > 10


def test_first_row_is_the_foot() -> None:
    """Below a car lies shade, above it its bright roof."""
    car = level_of(Texture.CAR_SIDE)
    assert car[10:60].mean() < 60 < 120 < car[-30:-10].mean()


def test_textures_are_the_same_on_each_call_and_read_only() -> None:
    again = make_textures.__wrapped__()
    np.testing.assert_array_equal(again.texels, make_textures().texels)
    with pytest.raises(ValueError, match="read-only"):
        make_textures().texels[0, 0] = 1


def draw_polygon(canvas: Tile, x: float, y: float) -> None:
    polygon(canvas, ellipse(x, y, 40, radius_y=20, angle_rad=0.7), 1.0)


def draw_stroke(canvas: Tile, x: float, y: float) -> None:
    stroke(canvas, [(x - 30, y - 10), (x, y + 25), (x + 35, y)], 5, value=1.0)


def draw_rectangle(canvas: Tile, x: float, y: float) -> None:
    rectangle(canvas, x - 30, y - 20, right=x + 25, top=y + 15, value=np.arange(70.0)[:, None])


@pytest.mark.parametrize("corner", [(0, 0), (SIDE, 0), (3, SIDE - 8), (-SIDE - 20, 2 * SIDE + 9)])
@pytest.mark.parametrize("draw", [draw_polygon, draw_stroke, draw_rectangle])
def test_what_is_drawn_over_the_edge_comes_in_at_the_other_side(
    draw: Callable[[Tile, float, float], None], corner: tuple[int, int]
) -> None:
    """Drawing commutes with a shift of the tile, but for 1 % of the area, since OpenCV clips an
    outline first."""
    inside = blank(0.0)
    over = blank(0.0)
    draw(inside, SIDE // 2, SIDE // 2)
    draw(over, *corner)
    shift_x, shift_y = (at - SIDE // 2 for at in corner)
    shifted = np.roll(downsampled(inside), (shift_y, shift_x), axis=(0, 1))
    assert np.abs(downsampled(over) - shifted).sum() <= 0.01 * shifted.sum()


def test_area_of_a_disc() -> None:
    canvas = blank(0.0)
    polygon(canvas, ellipse(100.3, 200.6, 50, radius_y=50, corners=200), 1.0)
    assert downsampled(canvas).sum() == pytest.approx(np.pi * 50**2, rel=0.03)


def test_noise_has_the_spectrum_asked_for() -> None:
    """Zero mean, unit variance, nothing outside the band, and power that falls as frequency^(−2
    slope) inside."""
    tile = noise(np.random.default_rng(0), 1.0, 4, high=64)
    assert tile.mean() == pytest.approx(0, abs=1e-6)
    assert tile.std() == pytest.approx(1, abs=1e-6)
    power = np.abs(np.fft.fft2(tile)) ** 2
    cycles = np.fft.fftfreq(SIDE, 1 / SIDE)
    frequency = np.hypot(cycles[:, None], cycles)
    assert power[(frequency < 3.99) | (frequency > 64.01)].sum() < 1e-9 * power.sum()
    rings = [power[(frequency > low) & (frequency < 1.25 * low)].mean() for low in (12, 24, 48)]
    np.testing.assert_allclose(np.divide(rings[:-1], rings[1:]), 4, rtol=0.15)

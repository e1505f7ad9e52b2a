"""Means of textures over footprints, against sums over texels."""

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo_sim.scene.texture_filter_numba import Footprint, sample, sample_square
from probevo_sim.scene.textures import SIZE, Texture, make_textures


def level(texture: Texture, index: int) -> FloatArray:
    """Return one mip level of a texture as an image, from −1 to 1."""
    side = SIZE >> index
    start = make_textures().level_start[index]
    return (
        make_textures().texels[texture, start : start + side * side].reshape(side, side) / 127.5
        - 1.0
    )


def mean_over(
    texture: Texture,
    a: float,
    b: float,
    *,
    a_by_u: float = 0.0,
    a_by_v: float = 0.0,
    b_by_u: float = 0.0,
    b_by_v: float = 0.0,
) -> float:
    footprint = Footprint(a, b, a_by_u, a_by_v=a_by_v, b_by_u=b_by_u, b_by_v=b_by_v)
    return sample(make_textures(), int(texture), footprint)


@pytest.mark.parametrize(("row", "column"), [(0, 0), (17, 300), (511, 511)])
def test_the_middle_of_a_texel_is_its_value(row: int, column: int) -> None:
    mean = level(Texture.BRICK, 0)[row, column]
    assert mean_over(Texture.BRICK, column + 0.5, row + 0.5) == pytest.approx(mean, abs=1e-12)


def test_the_tile_repeats() -> None:
    sides = {"a_by_u": 3.0, "a_by_v": 0.5, "b_by_u": 0.2, "b_by_v": 2.0}
    here = mean_over(Texture.ROCK, 100.3, 44.7, **sides)
    there = mean_over(Texture.ROCK, 100.3 + SIZE, 44.7 - 3 * SIZE, **sides)
    assert there == pytest.approx(here, abs=1e-9)


def test_a_footprint_of_a_whole_level_is_the_mean_of_its_texels() -> None:
    """Eight texels a side, centred on a texel of level 3."""
    mean = level(Texture.GRASS, 3)[20, 30]
    got = mean_over(Texture.GRASS, 8 * 30.5, 8 * 20.5, a_by_u=8.0, b_by_v=8.0)
    assert got == pytest.approx(mean, abs=1e-9)


def test_a_long_footprint_is_sampled_along_its_longer_side() -> None:
    """One texel wide and eight long: the mean of eight texels of a row, not of a square."""
    row = 40
    first = 64
    mean = level(Texture.BRICK, 0)[row, first : first + 8].mean()
    got = mean_over(Texture.BRICK, first + 4.0, row + 0.5, a_by_u=8.0, b_by_v=1.0)
    assert got == pytest.approx(mean, abs=1e-9)
    assert mean_over(
        Texture.BRICK, first + 4.0, row + 0.5, a_by_v=8.0, b_by_u=1.0
    ) == pytest.approx(mean, abs=1e-9)


def test_a_huge_footprint_sees_the_mean_of_the_tile() -> None:
    huge = mean_over(Texture.FACADE_OLD, 12.0, 99.0, a_by_u=1e5, b_by_v=1e5)
    assert huge == pytest.approx(level(Texture.FACADE_OLD, 9)[0, 0], abs=1e-9)
    assert abs(huge) < 0.05


def test_growing_footprints_change_the_mean_smoothly() -> None:
    """No step where one mip level takes over from another."""
    sizes = np.geomspace(1.0, 300.0, 2000)
    means = np.array(
        [mean_over(Texture.DIRT, 77.2, 31.9, a_by_u=size, b_by_v=size) for size in sizes]
    )
    assert np.abs(np.diff(means)).max() < 0.01


def test_the_soft_sample_of_a_soft_texture_is_the_full_one() -> None:
    for side in (1.0, 3.0, 20.0):
        soft = sample_square(make_textures(), int(Texture.BLOTCHES), a=55.5, b=201.5, side=side)
        assert soft == pytest.approx(
            mean_over(Texture.BLOTCHES, 55.5, 201.5, a_by_u=side, b_by_v=side), abs=0.05
        )

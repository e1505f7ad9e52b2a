"""Textures of the ground do not repeat, and are as they are drawn within a cell."""

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo_sim.scene.stochastic_tiling_numba import BEND_CELLS, BLEND_CELLS, sample_unrepeated
from probevo_sim.scene.texture_filter_numba import Footprint, sample
from probevo_sim.scene.textures import SIZE, Texture, lattice_texels, make_textures


def unrepeated(texture: Texture, a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the texture at places (a, b), [N] each, texels, through footprints of one texel."""
    lattice = int(lattice_texels(np.array([int(texture)]))[0])
    footprints = (
        Footprint(x, y, 1.0, a_by_v=0.0, b_by_u=0.0, b_by_v=1.0) for x, y in zip(a, b, strict=True)
    )
    return np.array(
        [sample_unrepeated(make_textures(), int(texture), lattice, each) for each in footprints]
    )


def repeated(texture: Texture, a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the same of equal tiles side by side."""
    footprints = (
        Footprint(x, y, 1.0, a_by_v=0.0, b_by_u=0.0, b_by_v=1.0) for x, y in zip(a, b, strict=True)
    )
    return np.array([sample(make_textures(), int(texture), each) for each in footprints])


@pytest.mark.parametrize("texture", [Texture.ASPHALT, Texture.GRASS, Texture.DIRT, Texture.DAPPLE])
@pytest.mark.parametrize("cells", [(1, 0), (0, 1), (2, 0), (1, 1), (5, -3)])
def test_nothing_is_the_same_a_few_tiles_on(texture: Texture, cells: tuple[int, int]) -> None:
    a, b = np.random.default_rng(5).uniform(-6 * SIZE, 6 * SIZE, (2, 4000))
    here = unrepeated(texture, a, b)
    there = unrepeated(texture, a + SIZE * cells[0], b + SIZE * cells[1])
    assert abs(np.corrcoef(here, there)[0, 1]) < 0.1
    tile = repeated(texture, a, b), repeated(texture, a + SIZE * cells[0], b + SIZE * cells[1])
    assert np.corrcoef(*tile)[0, 1] == pytest.approx(1.0)


@pytest.mark.parametrize("texture", [Texture.ASPHALT, Texture.PAVING, Texture.DAPPLE])
def test_mean_and_contrast_are_those_of_the_texture(texture: Texture) -> None:
    """Blending takes a few percent of the contrast."""
    a, b = np.random.default_rng(6).uniform(-20 * SIZE, 20 * SIZE, (2, 8000))
    ours = unrepeated(texture, a, b)
    drawn = repeated(texture, a, b)
    assert ours.mean() == pytest.approx(drawn.mean(), abs=0.04)
    assert 0.9 < ours.std() / drawn.std() < 1.02


def test_it_has_no_seams() -> None:
    """Between texels, it changes no faster than the texture does."""
    along = np.arange(0.0, 8.0 * SIZE, 0.25)
    across = np.full_like(along, 77.3)
    steps = np.abs(np.diff(unrepeated(Texture.BLOTCHES, along, across)))
    assert steps.max() < 3.0 * np.abs(np.diff(repeated(Texture.BLOTCHES, along, across))).max()


def test_within_a_cell_it_is_the_tile_shifted_by_whole_joints() -> None:
    """Far from the borders, the square is found in the tile exactly, at one place."""
    margin = round((BEND_CELLS + 0.5 * BLEND_CELLS) * SIZE)
    b, a = np.mgrid[margin : SIZE - margin, margin : SIZE - margin].reshape(2, -1) + 0.5
    shown = unrepeated(Texture.PAVING, a, b).reshape(SIZE - 2 * margin, -1)
    tile = make_textures().texels[Texture.PAVING, : SIZE * SIZE].reshape(SIZE, SIZE) / 127.5 - 1.0
    padded = np.zeros_like(tile)
    padded[: shown.shape[0], : shown.shape[1]] = shown
    correlation = np.fft.ifft2(np.fft.fft2(padded).conj() * np.fft.fft2(tile)).real
    row, column = np.unravel_index(np.argmax(correlation), correlation.shape)
    lattice = lattice_texels(np.array([Texture.PAVING]))[0]
    assert (row - margin) % lattice == (column - margin) % lattice == 0
    found = np.roll(tile, (-row, -column), axis=(0, 1))[: shown.shape[0], : shown.shape[1]]
    np.testing.assert_allclose(shown, found, atol=1e-9)


@pytest.mark.parametrize("texture", [Texture.PAVING, Texture.CONCRETE])
def test_joints_stay_in_line(texture: Texture) -> None:
    """The darkest rows of the tile are as dark in the plane, at the same places in all cells."""
    lattice = int(lattice_texels(np.array([int(texture)]))[0])
    b, a = np.mgrid[0 : 6 * SIZE, 0 : 6 * SIZE : 61].reshape(2, -1) + 0.5
    rows = unrepeated(texture, a, b).reshape(6 * SIZE, -1).mean(axis=1)
    joint = np.argmin(rows[:lattice])
    at_joints = rows[joint::lattice]
    assert at_joints.max() < np.median(rows) - 2.0 * rows.std()

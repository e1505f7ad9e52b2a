"""Stochastic tiling: textures of the ground that do not repeat, as compiled loops.

Equal tiles side by side show the same picture every few metres, and a camera that moves by as much
from frame to frame seems to stand. So the plane is divided into cells as large as a tile. Each
shows the texture shifted and turned at random, and borders of cells wind and are blended. Textures
with joints are not turned, and shifted so that their joints stay in line.
"""

from __future__ import annotations

import math

from probevo.compiled import compiled
from probevo_sim.scene.texture_filter_numba import Footprint, sample
from probevo_sim.scene.textures import SIZE, Mipmaps

BLEND_CELLS = 0.2
"""Width over which neighbouring cells are blended."""
BEND_CELLS = 0.2
"""Amplitude with which the borders of cells wind."""
BEND_RAD = 3.0
"""Angle of that per cell."""

TURNS = 1024
"""Directions in which a tile may lie."""


@compiled
def sample_unrepeated(
    mipmaps: Mipmaps, layer: int, lattice_texels: int, footprint: Footprint
) -> float:
    """Return the mean of texture ``layer`` over a footprint of the plane, from −1 to 1.

    Args:
        mipmaps: the textures.
        layer: the texture.
        lattice_texels: distance after which its joints repeat; 1 without joints.
        footprint: on the plane, in texels of mip level 0; far from the origin it is on other cells.
    """
    # The place in cells, between the centres of four of them.
    along_a = footprint.a / SIZE
    along_b = footprint.b / SIZE
    bent_a = along_a + BEND_CELLS * math.sin(BEND_RAD * along_b) - 0.5
    bent_b = along_b + BEND_CELLS * math.sin(BEND_RAD * along_a) - 0.5
    cell_a = math.floor(bent_a)
    cell_b = math.floor(bent_b)
    share_a = _upper_share(bent_a - cell_a)
    share_b = _upper_share(bent_b - cell_b)

    total = 0.0
    for i in range(2):
        share_i = share_a if i else 1.0 - share_a
        for j in range(2):
            share = share_i * (share_b if j else 1.0 - share_b)
            if share == 0.0:
                continue
            placed = _placed(footprint, int(cell_a) + i, int(cell_b) + j, lattice_texels)
            total += share * sample(mipmaps, layer, placed)
    return total


@compiled
def _upper_share(between: float) -> float:
    """Return the share of the upper of two cells at a place between their centres, 0 … 1."""
    return min(max((between - 0.5) / BLEND_CELLS + 0.5, 0.0), 1.0)


@compiled
def _placed(footprint: Footprint, cell_a: int, cell_b: int, lattice_texels: int) -> Footprint:
    """Return where a footprint on the plane lies on the tile of a cell."""
    # A hash of the cell: large primes spread neighbours (Teschner et al., 2003), then the bits are
    # mixed.
    code = ((cell_a * 73856093) ^ (cell_b * 19349663)) & 0xFFFFFFFF
    for _ in range(2):
        code = ((code ^ (code >> 16)) * 0x45D9F3B) & 0xFFFFFFFF
    code ^= code >> 16
    shift_a = code % SIZE
    shift_b = (code // SIZE) % SIZE
    angle_rad = 0.0
    if lattice_texels == 1:
        angle_rad = 2.0 * math.pi * (code // (SIZE * SIZE) % TURNS) / TURNS
    c = math.cos(angle_rad)
    s = math.sin(angle_rad)
    return Footprint(
        a=c * footprint.a - s * footprint.b + shift_a - shift_a % lattice_texels,
        b=s * footprint.a + c * footprint.b + shift_b - shift_b % lattice_texels,
        a_by_u=c * footprint.a_by_u - s * footprint.b_by_u,
        a_by_v=c * footprint.a_by_v - s * footprint.b_by_v,
        b_by_u=s * footprint.a_by_u + c * footprint.b_by_u,
        b_by_v=s * footprint.a_by_v + c * footprint.b_by_v,
    )

"""A part that several objects of furniture are made of."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from probevo.geometry import se3
from probevo_sim.scene.solids import BOX, Solids, solid
from probevo_sim.scene.textures import Texture


def sloping(
    size: ArrayLike,
    top_middle: ArrayLike,
    texture: Texture | tuple[Texture, Texture, Texture],
    *,
    roll: float = 0.0,
    pitch: float = 0.0,
    tile: ArrayLike = 2.0,
    albedo: float = 0.4,
    contrast: float = 0.8,
) -> Solids:
    """Build a box whose upper face is tilted about its own middle.

    Args:
        size: extent along x, y and z, [3].
        top_middle: middle of the upper face, [3].
        texture: of all faces, or of front, sides and top.
        roll: angle about x, rad; lifts the left side.
        pitch: angle about y, rad; lowers the front.
        tile: side of one tile of the texture.
        albedo: mean reflectance.
        contrast: how far the texture varies the reflectance.
    """
    depth = np.asarray(size, float)[2]
    slab = solid(
        BOX,
        size,
        (0.0, 0.0, -0.5 * depth),
        texture=texture,
        tile_m=tile,
        albedo=albedo,
        contrast=contrast,
    )
    T_object_top = se3.exp(np.array([0.0, 0.0, 0.0, roll, pitch, 0.0]))
    T_object_top[:3, 3] = top_middle
    return slab.at(T_object_top)

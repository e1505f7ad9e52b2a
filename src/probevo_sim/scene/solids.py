"""Solids, which a scene is made of: textured boxes and ellipsoids, as one struct of arrays."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import ArrayLike

from probevo.arrays import BoolArray, FloatArray, IntArray
from probevo_sim.scene.textures import Texture

BOX = 0
ELLIPSOID = 1


@dataclass(frozen=True)
class Solids:
    """A collection of N solids, each posed in the frame of the object that it belongs to.

    A solid's own axes are x forward, y left, z up, with the origin in its middle. Face 0 looks
    along x (front and back), face 1 along y (the sides), face 2 along z (top and bottom); an
    ellipsoid takes the texture of the face that a box would have there. Texture coordinates run
    from the solid's lower corner in m: (y, z) on face 0, (x, z) on face 1, (x, y) on face 2.
    """

    shape: IntArray
    """BOX or ELLIPSOID, [N]."""
    T_object_solid: FloatArray
    """Pose in its object's frame, [N, 4, 4], m."""
    half_size_m: FloatArray
    """Half the extent along its own axes, [N, 3]."""
    object_index: IntArray
    """The object that it belongs to, [N]: 0 is the ground, which is at rest.

    Then follow the movers, then the own vehicle."""
    texture: IntArray
    """Texture of each face, [N, 3]."""
    tile_m: FloatArray
    """Size of one tile of the texture along the two axes of each face, [N, 3, 2], m."""
    shift_m: FloatArray
    """Where on its texture each solid begins, [N, 2], m; makes two equal solids look different."""
    albedo: FloatArray
    """Mean reflectance, [N], 0 … 1."""
    contrast: FloatArray
    """How far the texture varies the reflectance, albedo (1 + contrast (2 texture − 1)), [N]."""
    seen: BoolArray
    """Whether the camera sees it, [N]; if not, it only casts a shadow, as the own vehicle does."""

    def __len__(self) -> int:
        """Return the number of solids, N."""
        return len(self.shape)

    @staticmethod
    def none() -> Solids:
        """Return no solid at all."""
        one = solid(BOX, (1.0, 1.0, 1.0), (0.0, 0.0, 0.0), texture=Texture.PLAIN, tile_m=1.0)
        return Solids(**{f.name: getattr(one, f.name)[:0] for f in fields(Solids)})

    def of_object(self, index: int) -> Solids:
        """Return the same solids as parts of another object."""
        return replace(self, object_index=np.full(len(self), index))

    def at(self, T_object_part: FloatArray) -> Solids:
        """Return the same solids, moved as one by T_object_part, [4, 4], m.

        It maps their present frame to the object's.
        """
        return replace(self, T_object_solid=T_object_part @ self.T_object_solid)


def join(parts: Iterable[Solids]) -> Solids:
    """Concatenate several groups of solids, in their order."""
    groups = list(parts)
    return Solids(
        **{
            f.name: np.concatenate([getattr(group, f.name) for group in groups])
            for f in fields(Solids)
        }
    )


def solid(
    shape: int,
    size_m: ArrayLike,
    center_m: ArrayLike,
    *,
    texture: Texture | tuple[Texture, Texture, Texture],
    tile_m: ArrayLike,
    yaw_rad: float = 0.0,
    albedo: float = 0.45,
    contrast: float = 0.8,
    shift_m: ArrayLike = (0.0, 0.0),
    seen: bool = True,
) -> Solids:
    """Return one solid at rest, as a part of object 0.

    Args:
        shape: BOX or ELLIPSOID.
        size_m: extent along its own x (forward), y (left), z (up), [3].
        center_m: its middle in the frame of its object, [3]. The ground is at z = 0.
        texture: of all faces, or of faces 0 (front, back), 1 (sides), 2 (top).
        tile_m: side of one tile: one number for all, or broadcastable to [3, 2]: two axes for each
            face.
        yaw_rad: rotation about z, counter-clockwise seen from above.
        albedo: mean reflectance, 0 … 1.
        contrast: how far the texture varies it, 0 … 1.
        shift_m: where on its texture it begins.
        seen: False for a solid that only casts a shadow.
    """
    T_object_solid = np.eye(4)
    cosine = np.cos(yaw_rad)
    sine = np.sin(yaw_rad)
    T_object_solid[:2, :2] = [[cosine, -sine], [sine, cosine]]
    T_object_solid[:3, 3] = center_m
    textures = texture if isinstance(texture, tuple) else (texture, texture, texture)
    return Solids(
        shape=np.array([shape]),
        T_object_solid=T_object_solid[None],
        half_size_m=0.5 * np.array(size_m, dtype=np.float64)[None],
        object_index=np.zeros(1, dtype=np.int64),
        texture=np.array([[int(t) for t in textures]]),
        tile_m=np.broadcast_to(np.asarray(tile_m, dtype=np.float64), (3, 2))[None].copy(),
        shift_m=np.array(shift_m, dtype=np.float64)[None],
        albedo=np.array([albedo], dtype=np.float64),
        contrast=np.array([contrast], dtype=np.float64),
        seen=np.array([seen]),
    )

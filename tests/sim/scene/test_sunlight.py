"""Cast shadows fall where geometry says, and are as dark as the setting says."""

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo_sim.scene.config import Effects
from probevo_sim.scene.renderer import Renderer
from probevo_sim.scene.shading_numba import SWAY_RAD_S
from probevo_sim.scene.solids import BOX, Solids, join, solid
from probevo_sim.scene.sunlight_numba import LEAVES_DARKNESS
from probevo_sim.scene.textures import Texture
from sim.scene.small_world import CAMERA, HEIGHT_M, renderer, trajectory, world

SUN = np.array([0.0, 0.6, 0.8])
"""In the north, that is on the left of the camera."""


def roof() -> Solids:
    """Return an unseen slab of 4 m × 4 m, 4 m up, whose shadow lies 3 m to the right of it."""
    slab = solid(
        BOX, (4.0, 4.0, 0.01), (12.0, 3.0, 4.0), texture=Texture.PLAIN, tile_m=1.0, seen=False
    )
    return join(
        [slab, solid(BOX, (0.1, 0.1, 0.1), (-50.0, 0.0, 0.05), texture=Texture.PLAIN, tile_m=1.0)]
    )


def ground_place(image: FloatArray, east_m: float, right_m: float) -> float:
    """Return the radiance of the ground at a place before the camera.

    The camera stands at the origin and looks east.
    """
    u, v = CAMERA.project(np.array([right_m, HEIGHT_M, east_m]))[:2]
    return float(image[round(v), round(u)])


def lit_and_shaded(east_m: float, right_m: float) -> tuple[float, float]:
    place = world(roof(), sun=SUN)
    lit, _ = renderer(place, shadows=0.0).pair(0.0)
    shaded, _ = renderer(place, shadows=1.0).pair(0.0)
    return ground_place(lit, east_m, right_m), ground_place(shaded, east_m, right_m)


@pytest.mark.parametrize(("east_m", "right_m"), [(12.0, 0.0), (11.0, 1.5), (13.5, -1.5)])
def test_under_the_roofs_shadow_only_the_sky_gives_light(east_m: float, right_m: float) -> None:
    lit, shaded = lit_and_shaded(east_m, right_m)
    place = world()
    sky_share = place.sky_irradiance / (place.sky_irradiance + place.sun_irradiance * SUN[2])
    assert shaded / lit == pytest.approx(sky_share, abs=0.02)


@pytest.mark.parametrize(
    ("east_m", "right_m"), [(8.0, 0.0), (12.0, 4.0), (12.0, -3.5), (17.0, 0.0)]
)
def test_beside_it_there_is_sun_but_for_the_leaves(east_m: float, right_m: float) -> None:
    lit, shaded = lit_and_shaded(east_m, right_m)
    place = world()
    sun_share = (
        place.sun_irradiance * SUN[2] / (place.sky_irradiance + place.sun_irradiance * SUN[2])
    )
    assert 1.0 - LEAVES_DARKNESS * sun_share - 0.02 <= shaded / lit <= 1.0


def test_leaves_shade_some_of_the_ground_and_sway_in_the_wind() -> None:
    """Before a camera that stands, their shadows move aside and come back."""
    place = world(sun=SUN)
    camera_stands = trajectory(speed_m_s=0.0)
    rows = slice(90, 128)  # ground

    def ground(shadows: float, time_s: float) -> FloatArray:
        effects = Effects(shadows=shadows)
        left, _ = Renderer(place, camera_stands, CAMERA, effects=effects).pair(time_s)
        return left[rows].astype(np.float64)

    half_a_sway_s = np.pi / SWAY_RAD_S
    lit = ground(0.0, 0.0)
    first = ground(1.0, 0.0)
    assert 0.05 < np.mean(first < 0.9 * lit) < 0.95
    assert not np.allclose(first, ground(1.0, half_a_sway_s), atol=0.02)
    # A texture sample at the edge of a cell may fall on either side of it, by rounding.
    np.testing.assert_allclose(first, ground(1.0, 2.0 * half_a_sway_s), atol=1e-3)


def test_half_the_strength_is_half_as_dark() -> None:
    place = world(roof(), sun=SUN)
    none, half, full = (
        ground_place(renderer(place, shadows=s).pair(0.0)[0], 12.0, 0.0) for s in (0.0, 0.5, 1.0)
    )
    assert half == pytest.approx(0.5 * (none + full), rel=0.02)


def test_a_solid_does_not_shade_its_own_lit_face() -> None:
    """A wall that faces the sun, without leaves: the same with shadows and without."""
    wall = solid(BOX, (40.0, 1.0, 10.0), (20.0, -6.0, 5.0), texture=Texture.BRICK, tile_m=3.0)
    images = [renderer(world(wall, sun=SUN), shadows=s).pair(0.0)[0] for s in (0.0, 1.0)]
    u, v = np.round(CAMERA.project(np.array([5.5, -1.0, 20.0]))[:2]).astype(int)
    ratio = images[1][v, u - 5 : u + 5] / images[0][v, u - 5 : u + 5]
    np.testing.assert_allclose(ratio, 1.0, atol=1e-4)

"""A few solids on a plane, and a camera that drives past them, for the tests of the renderer."""

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera
from probevo_sim.scene.config import Effects
from probevo_sim.scene.drive import Trajectory
from probevo_sim.scene.renderer import Renderer
from probevo_sim.scene.route import Route
from probevo_sim.scene.solids import BOX, ELLIPSOID, Solids, join, solid
from probevo_sim.scene.textures import Texture
from probevo_sim.scene.world import Ground, Movers, World

CAMERA = StereoCamera(180.0, 180.0, 159.5, cv_px=63.5, baseline_m=0.54, size_px=(320, 128))
HEIGHT_M = 1.5
SPEED_M_S = 6.0
YAW_RATE_RAD_S = 0.05
WALL_M = 30.0
"""How far east the front of the wall is; the camera starts at the origin and looks east."""


def trajectory(speed_m_s: float = SPEED_M_S) -> Trajectory:
    """Return a drive eastwards that bends slowly to the left, without suspension.

    At no speed, the camera stands at the origin, and does not turn either.
    """
    yaw_rate_rad_s = YAW_RATE_RAD_S * speed_m_s / SPEED_M_S
    t_s = np.linspace(-1.0, 5.0, 121)
    zero = np.zeros_like(t_s)
    coordinates = np.stack(
        [
            speed_m_s * t_s,
            0.5 * speed_m_s * yaw_rate_rad_s * t_s**2,
            HEIGHT_M + zero,
            yaw_rate_rad_s * t_s,
            zero,
            zero,
        ],
        axis=1,
    )
    spline: BSpline = make_interp_spline(t_s, coordinates, k=5)
    return Trajectory(4.0, spline)


def things() -> Solids:
    """Return a wall across the view, a box to the left, and a sphere to the right."""
    return join(
        [
            solid(
                BOX, (1.0, 80.0, 16.0), (WALL_M + 0.5, 0.0, 8.0), texture=Texture.BRICK, tile_m=3.0
            ),
            solid(
                BOX,
                (2.0, 3.0, 2.5),
                (12.0, 4.0, 1.25),
                texture=Texture.FACADE_OLD,
                tile_m=3.0,
                yaw_rad=0.5,
            ),
            solid(ELLIPSOID, (2.0, 2.0, 2.0), (10.0, -3.0, 1.0), texture=Texture.ROCK, tile_m=2.0),
        ]
    )


def world(
    solids: Solids | None = None, movers: Movers | None = None, sun: FloatArray | None = None
) -> World:
    ground = Ground(
        Route.from_turns([(60.0, 0.0)]),
        edge_m=np.array([4.0, np.inf]),
        texture=np.array([Texture.ASPHALT, Texture.PAVING]),
        tile_m=np.array([4.0, 3.0]),
        albedo=np.array([0.4, 0.5]),
        contrast=np.array([0.8, 0.8]),
    )
    to_sun = np.array([-0.6, 0.0, 0.8]) if sun is None else sun
    return World(solids or things(), movers or Movers.none(), ground, to_sun=to_sun)


def renderer(scene: World | None = None, **effects: float) -> Renderer:
    return Renderer(scene or world(), trajectory(), CAMERA, effects=Effects(**effects))

"""The world, which is the first camera, against the horizon and north, and where it is."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.geometry import so3
from probevo.measurements.variables import Variable

NORTH = Variable(kind="north", frame=0)
"""Its value is (tilt about east, tilt about north, heading), [3], rad: the first camera's heading,
clockwise from north, and by how much it is not level. Plain addition moves it."""
ORIGIN = Variable(kind="origin", frame=0)
"""Its value is the position of the first camera in east, north and up, [3], m. Plain addition moves
it."""
WORLD_STATES = frozenset({NORTH, ORIGIN})
"""What is estimated of the world, which is the first camera, where a measurement needs it."""
LEVEL = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""C_world_enu of a level first camera that looks north: x is east, y down, z north."""


def attitude_of_enu(north: FloatArray) -> FloatArray:
    """Return C_world_enu, [3, 3], which maps directions in east, north and up to the world."""
    matrix: FloatArray = LEVEL @ so3.exp(_tilt(north)) @ _about_up(float(north[2]))
    return matrix


def jacobian_of_enu(north: FloatArray, direction_enu: FloatArray) -> FloatArray:
    """Return ∂(C_world_enu d)/∂north of a direction d in east, north and up, [3], as [3, 3]."""
    tilt = _tilt(north)
    turned = _about_up(float(north[2])) @ direction_enu
    tilted = so3.exp(tilt) @ turned
    jacobian = np.empty((3, 3))
    # The tilt has no component about up: that rotation is the heading.
    jacobian[:, :2] = (-LEVEL @ so3.wedge(tilted) @ so3.left_jacobian(tilt))[:, :2]
    # e_z × the turned direction: the heading turns it about up.
    jacobian[:, 2] = LEVEL @ so3.exp(tilt) @ np.array([-turned[1], turned[0], 0.0])
    return jacobian


def _tilt(north: FloatArray) -> FloatArray:
    return np.array([north[0], north[1], 0.0])


def _about_up(angle_rad: float) -> FloatArray:
    return so3.exp(np.array([0.0, 0.0, angle_rad]))

"""The position of the camera, as from a satellite receiver."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.errors import InputError
from probevo.geometry import se3, so3
from probevo.measurements.arguments import as_array
from probevo.measurements.north import NORTH, ORIGIN, attitude_of_enu, jacobian_of_enu
from probevo.measurements.variables import Values, Variable
from probevo.measurements.vector_measurement import VectorMeasurement

VAGUENESS = 1e3
"""Standard deviation of the first camera's position before the first fix, as a multiple of the
fix's."""


class Position(VectorMeasurement):
    """A measured position in east, north and up, of an antenna that is fixed to the camera.

    Where the first camera is, and how it looks relative to north, is estimated with the pose
    (``ORIGIN``, ``NORTH``). Its heading must be known to some degrees (``north.heading_deg``), as
    from the course of the first fixes: with an unknown one, the first metres of a path would
    determine it, to which the fixes are far too coarse.

    Args:
        pose: pose of the camera.
        position_m: east, north and up from any fixed point, [3], m.
        covariance: [3, 3], m².
        lever_m: the antenna in the camera's frame, [3], m.

    Raises:
        InputError: a position or a lever is not a vector [3], the lever not finite, or the
            covariance not positive definite.
    """

    def __init__(
        self,
        pose: Variable,
        position_m: FloatArray,
        covariance: FloatArray,
        *,
        lever_m: FloatArray | None = None,
    ) -> None:
        super().__init__(covariance, dim=3)
        self.pose = pose
        self.position_m = as_array(position_m, (3,), "Position: position_m")
        lever_m = np.zeros(3) if lever_m is None else lever_m
        self.lever_m = as_array(lever_m, (3,), "Position: lever_m")
        if not np.isfinite(self.lever_m).all():
            cure = "Measure where the antenna is in the camera's frame."
            raise InputError("Position: lever_m", "it is not finite.", cure)

    @property
    def variables(self) -> tuple[Variable, ...]:
        """The pose, the attitude of the world relative to north, and the position of the first
        camera."""
        return (self.pose, NORTH, ORIGIN)

    def residual(self, values: Values) -> FloatArray:
        """Return measured minus predicted position, [3], m."""
        residual: FloatArray = self.position_m - values[ORIGIN] - self._from_origin(values)
        return residual

    def jacobians(self, values: Values) -> tuple[FloatArray, ...]:
        """Return the Jacobians of e by the pose, [3, 6], by north and by the origin, [3, 3]
        each."""
        C_enu_world = attitude_of_enu(values[NORTH]).T
        # T_world_cam Exp(−ξ) moves the antenna l by C_world_cam (−ρ + l^ φ).
        C_enu_cam = C_enu_world @ values[self.pose][:3, :3].T
        pose_jacobian = np.hstack([C_enu_cam, -C_enu_cam @ so3.wedge(self.lever_m)])
        # d = C_enu_world p with p fixed: 0 = ∂C_world_enu d + C_world_enu ∂d.
        moved = jacobian_of_enu(values[NORTH], self._from_origin(values))
        return pose_jacobian, C_enu_world @ moved, -np.eye(3)

    def origin_m(self, values: Values) -> FloatArray:
        """Return where the first camera is by this measurement alone, [3], m."""
        origin: FloatArray = self.position_m - self._from_origin(values)
        return origin

    def _from_origin(self, values: Values) -> FloatArray:
        """Return the antenna from the first camera in east, north and up, [3], m."""
        antenna_in_world_m = se3.transform(se3.inverse(values[self.pose]), self.lever_m[None])[0]
        from_origin: FloatArray = attitude_of_enu(values[NORTH]).T @ antenna_in_world_m
        return from_origin

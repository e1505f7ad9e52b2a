"""A known direction, such as that of the sun or of gravity, measured in the camera's frame."""

from __future__ import annotations

import math

import numpy as np

from probevo.arrays import FloatArray
from probevo.errors import InputError
from probevo.measurements.base import Values, Variable, VectorMeasurement
from probevo.measurements.north import attitude_of_enu, jacobian_of_enu

LEAST_SINE = 1e-12
"""Sine of an angle below which two directions are the same, or opposite."""


class Direction(VectorMeasurement):
    """A unit vector u measured in the camera, of a direction d known elsewhere (thesis chapter 5).

    With p = C d the predicted direction, the residual is −Bᵀ Log_u(p): the angle between the two,
    in the tangent plane of the sphere at u. Its axes B are those of azimuth and zenith, az =
    atan2(x, z) and zen = acos(−y). There, unlike in the angles themselves, nothing is singular
    where the zenith is measured, and no angle wraps.

    Args:
        pose: pose of the camera.
        in_camera: u, [3]; its length does not matter.
        known: d, [3], in the world, which is the first camera; or, with ``north``, in east, north
            and up.
        covariance: in the tangent plane, [2, 2], rad², in its directions of azimuth and zenith.
        north: ``NORTH`` if ``known`` is in east, north and up; the attitude of the world against
            them is then estimated, too.

    Raises:
        InputError: a direction is not finite or zero, or the covariance not positive definite.
    """

    def __init__(
        self,
        pose: Variable,
        in_camera: FloatArray,
        known: FloatArray,
        covariance: FloatArray,
        *,
        north: Variable | None = None,
    ) -> None:
        super().__init__(covariance)
        if self.covariance.shape != (2, 2):
            what = f"its covariance is {self.covariance.shape}."
            raise InputError("Direction", what, "It is [2, 2], of azimuth and zenith.")
        self.pose = pose
        self.in_camera = _unit(in_camera, "in_camera")
        self.known = _unit(known, "known")
        self.north = north
        self._axes = tangent_axes(self.in_camera)

    @staticmethod
    def of_angles(
        pose: Variable,
        angles_rad: tuple[float, float],
        known: FloatArray,
        covariance: FloatArray,
        *,
        north: Variable | None = None,
    ) -> Direction:
        """Return the measurement of an azimuth and a zenith angle in the camera, rad.

        Args:
            pose: pose of the camera.
            angles_rad: azimuth atan2(x, z) and zenith angle acos(−y).
            known: the same direction, as of the constructor.
            covariance: of these two angles, [2, 2], rad².
            north: as of the constructor.

        Raises:
            InputError: the zenith itself is measured, where an azimuth has no meaning.
        """
        azimuth, zenith = angles_rad
        shrunk = np.diag([math.sin(zenith), 1.0])
        return Direction(
            pose,
            of_azimuth_and_zenith(azimuth, zenith),
            known,
            shrunk @ np.asarray(covariance, np.float64) @ shrunk,
            north=north,
        )

    @property
    def variables(self) -> tuple[Variable, ...]:
        """The pose, and the attitude of the world against north if that is needed."""
        return (self.pose,) if self.north is None else (self.pose, self.north)

    def residual(self, values: Values) -> FloatArray:
        """Return −Bᵀ Log_u(p), [2], rad."""
        predicted = values[self.pose][:3, :3] @ self._in_world(values)
        cosine = float(self.in_camera @ predicted)
        sine = float(np.linalg.norm(np.cross(self.in_camera, predicted)))
        if sine < LEAST_SINE:
            # Opposite to what was measured: any way around is as short.
            return np.zeros(2) if cosine > 0.0 else np.array([math.pi, 0.0])
        return -(math.atan2(sine, cosine) / sine) * (self._axes.T @ predicted)

    def jacobians(self, values: Values) -> tuple[FloatArray, ...]:
        """Return ∂e/∂ξ of the pose, [2, 6], and that of the attitude against north, [2, 3].

        With Log_u(p) = (θ/sin θ)(p − cos θ u), its derivative by p is

            (θ/sin θ)(1 − u uᵀ) − ((sin θ − θ cos θ)/sin³θ)(p − cos θ u) uᵀ,

        and p moves by φ × p with the attitude.
        """
        C_cam_world = values[self.pose][:3, :3]
        predicted = C_cam_world @ self._in_world(values)
        of_predicted = self._by_predicted(predicted)
        of_pose = np.zeros((2, 6))
        of_pose[:, 3:] = -of_predicted @ np.cross(predicted, np.eye(3)).T
        if self.north is None:
            return (of_pose,)
        of_enu = jacobian_of_enu(values[self.north], self.known)
        return of_pose, of_predicted @ C_cam_world @ of_enu

    def _in_world(self, values: Values) -> FloatArray:
        if self.north is None:
            return self.known
        in_world: FloatArray = attitude_of_enu(values[self.north]) @ self.known
        return in_world

    def _by_predicted(self, predicted: FloatArray) -> FloatArray:
        """Return ∂e/∂p, [2, 3]."""
        cosine = float(self.in_camera @ predicted)
        sine = float(np.linalg.norm(np.cross(self.in_camera, predicted)))
        in_plane = self._axes.T @ predicted
        if sine < 1e-4:  # the series, whose next terms are of the second order
            return -(self._axes.T - np.outer(in_plane, self.in_camera) / 3.0)
        angle = math.atan2(sine, cosine)
        bend = (sine - angle * cosine) / sine**3
        return -(angle / sine * self._axes.T - bend * np.outer(in_plane, self.in_camera))


def of_azimuth_and_zenith(azimuth_rad: float, zenith_rad: float) -> FloatArray:
    """Return the unit vector in the camera of az = atan2(x, z) and zen = acos(−y), [3]."""
    return np.array(
        [
            math.sin(zenith_rad) * math.sin(azimuth_rad),
            -math.cos(zenith_rad),
            math.sin(zenith_rad) * math.cos(azimuth_rad),
        ]
    )


def tangent_axes(direction: FloatArray) -> FloatArray:
    """Return the directions in which azimuth and zenith angle of a unit vector grow, [3, 2].

    Straight up and straight down, where there is no azimuth, it is taken as zero.
    """
    x, y, z = direction.tolist()
    level = math.hypot(x, z)
    sine, cosine = (x / level, z / level) if level > LEAST_SINE else (0.0, 1.0)
    of_azimuth = np.array([cosine, 0.0, -sine])
    of_zenith = np.array([-y * sine, level, -y * cosine])
    return np.stack([of_azimuth, of_zenith], axis=1)


def _unit(direction: FloatArray, name: str) -> FloatArray:
    """Return a direction as a unit vector, [3].

    Raises:
        InputError: it has no direction.
    """
    vector = np.asarray(direction, dtype=np.float64)
    if vector.shape != (3,) or not np.isfinite(vector).all() or not vector.any():
        raise InputError(f"Direction: {name}", "it is not a finite vector [3] other than zero.")
    unit: FloatArray = vector / np.linalg.norm(vector)
    return unit

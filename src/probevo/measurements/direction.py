"""A known direction, such as the sun's or gravity's, measured in the camera's frame."""

from __future__ import annotations

import math

import numpy as np

from probevo.arrays import FloatArray
from probevo.errors import InputError, brief
from probevo.geometry import so3
from probevo.measurements.arguments import as_array, as_number
from probevo.measurements.north import attitude_of_enu, jacobian_of_enu
from probevo.measurements.variables import Values, Variable
from probevo.measurements.vector_measurement import VectorMeasurement

MAX_ANGLE_RAD = 3.0
"""Angle at which the derivative across the residual is capped; at π it is infinite."""
MIN_SINE = 1e-12
"""Sine of an angle below which two directions are the same, or opposite."""
MIN_SINE_OF_ZENITH = 1e-3
"""Sine of a zenith angle below which a direction counts as straight up or down, 0.06° from it: its
azimuth has no meaning."""


class Direction(VectorMeasurement):
    """A unit vector u measured in the camera, of a direction d known elsewhere (thesis chapter 5).

    With p = C d the predicted direction, the residual is Bᵀ Log_p(u): the angle between the two, in
    the tangent plane of the sphere at p. Its axes B are the directions of azimuth and zenith angle,
    az = atan2(x, z) and zen = acos(−y). Unlike the angles, it does not wrap. The plane is tangent
    at p and not at u: the noise of u would rotate the axes, and with them the Jacobians, and a
    constant offset of the sensor, if it is estimated, would drift away within a few hundred
    measurements.

    Args:
        pose: pose of the camera.
        in_camera: u, [3]; its length does not matter. NaN where the sensor has seen nothing.
        known: d, [3], in the world, which is the first camera; or, with ``north``, in east, north
            and up.
        covariance: in the tangent plane, along its directions of azimuth and zenith, [2, 2],
            rad².
        north: ``NORTH`` if ``known`` is in east, north and up; the attitude of the world relative
            to them is then estimated, too.

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
        super().__init__(covariance, dim=2)
        self.pose = pose
        measured = as_array(in_camera, (3,), "Direction: in_camera")
        self.in_camera = measured if np.isnan(measured).any() else _unit(measured, "in_camera")
        self.known = _unit(known, "known")
        self.north = north

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
            angles_rad: azimuth atan2(x, z) and zenith angle acos(−y); NaN where the sensor has
                seen nothing.
            known: the same direction, as in the constructor.
            covariance: of these two angles, [2, 2], rad².
            north: as in the constructor.

        Raises:
            InputError: the direction is straight up or down, where an azimuth has no meaning, the
                zenith angle is not from 0 to π, or an argument holds something else than numbers.
        """
        if np.shape(angles_rad) != (2,):
            what = f"is {brief(angles_rad)}."
            raise InputError("Direction: angles_rad", what, "Give azimuth and zenith angle.")
        azimuth, zenith = (as_number(angle, "Direction: angles_rad") for angle in angles_rad)
        covariance = as_array(covariance, (2, 2), "Direction: covariance")
        if math.isnan(azimuth) or math.isnan(zenith):
            return Direction(pose, np.full(3, math.nan), known, covariance, north=north)
        sine = math.sin(zenith) if 0.0 <= zenith <= math.pi else math.nan
        if not sine > MIN_SINE_OF_ZENITH:
            what = f"a zenith angle of {zenith} rad has no azimuth, or is outside 0 … π."
            cure = "It is from 0, upwards, to π. Give a direction straight up or down as a vector."
            raise InputError("Direction: angles_rad", what, cure)
        shrunk = np.diag([sine, 1.0])
        return Direction(
            pose,
            of_azimuth_and_zenith(azimuth, zenith),
            known,
            shrunk @ covariance @ shrunk,
            north=north,
        )

    @property
    def variables(self) -> tuple[Variable, ...]:
        """The pose, and the attitude of the world relative to north if that is needed."""
        return (self.pose,) if self.north is None else (self.pose, self.north)

    def residual(self, values: Values) -> FloatArray:
        """Return Bᵀ Log_p(u), [2], rad."""
        predicted = values[self.pose][:3, :3] @ self._known_in_world(values)
        cosine = float(self.in_camera @ predicted)
        # Bᵀ u has the length sin θ; Bᵀ Log_p(u) has the same direction and the length θ.
        tangent = tangent_axes(predicted).T @ self.in_camera
        sine = math.hypot(tangent[0], tangent[1])
        if sine < MIN_SINE:
            # Either equal, or opposite, where e has no direction: choose one.
            return np.zeros(2) if cosine > 0.0 else np.array([math.pi, 0.0])
        residual: FloatArray = math.atan2(sine, cosine) / sine * tangent
        return residual

    def jacobians(self, values: Values) -> tuple[FloatArray, ...]:
        """Return the Jacobians of e by the pose, [2, 6], and by the attitude relative to north,
        [2, 3].

        It is the covariant derivative: as p moves, the axes are transported without rotating about
        it. A rotation of the axes would change neither the length of e nor the cost, but it would
        change the information. If p moves towards u, e shrinks as much; if it moves across, e
        changes by the fraction θ/tan θ, with θ the length of e.
        """
        C_cam_world = values[self.pose][:3, :3]
        predicted = C_cam_world @ self._known_in_world(values)
        residual = self.residual(values)
        angle = float(np.linalg.norm(residual))
        shrinks = np.eye(2)
        if angle > 1e-6:
            towards = residual / angle
            across = angle / math.tan(min(angle, MAX_ANGLE_RAD))
            shrinks = across * np.eye(2) + (1.0 - across) * np.outer(towards, towards)
        # ∂e/∂p, [2, 3]; p = C d moves by φ × p = −p^ φ.
        direction_jacobian = -shrinks @ tangent_axes(predicted).T
        pose_jacobian = np.zeros((2, 6))
        pose_jacobian[:, 3:] = -direction_jacobian @ so3.wedge(predicted)
        if self.north is None:
            return (pose_jacobian,)
        world_jacobian = jacobian_of_enu(values[self.north], self.known)
        return pose_jacobian, direction_jacobian @ C_cam_world @ world_jacobian

    def _known_in_world(self, values: Values) -> FloatArray:
        if self.north is None:
            return self.known
        known_in_world: FloatArray = attitude_of_enu(values[self.north]) @ self.known
        return known_in_world


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
    sine, cosine = (x / level, z / level) if level > MIN_SINE else (0.0, 1.0)
    azimuth_axis = np.array([cosine, 0.0, -sine])
    zenith_axis = np.array([-y * sine, level, -y * cosine])
    return np.stack([azimuth_axis, zenith_axis], axis=1)


def _unit(direction: FloatArray, name: str) -> FloatArray:
    """Return a direction as a unit vector, [3].

    Raises:
        InputError: it has no direction.
    """
    vector = as_array(direction, (3,), f"Direction: {name}")
    if not np.isfinite(vector).all() or not vector.any():
        raise InputError(f"Direction: {name}", "it is not a finite vector [3] other than zero.")
    unit: FloatArray = vector / np.linalg.norm(vector)
    return unit

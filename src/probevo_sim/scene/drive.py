"""The motion of the rig along a road: a smooth trajectory with exact derivatives."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BSpline, make_interp_spline
from scipy.spatial.transform import Rotation

from probevo.arrays import FloatArray
from probevo.errors import InputError
from probevo.sequences.imu_calibration import GRAVITY_M_S2
from probevo_sim.scene.pace import Pace
from probevo_sim.scene.route import Route

C_BODY_CAM = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Rotation from the camera (x right, y down, z forward) to the body (x forward, y left, z up)."""

_KNOT_STEP_S = 0.05
"""Distance between the knots of the splines, or a little less."""
_MARGIN_S = 0.5
"""The splines reach this far beyond both ends."""
_LATERAL_M_S2 = 1.8
"""Largest lateral acceleration in a curve."""
_WANDER_RMS_M = 0.1
"""Lateral deviation from the planned path."""
_WANDER_FADE_M = 15.0
"""Distance from an end at rest over which the deviation grows from 0."""
_PITCH_RMS_RAD = 2.6e-3
_ROLL_RMS_RAD = 1.75e-3
_HEIGHT_RMS_M = 0.01
"""Motion of the suspension at high speed."""
_SINES = 4
"""Sine waves that each random motion is the sum of."""
_SWAY_RMS = np.array([0.12, 0.12, 0.08, *np.deg2rad([15.0, 8.0, 8.0])])
"""Motion of a rig that a person or a drone swings, of (x, y, z, yaw, pitch, roll), m and rad."""
_SWAY_HZ = (0.2, 1.8)
"""Frequencies of this motion."""
_CARRIED_SPEED_M_S = 1.3
_CARRIED_HEIGHT_M = 1.5


@dataclass(frozen=True)
class DrivePlan:
    """A plan of a drive: where along a route, and how fast.

    Distances count along the route's centre line.
    """

    start_m: float
    distance_m: float
    speed_m_s: float
    """Cruising speed; curves and halts may force a lower one."""
    height_m: float = 1.65
    """Height of the camera above the road."""
    pitch_down_rad: float = 0.0
    lateral_m: float = 0.0
    """Distance of the camera to the left of the centre line; negative when driving on the right."""
    stops_m: tuple[float, ...] = ()
    """Distances driven at which to halt for 1.5 s; those not within the drive are left out."""
    from_rest: bool = False
    """Whether the vehicle stands at the start."""
    to_rest: bool = False
    """Whether the vehicle stands at the end."""
    shake: float = 1.0
    """Amplitude of the suspension's motion.

    1 is 0.15° of pitch, 0.1° of roll and 1 cm of height, rms, at high speed."""
    carried: float = 0.0
    """How much the rig sways in all directions, carried by a person or a drone; 0 is a vehicle.

    1 is 15° of yaw, 8° of pitch and roll, and 0.1 m, rms, at 0.2 to 1.8 Hz."""

    def carried_by_hand(self, strength: float) -> DrivePlan:
        """Return the same drive at walking pace and at a person's height, with the rig swaying."""
        return replace(
            self,
            speed_m_s=min(self.speed_m_s, _CARRIED_SPEED_M_S),
            height_m=_CARRIED_HEIGHT_M,
            carried=strength,
        )


@dataclass(frozen=True, eq=False)
class Trajectory:
    """The motion of the left camera as quintic splines over time, whose derivatives are exact.

    Everything is defined up to 0.5 s beyond both ends, where the drive continues as at the ends.
    """

    duration_s: float
    coordinates: BSpline
    """(x, y, z, yaw, pitch, roll) in the world, m and rad, over time, s.

    The vehicle's axes (x forward, y left, z up) follow from the world's by rotations about z, then
    y, then x; the camera's follow from the vehicle's by ``C_BODY_CAM``. Pitch is positive nose
    down."""

    @staticmethod
    def along(route: Route, plan: DrivePlan, rng: np.random.Generator) -> Trajectory:
        """Drive along a route; another ``rng`` drives the same road a little differently.

        The vehicle deviates sideways from the planned path by 0.1 m rms, and its suspension
        oscillates at 1 to 2 Hz with an amplitude that grows with the speed as v / (v + 2 m/s). A
        rig that is carried sways in all directions besides. At an end at rest the pose is exactly
        the planned one.

        Args:
            route: the road.
            plan: where to drive, and how fast.
            rng: source of the deviation and of the oscillation.

        Raises:
            InputError: distance, speed or height is not positive.
        """
        if min(plan.distance_m, plan.speed_m_s, plan.height_m) <= 0:
            what = (
                f"distance {plan.distance_m} m, speed {plan.speed_m_s} m/s, height"
                f" {plan.height_m} m."
            )
            raise InputError("drive", what, "All three must be positive.")
        # Distance over time.
        pace = Pace.within(
            lambda d: _speed_limit(route, plan, d),
            plan.distance_m,
            plan.stops_m,
            from_rest=plan.from_rest,
            to_rest=plan.to_rest,
        )

        # Times of the knots, chosen so that both ends are knots.
        steps = int(np.ceil(pace.duration_s / _KNOT_STEP_S))
        beyond = int(np.ceil(_MARGIN_S / _KNOT_STEP_S)) + 1
        knot_step_s = pace.duration_s / steps
        t_s = np.linspace(
            -beyond * knot_step_s, pace.duration_s + beyond * knot_step_s, steps + 2 * beyond + 1
        )

        # Coordinates of the camera at the knots; the heading follows the direction of travel.
        driven_m = pace.distance(t_s)
        wander_m, wander_slope = _wander(plan, driven_m, rng)
        s_m = plan.start_m + driven_m
        lateral_m = plan.lateral_m + wander_m
        drift = np.arctan2(wander_slope, 1.0 - route.curvature(s_m) * lateral_m)
        pitch, roll, height = _suspension(plan, t_s, pace.speed(t_s), rng=rng)
        coordinates = [
            *route.place(s_m, lateral_m)[:, :2, 3].T,
            plan.height_m + height,
            route.heading(s_m) + drift,
            plan.pitch_down_rad + pitch,
            roll,
        ]
        places = np.stack(coordinates, axis=1)
        if plan.carried > 0.0:
            places += _sway(plan, t_s, pace.speed(t_s), rng=rng)
        return Trajectory(pace.duration_s, make_interp_spline(t_s, places, k=5))

    def T_world_cam(self, t_s: ArrayLike) -> FloatArray:
        """Return the pose of the left camera at times [...], s: [..., 4, 4], m."""
        coordinates = self.coordinates(np.asarray(t_s, float))
        T_world_cam = np.zeros((*coordinates.shape[:-1], 4, 4))
        T_world_cam[..., :3, :3] = _rotation(coordinates[..., 3:]) @ C_BODY_CAM
        T_world_cam[..., :3, 3] = coordinates[..., :3]
        T_world_cam[..., 3, 3] = 1.0
        return T_world_cam

    def velocity(self, t_s: ArrayLike) -> FloatArray:
        """Return the velocity of the left camera in the world at times [...], s: [..., 3], m/s."""
        velocity: FloatArray = self._rates(np.asarray(t_s, float))[..., :3]
        return velocity

    def angular_rate(self, t_s: ArrayLike) -> FloatArray:
        """Return the angular rate of the left camera at times [...], s: [..., 3], rad/s.

        The rate is that against the world, in the camera's axes.
        """
        t_s = np.asarray(t_s, float)
        _, pitch, roll = np.moveaxis(self.coordinates(t_s)[..., 3:], -1, 0)
        yaw_rate, pitch_rate, roll_rate = np.moveaxis(self._rates(t_s)[..., 3:], -1, 0)
        # Rates of Euler angles in the axes of the body.
        body_rate = [
            roll_rate - yaw_rate * np.sin(pitch),
            pitch_rate * np.cos(roll) + yaw_rate * np.cos(pitch) * np.sin(roll),
            yaw_rate * np.cos(pitch) * np.cos(roll) - pitch_rate * np.sin(roll),
        ]
        rate: FloatArray = np.stack(body_rate, axis=-1) @ C_BODY_CAM
        return rate

    def specific_force(self, t_s: ArrayLike) -> FloatArray:
        """Return the specific force at the left camera at times [...], s: [..., 3], m/s².

        Specific force is acceleration minus gravity, which an accelerometer measures. It is given
        in the camera's axes.
        """
        t_s = np.asarray(t_s, float)
        force = self._accelerations(t_s)[..., :3] + [0.0, 0.0, GRAVITY_M_S2]
        C_world_body = _rotation(self.coordinates(t_s)[..., 3:])
        force_camera: FloatArray = (force[..., None, :] @ C_world_body)[..., 0, :] @ C_BODY_CAM
        return force_camera

    @cached_property
    def _rates(self) -> BSpline:
        return self.coordinates.derivative()

    @cached_property
    def _accelerations(self) -> BSpline:
        return self.coordinates.derivative(2)


def _rotation(yaw_pitch_roll: FloatArray) -> FloatArray:
    """Return C_world_body of angles [..., 3], rad: [..., 3, 3]."""
    C_world_body = Rotation.from_euler("ZYX", yaw_pitch_roll.reshape(-1, 3)).as_matrix()
    return C_world_body.reshape(*yaw_pitch_roll.shape, 3)


def _speed_limit(route: Route, plan: DrivePlan, driven_m: FloatArray) -> FloatArray:
    """Return the cruising speed, or less where the lateral acceleration would be too high, m/s."""
    curvature = route.curvature(plan.start_m + driven_m)
    # At speed v along the centre line, a path at lateral d is driven at v (1 − κ d) and has the
    # curvature κ / (1 − κ d): its lateral acceleration is v² κ (1 − κ d).
    per_speed_squared = np.abs(curvature * (1.0 - curvature * plan.lateral_m))
    limit_m_s = np.sqrt(_LATERAL_M_S2 / np.maximum(per_speed_squared, 1e-9))
    return np.minimum(plan.speed_m_s, limit_m_s)


def _wander(
    plan: DrivePlan, driven_m: FloatArray, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Return a slow random offset to the left, m, and its slope along the road, [J] each.

    Both are 0 at the ends that are at rest.
    """
    wave_number = 2.0 * np.pi / rng.uniform(40.0, 120.0, _SINES)
    phase = rng.uniform(0.0, 2.0 * np.pi, _SINES)
    angle = driven_m[:, None] * wave_number + phase
    scale = _WANDER_RMS_M * np.sqrt(2.0 / _SINES)
    offset = scale * np.sin(angle).sum(axis=1)
    slope = scale * (wave_number * np.cos(angle)).sum(axis=1)

    # A quintic step, whose first two derivatives are 0 at both ends, fades the offset in.
    fade_m = min(_WANDER_FADE_M, 0.5 * plan.distance_m)
    for is_at_rest, sign, end_m in (
        (plan.from_rest, 1.0, 0.0),
        (plan.to_rest, -1.0, plan.distance_m),
    ):
        if is_at_rest:
            u = np.clip(sign * (driven_m - end_m) / fade_m, 0.0, 1.0)
            fade = u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
            fade_slope = sign * 30.0 * (u * (1.0 - u)) ** 2 / fade_m
            slope = fade * slope + fade_slope * offset
            offset = fade * offset
    return offset, slope


def _suspension(
    plan: DrivePlan, t_s: FloatArray, speed_m_s: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Return pitch, roll, rad, and height, m, of the body on its springs, [3, J]; 0 at rest."""
    frequency_hz = rng.uniform(1.0, 2.0, (3, _SINES, 1))
    phase = rng.uniform(0.0, 2.0 * np.pi, (3, _SINES, 1))
    sway = np.sin(2.0 * np.pi * frequency_hz * t_s + phase).sum(axis=1) * np.sqrt(2.0 / _SINES)
    rms = np.array([_PITCH_RMS_RAD, _ROLL_RMS_RAD, _HEIGHT_RMS_M])
    motion: FloatArray = plan.shake * rms[:, None] * sway * (speed_m_s / (speed_m_s + 2.0))
    return motion


def _sway(
    plan: DrivePlan, t_s: FloatArray, speed_m_s: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Return what a rig that is carried adds to (x, y, z, yaw, pitch, roll), [J, 6]; 0 at rest."""
    frequency_hz = rng.uniform(*_SWAY_HZ, (_SINES, 6))
    phase = rng.uniform(0.0, 2.0 * np.pi, (_SINES, 6))
    waves = np.sin(2.0 * np.pi * frequency_hz * t_s[:, None, None] + phase).sum(axis=1)
    fade = speed_m_s / (speed_m_s + 0.1)
    sway: FloatArray = plan.carried * np.sqrt(2.0 / _SINES) * _SWAY_RMS * waves * fade[:, None]
    return sway

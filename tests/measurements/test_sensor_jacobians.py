"""Direction, heading and travelled distance: Jacobians, closed forms, refusals."""

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo.errors import InputError
from probevo.geometry import se3, so3
from probevo.measurements.direction import Direction, of_azimuth_and_zenith, tangent_axes
from probevo.measurements.heading import Heading
from probevo.measurements.north import LEVEL, NORTH, ORIGIN, attitude_of_enu
from probevo.measurements.position import Position
from probevo.measurements.relative_pose import RelativePose
from probevo.measurements.travelled_distance import TravelledDistance
from probevo.measurements.variables import Values, dimension, pose_of, retract
from probevo.measurements.vector_measurement import VectorMeasurement, numeric_jacobians

PREV = pose_of(6)
POSE = pose_of(7)
COV = np.array([[0.04, 0.01], [0.01, 0.09]])


def random_measurements(rng: np.random.Generator) -> list[VectorMeasurement]:
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    return [
        Heading(POSE, rng.uniform(-3.0, 3.0), 0.1),
        Heading(POSE, rng.uniform(-3.0, 3.0), 0.1, north=NORTH),
        Position(POSE, rng.normal(size=3), np.eye(3), lever_m=rng.normal(size=3)),
        TravelledDistance(1.2, 0.1, POSE, axis=axis),
        TravelledDistance(1.2, 0.1, POSE, PREV, axis=axis),
        RelativePose(se3.exp(rng.normal(size=6)), np.eye(6), POSE),
        RelativePose(se3.exp(rng.normal(size=6)), np.eye(6), POSE, PREV),
    ]


@pytest.mark.parametrize("seed", range(20))
def test_jacobians_are_central_differences(seed: int) -> None:
    rng = np.random.default_rng(seed)
    values = {
        PREV: se3.exp(rng.normal(size=6)),
        POSE: se3.exp(rng.normal(size=6)),
        NORTH: rng.normal(scale=[0.3, 0.3, 2.0]),
        ORIGIN: rng.normal(size=3),
    }
    for measurement in random_measurements(rng):
        numeric = numeric_jacobians(measurement, values)
        for found, expected in zip(measurement.jacobians(values), numeric, strict=True):
            scale = 1.0 + np.abs(expected).max()
            np.testing.assert_allclose(found / scale, expected / scale, atol=1e-7)


def transported(axes: FloatArray, start: FloatArray, end: FloatArray) -> FloatArray:
    """Return axes of the tangent plane at one direction as they move to another along the arc."""
    axis = np.cross(start, end)
    sine = np.linalg.norm(axis)
    if sine < 1e-12:
        return axes
    return so3.exp(axis / sine * np.arctan2(sine, start @ end)) @ axes


@pytest.mark.parametrize("seed", range(20))
def test_the_jacobian_of_a_direction_is_that_of_axes_that_do_not_turn(seed: int) -> None:
    """By central differences of Bᵀ Log_p(u), with B moved from p along the arc; with north, too."""
    rng = np.random.default_rng(seed)
    values = {POSE: se3.exp(rng.normal(size=6)), NORTH: rng.normal(scale=[0.3, 0.3, 2.0])}
    u, d = rng.normal(size=(2, 3))
    C_cam_enu = values[POSE][:3, :3] @ attitude_of_enu(values[NORTH])
    if u @ C_cam_enu @ d < 0.0:
        u = -u  # nearly opposite, central differences would not be exact
    direction = Direction(POSE, u, d, COV, north=NORTH)

    def predicted(at: Values) -> FloatArray:
        return at[POSE][:3, :3] @ attitude_of_enu(at[NORTH]) @ direction.known

    start = predicted(values)

    def residual(at: Values) -> FloatArray:
        p = predicted(at)
        angle = np.arccos(p @ direction.in_camera)
        log = angle / np.sin(angle) * (direction.in_camera - np.cos(angle) * p)
        return transported(tangent_axes(start), start, p).T @ log

    for variable, found in zip(direction.variables, direction.jacobians(values), strict=True):
        for column, unit in enumerate(1e-6 * np.eye(dimension(values[variable]))):
            ahead = residual({**values, variable: retract(values[variable], unit)})
            behind = residual({**values, variable: retract(values[variable], -unit)})
            np.testing.assert_allclose(found[:, column], (ahead - behind) / 2e-6, atol=1e-5)


@pytest.mark.parametrize("seed", range(20))
def test_the_gradient_of_a_direction_is_that_of_half_its_squared_angle(seed: int) -> None:
    """So the turn of the axes, which the Jacobian leaves out, has no part in it."""
    rng = np.random.default_rng(seed)
    values = {POSE: se3.exp(rng.normal(size=6)), NORTH: rng.normal(scale=[0.3, 0.3, 2.0])}
    u, d = rng.normal(size=(2, 3))
    direction = Direction(POSE, u, d, 0.01 * np.eye(2), north=NORTH)
    residual = direction.residual(values)
    for found, numeric in zip(
        direction.jacobians(values), numeric_jacobians(direction, values), strict=True
    ):
        np.testing.assert_allclose(residual @ found, residual @ numeric, atol=1e-6)


@pytest.mark.parametrize("angle_rad", [0.0, 1e-9, 1e-5])
def test_the_jacobian_of_a_direction_holds_where_it_is_predicted_well(angle_rad: float) -> None:
    u = np.array([0.3, -0.5, 0.8]) / np.linalg.norm([0.3, -0.5, 0.8])
    known = so3.exp(angle_rad * np.array([0.6, 0.0, 0.8])) @ u
    direction = Direction(POSE, u, known, COV)
    values = {POSE: np.eye(4)}
    (numeric,) = numeric_jacobians(direction, values)
    np.testing.assert_allclose(direction.jacobians(values)[0], numeric, atol=2e-5)


def test_the_residual_is_the_angle_between_the_directions() -> None:
    """In the tangent plane: its length is the angle, however large."""
    rng = np.random.default_rng(1)
    for _ in range(50):
        u, d = rng.normal(size=(2, 3))
        u /= np.linalg.norm(u)
        d /= np.linalg.norm(d)
        residual = Direction(POSE, u, d, COV).residual({POSE: np.eye(4)})
        assert np.linalg.norm(residual) == pytest.approx(np.arccos(u @ d), abs=1e-9)


def test_small_residuals_are_those_of_azimuth_and_zenith() -> None:
    """e = (sin(zen) Δaz, Δzen), measured minus predicted."""
    azimuth, zenith = 0.7, 1.1
    measured = of_azimuth_and_zenith(azimuth + 1e-5, zenith - 2e-5)
    known = of_azimuth_and_zenith(azimuth, zenith)
    residual = Direction(POSE, measured, known, COV).residual({POSE: np.eye(4)})
    np.testing.assert_allclose(residual, [np.sin(zenith) * 1e-5, -2e-5], atol=1e-9)


def test_angles_with_their_covariance_become_a_direction() -> None:
    direction = Direction.of_angles(POSE, (0.7, 1.1), np.ones(3), COV)
    np.testing.assert_allclose(direction.in_camera, of_azimuth_and_zenith(0.7, 1.1))
    shrunk = np.diag([np.sin(1.1), 1.0])
    np.testing.assert_allclose(direction.covariance, shrunk @ COV @ shrunk)


@pytest.mark.parametrize("direction", [[0.0, -1.0, 0.0], [0.0, 1.0, 0.0], [1.0, 2.0, -3.0]])
def test_tangent_axes_are_orthonormal_straight_up_too(direction: list[float]) -> None:
    u = np.array(direction) / np.linalg.norm(direction)
    axes = tangent_axes(u)
    np.testing.assert_allclose(axes.T @ axes, np.eye(2), atol=1e-12)
    np.testing.assert_allclose(u @ axes, 0.0, atol=1e-12)


def test_a_level_camera_that_looks_east_sees_east_ahead() -> None:
    C_world_enu = attitude_of_enu(np.array([0.0, 0.0, np.pi / 2.0]))
    np.testing.assert_allclose(C_world_enu @ [1.0, 0.0, 0.0], [0.0, 0.0, 1.0], atol=1e-12)
    np.testing.assert_allclose(C_world_enu @ [0.0, 0.0, 1.0], [0.0, -1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(attitude_of_enu(np.zeros(3)), LEVEL, atol=1e-12)


def test_a_heading_is_clockwise_from_north() -> None:
    """A camera that has turned right by 30° from a first one that looks east heads 120°."""
    T_cam_world = np.eye(4)
    T_cam_world[:3, :3] = so3.exp(np.array([0.0, np.deg2rad(30.0), 0.0])).T
    values = {POSE: T_cam_world, NORTH: np.array([0.0, 0.0, np.pi / 2.0])}
    heading = Heading(POSE, np.deg2rad(120.0), 0.1, north=NORTH)
    np.testing.assert_allclose(heading.residual(values), 0.0, atol=1e-12)
    other_way = Heading(POSE, np.deg2rad(120.0 - 360.0 + 1.0), 0.1, north=NORTH)
    np.testing.assert_allclose(other_way.residual(values), np.deg2rad(1.0), atol=1e-12)
    from_first = Heading(POSE, np.deg2rad(30.0), 0.1)
    np.testing.assert_allclose(from_first.residual({POSE: T_cam_world}), 0.0, atol=1e-12)


def test_forward_is_a_positive_distance() -> None:
    """T_curr_prev of a camera that went 1.2 m ahead moves points 1.2 m nearer."""
    T_curr_prev = np.eye(4)
    T_curr_prev[2, 3] = -1.2
    distance = TravelledDistance(1.5, 0.1, POSE)
    np.testing.assert_allclose(distance.residual({POSE: T_curr_prev}), 0.3)


@pytest.mark.parametrize("vector", [[0.0, 0.0, 0.0], [1.0, np.inf, 0.0], [1.0, 0.0]])
def test_what_is_no_direction_is_refused(vector: list[float]) -> None:
    with pytest.raises(InputError, match="in_camera"):
        Direction(POSE, np.array(vector), np.ones(3), COV)
    with pytest.raises(InputError, match="known"):
        Direction(POSE, np.ones(3), np.array(vector), COV)


def test_an_axis_that_is_no_unit_vector_is_refused() -> None:
    with pytest.raises(InputError, match="axis"):
        TravelledDistance(1.0, 0.1, POSE, axis=np.array([0.0, 0.0, 2.0]))


def test_a_covariance_of_another_size_is_refused() -> None:
    with pytest.raises(InputError, match=r"\[2, 2\]"):
        Direction(POSE, np.ones(3), np.ones(3), np.eye(3))


def test_a_bounded_loss_is_bounded_and_its_weight_is_its_slope() -> None:
    """ρ is continuous and below a; w = 2 dρ/ds, by central differences."""
    heading = Heading(POSE, 0.0, 1.0).bounded()
    bound = 3.841458820694124  # 95 % of χ²(1)

    def cost(squared: float) -> float:
        return heading._cost(squared)

    for squared in [0.5, 3.0, bound - 1e-3, bound + 1e-3, 5.0, 40.0, 1e4]:
        slope = (cost(squared + 1e-5) - cost(squared - 1e-5)) / 2e-5
        assert heading._weight(squared) == pytest.approx(2.0 * slope, rel=1e-5, abs=1e-8)
        assert cost(squared) < bound
    assert Heading(POSE, 0.0, 1.0)._weight(1e4) == 1.0

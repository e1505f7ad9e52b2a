"""The rig's motion: exact derivatives, the plan's pose at the ends, limits and deviations."""

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo.errors import InputError
from probevo.geometry import so3
from probevo_sim.scene.drive import DrivePlan, Trajectory
from probevo_sim.scene.route import Route

ROAD = Route.from_turns(
    [(50.0, 0.0), (20.0, 1.5), (30.0, -0.7), (40.0, 0.0), (60.0, 0.5), (80.0, 0.0)],
    lead_m=30.0,
    start_heading_rad=0.4,
)
STRAIGHT = Route.from_turns([(1500.0, 0.0)])
LOOP = Route.loop(250.0)
PLAN = DrivePlan(5.0, 250.0, 10.0, lateral_m=-1.8, stops_m=(100.0,), pitch_down_rad=0.05)
ROUND_TRIP = DrivePlan(
    0.0, 250.0, 5.0, from_rest=True, to_rest=True, lateral_m=0.3, pitch_down_rad=0.1
)
STEP_S = 1e-4


def drive(route: Route, plan: DrivePlan, seed: int = 0) -> Trajectory:
    return Trajectory.along(route, plan, np.random.default_rng(seed))


def times(trajectory: Trajectory) -> FloatArray:
    """Return times all along a drive, and 0.1 s beyond both ends."""
    return np.linspace(-0.1, trajectory.duration_s + 0.1, 5000)


every_drive = pytest.mark.parametrize(
    "trajectory",
    [
        drive(ROAD, PLAN),
        drive(LOOP, ROUND_TRIP),
        drive(LOOP, ROUND_TRIP.carried_by_hand(1.0)),
    ],
)


@every_drive
def test_velocity_is_the_derivative_of_the_position(trajectory: Trajectory) -> None:
    t = times(trajectory)
    before = trajectory.T_world_cam(t - STEP_S)
    after = trajectory.T_world_cam(t + STEP_S)
    numeric = (after - before)[:, :3, 3] / (2 * STEP_S)
    velocity = trajectory.velocity(t)
    assert np.abs(velocity - numeric).max() < 1e-6 * np.abs(velocity).max()


@every_drive
def test_angular_rate_is_the_derivative_of_the_rotation(trajectory: Trajectory) -> None:
    """C_world_cam(t + h) = C_world_cam(t − h) Exp(2h ω): the rate in camera axes stands on the
    right."""
    t = times(trajectory)
    before = trajectory.T_world_cam(t - STEP_S)[:, :3, :3]
    after = trajectory.T_world_cam(t + STEP_S)[:, :3, :3]
    rate = trajectory.angular_rate(t)
    numeric = so3.log(before.mT @ after) / (2 * STEP_S)
    assert np.abs(rate - numeric).max() < 1e-6 * np.abs(rate).max()


@every_drive
def test_specific_force_is_acceleration_minus_gravity(trajectory: Trajectory) -> None:
    t = times(trajectory)
    velocity_change = trajectory.velocity(t + STEP_S) - trajectory.velocity(t - STEP_S)
    acceleration = velocity_change / (2 * STEP_S)
    force = trajectory.T_world_cam(t)[:, :3, :3] @ trajectory.specific_force(t)[..., None]
    assert np.abs(force[..., 0] - [0.0, 0.0, 9.81] - acceleration).max() < 1e-5


@every_drive
def test_poses_are_rigid(trajectory: Trajectory) -> None:
    T_world_cam = trajectory.T_world_cam(times(trajectory))
    C = T_world_cam[:, :3, :3]
    np.testing.assert_allclose(C.mT @ C, np.broadcast_to(np.eye(3), C.shape), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(C), 1.0)
    np.testing.assert_array_equal(
        T_world_cam[:, 3], np.broadcast_to([0.0, 0.0, 0.0, 1.0], (len(C), 4))
    )


def test_shapes_follow_those_of_the_times() -> None:
    trajectory = drive(LOOP, ROUND_TRIP)
    for shape in ((), (3,), (2, 3)):
        assert trajectory.T_world_cam(np.zeros(shape)).shape == (*shape, 4, 4)
        for query in (trajectory.velocity, trajectory.angular_rate, trajectory.specific_force):
            assert query(np.zeros(shape)).shape == (*shape, 3)


def test_ends_at_rest_are_at_the_plans_pose() -> None:
    """The camera 1.65 m up and 0.3 m to the left looks along the road, 0.1 rad down; its x axis is
    level."""
    trajectory = drive(LOOP, ROUND_TRIP)
    C_world_cam = np.array(
        [[0.0, -np.sin(0.1), np.cos(0.1)], [-1.0, 0.0, 0.0], [0.0, -np.cos(0.1), -np.sin(0.1)]]
    )
    for t_s in (0.0, trajectory.duration_s):
        T_world_cam = trajectory.T_world_cam(t_s)
        np.testing.assert_allclose(T_world_cam[:3, :3], C_world_cam, atol=1e-9)
        np.testing.assert_allclose(T_world_cam[:3, 3], [0.0, 0.3, 1.65], atol=1e-9)
        np.testing.assert_allclose(trajectory.velocity(t_s), 0.0, atol=1e-8)
        np.testing.assert_allclose(trajectory.angular_rate(t_s), 0.0, atol=1e-8)


def test_camera_looks_where_it_goes() -> None:
    """Without suspension the motion is along the optical axis, also in curves and deviations."""
    trajectory = drive(ROAD, DrivePlan(5.0, 250.0, 10.0, lateral_m=-1.8, shake=0.0))
    t = times(trajectory)
    in_camera = (trajectory.velocity(t)[:, None] @ trajectory.T_world_cam(t)[:, :3, :3])[:, 0]
    np.testing.assert_allclose(in_camera[:, :2], 0.0, atol=1e-3)
    assert in_camera[:, 2].min() > 1.0


def test_drive_is_slower_in_curves() -> None:
    trajectory = drive(ROAD, DrivePlan(5.0, 250.0, 15.0, from_rest=True, to_rest=True, shake=0.0))
    force = trajectory.specific_force(times(trajectory))
    assert 1.5 < np.abs(force[:, 0]).max() < 2.2
    assert 1.4 < np.abs(force[:, 2]).max() < 1.6


def test_halt_is_at_the_stop() -> None:
    trajectory = drive(ROAD, PLAN)
    t = np.arange(0.0, trajectory.duration_s, 0.01)
    halted = np.linalg.norm(trajectory.velocity(t), axis=1) < 1e-3
    s, _ = ROAD.nearest(trajectory.T_world_cam(t[halted])[:, :2, 3])
    assert 1.5 <= 0.01 * halted.sum() < 2.0
    np.testing.assert_allclose(s, PLAN.start_m + 100.0, atol=1e-3)


def test_suspension_has_its_size() -> None:
    """Over 100 s at 15 m/s: 0.15° of pitch, 0.1° of roll and 1 cm of height, times 15/17."""
    trajectory = drive(STRAIGHT, DrivePlan(0.0, 1500.0, 15.0))
    _, _, height, _, pitch, roll = np.std(trajectory.coordinates(times(trajectory)), axis=0)
    rms = 15.0 / 17.0 * np.array([np.deg2rad(0.15), np.deg2rad(0.1), 0.01])
    np.testing.assert_allclose([pitch, roll, height], rms, rtol=0.1)


def test_lateral_deviation_has_its_size() -> None:
    trajectory = drive(STRAIGHT, DrivePlan(0.0, 1500.0, 15.0))
    lateral_m = trajectory.coordinates(times(trajectory))[:, 1]
    assert np.sqrt(np.mean(lateral_m**2)) == pytest.approx(0.1, rel=0.1)


def test_same_seed_drives_the_same() -> None:
    first = drive(LOOP, ROUND_TRIP, 3)
    second = drive(LOOP, ROUND_TRIP, 3)
    assert first.coordinates(times(first)).tobytes() == second.coordinates(times(first)).tobytes()


def test_another_seed_drives_differently_from_and_to_the_same_place() -> None:
    first = drive(LOOP, ROUND_TRIP, 3)
    second = drive(LOOP, ROUND_TRIP, 4)
    one = first.T_world_cam([0.0, 25.0, first.duration_s])
    other = second.T_world_cam([0.0, 25.0, second.duration_s])
    np.testing.assert_allclose(one[[0, 2]], other[[0, 2]], atol=1e-9)
    assert np.linalg.norm((one - other)[1, :2, 3]) > 0.01


@pytest.mark.parametrize(
    "plan",
    [DrivePlan(0.0, 0.0, 1.0), DrivePlan(0.0, 1.0, 0.0), DrivePlan(0.0, 1.0, 1.0, height_m=0.0)],
)
def test_drive_to_nowhere_is_refused(plan: DrivePlan) -> None:
    with pytest.raises(InputError):
        drive(STRAIGHT, plan)


def test_a_rig_that_is_carried_sways_as_much_as_it_says() -> None:
    """At walking pace: half of 15° of yaw, of 8° of pitch and roll, and of 8 cm of height."""
    vehicle = DrivePlan(0.0, 200.0, 15.0, shake=0.0)
    trajectory = drive(STRAIGHT, vehicle.carried_by_hand(0.5))
    t = times(trajectory)
    _, _, height, yaw, pitch, roll = np.std(trajectory.coordinates(t), axis=0)
    np.testing.assert_allclose(
        [yaw, pitch, roll], 0.5 * 13.0 / 14.0 * np.deg2rad([15.0, 8.0, 8.0]), rtol=0.15
    )
    assert height == pytest.approx(0.5 * 13.0 / 14.0 * 0.08, rel=0.15)
    assert trajectory.duration_s == pytest.approx(200.0 / 1.3, rel=0.02)
    assert drive(STRAIGHT, vehicle).duration_s < 15.0


def test_a_rig_that_is_carried_starts_and_ends_at_rest_at_the_plans_pose() -> None:
    trajectory = drive(LOOP, ROUND_TRIP.carried_by_hand(1.0))
    for t_s in (0.0, trajectory.duration_s):
        coordinates = trajectory.coordinates(t_s)
        np.testing.assert_allclose(coordinates[1:3], [0.3, 1.5], atol=1e-9)
        np.testing.assert_allclose(coordinates[4:], [0.1, 0.0], atol=1e-9)
        np.testing.assert_allclose(trajectory.angular_rate(t_s), 0.0, atol=1e-7)

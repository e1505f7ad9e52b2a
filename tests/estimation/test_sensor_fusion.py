"""Fusion of sensors: the Cramér–Rao bound, lies, dropouts, and a heading that nobody knows."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Protocol

import numpy as np
import pytest

import probevo as pv
from intervals import chi2_interval
from probevo.arrays import FloatArray
from probevo.config import NorthConfig
from probevo.errors import InputError
from probevo.estimation.motion_estimate import MotionEstimate, SensorOutcome, Status
from probevo.estimation.sensor_fusion import SensorFusion, motion_innovations
from probevo.geometry import se3, so3
from probevo.measurements import Measurement, pose_of
from probevo.measurements.direction import Direction, tangent_axes
from probevo.measurements.heading import Heading
from probevo.measurements.north import NORTH, attitude_of_enu
from probevo.measurements.relative_rotation import RelativeRotation
from probevo.measurements.sensor import NoMeasurement, Reading, sensor_names
from probevo.measurements.travelled_distance import TravelledDistance
from probevo.measurements.vector_measurement import large_residual_threshold
from worlds import CAMERA, FORWARD, blind_frame, drive

STEP_COV = np.diag([1e-4, 1e-4, 1e-4, 3e-6, 3e-6, 3e-6])
SIGMA_RAD = np.deg2rad(10.0)
NUM_FRAMES = 250
NUM_FRAMES_OF_LIES = 400
EVERY = 5
DRIVES = 12


class Reads(Protocol):
    """A simulated sensor."""

    def read(self, index: int) -> Reading: ...


def true_path(rng: np.random.Generator, num_frames: int = NUM_FRAMES) -> FloatArray:
    """T_cam_world of a camera that drives and swings left and right."""
    steps = np.zeros((num_frames - 1, 6))
    steps[:, 2] = -0.5
    steps[:, 4] = 0.03 * np.sin(np.arange(num_frames - 1) / 15.0 + rng.uniform(0.0, 6.0))
    poses = [np.eye(4)]
    for step in steps:
        poses.append(se3.exp(step) @ poses[-1])
    return np.array(poses)


def motion(T_curr_prev: FloatArray) -> MotionEstimate:
    return MotionEstimate(T_curr_prev, STEP_COV, Status.OK, num_tracks=100)


class Sun:
    """A sun sensor with noise, or one that lies."""

    def __init__(
        self,
        poses: FloatArray,
        rng: np.random.Generator,
        fault: str | None = None,
        from_index: int = 0,
    ) -> None:
        self.poses = poses
        self.rng = rng
        self.fault = fault
        self.from_index = from_index
        self.in_world = np.array([0.6, -0.1, 0.8])
        self.in_world /= np.linalg.norm(self.in_world)

    def read(self, index: int) -> Reading:
        if index % EVERY:
            return Reading("sun", reason="between sightings")
        u = self.poses[index, :3, :3] @ self.in_world
        if index >= self.from_index:
            if self.fault == "offset":
                u = so3.exp(np.array([0.0, np.deg2rad(20.0), 0.0])) @ u
            if self.fault == "inverted":
                u = u * [-1.0, 1.0, 1.0]
            if self.fault == "stuck":
                u = self.poses[self.from_index, :3, :3] @ self.in_world
        u = so3.exp(np.cross(u, tangent_axes(u) @ (SIGMA_RAD * self.rng.normal(size=2)))) @ u
        measured = Direction(pose_of(index), u, self.in_world, SIGMA_RAD**2 * np.eye(2))
        return Reading("sun", (measured,))


def fuse(
    poses: FloatArray, steps: list[MotionEstimate], sensors: Sequence[Reads], north: NorthConfig
) -> tuple[list[SensorFusion], list[tuple[SensorOutcome, ...]]]:
    names = ["sun", "gps"][: len(sensors)]
    fusion = SensorFusion.at_origin(names)
    states = []
    outcomes = []
    for index, step in enumerate(steps, start=1):
        fusion = fusion.after(step)
        readings = [sensor.read(index) for sensor in sensors]
        fusion, outcome = fusion.updated(readings, pose_of(index), north, motion_innovations={})
        states.append(fusion)
        outcomes.append(outcome)
    return states, outcomes


def noisy_steps(poses: FloatArray, rng: np.random.Generator) -> list[MotionEstimate]:
    true = poses[1:] @ se3.inverse(poses[:-1])
    errors = rng.multivariate_normal(np.zeros(6), STEP_COV, len(true))
    return [motion(se3.exp(error) @ T) for error, T in zip(errors, true, strict=True)]


def attitude_error(state: SensorFusion, T_cam_world: FloatArray) -> FloatArray:
    """In the world's axes, [3], rad."""
    return so3.log(state.pose.T_world_cam[:3, :3] @ T_cam_world[:3, :3])


def heading_rms(states: list[SensorFusion], poses: FloatArray) -> float:
    errors = [attitude_error(state, T)[1] for state, T in zip(states, poses[1:], strict=True)]
    return float(np.sqrt(np.mean(np.square(errors))))


@dataclass(frozen=True)
class HonestDrive:
    """A drive with an honest sun sensor, and what became of both."""

    poses: FloatArray
    sun: Sun
    states: list[SensorFusion]
    outcomes: list[tuple[SensorOutcome, ...]]


@pytest.fixture(scope="module")
def honest_drives() -> list[HonestDrive]:
    drives = []
    for seed in range(DRIVES):
        rng = np.random.default_rng(seed)
        poses = true_path(rng)
        sun = Sun(poses, rng)
        states, outcomes = fuse(poses, noisy_steps(poses, rng), [sun], NorthConfig())
        drives.append(HonestDrive(poses, sun, states, outcomes))
    return drives


def test_the_attitude_reaches_its_fisher_bound_and_is_consistent(
    honest_drives: list[HonestDrive],
) -> None:
    """RMS over 12 drives and the second half of their frames, within 20 % of the bound; the claimed
    covariance is the bound within 10 %."""
    squares = []
    bounds = []
    claims = []
    nees = []
    for honest in honest_drives:
        poses = honest.poses
        adjoints = se3.adjoint(poses[1:] @ se3.inverse(poses[:-1]))
        cov = np.zeros((6, 6))
        for index, state in enumerate(honest.states, start=1):
            T = poses[index]
            adjoint = adjoints[index - 1]
            cov = adjoint @ cov @ adjoint.T + STEP_COV
            u = T[:3, :3] @ honest.sun.in_world
            if index % EVERY == 0:
                H = np.hstack([np.zeros((2, 3)), tangent_axes(u).T @ so3.wedge(u)])
                gain = cov @ H.T @ np.linalg.inv(H @ cov @ H.T + SIGMA_RAD**2 * np.eye(2))
                cov = cov - gain @ H @ cov
            if index > NUM_FRAMES // 2:
                down = T[:3, 1]
                squares.append(attitude_error(state, T)[1] ** 2)
                bounds.append(down @ cov[3:, 3:] @ down)
                claims.append(down @ state.pose.cov[3:, 3:] @ down)
        last = honest.states[-1]
        error = T[:3, :3] @ attitude_error(last, T)
        nees.append(error @ np.linalg.solve(last.pose.cov[3:, 3:], error))
    assert np.sqrt(np.mean(squares) / np.mean(bounds)) == pytest.approx(1.0, abs=0.2)
    assert np.sqrt(np.mean(claims) / np.mean(bounds)) == pytest.approx(1.0, abs=0.1)
    low, high = chi2_interval(dof=3, count=DRIVES, confidence=0.999)
    assert low < np.mean(nees) < high


@cache
def without_sensors(seed: int) -> list[SensorFusion]:
    rng = np.random.default_rng(seed)
    poses = true_path(rng, NUM_FRAMES_OF_LIES)
    states, _ = fuse(poses, noisy_steps(poses, rng), [], NorthConfig())
    return states


@pytest.mark.parametrize("from_index", [0, 150], ids=["from the start", "later"])
@pytest.mark.parametrize("fault", ["offset", "inverted", "stuck"])
def test_a_sensor_that_lies_is_excluded_and_forgotten(fault: str, from_index: int) -> None:
    """From then on the pose is, to the byte, that without it. What a sensor that was honest for
    thirty sightings has pulled until it is found out cannot be undone; one that lies from the
    start has pulled little."""
    rng = np.random.default_rng(5)
    poses = true_path(rng, NUM_FRAMES_OF_LIES)
    steps = noisy_steps(poses, rng)
    sun = Sun(poses, rng, fault, from_index)
    states, outcomes = fuse(poses, steps, [sun], NorthConfig())
    without = without_sensors(5)
    last = outcomes[-1][0]
    assert last.state == "excluded"
    assert last.reason
    np.testing.assert_array_equal(states[-1].pose.T_world_cam, without[-1].pose.T_world_cam)
    np.testing.assert_array_equal(states[-1].pose.cov, without[-1].pose.cov)
    if from_index == 0:
        assert heading_rms(states, poses) <= 1.05 * heading_rms(without, poses)


def test_an_honest_sensor_is_not_excluded(honest_drives: list[HonestDrive]) -> None:
    """In none of 12 drives of 80 sightings."""
    for honest in honest_drives:
        assert all(outcome[0].state != "excluded" for outcome in honest.outcomes)


class Gps:
    """A heading from north with dropouts."""

    def __init__(self, poses: FloatArray, rng: np.random.Generator, heading_deg: float) -> None:
        self.poses = poses
        self.rng = rng
        self.C_world_enu = attitude_of_enu(np.array([0.0, 0.0, np.deg2rad(heading_deg)]))

    def read(self, index: int) -> Reading:
        if index % 50 > 30:
            return Reading("gps", reason="no fix")
        east, north, _ = self.C_world_enu.T @ self.poses[index, 2, :3]
        heading = np.arctan2(east, north) + np.deg2rad(2.0) * self.rng.normal()
        return Reading("gps", (Heading(pose_of(index), heading, np.deg2rad(2.0), north=NORTH),))


@pytest.mark.parametrize("heading_deg", [0.0, 179.0, -135.0])
def test_an_unknown_heading_is_found_with_its_covariance(heading_deg: float) -> None:
    """The heading of the first camera is a state: it is known as well as the measurements say, and
    the drift is bounded beside it."""
    rng = np.random.default_rng(3)
    poses = true_path(rng)
    gps = Gps(poses, rng, heading_deg)
    states, outcomes = fuse(poses, noisy_steps(poses, rng), [gps], NorthConfig())
    assert outcomes[-1][0].state != "excluded"
    assert {outcome[0].reason for outcome in outcomes if outcome[0].state == "silent"} == {"no fix"}
    pose = states[-1].pose
    at = pose.slice_of(NORTH)
    assert at is not None
    sigma = np.sqrt(pose.joint_cov[at, at][2, 2])
    assert sigma < np.deg2rad(1.0)
    found = np.rad2deg(pose.further[0].value[2]) - heading_deg
    assert abs(np.remainder(found + 180.0, 360.0) - 180.0) < 4.0 * np.rad2deg(sigma)
    down = poses[-1, :3, 1]
    claimed = np.sqrt(down @ pose.cov[3:, 3:] @ down)
    assert abs(attitude_error(states[-1], poses[-1])[1]) < 4.0 * claimed
    assert claimed < np.sqrt(NUM_FRAMES * STEP_COV[4, 4])


@pytest.mark.parametrize("off_deg", [20.0, 90.0])
def test_a_wild_first_heading_loses_no_compass(off_deg: float) -> None:
    """It decides which way is north. Before, all later ones then seemed wrong."""
    rng = np.random.default_rng(4)
    poses = true_path(rng)
    compass = Gps(poses, rng, 40.0)

    class WildAtFirst:
        def read(self, index: int) -> Reading:
            reading = compass.read(index)
            if index != 1:
                return reading
            (one,) = reading.measurements
            assert isinstance(one, Heading)
            heading = one.heading_rad + np.deg2rad(off_deg)
            return Reading("gps", (Heading(one.pose, heading, np.deg2rad(2.0), north=NORTH),))

    states, outcomes = fuse(poses, noisy_steps(poses, rng), [WildAtFirst()], NorthConfig())
    assert "excluded" not in {outcome[0].state for outcome in outcomes}
    assert abs(attitude_error(states[-1], poses[-1])[1]) < np.deg2rad(2.0)


def test_of_two_sensors_the_honest_one_stays() -> None:
    rng = np.random.default_rng(8)
    poses = true_path(rng)
    north = NorthConfig(heading_deg=40.0, heading_sigma_deg=0.5, tilt_sigma_deg=0.5)
    sensors = [Sun(poses, rng, "offset"), Gps(poses, rng, 40.0)]
    states, outcomes = fuse(poses, noisy_steps(poses, rng), sensors, north)
    assert outcomes[-1][0].state == "excluded"
    assert outcomes[-1][1].state != "excluded"
    assert abs(attitude_error(states[-1], poses[-1])[1]) < np.deg2rad(2.0)


def test_wild_measurements_now_and_then_are_gated_and_no_lie() -> None:
    """One in fifteen is 90° off."""
    rng = np.random.default_rng(9)
    poses = true_path(rng)
    steps = noisy_steps(poses, rng)
    sun = Sun(poses, rng)

    class Wild:
        def read(self, index: int) -> Reading:
            reading = sun.read(index)
            if not reading.measurements or index % (15 * EVERY):
                return reading
            (one,) = reading.measurements
            assert isinstance(one, Direction)
            turned = so3.exp(np.array([0.0, np.pi / 2.0, 0.0])) @ one.in_camera
            return Reading("sun", (Direction(one.pose, turned, one.known, one.covariance),))

    states, outcomes = fuse(poses, steps, [Wild()], NorthConfig())
    gated = [index for index, one in enumerate(outcomes, start=1) if one[0].state == "gated"]
    assert set(range(75, NUM_FRAMES, 75)) <= set(gated)
    assert len(gated) <= NUM_FRAMES // 75 + 1
    assert outcomes[-1][0].state != "excluded"
    clean, _ = fuse(poses, steps, [Sun(poses, np.random.default_rng(10))], NorthConfig())
    assert np.trace(states[-1].pose.cov) < 1.1 * np.trace(clean[-1].pose.cov)


def test_the_innovation_of_a_solve_is_that_before_it() -> None:
    """For a linear measurement of a motion with a Gaussian prior, in closed form."""
    rng = np.random.default_rng(11)
    root = rng.normal(scale=0.05, size=(6, 6))
    P = root @ root.T
    T_prior = FORWARD
    one = TravelledDistance(1.3, 0.1, pose_of(0))
    (J,) = one.jacobians({pose_of(0): T_prior})
    S = J @ P @ J.T + one.covariance
    gain = P @ J.T / S
    innovation = one.residual({pose_of(0): T_prior})
    # The residual falls as J grows: e(Exp(ξ) T) = e + J ξ, so the update is against it.
    T_after = se3.exp(-gain @ innovation) @ T_prior
    cov = (np.eye(6) - gain @ J) @ P
    ((squared, weight, is_gated),) = motion_innovations(
        [one], T_after, pose_of(0), cov=cov, common_mode=np.zeros((6, 1))
    )
    assert weight == 1.0
    assert not is_gated
    assert squared == pytest.approx(float(innovation @ innovation) / S.item(), rel=0.02)


def test_a_measurement_of_the_motion_has_the_weight_of_the_solve() -> None:
    """Wheels that slip by a metre, ten standard deviations, hardly count."""
    one = TravelledDistance(2.0, 0.1, pose_of(0)).bounded()
    (residual,) = one.residual({pose_of(0): FORWARD})
    ((_, weight, is_gated),) = motion_innovations(
        [one], FORWARD, pose_of(0), cov=1e-4 * np.eye(6), common_mode=np.zeros((6, 1))
    )
    assert weight == pytest.approx((large_residual_threshold(1) / (residual / 0.1) ** 2) ** 2)
    assert weight < 0.01
    assert is_gated


@pytest.mark.parametrize("estimator", ["two-frame", "window"])
def test_a_wild_measurement_of_the_motion_is_gated(estimator: str) -> None:
    """Its bounded loss gives it a weight that is not quite 0."""
    frames = drive(np.random.default_rng(1), 12, points=60)
    true_m = float(np.linalg.norm(FORWARD[:3, 3]))

    def wheels(prev_frame: pv.Frame, frame: pv.Frame) -> list[Measurement]:
        travelled_m = true_m + (5.0 if frame.index == 8 else 0.0)
        curr = pose_of(frame.index)
        return [TravelledDistance(travelled_m, 0.02, curr, pose_of(prev_frame.index))]

    odometry = pv.StereoOdometry(CAMERA, config={"estimator": estimator}, sensors=[wheels])
    outcomes = [odometry.step(frame).sensors for frame in frames]
    states = [one[0].state for one in outcomes[1:]]
    assert [index for index, state in enumerate(states, start=1) if state == "gated"] == [8]
    assert 0.0 < outcomes[8][0].weight < 1e-3


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("estimator", ["two-frame", "window"])
def test_what_is_no_number_is_no_measurement(value: float, estimator: str) -> None:
    """As a receiver gives before its first fix."""
    frames = drive(np.random.default_rng(1), 8, points=60)

    def faulty(prev_frame: pv.Frame, frame: pv.Frame) -> list[Measurement]:
        curr = pose_of(frame.index)
        prev = pose_of(prev_frame.index)
        return [TravelledDistance(value, 0.02, curr, prev), Heading(curr, value, 0.1)]

    odometry = pv.StereoOdometry(CAMERA, config={"estimator": estimator}, sensors=[faulty])
    motions = [odometry.step(frame) for frame in frames]
    without = pv.StereoOdometry(CAMERA, config={"estimator": estimator})
    for motion, frame in zip(motions, frames, strict=True):
        np.testing.assert_array_equal(motion.T_world_cam, without.step(frame).T_world_cam)
    assert [one.sensors[0].reason for one in motions[1:]] == ["not a finite value"] * 7


def test_a_motion_from_no_pose_is_refused() -> None:
    """It would be taken for the pose itself."""
    frames = drive(np.random.default_rng(1), 2, points=60)

    def wheels(prev_frame: pv.Frame, frame: pv.Frame) -> list[Measurement]:
        return [TravelledDistance(1.0, 0.02, pose_of(frame.index))]

    odometry = pv.StereoOdometry(CAMERA, sensors=[wheels])
    odometry.step(frames[0])
    with pytest.raises(InputError, match=r"sensor wheels: (?s:.*)prev=pose_of"):
        odometry.step(frames[1])


WHEEL_SIGMA_M = 0.02


@pytest.mark.parametrize("estimator", ["two-frame", "window"])
def test_wheels_that_lie_are_excluded(estimator: str) -> None:
    """They say that the vehicle goes backwards. The path is as good as without them."""
    frames = drive(np.random.default_rng(1), 40, points=60)
    config = {"estimator": estimator, "window": {"frames": 4}}

    def wheels(prev_frame: pv.Frame, frame: pv.Frame) -> list[Measurement] | NoMeasurement:
        if frame.index % 4 == 0:
            return NoMeasurement("no pulse")
        return [
            TravelledDistance(
                sign * 1.2, WHEEL_SIGMA_M, pose_of(frame.index), pose_of(prev_frame.index)
            )
        ]

    lengths = {}
    for sign in (1.0, -1.0, 0.0):
        sensors = [wheels] if sign else []
        odometry = pv.StereoOdometry(CAMERA, config=config, sensors=sensors)
        estimates = [odometry.step(frame) for frame in frames]
        lengths[sign] = [np.linalg.norm(one.T_curr_prev[:3, 3]) for one in estimates[1:]]
        assert all(one.status is Status.OK for one in estimates[1:])
        if sensors:
            is_excluded = estimates[-1].sensors[0].state == "excluded"
            assert is_excluded == (sign < 0.0)
    true_m = np.linalg.norm(FORWARD[:3, 3])
    error = {
        sign: np.sqrt(np.mean((np.array(found) - true_m) ** 2)) for sign, found in lengths.items()
    }
    assert error[-1.0] <= 1.05 * error[0.0]


def test_right_wheels_beside_a_wrong_rig_stay() -> None:
    """All disparities are off by 0.2 px, twice the σ of the rig's constant error. Before, wheels
    that know a step to a millimetre were excluded, as if the images had no such error."""
    frames = []
    for frame in drive(np.random.default_rng(3), 50):
        assert frame.features is not None
        pixels = frame.features.pixels - np.array([0.0, 0.0, 0.2, 0.0])
        frames.append(replace(frame, features=replace(frame.features, pixels=pixels)))
    rng = np.random.default_rng(4)
    true_m = float(se3.inverse(FORWARD)[2, 3])

    def wheels(prev_frame: pv.Frame, frame: pv.Frame) -> list[Measurement]:
        measured_m = true_m + 1e-3 * rng.normal()
        curr = pose_of(frame.index)
        return [TravelledDistance(measured_m, 1e-3, curr, pose_of(prev_frame.index))]

    odometry = pv.StereoOdometry(CAMERA, config={"estimator": "two-frame"}, sensors=[wheels])
    by_images = pv.StereoOdometry(CAMERA, config={"estimator": "two-frame"})
    of_rig_m = []
    for frame in frames:
        motion = odometry.step(frame)
        without = by_images.step(frame)
        assert all(one.state != "excluded" for one in motion.sensors)
        of_rig_m.append([np.linalg.norm(one.common_mode[2]) for one in (motion, without)])
    # Images and wheels know the motion ahead equally well, so that the wheels halve what errors of
    # the rig do to it; a little less where they are down-weighted.
    held, by_itself = np.array(of_rig_m[10:]).mean(axis=0)
    assert 0.45 * by_itself < held < 0.75 * by_itself


@pytest.mark.parametrize("estimator", ["two-frame", "window"])
@pytest.mark.parametrize("offset_rad", [0.0, 5e-3])
def test_a_sensor_surer_than_the_images_is_tested_too(estimator: str, offset_rad: float) -> None:
    """It claims 0.01 mrad; one that is off by 500 times as much is excluded."""
    frames = drive(np.random.default_rng(1), 30)
    rng = np.random.default_rng(5)
    sigma_rad = 1e-5

    def turns(prev_frame: pv.Frame, frame: pv.Frame) -> list[Measurement]:
        error = np.array([0.0, offset_rad, 0.0]) + sigma_rad * rng.normal(size=3)
        turned = so3.exp(error) @ FORWARD[:3, :3]
        cov = sigma_rad**2 * np.eye(3)
        return [
            RelativeRotation(turned, cov, curr=pose_of(frame.index), prev=pose_of(prev_frame.index))
        ]

    config = {"estimator": estimator, "window": {"frames": 4}}
    odometry = pv.StereoOdometry(CAMERA, config=config, sensors=[turns])
    estimates = [odometry.step(frame) for frame in frames]
    is_excluded = estimates[-1].sensors[0].state == "excluded"
    assert is_excluded == (offset_rad > 0.0)
    if not is_excluded:
        assert all(one.sensors[0].mahalanobis_sq is not None for one in estimates[1:])


@pytest.mark.parametrize("frames_ago", [1, 3])
@pytest.mark.parametrize("estimator", ["two-frame", "window"])
def test_a_measurement_that_is_not_of_the_current_frame_is_refused(
    estimator: str, frames_ago: int
) -> None:
    """A sensor with a delay would correct the wrong pose. The odometry is as before the call."""
    frames = drive(np.random.default_rng(1), 6)

    def late(prev_frame: pv.Frame, frame: pv.Frame) -> list[Measurement]:
        if frame.index < 5:
            return []
        first = pose_of(frame.index - frames_ago)
        if frames_ago == 1:
            return [
                Direction(first, np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, 1.0]), np.eye(2))
            ]
        return [TravelledDistance(3.6, 0.1, pose_of(frame.index), first)]

    odometry = pv.StereoOdometry(CAMERA, config={"estimator": estimator}, sensors=[late])
    for frame in frames[:5]:
        odometry.step(frame)
    before = odometry.state
    with pytest.raises(InputError, match=f"sensor late: at frame 5 .* frame .*{5 - frames_ago}"):
        odometry.step(frames[5])
    assert odometry.state is before


def test_sensors_of_one_name_are_numbered_without_repeating_one() -> None:
    class Named:
        def __init__(self, name: str) -> None:
            self.name = name

        def __call__(self, prev_frame: pv.Frame, frame: pv.Frame) -> list[Measurement]:
            return []

    names = ("gps 2", "gps", "gps", "sun dial", "sun")
    assert sensor_names([Named(name) for name in names]) == (
        *("gps 2", "gps", "gps 3", "sun dial", "sun"),
    )


@pytest.mark.parametrize(("estimator", "state"), [("two-frame", "silent"), ("window", "used")])
def test_a_measured_motion_has_nothing_to_be_tested_against_where_nothing_is_seen(
    estimator: str, state: str
) -> None:
    """Two-frame steps are dead-reckoned without it, and say so; the window uses it."""
    frames = drive(np.random.default_rng(1), 10, points=60)
    frames += [blind_frame(10 + k) for k in range(3)]

    def turns(prev_frame: pv.Frame, frame: pv.Frame) -> list[Measurement]:
        curr = pose_of(frame.index)
        cov = 1e-6 * np.eye(3)
        return [RelativeRotation(FORWARD[:3, :3], cov, curr, pose_of(prev_frame.index))]

    config = {"estimator": estimator, "window": {"frames": 4}}
    odometry = pv.StereoOdometry(CAMERA, config=config, sensors=[turns])
    estimates = [odometry.step(frame) for frame in frames]
    assert [one.sensors[0].state for one in estimates[1:10]] == ["used"] * 9
    for blind in estimates[10:]:
        assert blind.status is Status.TOO_FEW_TRACKS
        assert blind.sensors[0].state == state
        assert blind.sensors[0].reason == ("dead-reckoned step" if state == "silent" else None)

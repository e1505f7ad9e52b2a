"""Frames that show nothing, and the features that are seen again behind them."""

from dataclasses import replace

import numpy as np
import pytest

import probevo as pv
from intervals import chi2_interval
from probevo.arrays import FloatArray
from probevo.config import OdometryConfig
from probevo.estimation.motion_estimate import MotionEstimate
from probevo.estimation.motion_model import MotionModel
from probevo.estimation.recovery import (
    MAX_DURATION_S,
    DeadReckonedPath,
    OutageVelocity,
    Recovery,
    span_factor,
)
from probevo.evaluation.consistency import drift_covariances
from probevo.geometry import se3
from probevo.geometry.uncertainty import normalized_error_squared
from probevo.sequences.frame import StereoFeatures
from worlds import CAMERA, FORWARD, blind_frame, drive

FRAMES = 14
BLIND = (7, 8, 9)
"""Frames that show nothing."""


def motions_of(frames: list[pv.Frame], estimator: str = "two-frame") -> list[MotionEstimate]:
    odometry = pv.StereoOdometry(CAMERA, config={"estimator": estimator})
    return [odometry.step(frame) for frame in frames]


def drive_with_blind_frames(
    rng: np.random.Generator, blind: tuple[int, ...] = BLIND
) -> tuple[list[pv.Frame], FloatArray]:
    """A drive whose speed and turn rate wander, as a car's do, and its true motions."""
    changes = rng.normal(size=(FRAMES, 6)) * np.repeat([0.01, 0.001], 3)
    true = np.array([se3.exp(change) @ FORWARD for change in np.cumsum(changes, axis=0)])
    frames = drive(rng, FRAMES, true)
    for index in blind:
        frames[index] = blind_frame(index)
    return frames, true[1:]


@pytest.mark.parametrize("estimator", ["two-frame", "window"])
def test_the_first_frame_behind_leads_back_to_the_last_one_before(estimator: str) -> None:
    frames, true = drive_with_blind_frames(np.random.default_rng(0))
    motions = motions_of(frames, estimator)
    expected = [pv.Status.TOO_FEW_TRACKS] * 3 + [pv.Status.RECOVERED, pv.Status.OK]
    assert [motion.status for motion in motions[7:12]] == expected
    # The path from before to behind is as good as if it had been seen in one piece.
    found = np.eye(4)
    exact = np.eye(4)
    for k in range(7, 11):
        found = motions[k].T_curr_prev @ found
        exact = true[k - 1] @ exact
    assert np.linalg.norm(se3.log(exact @ se3.inverse(found))[:3]) < 0.05


@pytest.mark.parametrize("estimator", ["two-frame", "window"])
@pytest.mark.parametrize("blind", [BLIND, (7, 9)])
def test_steps_and_path_are_within_their_covariance(blind: tuple[int, ...], estimator: str) -> None:
    """Of 12 drives; the last pose, and the step that recovers."""
    of_step = []
    of_pose = []
    for seed in range(12):
        frames, true = drive_with_blind_frames(np.random.default_rng(seed), blind)
        steps = motions_of(frames, estimator)[1:]
        count = sum(step.status is pv.Status.RECOVERED for step in steps)
        assert count == (1 if blind == BLIND else 2)
        T_world_cam = np.eye(4)
        T_world_cam_true = np.eye(4)
        for step, T_true in zip(steps, true, strict=True):
            T_world_cam = T_world_cam @ se3.inverse(step.T_curr_prev)
            T_world_cam_true = T_world_cam_true @ se3.inverse(T_true)
            if step.status is pv.Status.RECOVERED:
                of_step.append(normalized_error_squared(T_true, step.T_curr_prev, step.cov))
        np.testing.assert_allclose(steps[-1].T_world_cam, T_world_cam, atol=1e-9)
        cov = drift_covariances(
            np.array([step.T_curr_prev for step in steps]),
            np.array([step.cov for step in steps]),
            np.array([step.common_mode for step in steps]),
            np.array([step.path_cross_cov for step in steps]),
        )[-1]
        np.testing.assert_allclose(steps[-1].cov_cam_world, cov, rtol=1e-5, atol=1e-11)
        of_pose.append(
            normalized_error_squared(se3.inverse(T_world_cam_true), se3.inverse(T_world_cam), cov)
        )
    # The calibration's uncertainty counts though it is exact here, and the motion model allows for
    # more than such a car does: conservative, the latter by far.
    _, high = chi2_interval(6, len(of_pose))
    assert 0.3 < np.mean(of_pose) < high
    assert np.mean(of_step) < high
    assert np.sqrt(np.trace(cov[:3, :3])) < 0.1


def test_the_path_is_that_of_a_motion_seen_in_one_piece() -> None:
    """P = Ad P Adᵀ + S, whatever the dead reckoning claimed in between."""
    rng = np.random.default_rng(0)
    before = random_cov(rng, 0.01)
    path = DeadReckonedPath.none()
    cov = before
    for _ in range(3):
        reckoned = MotionEstimate(
            FORWARD, random_cov(rng, 0.3), pv.Status.TOO_FEW_TRACKS, num_tracks=0
        )
        path = path.advanced(0.1, reckoned)
        cov = grown(cov, reckoned)
    assert path.duration_s == pytest.approx(0.3)
    T_curr_usable = se3.exp(0.01 * rng.normal(size=6)) @ FORWARD @ path.T_prev_usable
    seen = MotionEstimate(T_curr_usable, random_cov(rng, 0.02), pv.Status.OK, num_tracks=50)
    step = path.closed(seen)
    np.testing.assert_allclose(step.T_curr_prev @ path.T_prev_usable, T_curr_usable, atol=1e-12)
    np.testing.assert_allclose(grown(cov, step), grown(before, seen), atol=1e-12)


def random_cov(rng: np.random.Generator, sigma: float) -> FloatArray:
    root = sigma * rng.normal(size=(6, 6))
    return root @ root.T


def grown(cov: FloatArray, motion: MotionEstimate) -> FloatArray:
    adjoint = se3.adjoint(motion.T_curr_prev)
    cross = motion.path_cross_cov
    return adjoint @ cov @ adjoint.T + motion.cov + cross + cross.T


def test_the_prediction_over_several_steps_is_that_of_the_motion_model() -> None:
    """Its covariance is that of the path which is dead-reckoned once more."""
    model = MotionModel.at_start(OdometryConfig().motion_model)
    model = model.after_solve(0.1, FORWARD, 1e-4 * np.eye(6))
    path = DeadReckonedPath.none()
    for _ in range(4):
        prediction = model.predict(0.1, None)
        reckoned = model.dead_reckoned(prediction, None, is_rejected=False)
        motion = MotionEstimate(
            reckoned.T_curr_prev,
            reckoned.cov,
            pv.Status.TOO_FEW_TRACKS,
            num_tracks=0,
            path_cross_cov=reckoned.path_cross_cov,
        )
        predicted = path.predicted(prediction, model.path_sensitivity)
        path = path.advanced(0.1, motion)
        model = model.after_dead_reckoning(0.1, prediction, prediction.T_curr_prev)
        np.testing.assert_allclose(predicted.T_curr_prev, path.T_prev_usable, atol=1e-12)
        np.testing.assert_allclose(predicted.cov, path.cov, atol=1e-12)


def test_features_of_long_ago_are_given_up() -> None:
    """The same points behind more than three seconds of blindness are those of a new start."""
    at_rest = np.broadcast_to(np.eye(4), (60, 4, 4))
    frames = drive(np.random.default_rng(0), 60, np.array(at_rest))
    for index in range(10, 10 + round(10 * MAX_DURATION_S) + 1):
        frames[index] = blind_frame(index)
    statuses = {motion.status for motion in motions_of(frames)}
    assert pv.Status.RECOVERED not in statuses


@pytest.mark.parametrize(("frames", "factor"), [(1.0, 1.0), (2.0, 1.0), (6.0, 3.0)])
def test_noise_grows_with_frames_but_the_common_mode_does_not(frames: float, factor: float) -> None:
    common_mode = 0.1 * np.ones((6, 3))
    own = np.eye(6)
    motion = MotionEstimate(
        FORWARD,
        own + common_mode @ common_mode.T,
        pv.Status.OK,
        num_tracks=50,
        common_mode=common_mode,
    )
    found = Recovery(DeadReckonedPath.none(), span_factor(frames)).accepted(motion)
    assert found.status is pv.Status.RECOVERED
    np.testing.assert_allclose(found.cov, factor * own + common_mode @ common_mode.T)


def test_a_window_keeps_no_more_blind_frames_than_others() -> None:
    """And each of its frames leaves once, whether blind or not."""
    blind = tuple(range(12, 26))
    at_rest = np.broadcast_to(np.eye(4), (45, 4, 4))
    frames = drive(np.random.default_rng(0), 45, np.array(at_rest))
    for index in blind:
        frames[index] = blind_frame(index)
    limit = 5
    odometry = pv.StereoOdometry(
        CAMERA, config={"estimator": "window", "window": {"frames": limit}}
    )
    left: list[int] = []
    for frame in frames:
        status = odometry.step(frame).status
        window = odometry.window
        assert window is not None
        left += [pose.frame for pose in window.marginalized]
        num_blind = int(window.is_blind.sum())
        assert num_blind <= limit
        assert len(window) - num_blind <= limit
        if frame.index == blind[-1] + 1:
            # Landmarks connect it with the last frame before.
            assert status is pv.Status.RECOVERED
            last_usable = window.slot(blind[0] - 1)
            ends = window.observations.slot == len(window) - 1
            begins = window.observations.slot == last_usable
            assert set(window.landmark_rows[ends]) & set(window.landmark_rows[begins])
    assert odometry.window is not None
    assert sorted([*left, *odometry.window.frames]) == list(range(45))


@pytest.mark.parametrize("estimator", ["two-frame", "window"])
def test_behind_blind_frames_the_motion_of_the_images_is_that_of_the_step(estimator: str) -> None:
    """Not that from the last usable frame, which the solve has found."""
    frames, true = drive_with_blind_frames(np.random.default_rng(0))
    odometry = pv.StereoOdometry(CAMERA, config={"estimator": estimator})
    for frame in frames[: BLIND[-1] + 2]:
        estimate = odometry.step(frame)
    assert estimate.status is pv.Status.RECOVERED
    error = se3.log(true[BLIND[-1]] @ se3.inverse(odometry.T_curr_prev_before_window))
    assert np.linalg.norm(error[:3]) < 0.2


def drive_past_a_lorry(
    rng: np.random.Generator, *, hidden: range, count: int = FRAMES
) -> tuple[list[pv.Frame], FloatArray]:
    """A drive that sees other points from the first hidden frame on, and those before again behind
    the hidden ones; and its true motions."""
    changes = rng.normal(size=(count, 6)) * np.repeat([0.01, 0.001], 3)
    true = np.array([se3.exp(change) @ FORWARD for change in np.cumsum(changes, axis=0)])
    behind = drive(rng, count, true, points=100)
    others = drive(rng, count, true, points=100)
    frames = []
    for frame, of_others in zip(behind, others, strict=True):
        before, after = frame.features, of_others.features
        assert before is not None
        assert after is not None
        ids = np.zeros(0, np.int64)
        pixels = np.zeros((0, 4))
        if frame.index not in hidden:
            ids, pixels = before.ids, before.pixels
        if frame.index >= hidden.start:
            ids = np.concatenate([ids, after.ids + 10**6])
            pixels = np.vstack([pixels, after.pixels])
        frames.append(replace(frame, features=StereoFeatures(ids, pixels)))
    return frames, true[1:]


@pytest.mark.parametrize("hidden", [range(7, 8), range(7, 10)])
def test_a_window_connects_the_frames_before_with_any_behind_that_see_the_same(
    hidden: range,
) -> None:
    """The first frame behind a gap is solved, but from the one before it, whose place is only
    dead-reckoned."""
    of_pose = []
    for seed in range(10):
        frames, true = drive_past_a_lorry(np.random.default_rng(seed), hidden=hidden)
        odometry = pv.StereoOdometry(CAMERA)
        T_world_cam = np.eye(4)
        statuses = []
        for frame in frames:
            motion = odometry.step(frame)
            statuses.append(motion.status)
            if frame.index:
                T_world_cam = T_world_cam @ se3.inverse(true[frame.index - 1])
            if frame.index == hidden.start:
                uncertain = motion.cov_cam_world
        lost = [k for k, status in enumerate(statuses) if status is not pv.Status.OK]
        assert lost == [0, hidden.start]
        # Dead reckoning has left 0.02 rad, which is in all later poses but for the connection.
        assert np.sqrt(np.diagonal(uncertain)[3:]).max() > 0.015
        assert np.sqrt(np.diagonal(motion.cov_cam_world)[3:]).max() < 0.003
        assert odometry.state is not None
        assert odometry.state.outage is None
        of_pose.append(
            normalized_error_squared(
                se3.inverse(T_world_cam), motion.T_cam_world, motion.cov_cam_world
            )
        )
    _, high = chi2_interval(6, len(of_pose))
    assert np.mean(of_pose) < high


def test_what_is_never_seen_again_is_given_up() -> None:
    """And nothing holds on to the frames before, however often that happens."""
    frames, _ = drive_past_a_lorry(np.random.default_rng(0), hidden=range(7, 60), count=60)
    odometry = pv.StereoOdometry(CAMERA)
    waited = 0
    for frame in frames:
        odometry.step(frame)
        assert odometry.state is not None
        outage = odometry.state.outage
        if outage is not None and not outage.lasts:
            waited += 1
            assert outage.before.outage is None
            assert outage.path.duration_s <= MAX_DURATION_S
    assert 20 < waited < 10 * MAX_DURATION_S
    assert odometry.state.outage is None


def test_two_frames_have_nothing_to_connect() -> None:
    frames, _ = drive_past_a_lorry(np.random.default_rng(0), hidden=range(7, 8))
    odometry = pv.StereoOdometry(CAMERA, config={"estimator": "two-frame"})
    for frame in frames:
        odometry.step(frame)
        assert odometry.state is not None
        assert odometry.state.outage is None or odometry.state.outage.lasts


def driven(rng: np.random.Generator, frames: int, acceleration: float) -> FloatArray:
    """Return the motions of a vehicle that accelerates at random, [frames, 4, 4], by so many
    standard deviations of the motion model."""
    accelerations = MotionModel.at_start(OdometryConfig().motion_model).accelerations
    changes = acceleration * 0.1**2 * accelerations * rng.normal(size=(frames, 6))
    motions: FloatArray = se3.exp(se3.log(FORWARD) + np.cumsum(changes, axis=0))
    return motions


def gap_of(motions: FloatArray, cov: FloatArray) -> OutageVelocity:
    """Return the gap between the first of these motions and the last, both of which are solved."""
    before = MotionModel.at_start(OdometryConfig().motion_model).after_solve(0.1, motions[0], cov)
    path = replace(DeadReckonedPath.none(), duration_s=0.1 * (len(motions) - 2))
    behind = MotionEstimate(motions[-1], cov, pv.Status.OK, num_tracks=50)
    return OutageVelocity.between(path, before, behind, 0.1)


@pytest.mark.parametrize("dark", [1, 3, 10])
def test_a_motion_across_a_gap_agrees_with_the_velocities_beside_it(dark: int) -> None:
    cov = 1e-6 * np.eye(6)
    for seed in range(200):
        motions = driven(np.random.default_rng(seed), dark + 2, acceleration=1.0)
        gap = gap_of(motions, cov)
        across = np.eye(4)
        for motion in motions[1:]:
            across = motion @ across
        assert not gap.contradicts(across, cov)
        # Two more solved steps change nothing, whatever they are.
        turn = se3.exp(np.array([0.0, 0.0, -2.0, 0.0, 0.5, 0.0]))
        later = gap.advanced(turn).advanced(turn)
        assert not later.contradicts(turn @ turn @ across, cov)


def test_the_motion_of_a_vehicle_that_covers_the_view_contradicts_them() -> None:
    """It is as fast as the camera: its features stay where they are."""
    cov = 1e-6 * np.eye(6)
    for dark in (1, 3, 5):
        motions = driven(np.random.default_rng(dark), dark + 2, acceleration=0.2)
        gap = gap_of(motions, cov)
        assert gap.contradicts(np.eye(4), cov)
        assert gap.advanced(FORWARD).contradicts(FORWARD, cov)


def test_behind_a_start_the_velocity_of_the_step_behind_counts() -> None:
    cov = 1e-6 * np.eye(6)
    start = MotionModel.at_start(OdometryConfig().motion_model)
    path = replace(DeadReckonedPath.none(), duration_s=0.1)
    gap = OutageVelocity.between(
        path, start, MotionEstimate(FORWARD, cov, pv.Status.OK, num_tracks=50), 0.1
    )
    assert not gap.contradicts(FORWARD @ FORWARD, cov)
    back = se3.exp(np.array([0.0, 0.0, 12.0, 0.0, 0.0, 0.0]))
    assert gap.contradicts(FORWARD @ back, cov)

"""Tracks to motion: how each status comes about, and that what is not OK is not believed."""

import numpy as np
import pytest

from probevo.config import GyroConfig, OdometryConfig, RansacConfig, SolverConfig
from probevo.geometry import se3, so3
from probevo.motion.estimate import Status
from probevo.motion.motion_model import ExpectedMotion, MotionModel
from probevo.motion.reprojection import RotationPrior
from probevo.motion.visual import VisualMotion, estimate_motion
from probevo.noise import StudentT
from probevo.stage_clock import StageClock
from probevo.tracking.tracks import Tracks
from worlds import CAMERA, FORWARD, at_infinity, both, motion_error, seen_twice

CONFIG = OdometryConfig()
UNKNOWN = MotionModel.at_start(CONFIG.motion_model).expected(0.1, None)
"""What is expected of the first step: any motion of a car."""
STANDSTILL = ExpectedMotion(np.eye(4), np.diag(np.repeat([0.05**2, 0.01**2], 3)))


def look(
    tracks: Tracks,
    expected: ExpectedMotion = UNKNOWN,
    rotation: RotationPrior | None = None,
    config: OdometryConfig = CONFIG,
    clock: StageClock | None = None,
) -> VisualMotion:
    predictors, rng = np.zeros((len(tracks), 0)), np.random.default_rng(0)
    clock = clock or StageClock()
    return estimate_motion(tracks, predictors, StudentT(), CAMERA, expected, rotation, config, rng, clock)


def test_good_tracks_give_the_motion() -> None:
    visual = look(seen_twice(np.random.default_rng(0), 200, sigma_px=0.2))
    assert visual.status is Status.OK
    assert visual.solution is not None
    error = motion_error(visual.solution.T_curr_prev)
    assert error @ np.linalg.solve(visual.solution.cov, error) < 22.5  # 99.9 % of χ²(6)


@pytest.mark.parametrize("count", [0, 1, 3, 5])
def test_fewer_tracks_than_wanted_are_too_few(count: int) -> None:
    visual = look(seen_twice(np.random.default_rng(1), count))
    assert visual.status is Status.TOO_FEW_TRACKS
    assert visual.solution is None
    np.testing.assert_array_equal(visual.weights, np.zeros(count))


def test_as_many_tracks_as_wanted_are_enough() -> None:
    assert look(seen_twice(np.random.default_rng(2), CONFIG.solver.min_tracks)).status is Status.OK


def test_tracks_that_agree_on_nothing_are_too_few() -> None:
    """Twenty points that jump about at random: less than six agree on any motion."""
    tracks = seen_twice(np.random.default_rng(3), 20)
    tracks.curr_px[:] += np.random.default_rng(4).uniform(-200.0, 200.0, (20, 4))
    assert look(tracks).status is Status.TOO_FEW_TRACKS


def test_points_at_infinity_alone_are_degenerate() -> None:
    """They fix the rotation, but no translation."""
    assert look(at_infinity(np.random.default_rng(5), 60)).status is Status.DEGENERATE


def test_far_points_are_degenerate_though_all_is_finite() -> None:
    """Points at 3 to 6 km, a tenth of a pixel of disparity: the translation is known to metres only."""
    visual = look(seen_twice(np.random.default_rng(6), 100, sigma_px=0.2, depth_m=(3000.0, 6000.0)))
    assert visual.status is Status.DEGENERATE


def test_points_all_in_one_place_are_degenerate() -> None:
    """They agree with the motion that was expected, but do not fix it."""
    tracks = seen_twice(np.random.default_rng(7), 1)
    visual = look(tracks.kept(np.zeros(30, np.int64)), ExpectedMotion(FORWARD, UNKNOWN.cov))
    assert visual.status is Status.DEGENERATE


def test_few_near_points_rescue_those_at_infinity() -> None:
    rng = np.random.default_rng(8)
    visual = look(both(at_infinity(rng, 60), seen_twice(rng, 15, sigma_px=0.2, depth_m=(5.0, 15.0))))
    assert visual.status is Status.OK


def test_an_absurd_jump_is_not_believed() -> None:
    """All tracks agree on 1.2 m ahead where 5 cm is the standard deviation of what is possible."""
    assert look(seen_twice(np.random.default_rng(9), 200, sigma_px=0.2), STANDSTILL).status is Status.NOT_CONVERGED


def test_a_solve_that_is_cut_short_is_not_believed() -> None:
    config = OdometryConfig(solver=SolverConfig(max_iterations=1))
    visual = look(seen_twice(np.random.default_rng(10), 200, sigma_px=0.2), config=config)
    assert visual.status is Status.NOT_CONVERGED


def test_outliers_of_the_consensus_have_no_weight_and_no_part_in_the_solve() -> None:
    tracks = seen_twice(np.random.default_rng(11), 100, sigma_px=0.2)
    tracks.curr_px[:30, 1::2] += 40.0
    visual = look(tracks)
    assert (visual.weights[:30] == 0.0).all()
    assert visual.weights[30:].mean() > 0.5
    assert not visual.used[:30].any()
    assert visual.solution is not None
    assert len(visual.solution.weight) == visual.used.sum()


def test_without_rejection_the_robust_loss_sees_all() -> None:
    config = OdometryConfig(ransac=RansacConfig(mode="guess"))
    tracks = seen_twice(np.random.default_rng(12), 100, sigma_px=0.2)
    tracks.curr_px[:30, 1::2] += 40.0
    visual = look(tracks, config=config)
    assert visual.used.sum() == 100
    assert (visual.weights[:30] < 0.05).all()
    assert visual.status is Status.OK


def test_noisy_tracks_widen_the_threshold() -> None:
    """At 3 px hardly any of them agree on a motion; at 12 px enough do, none as well as the model wants."""
    visual = look(seen_twice(np.random.default_rng(13), 100, sigma_px=4.0, depth_m=(4.0, 10.0)))
    assert visual.used.sum() >= 25
    assert visual.status is Status.TOO_FEW_TRACKS


def test_tracks_of_nothing_are_not_believed() -> None:
    """Points matched at random agree on some motion, but too few, or not well enough."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        before, now = (seen_twice(rng, 150) for _ in range(2))
        visual = look(Tracks(before.prev_px, now.curr_px, before.ids, before.age))
        assert visual.status is not Status.OK


def test_the_gyro_s_rotation_may_start_the_consensus() -> None:
    """One point and a gyro that is off by 0.1°: the solve corrects it."""
    config = OdometryConfig(ransac=RansacConfig(rotation_from="gyro"))
    C_gyro = so3.exp(np.radians([0.1, 0.0, 0.0])) @ FORWARD[:3, :3]
    tracks = seen_twice(np.random.default_rng(14), 200, sigma_px=0.2, depth_m=(5.0, 15.0))
    visual = look(tracks, rotation=RotationPrior(C_gyro, 1e-6 * np.eye(3)), config=config)
    assert visual.solution is not None
    assert np.linalg.norm(motion_error(visual.solution.T_curr_prev)[3:]) < 3e-4


@pytest.mark.parametrize("prior", [False, True])
def test_the_gyro_enters_the_solve_only_if_asked_for(prior: bool) -> None:
    """A gyro that is all too sure of a wrong rotation, by 0.1°, has its way only as a prior."""
    C_gyro = so3.exp(np.radians([0.0, 0.1, 0.0])) @ FORWARD[:3, :3]
    tracks = seen_twice(np.random.default_rng(15), 200, sigma_px=0.2)
    config = OdometryConfig(gyro=GyroConfig(prior=prior))
    solution = look(tracks, rotation=RotationPrior(C_gyro, 1e-14 * np.eye(3)), config=config).solution
    assert solution is not None
    off_deg = np.degrees(np.linalg.norm(so3.log(solution.T_curr_prev[:3, :3] @ C_gyro.T)))
    assert bool(off_deg < 1e-3) is prior


def test_times_of_the_stages_are_taken() -> None:
    clock = StageClock()
    look(seen_twice(np.random.default_rng(16), 50), clock=clock)
    assert set(clock.times_ms) == {"consensus", "solve"}


def test_the_motion_does_not_depend_on_where_it_was_expected() -> None:
    tracks = seen_twice(np.random.default_rng(17), 200, sigma_px=0.2)
    near = ExpectedMotion(se3.exp(np.array([0.0, 0.0, -1.0, 0.0, 0.0, 0.0])), UNKNOWN.cov)
    solutions = [look(tracks, expected).solution for expected in (UNKNOWN, near)]
    assert solutions[0] is not None
    assert solutions[1] is not None
    assert np.abs(motion_error(solutions[0].T_curr_prev, solutions[1].T_curr_prev)).max() < 2e-3

"""Tracks to motion: how each status comes about, and that what is not OK is not believed."""

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from scipy.stats import chi2

from intervals import chi2_interval
from probevo.arrays import FloatArray
from probevo.config import GyroConfig, OdometryConfig, RansacConfig, SolverConfig
from probevo.errors import InputError
from probevo.estimation.disparity_filter import DisparityMemory
from probevo.estimation.motion_estimate import Status
from probevo.estimation.motion_model import ExpectedMotion, MotionModel
from probevo.estimation.reprojection import ReprojectionSolution, RotationPrior, solve_reprojection
from probevo.estimation.two_frame import VisualMotion, confirmed, estimate_motion, solve
from probevo.geometry import se3, so3
from probevo.geometry.uncertainty import normalized_error_squared
from probevo.noise import Fixed, NoiseModel, StereoNoise, StudentT
from probevo.stage_clock import StageClock
from probevo.tracking.tracks import Tracks
from worlds import CAMERA, FORWARD, Homesick, at_infinity, both, motion_error, seen_twice, tracks_of

CONFIG = OdometryConfig()
UNKNOWN = MotionModel.at_start(CONFIG.motion_model).expected(0.1, None)
"""What is expected of the first step: any motion of a car."""
SLOW = np.diag(np.repeat([0.05, 0.01], 3))
STANDSTILL = ExpectedMotion(np.eye(4), SLOW**2, SLOW)


def look(
    tracks: Tracks,
    expected: ExpectedMotion = UNKNOWN,
    rotation: RotationPrior | None = None,
    config: OdometryConfig = CONFIG,
    clock: StageClock | None = None,
    noise: NoiseModel | None = None,
) -> VisualMotion:
    predictors = np.zeros((len(tracks), 0))
    rng = np.random.default_rng(0)
    clock = clock or StageClock()
    return estimate_motion(
        tracks,
        predictors,
        noise or StudentT(),
        camera=CAMERA,
        expected=expected,
        rotation=rotation,
        memory=DisparityMemory.none(),
        config=config,
        rng=rng,
        clock=clock,
    )


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
    """Points at 3 to 6 km, a tenth of a pixel of disparity: the translation is known to metres
    only."""
    visual = look(seen_twice(np.random.default_rng(6), 100, sigma_px=0.2, depth_m=(3000.0, 6000.0)))
    assert visual.status is Status.DEGENERATE


def test_points_all_in_one_place_are_degenerate() -> None:
    """They agree with the motion that was expected, but do not fix it."""
    tracks = seen_twice(np.random.default_rng(7), 1)
    visual = look(tracks.kept(np.zeros(30, np.int64)), replace(UNKNOWN, T_curr_prev=FORWARD))
    assert visual.status is Status.DEGENERATE


def test_few_near_points_rescue_those_at_infinity() -> None:
    rng = np.random.default_rng(8)
    visual = look(
        both(at_infinity(rng, 60), seen_twice(rng, 15, sigma_px=0.2, depth_m=(5.0, 15.0)))
    )
    assert visual.status is Status.OK


def test_an_absurd_jump_is_not_believed() -> None:
    """All tracks agree on 1.2 m ahead where 5 cm is the standard deviation of what is possible."""
    assert (
        look(seen_twice(np.random.default_rng(9), 200, sigma_px=0.2), STANDSTILL).status
        is Status.NOT_CONVERGED
    )


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


def test_out_of_domain_features_are_told_among_those_used() -> None:
    tracks = seen_twice(np.random.default_rng(11), 100, sigma_px=0.2)
    tracks.curr_px[:30, 1::2] += 40.0
    visual = look(tracks, noise=Homesick())
    plain = look(tracks)
    assert visual.out_of_domain is not None
    np.testing.assert_array_equal(
        visual.out_of_domain[visual.used], np.arange(visual.num_used) % 3 == 0
    )
    assert not visual.out_of_domain[~visual.used].any()
    assert visual.num_out_of_domain == -(-visual.num_used // 3)
    assert visual.num_used == plain.num_used == visual.used.sum() > 60
    assert (plain.out_of_domain, plain.num_out_of_domain) == (None, None)


def test_where_nothing_is_solved_nothing_is_used_and_nothing_out_of_domain() -> None:
    visual = look(seen_twice(np.random.default_rng(1), 5), noise=Homesick())
    assert (visual.status, visual.num_used, visual.num_out_of_domain) == (
        Status.TOO_FEW_TRACKS,
        0,
        None,
    )


def test_without_rejection_the_robust_loss_sees_all() -> None:
    config = OdometryConfig(ransac=RansacConfig(mode="guess"))
    tracks = seen_twice(np.random.default_rng(12), 100, sigma_px=0.2)
    tracks.curr_px[:30, 1::2] += 40.0
    visual = look(tracks, config=config)
    assert visual.used.sum() == 100
    assert (visual.weights[:30] < 0.05).all()
    assert visual.status is Status.OK


def test_noisy_tracks_widen_the_threshold() -> None:
    """At 3 px hardly any of them agree on a motion; at 12 px enough do, none as well as the model
    wants."""
    visual = look(seen_twice(np.random.default_rng(13), 100, sigma_px=4.0, depth_m=(4.0, 10.0)))
    assert visual.used.sum() >= 25
    assert visual.status is Status.TOO_FEW_TRACKS


def test_tracks_of_nothing_are_not_believed() -> None:
    """Points matched at random agree on some motion, but too few, or not well enough."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        before, now = (seen_twice(rng, 150) for _ in range(2))
        visual = look(Tracks(before.prev_px, now.curr_px, before.ids, age=before.age))
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
    solution = look(
        tracks, rotation=RotationPrior(C_gyro, 1e-14 * np.eye(3)), config=config
    ).solution
    assert solution is not None
    off_deg = np.degrees(np.linalg.norm(so3.log(solution.T_curr_prev[:3, :3] @ C_gyro.T)))
    assert bool(off_deg < 1e-3) is prior


def test_times_of_the_stages_are_taken() -> None:
    clock = StageClock()
    look(seen_twice(np.random.default_rng(16), 50), clock=clock)
    assert set(clock.times_ms) == {"consensus", "solve"}


def test_the_motion_does_not_depend_on_where_it_was_expected() -> None:
    tracks = seen_twice(np.random.default_rng(17), 200, sigma_px=0.2)
    near = replace(UNKNOWN, T_curr_prev=se3.exp(np.array([0.0, 0.0, -1.0, 0.0, 0.0, 0.0])))
    solutions = [look(tracks, expected).solution for expected in (UNKNOWN, near)]
    assert solutions[0] is not None
    assert solutions[1] is not None
    assert np.abs(motion_error(solutions[0].T_curr_prev, solutions[1].T_curr_prev)).max() < 2e-3


METHODS: tuple[Literal["reprojection", "alignment"], ...] = ("reprojection", "alignment")
NEAR_M = (3.0, 10.0)
"""Here the noise of triangulated points is nearly Gaussian, as alignment assumes."""


def solved(
    tracks: Tracks, method: Literal["reprojection", "alignment"], noise: StereoNoise | None = None
) -> ReprojectionSolution:
    """From a guess that is off by 5 cm and half a degree."""
    guess = se3.exp(np.array([0.02, -0.03, 0.03, 0.004, -0.006, 0.005])) @ FORWARD
    noise = noise or Fixed().predict(np.zeros((len(tracks), 0)))
    return solve(
        tracks, noise, guess, camera=CAMERA, prior=None, config=SolverConfig(method=method)
    )


def test_alignment_and_reprojection_are_exact_without_noise() -> None:
    tracks = seen_twice(np.random.default_rng(18), 60, depth_m=NEAR_M)
    for method in METHODS:
        assert np.abs(motion_error(solved(tracks, method).T_curr_prev)).max() < 1e-6


def test_near_points_give_the_same_motion_aligned_or_reprojected() -> None:
    """They differ by a small part of their standard deviation, which they agree on."""
    tracks = seen_twice(np.random.default_rng(19), 100, sigma_px=0.2, depth_m=NEAR_M)
    reprojected, aligned = (solved(tracks, method) for method in METHODS)
    assert (reprojected.converged, aligned.converged) == (True, True)
    sigma = np.sqrt(np.diag(reprojected.cov))
    between = motion_error(aligned.T_curr_prev, reprojected.T_curr_prev)
    assert (np.abs(between) < 0.3 * sigma).all()
    np.testing.assert_allclose(np.sqrt(np.diag(aligned.cov)), sigma, rtol=0.3)


def disturbed(rng: np.random.Generator, clean: Tracks, sigma_px: FloatArray) -> Tracks:
    """With noise of its own on each feature, [N]."""
    white = sigma_px[:, None] * rng.normal(size=(2, len(clean), 4))
    return tracks_of(clean.prev_px + white[0], clean.curr_px + white[1])


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("spread", [0.0, 1.0])
def test_the_covariance_of_either_is_honest(
    method: Literal["reprojection", "alignment"], spread: float
) -> None:
    """The NEES of 150 noisy solves sum up to within the 99 % interval of χ²(900), where each
    feature's σ is known.

    With ``spread``, it differs by a factor of e from one feature to the next.
    """
    rng = np.random.default_rng(20)
    errors = []
    for _ in range(150):
        factor = np.exp(2.0 * spread * rng.normal(size=60))
        tracks = disturbed(rng, seen_twice(rng, 60, depth_m=NEAR_M), 0.2 * np.sqrt(factor))
        solution = solved(tracks, method, Fixed().predict(np.zeros((60, 0))).scaled(factor))
        errors.append(float(normalized_error_squared(FORWARD, solution.T_curr_prev, solution.cov)))
    assert chi2.ppf(0.005, df=6 * 150) < np.sum(errors) < chi2.ppf(0.995, df=6 * 150)


def test_the_covariance_of_an_alignment_is_honest_under_heavy_tails() -> None:
    """The scale of the shipped Student-t is no covariance: of what it has of tails, the consensus
    leaves a part."""
    rng = np.random.default_rng(22)
    errors = []
    config = OdometryConfig(solver=SolverConfig(method="alignment"))
    for _ in range(150):
        tracks = disturbed(
            rng, seen_twice(rng, 100, depth_m=NEAR_M), 0.17 / np.sqrt(rng.chisquare(2.5, 100) / 2.5)
        )
        visual = look(tracks, config=config, noise=StudentT(time_correlation_ratio=0.0))
        assert visual.solution is not None
        errors.append(
            float(
                normalized_error_squared(FORWARD, visual.solution.T_curr_prev, visual.solution.cov)
            )
        )
    # What the consensus rejects of the tails is not known: the lower bound is looser.
    _, high = chi2_interval(6, len(errors))
    assert 4.0 < np.mean(errors) < high


def test_alignment_says_what_the_reprojection_says_of_each_feature() -> None:
    """At its own motion: residuals and weights, by which mismatches are told."""
    tracks = seen_twice(np.random.default_rng(21), 80, sigma_px=0.2, depth_m=NEAR_M)
    noise = StudentT().predict(np.zeros((80, 0)))
    aligned = solved(tracks, "alignment", noise)
    there = solve_reprojection(
        tracks.prev_px,
        tracks.curr_px,
        noise,
        guess=aligned.T_curr_prev,
        camera=CAMERA,
        max_iterations=0,
    )
    np.testing.assert_array_equal(aligned.residuals, there.residuals)
    np.testing.assert_array_equal(aligned.weight, there.weight)
    assert aligned.iterations > 0


def test_alignment_finds_its_way_through_the_whole_flow() -> None:
    config = OdometryConfig(solver=SolverConfig(method="alignment"))
    tracks = seen_twice(np.random.default_rng(22), 200, sigma_px=0.2, depth_m=NEAR_M)
    tracks.curr_px[:40, 1::2] += 40.0
    visual = look(tracks, config=config)
    assert visual.status is Status.OK
    assert visual.solution is not None
    assert np.linalg.norm(motion_error(visual.solution.T_curr_prev)) < 0.02


def test_alignment_needs_the_noise_of_each_observation() -> None:
    """A learned noise of the whole residual says nothing of the points on their own."""
    noise = StereoNoise(
        np.tile(np.eye(4), (60, 1, 1)), np.full(60, np.inf), np.zeros((60, 4)), refers_to="residual"
    )
    tracks = seen_twice(np.random.default_rng(23), 60)
    with pytest.raises(InputError) as caught:
        solved(tracks, "alignment", noise)
    assert str(caught.value).startswith(
        "--solver.method: alignment needs the noise of each observation"
    )
    assert "reprojection" in caught.value.cure
    assert solved(tracks, "reprojection", noise).converged


def test_without_iterations_the_guess_is_kept() -> None:
    """And everything else is said of the features at it: residuals are those of the guess."""
    tracks = seen_twice(np.random.default_rng(24), 40, depth_m=NEAR_M)
    guess = se3.exp(np.array([0.01, 0.0, 0.02, 0.0, 0.001, 0.0])) @ FORWARD
    noise = Fixed().predict(np.zeros((40, 0)))
    there = solve_reprojection(
        tracks.prev_px, tracks.curr_px, noise, guess=guess, camera=CAMERA, max_iterations=0
    )
    np.testing.assert_array_equal(there.T_curr_prev, guess)
    assert (there.iterations, there.converged) == (0, True)
    predicted = CAMERA.project(se3.transform(guess, CAMERA.triangulate(tracks.prev_px)))
    plain = tracks.curr_px - predicted
    assert np.corrcoef(there.residuals.ravel(), plain.ravel())[0, 1] > 0.99
    assert np.isfinite(there.cov).all()


def street_and_car(sigma_px: tuple[float, float], T_car: FloatArray) -> Tracks:
    """120 features of a street and 30 of a car, with their noise, and how the camera moves by the
    car's word."""
    rng = np.random.default_rng(30)
    return both(
        seen_twice(rng, 120, sigma_px=sigma_px[0]),
        seen_twice(rng, 30, T_car, sigma_px=sigma_px[1], depth_m=(5.0, 15.0)),
    )


def noise_of(sigma_px: tuple[float, float]) -> StereoNoise:
    scale = np.repeat(sigma_px, [120, 30])[:, None, None] ** 2 * np.eye(4)
    return StereoNoise(scale, np.full(150, 20.0), np.zeros((150, 4)), refers_to="observation")


SIDEWAYS = se3.exp(np.array([0.2, 0.0, 0.0, 0.0, 0.0, 0.0])) @ FORWARD


def test_a_noise_that_went_with_a_car_is_contradicted_by_the_street() -> None:
    tracks = street_and_car((0.2, 0.2), SIDEWAYS)
    fooled = solve(
        tracks, noise_of((3.0, 0.1)), FORWARD, camera=CAMERA, prior=None, config=CONFIG.solver
    )
    assert np.linalg.norm(motion_error(fooled.T_curr_prev, SIDEWAYS)[:3]) < 0.1
    judging = confirmed(fooled, tracks, FORWARD, camera=CAMERA, prior=None, config=CONFIG.solver)
    assert np.linalg.norm(motion_error(judging)[:3]) < 0.05


def test_a_noise_that_is_right_has_the_word() -> None:
    sigma_px = 0.6, 0.1
    tracks = street_and_car(sigma_px, FORWARD)
    solution = solve(
        tracks, noise_of(sigma_px), FORWARD, camera=CAMERA, prior=None, config=CONFIG.solver
    )
    judging = confirmed(solution, tracks, FORWARD, camera=CAMERA, prior=None, config=CONFIG.solver)
    np.testing.assert_array_equal(judging, solution.T_curr_prev)


def test_a_motion_that_cannot_be_contradicted_stands() -> None:
    """Two tracks say nothing of their own."""
    tracks = street_and_car((0.2, 0.2), SIDEWAYS)
    solution = solve(
        tracks, noise_of((3.0, 0.1)), FORWARD, camera=CAMERA, prior=None, config=CONFIG.solver
    )
    judging = confirmed(
        solution,
        tracks.kept(np.arange(2)),
        FORWARD,
        camera=CAMERA,
        prior=None,
        config=CONFIG.solver,
    )
    np.testing.assert_array_equal(judging, solution.T_curr_prev)

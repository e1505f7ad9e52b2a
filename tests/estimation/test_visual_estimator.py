"""Tracks to motion: how each status comes about, and that only a status of OK is accepted."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.special import chdtri

import probevo as pv
from intervals import chi2_interval
from probevo.arrays import FloatArray
from probevo.config import GyroConfig, OdometryConfig, RansacConfig, SolverConfig
from probevo.errors import InputError
from probevo.estimation import visual_estimator
from probevo.estimation.acceptance import are_beyond_chance, evaluate_status
from probevo.estimation.disparity_filter import DisparityFilter
from probevo.estimation.motion_estimate import Status
from probevo.estimation.motion_model import MotionModel, MotionPrediction
from probevo.estimation.ransac import Consensus
from probevo.estimation.reprojection import ReprojectionSolution, solve_reprojection
from probevo.estimation.two_frame import TwoFrameEstimate, TwoFrameEstimator
from probevo.estimation.visual_estimator import VisualEstimator
from probevo.estimation.visual_motion import MotionPriors, VisualMotion
from probevo.estimation.visual_solve import VisualSolve
from probevo.geometry import se3, so3
from probevo.geometry.uncertainty import normalized_error_squared
from probevo.measurements.relative_rotation import RelativeRotation
from probevo.measurements.stereo_observations import StereoObservations
from probevo.measurements.variables import MOTION
from probevo.noise import (
    Fixed,
    GeneralizedKernel,
    NearestNeighbors,
    NoiseModel,
    StereoNoise,
    StudentT,
)
from probevo.noise.base import has_relative_scale
from probevo.stage_clock import StageClock
from probevo.tracking.tracks import Tracks
from worlds import (
    CAMERA,
    FORWARD,
    Homesick,
    at_infinity,
    both,
    drive,
    motion_error,
    seen_twice,
    tracks_of,
)

CONFIG = OdometryConfig()
UNKNOWN = MotionModel.at_start(CONFIG.motion_model).predict(0.1, None)
"""The prediction of the first step: any motion of a car."""
SLOW = np.diag(np.repeat([0.05, 0.01], 3))
STANDSTILL = MotionPrediction(np.eye(4), SLOW**2, velocity_sensitivity=SLOW)
NEAR_M = (3.0, 10.0)
"""Here the noise of triangulated points is nearly Gaussian, as alignment assumes."""


Scaled = partial(StudentT, scale_is_relative=True)
"""A given scale that the odometry is to scale."""


def priors_of(
    prediction: MotionPrediction = UNKNOWN,
    gyro: RelativeRotation | None = None,
    config: OdometryConfig = CONFIG,
) -> MotionPriors:
    """As the odometry gives them: the gyro enters the solve where the settings say so."""
    return MotionPriors(
        prediction=prediction,
        gyro=gyro,
        disparities=DisparityFilter.none(),
        measurements=[gyro] if gyro is not None and config.gyro.prior else [],
    )


def estimate(
    tracks: Tracks,
    prediction: MotionPrediction = UNKNOWN,
    *,
    gyro: RelativeRotation | None = None,
    config: OdometryConfig = CONFIG,
    clock: StageClock | None = None,
    noise: NoiseModel | None = None,
    predicts_from_motion: bool = False,
) -> VisualMotion:
    estimator = VisualEstimator(
        CAMERA, noise or StudentT(), config, predicts_from_motion=predicts_from_motion
    )
    return estimator.estimate(
        tracks,
        np.zeros((len(tracks), 0)),
        priors_of(prediction, gyro, config),
        rng=np.random.default_rng(0),
        clock=clock or StageClock(),
    )


def test_good_tracks_give_the_motion() -> None:
    visual = estimate(seen_twice(np.random.default_rng(0), 200, sigma_px=0.2))
    assert visual.status is Status.OK
    assert visual.solution is not None
    assert visual.accepted_solution is visual.solution
    error = motion_error(visual.solution.T_curr_prev)
    assert error @ np.linalg.solve(visual.solution.cov, error) < 22.5  # 99.9 % of χ²(6)


@pytest.mark.parametrize("count", [0, 1, 3, 5])
def test_fewer_tracks_than_wanted_are_too_few(count: int) -> None:
    visual = estimate(seen_twice(np.random.default_rng(1), count))
    assert visual.status is Status.TOO_FEW_TRACKS
    assert visual.solution is None
    np.testing.assert_array_equal(visual.weights, np.zeros(count))
    with pytest.raises(ValueError, match="TOO_FEW_TRACKS"):
        _ = visual.accepted_solution


def test_as_many_tracks_as_wanted_are_enough() -> None:
    tracks = seen_twice(np.random.default_rng(2), CONFIG.solver.min_tracks)
    assert estimate(tracks).status is Status.OK


def test_tracks_that_agree_on_nothing_are_too_few() -> None:
    """Twenty points that jump about at random: less than six agree on any motion."""
    tracks = seen_twice(np.random.default_rng(3), 20)
    tracks.curr_px[:] += np.random.default_rng(4).uniform(-200.0, 200.0, (20, 4))
    assert estimate(tracks).status is Status.TOO_FEW_TRACKS


def test_points_at_infinity_only_are_degenerate() -> None:
    """They fix the rotation, but no translation."""
    visual = estimate(at_infinity(np.random.default_rng(5), 60))
    assert visual.status is Status.DEGENERATE
    assert visual.solution is None


def test_far_points_are_degenerate_though_all_is_finite() -> None:
    """Points at 3 to 6 km, a tenth of a pixel of disparity: the translation is known to metres
    only."""
    tracks = seen_twice(np.random.default_rng(6), 100, sigma_px=0.2, depth_m=(3000.0, 6000.0))
    assert estimate(tracks).status is Status.DEGENERATE


def test_points_all_in_one_place_are_degenerate() -> None:
    """They agree with the predicted motion, but do not fix it."""
    tracks = seen_twice(np.random.default_rng(7), 1)
    same = tracks.subset(np.zeros(30, np.int64))
    assert estimate(same, replace(UNKNOWN, T_curr_prev=FORWARD)).status is Status.DEGENERATE


def test_few_near_points_rescue_those_at_infinity() -> None:
    rng = np.random.default_rng(8)
    far = at_infinity(rng, 60)
    near = seen_twice(rng, 15, sigma_px=0.2, depth_m=(5.0, 15.0))
    assert estimate(both(far, near)).status is Status.OK


def test_a_motion_that_fails_the_gate_is_not_accepted() -> None:
    """All tracks agree on 1.2 m ahead where 5 cm is the standard deviation of what is possible."""
    visual = estimate(seen_twice(np.random.default_rng(9), 200, sigma_px=0.2), STANDSTILL)
    assert visual.status is Status.NOT_CONVERGED
    assert visual.solution is not None
    assert not len(visual.disparities.ids)


@pytest.mark.parametrize("seed", range(3))
def test_of_a_van_ahead_and_fewer_features_of_the_street_the_latter_give_the_motion(
    seed: int,
) -> None:
    """The van keeps its distance, within 10 m, while 1.2 m ahead are predicted to 5 cm."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1.0, 1.0, (60, 3)) + np.array([0.0, 0.0, 8.0])
    on_van = tracks_of(*(CAMERA.project(points) + 0.2 * rng.normal(size=(2, 60, 4))))
    street = seen_twice(rng, 40, sigma_px=0.2, depth_m=(5.0, 40.0))
    visual = estimate(both(on_van, street), replace(STANDSTILL, T_curr_prev=FORWARD))
    assert visual.status is Status.OK
    error = motion_error(visual.accepted_solution.T_curr_prev)
    assert error @ np.linalg.solve(visual.accepted_solution.cov, error) < 22.5  # 99.9 % of χ²(6)
    assert visual.weights[:60].max() < 0.5


def test_a_solve_that_is_cut_short_is_not_accepted() -> None:
    config = OdometryConfig(solver=SolverConfig(max_iterations=1))
    visual = estimate(seen_twice(np.random.default_rng(10), 200, sigma_px=0.2), config=config)
    assert visual.status is Status.NOT_CONVERGED


def with_mismatches(seed: int) -> Tracks:
    """A hundred tracks, of which the first thirty are off by 40 px along the columns."""
    tracks = seen_twice(np.random.default_rng(seed), 100, sigma_px=0.2)
    tracks.curr_px[:30, 1::2] += 40.0
    return tracks


def test_outliers_of_the_consensus_have_no_weight_and_no_part_in_the_solve() -> None:
    visual = estimate(with_mismatches(11))
    assert (visual.weights[:30] == 0.0).all()
    assert visual.outliers[:30].all()
    assert visual.weights[30:].mean() > 0.5
    assert not visual.used[:30].any()
    assert visual.solution is not None
    assert len(visual.solution.features.weight) == visual.used.sum()


def test_features_out_of_domain_are_counted_among_those_used() -> None:
    tracks = with_mismatches(11)
    visual = estimate(tracks, noise=Homesick())
    plain = estimate(tracks)
    assert visual.noise is not None
    np.testing.assert_array_equal(visual.noise.out_of_domain, np.arange(visual.num_used) % 3 == 0)
    assert visual.num_out_of_domain == -(-visual.num_used // 3)
    assert visual.num_used == plain.num_used == visual.used.sum() > 60
    assert plain.noise is not None
    assert plain.noise.out_of_domain is None
    assert plain.num_out_of_domain is None


@pytest.mark.parametrize("factor", [0.2, 1.0, 5.0])
def test_a_noise_factor_is_a_larger_scale_of_the_model(factor: float) -> None:
    """A motion under a model's variances times the factor is that of a model with these variances,
    and residuals show the same either way."""
    tracks = seen_twice(np.random.default_rng(0), 200, sigma_px=0.3)
    scale = 0.03 * np.eye(4)

    def solved(model_factor: float, noise_factor: float) -> VisualMotion:
        estimator = VisualEstimator(
            CAMERA, Scaled(4.0, model_factor * scale), CONFIG, predicts_from_motion=False
        )
        return estimator.estimate(
            tracks,
            np.zeros((len(tracks), 0)),
            replace(priors_of(), noise_factor=noise_factor),
            rng=np.random.default_rng(0),
            clock=StageClock(),
        )

    by_factor = solved(1.0, factor)
    by_model = solved(factor, 1.0)
    for name in ("T_curr_prev", "cov"):
        np.testing.assert_allclose(
            getattr(by_factor.accepted_solution, name),
            getattr(by_model.accepted_solution, name),
            rtol=1e-12,
        )
    assert by_factor.estimated_noise_factor is not None
    assert by_model.estimated_noise_factor is not None
    assert by_factor.estimated_noise_factor == pytest.approx(
        factor * by_model.estimated_noise_factor
    )


@pytest.mark.parametrize("sigma_px", [0.05, 0.2, 0.6, 1.0])
def test_residuals_show_the_factor_of_the_noise(sigma_px: float) -> None:
    """Gaussian errors, under a noise that is nearly Gaussian: whether the noise is that of the
    model, or less, or so much more that the covariance is enlarged or the solve repeated."""
    tracks = seen_twice(np.random.default_rng(0), 400, sigma_px=sigma_px, depth_m=NEAR_M)
    visual = estimate(tracks, noise=Scaled(100.0, 0.2**2 * np.eye(4)))
    assert visual.estimated_noise_factor == pytest.approx((sigma_px / 0.2) ** 2, rel=0.2)


class PartlyGaussian(StudentT):
    """The even features have ν = ∞."""

    def predict(self, predictors: FloatArray) -> StereoNoise:
        noise = super().predict(predictors)
        return replace(noise, dof=np.where(np.arange(len(noise.dof)) % 2, noise.dof, np.inf))


def test_features_of_gaussian_noise_do_not_keep_the_others_from_showing_the_factor() -> None:
    tracks = seen_twice(np.random.default_rng(0), 400, sigma_px=0.6, depth_m=NEAR_M)
    noise = PartlyGaussian(100.0, 0.2**2 * np.eye(4), scale_is_relative=True)
    assert estimate(tracks, noise=noise).estimated_noise_factor == pytest.approx(9.0, rel=0.25)


def test_a_scale_that_was_given_is_kept() -> None:
    tracks = seen_twice(np.random.default_rng(0), 200, sigma_px=0.2)
    given = StudentT(4.0, 0.03 * np.eye(4))
    fitted = StudentT(4.0).fit(np.zeros((50, 0)), np.random.default_rng(0).normal(size=(50, 4)))
    read = StudentT.from_file(fitted.to_file())
    published = GeneralizedKernel("published")
    gaussian = StudentT(np.inf)
    for noise in (
        given,
        fitted,
        read,
        gaussian,
        NearestNeighbors(base=given),
        Fixed(),
        published,
    ):
        assert not has_relative_scale(noise)
    relative = Scaled(4.0, 0.03 * np.eye(4))
    models = (StudentT(), StudentT(4.0), relative)
    for noise in (*models, *(StudentT.from_file(model.to_file()) for model in models)):
        assert has_relative_scale(noise)
        assert has_relative_scale(NearestNeighbors(base=noise))
    assert has_relative_scale(GeneralizedKernel())
    assert estimate(tracks, noise=given).estimated_noise_factor is None


def test_in_a_window_the_errors_of_aligned_windows_do_not_last() -> None:
    """They do with two frames, and in tracks of another front end."""
    tracks = seen_twice(np.random.default_rng(0), 200, sigma_px=0.2)
    aligned = replace(tracks, difference=np.full((200, 2), 2.0))
    given = StudentT(4.0, 0.03 * np.eye(4), time_correlation_ratio=0.7)
    two_frames = OdometryConfig(estimator="two-frame")

    def lasts(tracks: Tracks, noise: NoiseModel, config: OdometryConfig) -> bool:
        visual = estimate(tracks, noise=noise, config=config)
        assert visual.noise is not None
        return visual.noise.time_correlated is not None

    assert not lasts(aligned, StudentT(), CONFIG)
    assert lasts(tracks, StudentT(), CONFIG)
    assert not lasts(aligned, given, CONFIG)
    assert lasts(tracks, given, CONFIG)
    assert lasts(aligned, StudentT(), two_frames)


def test_neither_rest_nor_gaussian_noise_shows_a_factor() -> None:
    moving = seen_twice(np.random.default_rng(0), 200, sigma_px=0.2)
    resting = seen_twice(np.random.default_rng(0), 200, np.eye(4), sigma_px=0.2)
    assert estimate(moving).estimated_noise_factor is not None
    assert estimate(moving, noise=Fixed()).estimated_noise_factor is None
    assert estimate(resting).estimated_noise_factor is None


def test_features_that_hardly_move_teach_no_noise() -> None:
    """The motion is known to a hundredth of itself, but by features that have moved by a third of a
    pixel: between the same pixels, they have the same errors in both frames."""
    creeping = se3.exp(np.array([0.0, 0.0, -0.015, 0.0, 0.0, 0.0]))
    tracks = seen_twice(np.random.default_rng(4), 300, creeping, sigma_px=0.003)
    shift_px = np.linalg.norm(tracks.curr_px[:, :2] - tracks.prev_px[:, :2], axis=1)
    assert np.median(shift_px) < 0.5
    visual = estimate(tracks, noise=Scaled(scale=0.003**2 * np.eye(4)))
    assert visual.solution is not None
    assert visual.solution.exceeds_noise
    assert visual.estimated_noise_factor is None


def test_where_nothing_is_solved_nothing_is_used_and_nothing_out_of_domain() -> None:
    visual = estimate(seen_twice(np.random.default_rng(1), 5), noise=Homesick())
    assert visual.status is Status.TOO_FEW_TRACKS
    assert visual.num_used == 0
    assert visual.num_out_of_domain is None
    assert visual.noise is None


def test_without_rejection_the_robust_loss_sees_all() -> None:
    config = OdometryConfig(ransac=RansacConfig(mode="guess"))
    visual = estimate(with_mismatches(12), config=config)
    assert visual.used.sum() == 100
    assert (visual.weights[:30] < 0.05).all()
    assert visual.status is Status.OK


def test_noisy_tracks_widen_the_threshold() -> None:
    """At 3 px hardly any of them agree on a motion; at 12 px enough do, but the noise would be
    twenty times as large as the model says."""
    tracks = seen_twice(np.random.default_rng(13), 100, sigma_px=4.0, depth_m=(4.0, 10.0))
    visual = estimate(tracks)
    assert visual.used.sum() >= 25
    assert visual.status is Status.TOO_FEW_TRACKS


def test_noise_that_is_larger_than_predicted_enlarges_the_covariance() -> None:
    """Five times as much noise as the model says: none of the features agrees as well as the model
    wants. They are no worse for that."""
    nees = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        tracks = seen_twice(rng, 100, sigma_px=1.0, depth_m=(4.0, 10.0))
        visual = estimate(tracks, noise=StudentT(5.0, 0.04 * np.eye(4)))
        assert visual.status is Status.OK
        solution = visual.accepted_solution
        nees.append(float(normalized_error_squared(FORWARD, solution.T_curr_prev, solution.cov)))
    low, _ = chi2_interval(6, len(nees))
    assert low < np.mean(nees) < 7.5


def test_a_handful_that_agree_only_under_a_larger_noise_may_agree_by_chance() -> None:
    """Of ten features, whose noise is five times as large as the model says, none is solved for;
    of a hundred, above, all are."""
    noise = StudentT(5.0, 0.04 * np.eye(4))
    for seed in range(20):
        rng = np.random.default_rng(seed)
        visual = estimate(seen_twice(rng, 10, sigma_px=1.0, depth_m=(4.0, 10.0)), noise=noise)
        assert visual.status is Status.TOO_FEW_TRACKS


def test_more_tracks_near_the_prediction_replace_a_consensus_that_hardly_fits(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """RANSAC has settled on another motion, on which tracks agree within pixels, as its threshold
    admits."""
    rng = np.random.default_rng(7)
    good = seen_twice(rng, 30, sigma_px=0.2, depth_m=(5.0, 20.0))
    bad = seen_twice(rng, 30, np.eye(4), sigma_px=1.0, depth_m=(5.0, 20.0))
    found = Consensus(np.eye(4), np.arange(60) >= 24)
    monkeypatch.setattr(visual_estimator, "initial_motion", lambda *_, **__: found)
    visual = estimate(both(good, bad), replace(UNKNOWN, T_curr_prev=FORWARD))
    assert visual.status is Status.OK
    assert visual.used[:30].all()
    solution = visual.accepted_solution
    error = motion_error(solution.T_curr_prev)
    assert error @ np.linalg.solve(solution.cov, error) < chdtri(6, 1e-3)


def test_the_evaluation_of_two_frames_is_as_uncertain_with_another_measurement() -> None:
    """It has the enlarged covariance, too, whether or not it is evaluated again; the gyro knows
    next to nothing here."""
    tracks = seen_twice(np.random.default_rng(3), 100, sigma_px=0.4, depth_m=(4.0, 10.0))
    noise = StudentT(5.0, 0.04 * np.eye(4))
    gyro = RelativeRotation(np.eye(3), 1e4 * np.eye(3), MOTION)
    with_prior = OdometryConfig(gyro=GyroConfig(prior=True))
    alone = estimate(tracks, noise=noise).two_frames_only
    beside = estimate(tracks, gyro=gyro, config=with_prior, noise=noise).two_frames_only
    assert alone is not None
    assert beside is not None
    np.testing.assert_allclose(np.diag(beside.cov), np.diag(alone.cov), rtol=0.02)


def test_noisy_images_leave_other_measurements_as_good_as_they_are() -> None:
    """The features show half as much noise again as the model says, so the covariance is enlarged:
    that of the rotation stays the gyro's."""
    tracks = seen_twice(np.random.default_rng(3), 100, sigma_px=0.4, depth_m=(4.0, 10.0))
    noise = StudentT(5.0, 0.04 * np.eye(4))
    with_prior = OdometryConfig(gyro=GyroConfig(prior=True))
    images = estimate(tracks, noise=noise).accepted_solution
    sigma_rad = 0.1 * np.sqrt(np.diag(images.cov)[3:].min())
    gyro = RelativeRotation(FORWARD[:3, :3], sigma_rad**2 * np.eye(3), MOTION)
    both_know = estimate(tracks, gyro=gyro, config=with_prior, noise=noise).accepted_solution
    sigma = np.sqrt(np.diag(both_know.cov))
    np.testing.assert_allclose(sigma[3:], sigma_rad, rtol=0.01)


@pytest.mark.parametrize("num_outliers", [0, 40])
def test_a_motion_that_few_confirm_is_claimed_with_care(num_outliers: int) -> None:
    """Twice as much noise as the model says: less than a third of the features agree as well as the
    model wants. Their covariance alone would have a NEES of 9; it is on the safe side instead."""
    nees = []
    num_few = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        tracks = seen_twice(rng, 100, sigma_px=0.4, depth_m=(4.0, 10.0))
        tracks.curr_px[:num_outliers] += 4.0 * rng.normal(size=(num_outliers, 4))
        visual = estimate(tracks, noise=StudentT(5.0, 0.04 * np.eye(4)))
        assert visual.status is Status.OK
        if visual.num_inliers < visual.num_used / 3:
            num_few += 1
            solution = visual.accepted_solution
            nees.append(
                float(normalized_error_squared(FORWARD, solution.T_curr_prev, solution.cov))
            )
    assert num_few > 50
    assert 1.0 < np.mean(nees) < 6.0
    assert max(nees) < 20.0


def test_the_noise_for_a_window_has_the_whole_excess_of_the_current_frame() -> None:
    """A usual frame, and one with three times its noise: the variance of a residual is five times
    as large as predicted, that of the current observation nine times. A window that took five would
    claim too much."""
    predicted = 0.04 * np.eye(4)
    factors = []
    num_enlarged = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        tracks = seen_twice(rng, 100, sigma_px=0.2, depth_m=(4.0, 10.0))
        tracks.curr_px[:] += np.sqrt(0.6**2 - 0.2**2) * rng.normal(size=(100, 4))
        visual = estimate(tracks, noise=StudentT(5.0, predicted))
        assert visual.status is Status.OK
        assert visual.noise is not None
        factors.append(visual.noise.scale[0, 0, 0] / predicted[0, 0])
        # Where the step was enlarged, the frame before, where new landmarks are anchored, has the
        # noise that the solve began with.
        if visual.noise.prev_scale is not None:
            num_enlarged += 1
            assert visual.noise.prev_scale[0, 0, 0] < 0.5 * visual.noise.scale[0, 0, 0]
    assert num_enlarged > 20
    # The outliers of the solve gain no weight by it, so it is rather more than less.
    assert 9.0 < np.mean(factors) < 25.0


def test_a_usual_frame_has_the_predicted_noise_in_a_window() -> None:
    tracks = seen_twice(np.random.default_rng(3), 100, sigma_px=0.2, depth_m=(4.0, 10.0))
    visual = estimate(tracks, noise=StudentT(5.0, 0.04 * np.eye(4)))
    assert visual.noise is not None
    np.testing.assert_array_equal(visual.noise.scale[:, 0, 0], 0.04)


@pytest.mark.parametrize("seed", range(5))
def test_features_that_agree_on_nothing_stay_refused(seed: int) -> None:
    rng = np.random.default_rng(seed)
    one = seen_twice(rng, 100)
    other = seen_twice(rng, 100)
    tracks = replace(one, curr_px=other.curr_px)
    assert estimate(tracks).status is not Status.OK


def test_tracks_of_nothing_are_not_accepted() -> None:
    """Points matched at random agree on some motion, but too few, or not well enough."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        prev, curr = (seen_twice(rng, 150) for _ in range(2))
        visual = estimate(Tracks(prev.prev_px, curr.curr_px, prev.ids, age=prev.age))
        assert visual.status is not Status.OK


def test_the_gyro_s_rotation_may_start_the_consensus() -> None:
    """One point and a gyro that is off by 0.1°: the solve corrects it."""
    config = OdometryConfig(ransac=RansacConfig(rotation_from="gyro"))
    C_gyro = so3.exp(np.radians([0.1, 0.0, 0.0])) @ FORWARD[:3, :3]
    tracks = seen_twice(np.random.default_rng(14), 200, sigma_px=0.2, depth_m=(5.0, 15.0))
    gyro = RelativeRotation(C_gyro, 1e-6 * np.eye(3), curr=MOTION)
    visual = estimate(tracks, gyro=gyro, config=config)
    assert visual.solution is not None
    assert np.linalg.norm(motion_error(visual.solution.T_curr_prev)[3:]) < 3e-4


@pytest.mark.parametrize("prior", [False, True])
def test_the_gyro_enters_the_solve_only_as_a_measurement(prior: bool) -> None:
    """A gyro that is far too certain of a wrong rotation, by 0.1°, prevails only as a prior."""
    C_gyro = so3.exp(np.radians([0.0, 0.1, 0.0])) @ FORWARD[:3, :3]
    tracks = seen_twice(np.random.default_rng(15), 200, sigma_px=0.2)
    config = OdometryConfig(gyro=GyroConfig(prior=prior))
    gyro = RelativeRotation(C_gyro, 1e-14 * np.eye(3), curr=MOTION)
    visual = estimate(tracks, gyro=gyro, config=config)
    solution = visual.solution
    assert solution is not None
    off_deg = np.degrees(np.linalg.norm(so3.log(solution.T_curr_prev[:3, :3] @ C_gyro.T)))
    assert bool(off_deg < 1e-3) is prior


def test_what_two_frames_say_leaves_out_the_gyro() -> None:
    """The rig's calibration learns from the features of two frames, at the motion of the solve."""
    C_gyro = so3.exp(np.radians([0.0, 0.1, 0.0])) @ FORWARD[:3, :3]
    tracks = seen_twice(np.random.default_rng(15), 200, sigma_px=0.2)
    config = OdometryConfig(gyro=GyroConfig(prior=True))
    gyro = RelativeRotation(C_gyro, 1e-10 * np.eye(3), curr=MOTION)
    visual = estimate(tracks, gyro=gyro, config=config)
    with_gyro = visual.solution
    without = visual.two_frames_only
    assert with_gyro is not None
    assert without is not None
    np.testing.assert_array_equal(without.T_curr_prev, with_gyro.T_curr_prev)
    inliers = tracks.subset(visual.used)
    evaluated = solve_reprojection(
        StereoObservations.of(
            inliers.prev_px,
            inliers.curr_px,
            StudentT().predict(np.zeros((visual.num_used, 0))),
            camera=CAMERA,
        ),
        guess=with_gyro.T_curr_prev,
        max_iterations=0,
    )
    np.testing.assert_array_equal(without.hessian, evaluated.hessian)
    np.testing.assert_array_equal(without.features.residuals, evaluated.features.residuals)
    sigma_rad = np.sqrt(np.diagonal(with_gyro.cov)[3:])
    assert (sigma_rad < 0.5 * np.sqrt(np.diagonal(without.cov)[3:])).all()
    plain = estimate(tracks, gyro=gyro)
    assert plain.two_frames_only is plain.solution


def test_times_of_the_stages_are_taken() -> None:
    clock = StageClock()
    estimate(seen_twice(np.random.default_rng(16), 50), clock=clock)
    assert set(clock.times_ms) == {"consensus", "solve"}


def test_the_motion_does_not_depend_on_the_prediction() -> None:
    tracks = seen_twice(np.random.default_rng(17), 200, sigma_px=0.2)
    near = replace(UNKNOWN, T_curr_prev=se3.exp(np.array([0.0, 0.0, -1.0, 0.0, 0.0, 0.0])))
    solutions = [estimate(tracks, prediction).solution for prediction in (UNKNOWN, near)]
    assert solutions[0] is not None
    assert solutions[1] is not None
    assert np.abs(motion_error(solutions[0].T_curr_prev, solutions[1].T_curr_prev)).max() < 2e-3


def test_the_covariance_of_an_alignment_is_consistent_under_heavy_tails() -> None:
    """The scale of the shipped Student-t is no covariance: of its tails, the consensus leaves a
    part."""
    rng = np.random.default_rng(22)
    config = OdometryConfig(solver=SolverConfig(method="alignment"))
    errors = []
    for _ in range(150):
        clean = seen_twice(rng, 100, depth_m=NEAR_M)
        sigma_px = 0.17 / np.sqrt(rng.chisquare(2.5, 100) / 2.5)
        white = sigma_px[:, None] * rng.normal(size=(2, 100, 4))
        tracks = tracks_of(clean.prev_px + white[0], clean.curr_px + white[1])
        visual = estimate(tracks, config=config, noise=StudentT(time_correlation_ratio=0.0))
        solution = visual.solution
        assert solution is not None
        errors.append(normalized_error_squared(FORWARD, solution.T_curr_prev, solution.cov))
    assert 4.0 < np.mean(errors) < 7.5


def test_alignment_serves_the_whole_flow() -> None:
    config = OdometryConfig(solver=SolverConfig(method="alignment"))
    tracks = seen_twice(np.random.default_rng(22), 200, sigma_px=0.2, depth_m=NEAR_M)
    tracks.curr_px[:40, 1::2] += 40.0
    visual = estimate(tracks, config=config)
    assert visual.status is Status.OK
    assert visual.solution is not None
    assert np.linalg.norm(motion_error(visual.solution.T_curr_prev)) < 0.02


SIDEWAYS = se3.exp(np.array([0.2, 0.0, 0.0, 0.0, 0.0, 0.0])) @ FORWARD


class KnownNoise(StudentT):
    """The noise of 120 features of a street and 30 of a car, each group with its own σ, px."""

    def __init__(self, street_px: float, car_px: float) -> None:
        super().__init__()
        self.sigma_px = np.repeat([street_px, car_px], [120, 30])

    def predict(self, predictors: FloatArray) -> StereoNoise:
        return StereoNoise(
            scale=self.sigma_px[:, None, None] ** 2 * np.eye(4),
            dof=np.full(150, 20.0),
            bias=np.zeros((150, 4)),
            refers_to="observation",
        )


def street_and_car(sigma_px: tuple[float, float], T_car: FloatArray) -> Tracks:
    """120 features of a street and 30 of a car, with their noise; T_car is the camera's motion
    relative to the car."""
    rng = np.random.default_rng(30)
    return both(
        seen_twice(rng, 120, sigma_px=sigma_px[0]),
        seen_twice(rng, 30, T_car, sigma_px=sigma_px[1], depth_m=(5.0, 15.0)),
    )


def reference_of(
    tracks: Tracks, noise: KnownNoise, contradicting: Tracks | None = None
) -> tuple[ReprojectionSolution, FloatArray]:
    """The solve under the learned noise, and the motion by which the next step judges features.

    ``contradicting`` takes the place of the tracks in the second solve, which trusts all alike.
    """
    predicted = noise.predict(np.zeros((len(tracks), 0)))
    two_frame = TwoFrameEstimator(CAMERA, CONFIG.solver)
    solution = two_frame.solve(tracks, predicted, guess=FORWARD)
    of_all = TwoFrameEstimate(
        solution=solution,
        weights=np.ones(len(tracks)),
        disparities=DisparityFilter.none(),
        has_history=np.zeros(len(tracks), np.bool_),
    )
    visual = VisualEstimator(CAMERA, noise, CONFIG, predicts_from_motion=True)
    solve = VisualSolve(
        T_guess=FORWARD,
        used=np.ones(len(tracks), np.bool_),
        tracks=tracks if contradicting is None else contradicting,
        noise=predicted,
        estimate=of_all,
        noise_factor=1.0,
    )
    return solution, visual._reference_motion(solve, priors_of())


def test_a_noise_that_follows_a_car_is_contradicted_by_the_street() -> None:
    tracks = street_and_car((0.2, 0.2), SIDEWAYS)
    solution, T_reference = reference_of(tracks, KnownNoise(3.0, 0.1))
    assert np.linalg.norm(motion_error(solution.T_curr_prev, SIDEWAYS)[:3]) < 0.1
    assert np.linalg.norm(motion_error(T_reference)[:3]) < 0.05


def test_a_noise_that_is_right_is_not_contradicted() -> None:
    tracks = street_and_car((0.6, 0.1), FORWARD)
    solution, T_reference = reference_of(tracks, KnownNoise(0.6, 0.1))
    np.testing.assert_array_equal(T_reference, solution.T_curr_prev)


def test_a_motion_that_cannot_be_contradicted_stands() -> None:
    """Two tracks do not fix a motion of their own."""
    tracks = street_and_car((0.2, 0.2), SIDEWAYS)
    two = tracks.subset(np.arange(2))
    solution, T_reference = reference_of(tracks, KnownNoise(3.0, 0.1), contradicting=two)
    np.testing.assert_array_equal(T_reference, solution.T_curr_prev)


@pytest.mark.parametrize(("right_error_px", "agrees"), [(0.0, False), (30.0, True)])
def test_right_images_that_are_known_to_be_off_contradict_nothing(
    right_error_px: float, agrees: bool
) -> None:
    """All current right images are 3 px off, as by a delay that was not removed."""
    tracks = street_and_car((0.2, 0.2), FORWARD)
    off = replace(
        tracks,
        curr_px=tracks.curr_px + np.array([0.0, 0.0, 3.0, 0.0]),
        velocity_error_px=np.tile([0.0, 0.0, right_error_px, 0.0], (150, 1)),
    )
    solution, T_reference = reference_of(tracks, KnownNoise(0.2, 0.2), contradicting=off)
    assert np.array_equal(T_reference, solution.T_curr_prev) == agrees


@pytest.mark.parametrize("predicts_from_motion", [False, True])
def test_only_a_noise_that_depends_on_earlier_motions_needs_another_reference(
    predicts_from_motion: bool,
) -> None:
    """The whole flow without RANSAC, started beside the car's motion."""
    config = OdometryConfig(ransac=RansacConfig(mode="off"))
    visual = estimate(
        street_and_car((0.2, 0.2), SIDEWAYS),
        replace(UNKNOWN, T_curr_prev=FORWARD),
        config=config,
        noise=KnownNoise(3.0, 0.1),
        predicts_from_motion=predicts_from_motion,
    )
    assert visual.solution is not None
    T_expected = FORWARD if predicts_from_motion else SIDEWAYS
    assert np.linalg.norm(motion_error(visual.solution.T_curr_prev, SIDEWAYS)[:3]) < 0.1
    assert np.linalg.norm(motion_error(visual.T_reference, T_expected)[:3]) < 0.1


@pytest.fixture(scope="module")
def solution() -> ReprojectionSolution:
    """An accepted solve."""
    visual = estimate(seen_twice(np.random.default_rng(0), 200, sigma_px=0.2))
    return visual.accepted_solution


def status_of(
    solution: ReprojectionSolution,
    prediction: MotionPrediction = UNKNOWN,
    *,
    is_supported: bool = True,
) -> Status:
    return evaluate_status(solution, prediction, is_supported=is_supported, config=CONFIG)


def test_judge_accepts_a_determined_converged_solve(solution: ReprojectionSolution) -> None:
    assert status_of(solution) is Status.OK
    assert status_of(solution, is_supported=False) is Status.TOO_FEW_TRACKS
    assert status_of(replace(solution, converged=False)) is Status.NOT_CONVERGED
    assert status_of(solution, prediction=STANDSTILL) is Status.NOT_CONVERGED
    nowhere = replace(solution, cov=np.full((6, 6), np.nan))
    assert status_of(nowhere) is Status.DEGENERATE


@pytest.mark.parametrize(
    ("num_used", "need_larger_noise", "weight", "fewest"),
    [
        *((90, False, 0.2, 6), (90, False, 1.0, 6)),
        *((89, False, 0.2, None), (89, False, 1.0, 6), (50, False, 1.0, 6)),
        *((49, False, 0.2, None), (49, False, 1.0, 12)),
        *((50, True, 0.2, None), (50, True, 1.0, 12), (100, True, 1.0, 12)),
    ],
)
def test_tracks_that_may_agree_by_chance_must_be_more_and_agree_better(
    num_used: int, need_larger_noise: bool, weight: float, fewest: int | None
) -> None:
    """Those that RANSAC has chosen from many, and those that hardly fit."""
    for number in (5, 6, 11, 12, num_used):
        weights = np.where(np.arange(num_used) < number, weight, 0.0)
        are_enough = are_beyond_chance(
            weights, num_tracks=100, need_larger_noise=need_larger_noise, config=CONFIG
        )
        assert are_enough == (fewest is not None and number >= fewest)


@pytest.mark.parametrize("axis", range(6))
def test_judge_calls_a_large_standard_deviation_degenerate(
    solution: ReprojectionSolution, axis: int
) -> None:
    """In any direction, just beyond the limits of the settings and just within."""
    limits = np.repeat(
        [CONFIG.solver.max_translation_sigma_m, CONFIG.solver.max_rotation_sigma_rad], 3
    )
    for factor, status in ((1.01, Status.DEGENERATE), (0.99, Status.OK)):
        sigma = np.full(6, 1e-4)
        sigma[axis] = factor * limits[axis]
        assert status_of(replace(solution, cov=np.diag(sigma**2))) is status


@pytest.mark.parametrize("seed", [10, 17, 20, 25, 33, 37])
def test_of_two_motions_near_the_prediction_the_one_of_more_features_is_taken(seed: int) -> None:
    """A camera at 1 m/s, and 47 of 100 features that keep pace with it. Of most points, RANSAC's 3
    px hold under both motions, and both are within two sigmas of the prediction."""
    rng = np.random.default_rng(seed)
    slowly = se3.exp(np.array([0.0, 0.0, -0.1, 0.0, 0.002, 0.0]))
    along = se3.exp(np.array([0.0, 0.0, 0.0, 0.0, 0.002, 0.0]))
    standing = seen_twice(rng, 53, slowly, sigma_px=0.1, depth_m=(5.0, 30.0))
    moving = seen_twice(rng, 47, along, sigma_px=0.1, depth_m=(5.0, 30.0))
    visual = estimate(both(standing, moving), replace(STANDSTILL, T_curr_prev=slowly))
    error_m = motion_error(visual.accepted_solution.T_curr_prev, slowly)[:3]
    assert np.linalg.norm(error_m) < 0.05


def test_a_model_that_returns_no_noise_is_named() -> None:
    class Wrong(StudentT):
        def predict(self, predictors: FloatArray) -> StereoNoise:
            return np.eye(4)  # type: ignore[return-value]

    odometry = pv.StereoOdometry(CAMERA, noise=Wrong())
    frames = drive(np.random.default_rng(0), 2)
    odometry.step(frames[0])
    with pytest.raises(InputError, match="its predict returns a ndarray, where a StereoNoise is"):
        odometry.step(frames[1])

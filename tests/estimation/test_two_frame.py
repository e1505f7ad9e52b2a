"""The two-frame estimator: both methods, their covariances, and what they say of each feature."""

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from scipy.stats import chi2

import probevo as pv
from probevo.arrays import FloatArray
from probevo.config import SolverConfig
from probevo.errors import InputError
from probevo.estimation.disparity_filter import DisparityFilter, update_with_latent_errors
from probevo.estimation.feature_weights import INLIER_FROM, feature_weights
from probevo.estimation.reprojection import ReprojectionSolution, solve_reprojection
from probevo.estimation.two_frame import TwoFrameEstimator
from probevo.geometry import se3
from probevo.geometry.uncertainty import normalized_error_squared
from probevo.measurements.base import Measurement
from probevo.measurements.pose_prior import PosePrior
from probevo.measurements.relative_rotation import RelativeRotation
from probevo.measurements.stereo_observations import StereoObservations
from probevo.measurements.travelled_distance import TravelledDistance
from probevo.measurements.variables import pose_of
from probevo.noise import Fixed, StereoNoise, StudentT
from probevo.tracking.tracks import Tracks
from worlds import (
    CAMERA,
    FORWARD,
    TWO_FRAMES,
    drive,
    motion_error,
    moved,
    random_pixels,
    seen_twice,
    tracks_of,
)

Method = Literal["reprojection", "alignment"]
METHODS: tuple[Method, ...] = ("reprojection", "alignment")
NEAR_M = (3.0, 10.0)
"""Here the noise of triangulated points is nearly Gaussian, as alignment assumes."""
GUESS = se3.exp(np.array([0.02, -0.03, 0.03, 0.004, -0.006, 0.005])) @ FORWARD
"""Off by 5 cm and half a degree."""


def solved(
    tracks: Tracks, method: Method, noise: StereoNoise | None = None
) -> ReprojectionSolution:
    estimator = TwoFrameEstimator(CAMERA, SolverConfig(method=method))
    noise = noise or Fixed().predict(np.zeros((len(tracks), 0)))
    return estimator.solve(tracks, noise, guess=GUESS)


def test_alignment_and_reprojection_are_exact_without_noise() -> None:
    tracks = seen_twice(np.random.default_rng(18), 60, depth_m=NEAR_M)
    for method in METHODS:
        assert np.abs(motion_error(solved(tracks, method).T_curr_prev)).max() < 1e-6


def test_near_points_give_the_same_motion_aligned_or_reprojected() -> None:
    """They differ by a small part of their standard deviation, which they agree on."""
    tracks = seen_twice(np.random.default_rng(19), 100, sigma_px=0.2, depth_m=NEAR_M)
    reprojected, aligned = (solved(tracks, method) for method in METHODS)
    assert reprojected.converged
    assert aligned.converged
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
def test_the_covariance_of_either_is_consistent(method: Method, spread: float) -> None:
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


@pytest.mark.parametrize("method", METHODS)
def test_either_removes_the_bias_that_a_noise_model_has_learned(method: Method) -> None:
    tracks = seen_twice(np.random.default_rng(25), 60, depth_m=NEAR_M)
    bias = np.tile([0.5, 0.0, -0.2, 0.0], (60, 1))
    noise = replace(Fixed().predict(np.zeros((60, 0))), bias=bias)
    biased = tracks_of(tracks.prev_px, tracks.curr_px + bias)
    assert np.abs(motion_error(solved(biased, method, noise).T_curr_prev)).max() < 1e-6


def test_both_take_the_noise_of_each_observation_at_its_own_time() -> None:
    """The covariance shrinks alike if the first frame is ten times as sharp as the second one."""
    tracks = seen_twice(np.random.default_rng(26), 100, depth_m=NEAR_M)
    equal = Fixed().predict(np.zeros((100, 0)))
    sharper = replace(equal, prev_scale=0.01 * equal.scale)
    reprojected, aligned = (
        np.diag(solved(tracks, method, sharper).cov) / np.diag(solved(tracks, method, equal).cov)
        for method in METHODS
    )
    assert (reprojected < 0.5).all()
    np.testing.assert_allclose(aligned, reprojected, rtol=0.3)


def test_alignment_says_what_the_reprojection_says_of_each_feature() -> None:
    """At its own motion: residuals and weights, by which mismatches are found."""
    tracks = seen_twice(np.random.default_rng(21), 80, sigma_px=0.2, depth_m=NEAR_M)
    noise = StudentT().predict(np.zeros((80, 0)))
    aligned = solved(tracks, "alignment", noise)
    there = solve_reprojection(
        StereoObservations.of(tracks.prev_px, tracks.curr_px, noise, camera=CAMERA),
        guess=aligned.T_curr_prev,
        max_iterations=0,
    )
    np.testing.assert_array_equal(aligned.features.residuals, there.features.residuals)
    np.testing.assert_array_equal(aligned.features.weight, there.features.weight)
    assert aligned.iterations > 0


def test_alignment_needs_the_noise_of_each_observation() -> None:
    """A learned noise of the whole residual says nothing of the points on their own."""
    noise = StereoNoise(
        scale=np.tile(np.eye(4), (60, 1, 1)),
        dof=np.full(60, np.inf),
        bias=np.zeros((60, 4)),
        refers_to="residual",
    )
    tracks = seen_twice(np.random.default_rng(23), 60)
    with pytest.raises(InputError) as caught:
        solved(tracks, "alignment", noise)
    assert str(caught.value).startswith(
        "--solver.method: alignment needs the noise of each observation"
    )
    assert "reprojection" in caught.value.cure
    assert solved(tracks, "reprojection", noise).converged


def test_alignment_takes_no_sensor_of_the_motion() -> None:
    """It would say that it used one."""
    frames = drive(np.random.default_rng(1), 2)

    def wheels(prev_frame: pv.Frame, frame: pv.Frame) -> list[Measurement]:
        return [TravelledDistance(1.2, 0.1, pose_of(frame.index), pose_of(prev_frame.index))]

    config = TWO_FRAMES | {"solver": {"method": "alignment"}}
    odometry = pv.StereoOdometry(CAMERA, config=config, sensors=[wheels])
    odometry.step(frames[0])
    with pytest.raises(InputError, match="alignment takes no measurement of the motion"):
        odometry.step(frames[1])


def test_without_iterations_the_guess_is_kept() -> None:
    """And everything else is said of the features at it: residuals are those of the guess."""
    tracks = seen_twice(np.random.default_rng(24), 40, depth_m=NEAR_M)
    guess = se3.exp(np.array([0.01, 0.0, 0.02, 0.0, 0.001, 0.0])) @ FORWARD
    noise = Fixed().predict(np.zeros((40, 0)))
    there = solve_reprojection(
        StereoObservations.of(tracks.prev_px, tracks.curr_px, noise, camera=CAMERA),
        guess=guess,
        max_iterations=0,
    )
    np.testing.assert_array_equal(there.T_curr_prev, guess)
    assert there.iterations == 0
    assert there.converged
    predicted = CAMERA.project(se3.transform(guess, CAMERA.triangulate(tracks.prev_px)))
    plain = tracks.curr_px - predicted
    assert np.corrcoef(there.features.residuals.ravel(), plain.ravel())[0, 1] > 0.99
    assert np.isfinite(there.cov).all()


def three_frames(rng: np.random.Generator, count: int) -> tuple[Tracks, Tracks]:
    """The same points in two steps, with noise."""
    true = [random_pixels(rng, count, (8.0, 40.0))]
    for _ in range(2):
        true.append(moved(true[-1], FORWARD))
    seen = [pixels + 0.2 * rng.normal(size=pixels.shape) for pixels in true]
    return tracks_of(seen[0], seen[1]), tracks_of(seen[1], seen[2])


@pytest.mark.parametrize("method", METHODS)
def test_estimate_without_history_is_the_solve(method: Method) -> None:
    """And only the reprojection filters disparities, those of its inliers."""
    estimator = TwoFrameEstimator(CAMERA, SolverConfig(method=method))
    tracks, _ = three_frames(np.random.default_rng(25), 80)
    noise = StudentT().predict(np.zeros((80, 0)))
    solution = estimator.solve(tracks, noise, guess=GUESS)
    estimate = estimator.estimate(tracks, noise, DisparityFilter.none(), guess=GUESS)
    np.testing.assert_allclose(estimate.solution.T_curr_prev, solution.T_curr_prev, atol=1e-12)
    np.testing.assert_allclose(estimate.solution.cov, solution.cov, rtol=1e-9)
    np.testing.assert_array_equal(
        estimate.weights, feature_weights(solution.features, noise.dof, "noise")
    )
    assert not estimate.has_history.any()
    inliers = tracks.ids[estimate.weights >= INLIER_FROM] if method == "reprojection" else []
    np.testing.assert_array_equal(estimate.disparities.ids, inliers)


def test_estimate_with_history_is_a_solve_with_a_disparity_prior() -> None:
    """And then the common-mode errors are accounted for."""
    estimator = TwoFrameEstimator(CAMERA, SolverConfig())
    first, second = three_frames(np.random.default_rng(26), 150)
    noise = StudentT().predict(np.zeros((150, 0)))
    before = estimator.estimate(first, noise, DisparityFilter.none(), guess=FORWARD).disparities
    estimate = estimator.estimate(second, noise, before, guess=FORWARD)
    prior = before.of_tracks(second)
    solution = solve_reprojection(
        StereoObservations.of(
            second.prev_px, second.curr_px, noise, camera=CAMERA, disparity_prior=prior.states
        ),
        guess=FORWARD,
    )
    weights = feature_weights(solution.features, noise.dof, "noise")
    expected, after = update_with_latent_errors(
        prior, second, noise, solution=solution, camera=CAMERA, inliers=weights >= INLIER_FROM
    )
    assert estimate.has_history.any()
    np.testing.assert_array_equal(estimate.weights, weights)
    np.testing.assert_array_equal(estimate.solution.T_curr_prev, expected.T_curr_prev)
    np.testing.assert_array_equal(estimate.solution.cov, expected.cov)
    np.testing.assert_array_equal(estimate.disparities.states.cov, after.states.cov)
    np.testing.assert_array_equal(estimate.disparities.path_cross_cov, after.path_cross_cov)
    assert np.abs(after.path_cross_cov).max() > 0.0


def test_evaluate_keeps_the_given_motion_and_filters_the_disparities() -> None:
    """Its features are those of a solve with no iterations, given the same history."""
    estimator = TwoFrameEstimator(CAMERA, SolverConfig())
    first, second = three_frames(np.random.default_rng(27), 100)
    noise = StudentT().predict(np.zeros((100, 0)))
    before = estimator.evaluate(first, noise, DisparityFilter.none(), T_curr_prev=FORWARD)
    estimate = estimator.evaluate(second, noise, before.disparities, T_curr_prev=FORWARD)
    there = solve_reprojection(
        StereoObservations.of(
            second.prev_px,
            second.curr_px,
            noise,
            camera=CAMERA,
            disparity_prior=before.disparities.of_tracks(second).states,
        ),
        guess=FORWARD,
        max_iterations=0,
    )
    np.testing.assert_array_equal(estimate.solution.T_curr_prev, FORWARD)
    np.testing.assert_array_equal(estimate.solution.features.residuals, there.features.residuals)
    np.testing.assert_array_equal(estimate.disparities.path_cross_cov, 0.0)
    np.testing.assert_array_equal(estimate.disparities.common, 0.0)
    np.testing.assert_array_equal(
        estimate.disparities.ids, second.ids[estimate.weights >= INLIER_FROM]
    )
    # The second step has made their disparities more certain.
    both = np.intersect1d(before.disparities.ids, estimate.disparities.ids)
    cov_before = before.disparities.states.cov[np.isin(before.disparities.ids, both)]
    cov_after = estimate.disparities.states.cov[np.isin(estimate.disparities.ids, both)]
    assert np.median(cov_after[:, 0, 0] / cov_before[:, 0, 0]) < 1.0


def test_other_measurements_are_of_the_named_pose() -> None:
    """A measurement of the current pose under its own name, with the previous pose held, is one of
    T_curr_prev."""
    estimator = TwoFrameEstimator(CAMERA, SolverConfig())
    tracks = seen_twice(np.random.default_rng(28), 60, sigma_px=0.2)
    noise = StudentT().predict(np.zeros((60, 0)))
    curr = pose_of(8)
    C = FORWARD[:3, :3]
    of_two_poses = RelativeRotation(C, 1e-8 * np.eye(3), curr=curr, prev=pose_of(7))
    of_one_pose = RelativeRotation(C, 1e-8 * np.eye(3), curr=curr)
    solutions = [
        estimator.solve(tracks, noise, guess=GUESS, others=[gyro], curr=curr)
        for gyro in (of_two_poses, of_one_pose)
    ]
    np.testing.assert_array_equal(solutions[0].T_curr_prev, solutions[1].T_curr_prev)
    np.testing.assert_array_equal(solutions[0].cov, solutions[1].cov)
    certain = PosePrior(curr, FORWARD, 1e-16 * np.eye(6))
    held = estimator.solve(tracks, noise, guess=GUESS, others=[certain], curr=curr)
    assert np.abs(motion_error(held.T_curr_prev)).max() < 1e-6


def test_certain_disparities_of_the_filter_outweigh_noisy_ones() -> None:
    rng = np.random.default_rng(29)
    estimator = TwoFrameEstimator(CAMERA, SolverConfig())
    noise = StudentT().predict(np.zeros((100, 0)))
    true_prev_px = random_pixels(rng, 100, (8.0, 40.0))
    curr_px = moved(true_prev_px, FORWARD)
    off = np.zeros((100, 4))
    off[:, 2] = rng.normal(scale=0.4, size=100)
    tracks = tracks_of(true_prev_px + off, curr_px + off)
    known = estimator.evaluate(
        tracks_of(moved(true_prev_px, se3.inverse(FORWARD)), true_prev_px),
        noise,
        DisparityFilter.none(),
        T_curr_prev=FORWARD,
    ).disparities
    certain = replace(known, states=replace(known.states, cov=known.states.cov * 1e-4))
    plain = estimator.estimate(tracks, noise, DisparityFilter.none(), guess=FORWARD)
    with_filter = estimator.estimate(tracks, noise, certain, guess=FORWARD)
    errors = [
        np.linalg.norm(motion_error(each.solution.T_curr_prev)[:3]) for each in (plain, with_filter)
    ]
    assert errors[1] < 0.5 * errors[0]

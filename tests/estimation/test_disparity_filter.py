"""The disparity filter is the posterior of the joint Gaussian; its motions are consistent."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest

from intervals import chi2_interval
from probevo.arrays import FloatArray, IntArray
from probevo.camera.rig_jitter import jitter_offsets
from probevo.estimation.disparity_filter import (
    RANDOM_WALK,
    DisparityFilter,
    StackedErrors,
    update_at_known_motion,
    update_with_latent_errors,
)
from probevo.estimation.reprojection import ReprojectionSolution, solve_reprojection
from probevo.evaluation.consistency import drift_covariances
from probevo.geometry import se3
from probevo.geometry.uncertainty import normalized_error_squared
from probevo.measurements.point_priors import DisparityPrior
from probevo.measurements.stereo_observations import StereoObservations
from probevo.noise import StudentT
from probevo.tracking.tracks import Tracks
from worlds import CAMERA

STEP = se3.exp(np.array([0.02, 0.01, -0.8, 0.002, 0.008, -0.001]))
SCALE = np.diag([0.04, 0.04, 0.05, 0.05])
NOISE = StudentT(np.inf, SCALE, time_correlation_ratio=3.0)
SLIP_PX = 0.07


def points_m(rng: np.random.Generator, count: int) -> FloatArray:
    """From 6 to 40 m ahead, all over the image."""
    z = rng.uniform(6.0, 40.0, count)
    return np.column_stack(
        [rng.uniform(-0.6, 0.6, count) * z, rng.uniform(-0.2, 0.2, count) * z, z]
    )


def views(points: FloatArray, steps: int) -> list[FloatArray]:
    """True observations of the points from the start and after each step, [N, 4] each, px."""
    places = [points]
    for _ in range(steps):
        places.append(se3.transform(STEP, places[-1]))
    return [CAMERA.project(place) for place in places]


def tracks_of(prev_px: FloatArray, curr_px: FloatArray, ids: IntArray | None = None) -> Tracks:
    own = np.arange(len(prev_px)) if ids is None else ids
    return Tracks(prev_px, curr_px, own, age=np.full(len(own), 2))


def evaluate_at(
    tracks: Tracks, model: StudentT, disparities: DisparityFilter, T_curr_prev: FloatArray = STEP
) -> ReprojectionSolution:
    """The features at a known motion, by default the true one."""
    return solve_reprojection(
        StereoObservations.of(
            tracks.prev_px,
            tracks.curr_px,
            model.predict(np.zeros((len(tracks), 0))),
            camera=CAMERA,
            disparity_prior=disparities.of_tracks(tracks).states,
        ),
        guess=T_curr_prev,
        max_iterations=0,
    )


def filtered(
    tracks: Tracks, model: StudentT, prior: DisparityFilter, *, solution: ReprojectionSolution
) -> DisparityFilter:
    """The filter after a step whose motion is known."""
    after, _ = update_at_known_motion(
        prior.of_tracks(tracks),
        tracks,
        model.predict(np.zeros((len(tracks), 0))),
        solution=solution,
        camera=CAMERA,
        inliers=np.ones(len(tracks), np.bool_),
    )
    return after


def test_true_disparities_are_propagated_with_the_motion() -> None:
    seen = views(points_m(np.random.default_rng(0), 50), 3)
    disparities = DisparityFilter.none()
    for prev_px, curr_px in pairwise(seen):
        tracks = tracks_of(prev_px, curr_px)
        solution = evaluate_at(tracks, NOISE, disparities)
        disparities = filtered(tracks, NOISE, disparities, solution=solution)
        measured_px = curr_px[:, 0] - curr_px[:, 2]
        np.testing.assert_allclose(disparities.states.disparity, measured_px, rtol=1e-9)
        np.testing.assert_allclose(disparities.states.error, 0.0, atol=1e-9)


def test_a_prior_that_says_what_the_observation_says_changes_nothing() -> None:
    """Where u and v are independent of the disparity, as they are of a disparity prior."""
    scale = np.diag([1e-9, 0.04, 0.05, 0.05])
    model = StudentT(5.0, scale, time_correlation_ratio=2.0)
    rng = np.random.default_rng(1)
    prev_px, curr_px = (
        px + rng.normal(scale=0.2, size=px.shape) for px in views(points_m(rng, 40), 1)
    )
    noise = model.predict(np.zeros((40, 0)))
    without = solve_reprojection(
        StereoObservations.of(prev_px, curr_px, noise, camera=CAMERA), guess=STEP
    )
    variance = scale[0, 0] + scale[2, 2]
    tau_squared = noise.time_correlated
    assert tau_squared is not None
    new = np.array([[variance, 0.0], [0.0, 0.0]])
    correlated = tau_squared[:, None, None] * np.array([[1.0, -1.0], [-1.0, 1.0]])
    prior = DisparityPrior(
        rows=np.arange(40),
        disparity=prev_px[:, 0] - prev_px[:, 2],
        error=np.zeros(40),
        cov=new + correlated,
    )
    with_prior = solve_reprojection(
        StereoObservations.of(prev_px, curr_px, noise, camera=CAMERA, disparity_prior=prior),
        guess=STEP,
    )
    np.testing.assert_allclose(with_prior.T_curr_prev, without.T_curr_prev, atol=1e-7)
    np.testing.assert_allclose(with_prior.cov, without.cov, rtol=1e-3)


def test_it_is_the_posterior_of_the_joint_gaussian() -> None:
    """Three frames of one point, at known motions, against the least squares of all its
    observations at once.

    The disparity in each frame follows from that in the first; the left image is exact, so that
    only u_r contributes.
    """
    scale = np.diag([1e-8, 1e-8, 0.05, 1e-8])
    model = StudentT(np.inf, scale, time_correlation_ratio=3.0)
    tau_squared = 9.0 * (scale[0, 0] + scale[2, 2])
    rng = np.random.default_rng(2)
    point = np.array([[1.5, -0.5, 9.0]])
    straight = se3.exp(np.array([0.0, 0.0, -0.8, 0.0, 0.0, 0.0]))
    true = [CAMERA.project(point), CAMERA.project(se3.transform(straight, point))]
    true.append(CAMERA.project(se3.transform(straight @ straight, point)))
    seen = [px + np.array([0.0, 0.0, rng.normal(scale=0.5), 0.0]) for px in true]
    disparities = DisparityFilter.none()
    for prev_px, curr_px in pairwise(seen):
        tracks = tracks_of(prev_px, curr_px)
        solution = evaluate_at(tracks, model, disparities, straight)
        disparities = filtered(tracks, model, disparities, solution=solution)
    # The left image, exact, fixes the disparity by parallax; the three measured errors tell of δ:
    # it is constant within a step, and walks between two.
    errors = np.array(
        [(px[0, 0] - px[0, 2]) - (at[0, 0] - at[0, 2]) for px, at in zip(seen, true, strict=True)]
    )
    prior = tau_squared * (np.ones((3, 3)) + np.diag([0.0, 0.0, RANDOM_WALK]))
    gain = prior[2] @ np.linalg.inv(prior + scale[2, 2] * np.eye(3))
    states = disparities.states
    assert states.disparity[0] == pytest.approx(true[2][0, 0] - true[2][0, 2], abs=1e-2)
    assert states.error[0] == pytest.approx(gain @ errors, abs=0.02)
    assert states.cov[0, 1, 1] == pytest.approx(
        prior[2, 2] - gain @ prior[2] + RANDOM_WALK * tau_squared, rel=0.05
    )


TAU_PX = 1.0
SLIPPING = StudentT(
    np.inf,
    0.5 * SLIP_PX**2 * np.tile(np.eye(2), (2, 2)) + np.diag([1e-6, 1e-6, 0.02, 0.01]),
    time_correlation_ratio=TAU_PX / np.sqrt(0.02),
)


def drive(rng: np.random.Generator, steps: int, life: int) -> list[Tracks]:
    """Steps among 300 patches that slip by 0.07 px from frame to frame, and are new ones after
    ``life`` frames.

    New in each frame, their disparities are off by 0.14 px. Time-correlated, they are off by 1 px
    besides, which walks from the second frame on: the error is the same in the first two frames, as
    it is taken to be for a track of two frames.
    """
    count = 300
    ids = np.arange(count)
    age = rng.integers(0, life, count)
    next_id = count
    points = points_m(rng, count) + np.array([0.0, 0.0, 8.0])
    correlated_px = rng.normal(scale=TAU_PX, size=count)
    age[age == 0] = 1
    first = np.ones(count, np.bool_)
    frames = []
    for _ in range(steps + 1):
        error = np.zeros((count, 4))
        error[:, 2:] = rng.normal(scale=[0.1 * np.sqrt(2.0), 0.1], size=(count, 2))
        error[:, 2] -= correlated_px
        frames.append((ids.copy(), CAMERA.project(points) + error))
        walk_px = np.where(first, 0.0, np.sqrt(RANDOM_WALK) * TAU_PX)
        correlated_px += walk_px * rng.normal(size=count)
        points[:, :2] += rng.normal(scale=SLIP_PX, size=(count, 2)) * points[:, 2:] / CAMERA.fu_px
        points = se3.transform(STEP, points)
        age = age + 1
        first = np.zeros(count, np.bool_)
        new = age >= life
        num_new = int(new.sum())
        ids[new] = np.arange(next_id, next_id + num_new)
        next_id += num_new
        points[new] = points_m(rng, num_new) + np.array([0.0, 0.0, 8.0])
        correlated_px[new] = rng.normal(scale=TAU_PX, size=num_new)
        age[new] = 0
        first[new] = True
    found = []
    for (prev_ids, prev_px), (curr_ids, curr_px) in pairwise(frames):
        _, rows, columns = np.intersect1d(prev_ids, curr_ids, return_indices=True)
        found.append(tracks_of(prev_px[rows], curr_px[columns], curr_ids[columns]))
    return found


JITTER_COV = np.diag([2e-4, 1e-3, 2e-4]) ** 2
"""Of a rig whose disparities are all off by 0.7 px, anew in each frame."""


def on_a_loose_rig(rng: np.random.Generator, steps: list[Tracks]) -> list[Tracks]:
    """The same drive, seen by a rig whose right camera turns from frame to frame."""
    omegas = rng.multivariate_normal(np.zeros(3), JITTER_COV, size=len(steps) + 1)
    loose = []
    for tracks, before, now in zip(steps, omegas, omegas[1:], strict=False):
        prev_px = tracks.prev_px.copy()
        curr_px = tracks.curr_px.copy()
        prev_px[:, 2:] += jitter_offsets(prev_px, CAMERA) @ before
        curr_px[:, 2:] += jitter_offsets(curr_px, CAMERA) @ now
        loose.append(tracks_of(prev_px, curr_px, tracks.ids))
    return loose


@dataclass(frozen=True)
class SolvedDrive:
    """The steps of a drive as they were solved."""

    T: FloatArray
    cov: FloatArray
    path_cross_cov: FloatArray

    @staticmethod
    def along(
        steps: list[Tracks], *, filters: bool, jitter_cov: FloatArray | None = None
    ) -> SolvedDrive:
        disparities = DisparityFilter.none()
        solved = []
        path_cross_cov = []
        for tracks in steps:
            noise = SLIPPING.predict(np.zeros((len(tracks), 0)))
            noise = replace(noise, jitter_cov=jitter_cov)
            prior = disparities.of_tracks(tracks)
            solution = solve_reprojection(
                StereoObservations.of(
                    tracks.prev_px,
                    tracks.curr_px,
                    noise,
                    camera=CAMERA,
                    disparity_prior=prior.states,
                ),
                guess=STEP,
            )
            if filters:
                solution, disparities = update_with_latent_errors(
                    prior,
                    tracks,
                    noise,
                    solution=solution,
                    camera=CAMERA,
                    inliers=np.ones(len(tracks), np.bool_),
                )
            solved.append(solution)
            path_cross_cov.append(disparities.path_cross_cov)
        return SolvedDrive(
            T=np.array([s.T_curr_prev for s in solved]),
            cov=np.array([s.cov for s in solved]),
            path_cross_cov=np.array(path_cross_cov),
        )

    def end_error_squared(self, path_cross_cov: FloatArray) -> float:
        """NEES of the pose at the end."""
        no_common_mode = np.zeros((len(self.T), 6, 1))
        cov = drift_covariances(self.T, self.cov, no_common_mode, path_cross_cov)[-1]
        end = np.eye(4)
        true = np.eye(4)
        for T in self.T:
            end = T @ end
            true = STEP @ true
        return float(normalized_error_squared(true[None], end[None], cov[None])[0])


@pytest.fixture(scope="module")
def drives() -> dict[bool, list[SolvedDrive]]:
    """30 of 25 steps, with the filter and without."""
    seen = [drive(np.random.default_rng(seed), 25, 10) for seed in range(30)]
    return {
        filters: [SolvedDrive.along(steps, filters=filters) for steps in seen]
        for filters in (False, True)
    }


def test_it_makes_better_motions_with_a_consistent_covariance(
    drives: dict[bool, list[SolvedDrive]],
) -> None:
    errors = {}
    nees = {}
    for filters, solved in drives.items():
        T = np.concatenate([each.T[8:] for each in solved])
        cov = np.concatenate([each.cov[8:] for each in solved])
        true = np.broadcast_to(STEP, T.shape)
        nees[filters] = float(np.mean(normalized_error_squared(true, T, cov)))
        errors[filters] = float(np.sqrt(np.mean(np.sum((T - true)[:, :3, 3] ** 2, axis=1))))
    assert errors[True] < 0.9 * errors[False]
    # The steps of a drive share features, and are not independent: the upper bound is looser.
    low, _ = chi2_interval(6, len(drives[True]) * (25 - 8))
    assert low < nees[True] < 7.2


def test_path_covariance_needs_the_cross_covariances(drives: dict[bool, list[SolvedDrive]]) -> None:
    with_them = np.mean([each.end_error_squared(each.path_cross_cov) for each in drives[True]])
    without = np.mean(
        [each.end_error_squared(np.zeros_like(each.path_cross_cov)) for each in drives[True]]
    )
    low, high = chi2_interval(6, len(drives[True]), confidence=0.99)
    assert low < with_them < high
    assert without > 1.5 * with_them


def test_the_jitter_of_a_rig_belongs_to_all_tracks() -> None:
    """The filter knows which error of the disparities is common to all tracks since the last
    frame: the motions are consistent, and nearly as good as those of a rigid rig."""
    nees: dict[bool, list[float]] = {False: [], True: []}
    errors: dict[bool, list[float]] = {False: [], True: []}
    for seed in range(20):
        rng = np.random.default_rng(seed)
        steps = on_a_loose_rig(rng, drive(rng, 25, 10))
        for knows in (False, True):
            solved = SolvedDrive.along(
                steps, filters=True, jitter_cov=JITTER_COV if knows else None
            )
            true = np.broadcast_to(STEP, solved.T[8:].shape)
            nees[knows] += normalized_error_squared(true, solved.T[8:], solved.cov[8:]).tolist()
            errors[knows] += np.sum((solved.T[8:] - true)[:, :3, 3] ** 2, axis=1).tolist()
    low, _ = chi2_interval(6, len(nees[True]))
    assert low < np.mean(nees[True]) < 8.0
    assert np.mean(nees[False]) > 50.0
    assert np.sqrt(np.mean(errors[True])) < 0.2 * np.sqrt(np.mean(errors[False]))


def test_only_inliers_in_front_of_the_camera_are_kept() -> None:
    seen = views(points_m(np.random.default_rng(4), 6), 1)
    tracks = tracks_of(seen[0], seen[1], np.array([9, 4, 7, 1, 3, 8]))
    solution = evaluate_at(tracks, NOISE, DisparityFilter.none())
    solution.features.information[3] = 0.0
    disparities, _ = update_at_known_motion(
        DisparityFilter.none().of_tracks(tracks),
        tracks,
        NOISE.predict(np.zeros((6, 0))),
        solution=solution,
        camera=CAMERA,
        inliers=np.array([True, False, True, True, True, True]),
    )
    assert disparities.ids.tolist() == [3, 7, 8, 9]
    ids = np.array([8, 2, 9, 100, 0])
    states = disparities.of_tracks(replace(tracks.subset(np.arange(5)), ids=ids)).states
    assert states.rows.tolist() == [0, 2]
    np.testing.assert_array_equal(states.disparity, disparities.states.disparity[[2, 3]])


def test_a_changed_measurement_of_the_last_frame_is_taken_up_by_the_error() -> None:
    """The rig's calibration corrects the last frame by 0.3 px more than before: d stays what it
    was, δ takes up the difference."""
    seen = views(points_m(np.random.default_rng(8), 20), 2)
    first = tracks_of(*seen[:2])
    solution = evaluate_at(first, NOISE, DisparityFilter.none())
    disparities = filtered(first, NOISE, DisparityFilter.none(), solution=solution)
    same = tracks_of(*seen[1:])
    changed = tracks_of(*(px - np.array([0.0, 0.0, 0.3, 0.0]) for px in seen[1:]))
    of_same = disparities.of_tracks(same).states
    of_changed = disparities.of_tracks(changed).states
    np.testing.assert_allclose(of_changed.error, of_same.error + 0.3, atol=1e-9)
    np.testing.assert_array_equal(of_changed.disparity, of_same.disparity)
    np.testing.assert_allclose(
        evaluate_at(changed, NOISE, disparities).features.residuals,
        evaluate_at(same, NOISE, disparities).features.residuals,
        atol=1e-9,
    )


def test_without_inliers_nothing_is_kept() -> None:
    seen = views(points_m(np.random.default_rng(6), 40), 2)
    disparities = DisparityFilter.none()
    noise = NOISE.predict(np.zeros((40, 0)))
    for are_inliers in (True, False):
        tracks = tracks_of(*seen[:2]) if are_inliers else tracks_of(*seen[1:])
        prior = disparities.of_tracks(tracks)
        solution = solve_reprojection(
            StereoObservations.of(
                tracks.prev_px, tracks.curr_px, noise, camera=CAMERA, disparity_prior=prior.states
            ),
            guess=STEP,
        )
        solution, disparities = update_with_latent_errors(
            prior,
            tracks,
            noise,
            solution=solution,
            camera=CAMERA,
            inliers=np.full(40, are_inliers),
        )
        np.testing.assert_allclose(solution.T_curr_prev, STEP, atol=1e-6)
        assert len(disparities.ids) == (40 if are_inliers else 0)


def test_a_step_that_fixes_no_motion_stays_as_it_is_and_empties_the_filter() -> None:
    far = tracks_of(
        np.tile([300.0, 150.0, 300.0, 150.0], (9, 1)), np.tile([301.0, 150.0, 301.0, 150.0], (9, 1))
    )
    noise = NOISE.predict(np.zeros((9, 0)))
    solution = solve_reprojection(
        StereoObservations.of(far.prev_px, far.curr_px, noise, camera=CAMERA), guess=np.eye(4)
    )
    same, disparities = update_with_latent_errors(
        DisparityFilter.none().of_tracks(far),
        far,
        noise,
        solution=solution,
        camera=CAMERA,
        inliers=np.ones(9, np.bool_),
    )
    assert same is solution
    assert not len(disparities.ids)


def test_without_time_correlated_errors_there_is_nothing_to_filter() -> None:
    seen = views(points_m(np.random.default_rng(5), 6), 1)
    tracks = tracks_of(seen[0], seen[1])
    model = StudentT(5.0, SCALE)
    nothing = DisparityFilter.none()
    solution = evaluate_at(tracks, model, nothing)
    assert not len(filtered(tracks, model, nothing, solution=solution).ids)
    assert not len(nothing.of_tracks(tracks).ids)


@pytest.mark.parametrize("jitter_cov", [None, JITTER_COV])
def test_the_stacked_errors_are_the_unknowns_of_the_solve_and_then_the_latent_ones(
    jitter_cov: FloatArray | None,
) -> None:
    prev_px, curr_px = views(points_m(np.random.default_rng(0), 50), 1)
    noise = replace(NOISE.predict(np.zeros((50, 0))), jitter_cov=jitter_cov)
    observations = StereoObservations.of(prev_px, curr_px, noise, camera=CAMERA)
    solution = solve_reprojection(observations, guess=STEP, max_iterations=0)
    errors = StackedErrors.of(solution.jitter)
    places = np.arange(errors.size)
    parts = np.concatenate([places[part] for part in errors])
    np.testing.assert_array_equal(parts, places)
    assert errors.latent.start == solution.full_jacobian.shape[2]


@pytest.mark.parametrize("jitter_cov", [None, JITTER_COV])
def test_a_motion_that_is_as_uncertain_as_by_the_features_has_their_joint_posterior(
    jitter_cov: FloatArray | None,
) -> None:
    """Motion and latent errors then have the covariance of a step that solves for both; with a
    motion that is all but exact, the disparities are known better."""
    steps = drive(np.random.default_rng(3), 6, 10)
    if jitter_cov is not None:
        steps = on_a_loose_rig(np.random.default_rng(4), steps)
    disparities = DisparityFilter.none()
    for tracks in steps:
        noise = replace(SLIPPING.predict(np.zeros((len(tracks), 0))), jitter_cov=jitter_cov)
        prior = disparities.of_tracks(tracks)
        solution = solve_reprojection(
            StereoObservations.of(
                tracks.prev_px,
                tracks.curr_px,
                noise,
                camera=CAMERA,
                disparity_prior=prior.states,
            ),
            guess=STEP,
        )
        inliers = np.ones(len(tracks), np.bool_)
        solved, disparities = update_with_latent_errors(
            prior, tracks, noise, solution=solution, camera=CAMERA, inliers=inliers
        )
    found = {}
    for name, motion_cov in (("as solved", solved.cov), ("exact", 1e-12 * np.eye(6))):
        found[name], common = update_at_known_motion(
            prior,
            tracks,
            noise,
            solution=solution,
            camera=CAMERA,
            inliers=inliers,
            motion_cov=motion_cov,
        )
        assert common is not None
        np.testing.assert_allclose(common.cov[:6, :6], motion_cov, rtol=1e-6)
        # c is known no worse than before the step, and a prediction moves with c as J does with ξ.
        assert np.linalg.eigvalsh(common.cov[-6:, -6:]).max() < 1.0 + 1e-9
        assert common.jacobian.shape == (len(tracks), 4, len(common.cov))
    variance = {
        name: after.states.cov[:, 0, 0] + np.sum(after.common[:, 0] ** 2, axis=1)
        for name, after in found.items()
    }
    expected = disparities.states.cov[:, 0, 0] + np.sum(disparities.common[:, 0] ** 2, axis=1)
    np.testing.assert_allclose(variance["as solved"], expected, rtol=1e-6)
    assert (variance["exact"] < variance["as solved"]).all()

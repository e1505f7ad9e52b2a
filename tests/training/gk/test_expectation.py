"""The E-step: motions as the solver and the truth give them, and the errors that are then left."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.test_disparity_filter import SLIPPING, STEP
from estimation.test_disparity_filter import drive as slipping_steps
from intervals import chi2_interval
from probevo.arrays import FloatArray
from probevo.config import SolverConfig
from probevo.geometry import se3
from probevo.geometry.uncertainty import normalized_error_squared
from probevo.noise import StereoNoise, StudentT
from probevo.noise.base import RefersTo
from probevo.training.drive import Drive
from probevo.training.gk.conditioning import Stretch, conditioned
from probevo.training.gk.expectation import (
    UNSOLVED_SIGMA,
    Expectation,
    MotionPosterior,
    expect,
    solve_drive,
)
from probevo.training.supervised_drive import DriveInMemory
from probevo.training.supervision import Supervision
from probevo_sim.point_world import PointWorld
from training.supervised_drives import drive_of, in_memory, known, point_world, true_motions
from worlds import CAMERA

EXACT = np.zeros(6)


@pytest.fixture(scope="module")
def world() -> PointWorld:
    """All of σ = 0.3 px."""
    return point_world("constant", frames=40, sigma_px=(0.3, 0.3))


@pytest.fixture(scope="module")
def drive(world: PointWorld) -> Drive:
    return drive_of(world)


SIGMA = 0.3
R = SIGMA**2 * np.eye(4)


def right_noise(
    drive: Drive, refers_to: RefersTo = "observation", bias: FloatArray | None = None
) -> StereoNoise:
    """What the features truly have."""
    count = len(drive.phi)
    bias = np.zeros(4) if bias is None else bias
    return StereoNoise(
        np.tile(R, (count, 1, 1)),
        np.full(count, np.inf),
        np.tile(bias, (count, 1)),
        refers_to=refers_to,
    )


def expected(world: PointWorld, drive: Drive, noise: StereoNoise, kind: str = "gt") -> Expectation:
    """Do the E-step under this noise, with exact truth of this kind."""
    return expect(in_memory(drive, world, kind), lambda _: noise, SolverConfig(), truth_sigma=EXACT)


def solved(world: PointWorld, drive: Drive, noise: StereoNoise) -> MotionPosterior:
    """Solve the drive under this noise without truth."""
    return solve_drive(in_memory(drive, world), lambda _: noise, SolverConfig())


def test_motions_without_truth_are_those_of_the_solver(world: PointWorld, drive: Drive) -> None:
    noise = right_noise(drive)
    features_only = solved(world, drive, noise).T_curr_prev
    found = expected(world, drive, noise, "none")
    np.testing.assert_array_equal(found.T_curr_prev, features_only)
    np.testing.assert_array_equal(found.T_features_only, features_only)


def test_with_exact_truth_the_motions_are_true(world: PointWorld, drive: Drive) -> None:
    found = expected(world, drive, right_noise(drive))
    assert np.abs(se3.log(true_motions(world) @ se3.inverse(found.T_curr_prev))).max() < 2e-4
    assert np.abs(se3.log(true_motions(world) @ se3.inverse(found.T_features_only))).max() > 2e-3


def test_truth_that_is_given_as_exact_may_be_wrong(world: PointWorld, drive: Drive) -> None:
    """By 20 m a step, so that some points end up all but in the camera: their Σ is as good as
    singular."""
    off = se3.exp(
        np.random.default_rng(1).normal(size=(40, 6)) * np.r_[np.full(3, 20.0), np.zeros(3)]
    )
    wrong = replace(known(world), T_world_cam=world.T_world_cam @ off)
    supervised = DriveInMemory(drive, world.camera, wrong)
    noise = StudentT()
    found = expect(supervised, noise.predict, SolverConfig(), truth_sigma=EXACT).feature_errors
    assert np.isfinite(found.errors).all()
    assert np.isfinite(found.error_cov).all()
    assert np.isfinite(found.log_likelihood).all()


def test_errors_of_observations_have_the_covariance_of_one(world: PointWorld, drive: Drive) -> None:
    """Though residuals are larger, by the noise of the point: 5,000 errors at the true motion
    scatter as R, within 6 %, and so do those of the nearest and of the farthest half alone."""
    found = expected(world, drive, right_noise(drive))
    assert len(found.feature_errors.errors) > 4000
    disparity = (
        drive.prev_px[found.feature_errors.features, 0]
        - drive.prev_px[found.feature_errors.features, 2]
    )
    near = disparity > np.median(disparity)
    for some in (near, ~near):
        scatter = (
            found.feature_errors.errors[some].T @ found.feature_errors.errors[some] / some.sum()
        )
        assert np.linalg.norm(scatter - R) < 0.06 * np.linalg.norm(R)


def test_residuals_are_larger_than_errors_of_observations(world: PointWorld, drive: Drive) -> None:
    """By the noise of the earlier observation, which a moved point carries along: more than half as
    much again."""
    residuals, errors = (
        expected(world, drive, right_noise(drive, refers_to)).feature_errors.errors
        for refers_to in ("residual", "observation")
    )
    assert np.sum(residuals**2) > 1.5 * np.sum(errors**2)


@pytest.mark.parametrize(("refers_to", "off"), [("observation", 0.08), ("residual", 0.02)])
def test_the_spread_is_the_covariance_of_the_errors_that_the_motion_causes(
    world: PointWorld, drive: Drive, refers_to: RefersTo, off: float
) -> None:
    """J C Jᵀ, J by central differences of the errors by the motion, and C the covariance of the
    step. Errors of observations hang on the motion by the Σ that they are scaled with, too, by some
    4 %, which is left aside."""
    noise = right_noise(drive, refers_to)
    step = 5
    h = 1e-6
    found = expected(world, drive, noise, "none")
    cov = solved(world, drive, noise).cov

    def errors_at(T: FloatArray) -> FloatArray:
        """Return the errors of the step with its motion given as exact truth."""
        poses = se3.chain_motions(T[None])
        frames = np.array([step, step + 1])
        supervised = DriveInMemory(drive, world.camera, Supervision("sparse", frames, poses))
        given = expect(
            supervised, lambda _: noise, SolverConfig(), truth_sigma=EXACT
        ).feature_errors
        errors: FloatArray = given.errors[drive.step_of_feature[given.features] == step]
        return errors

    at = drive.step_of_feature[found.feature_errors.features] == step
    T = found.T_curr_prev[step]
    # Exact truth is off by 1e-4 at best, so that a motion follows it by a gain only, which is taken
    # out again.
    J = np.stack(
        [
            (errors_at(se3.exp(h * axis) @ T) - errors_at(se3.exp(-h * axis) @ T))
            for axis in np.eye(6)
        ],
        axis=-1,
    )
    gain = cov[step] @ np.linalg.inv(
        cov[step] + np.diag(np.r_[np.full(3, 1e-4), np.full(3, 1e-5)] ** 2)
    )
    J = J / (2.0 * h) @ np.linalg.inv(gain)
    by_differences = J @ cov[step] @ J.mT
    spread = found.feature_errors.error_cov[at]
    assert np.linalg.norm(spread - by_differences) < off * np.linalg.norm(by_differences)


def test_errors_and_spread_together_scatter_as_the_noise_does(
    world: PointWorld, drive: Drive
) -> None:
    """Without truth, the motion follows the features, and residuals are too small: by just the
    spread, within 4 %."""
    found = expected(world, drive, right_noise(drive), "none")
    scatter = (
        found.feature_errors.errors.T
        @ found.feature_errors.errors
        / len(found.feature_errors.errors)
    )
    assert np.trace(scatter) < 0.99 * np.trace(R)
    whole = scatter + found.feature_errors.error_cov.mean(axis=0)
    assert np.linalg.norm(whole - R) < 0.04 * np.linalg.norm(R)


@pytest.mark.parametrize("refers_to", ["observation", "residual"])
def test_errors_hold_the_bias_that_the_noise_takes_off(
    world: PointWorld, drive: Drive, refers_to: RefersTo
) -> None:
    """So that what is learned is the bias, and not what is left of it: here of an image that is off
    by a pixel."""
    bias = np.array([0.5, -0.3, 0.5, -0.3])
    off = replace(drive, curr_px=drive.curr_px + bias)
    found = expected(world, off, right_noise(off, refers_to, bias))
    np.testing.assert_allclose(found.feature_errors.errors.mean(axis=0), bias, atol=0.05)
    plain = expected(world, drive, right_noise(drive, refers_to))
    np.testing.assert_allclose(
        found.feature_errors.log_likelihood.mean(),
        plain.feature_errors.log_likelihood.mean(),
        rtol=1e-6,
    )


def test_the_right_noise_is_the_likeliest(world: PointWorld, drive: Drive) -> None:
    """Of observations, though what is judged are residuals."""
    noise = right_noise(drive)
    likelihoods = [
        expected(world, drive, noise.scaled(factor)).feature_errors.log_likelihood.mean()
        for factor in (0.8, 1.0, 1.25)
    ]
    assert likelihoods[1] > max(likelihoods[0], likelihoods[2])


def test_a_step_of_too_few_features_keeps_its_motion_and_teaches_nothing(
    world: PointWorld, drive: Drive
) -> None:
    """And is as good as unknown."""
    used = drive.used.copy()
    used[drive.rows(4)] = False
    used[drive.rows(4).start : drive.rows(4).start + 2] = True
    few = replace(drive, used=used)
    noise = right_noise(drive)
    posterior = solved(world, few, noise)
    np.testing.assert_array_equal(posterior.T_curr_prev[4], drive.T_curr_prev[4])
    np.testing.assert_array_equal(posterior.cov[4], np.diag(UNSOLVED_SIGMA**2))
    found = expected(world, few, noise)
    assert not (drive.step_of_feature[found.feature_errors.features] == 4).any()
    assert np.isfinite(found.T_curr_prev).all()


def test_where_every_stretch_has_a_step_of_too_few_features_the_truth_is_not_used(
    world: PointWorld, drive: Drive
) -> None:
    """It is used if one stretch has none: then it is as good as that one says."""
    used = drive.used.copy()
    for step in range(1, len(drive.T_curr_prev), 3):
        used[drive.rows(step)] = False
    few = replace(drive, used=used)
    noise = right_noise(drive)
    posterior = solved(world, few, noise)
    np.testing.assert_array_equal(posterior.is_solved, np.arange(len(drive.T_curr_prev)) % 3 != 1)
    supervised = in_memory(few, world, "sparse", every=3)
    found = expect(supervised, lambda _: noise, SolverConfig(), truth_sigma=None)
    np.testing.assert_array_equal(found.T_curr_prev, found.T_features_only)

    used[drive.rows(1)] = True
    found = expect(supervised, lambda _: noise, SolverConfig(), truth_sigma=None)
    moved = np.abs(found.T_curr_prev - found.T_features_only).max(axis=(1, 2))
    assert moved[4::3].min() > 0.0


def test_of_features_that_are_not_used_nothing_is_learned(world: PointWorld, drive: Drive) -> None:
    used = np.arange(len(drive.phi)) % 3 > 0
    found = expected(world, replace(drive, used=used), right_noise(drive))
    assert used[found.feature_errors.features].all()
    assert (np.diff(found.feature_errors.features) > 0).all()


def test_without_any_step_to_solve_there_is_nothing(world: PointWorld, drive: Drive) -> None:
    blind = replace(drive, used=np.zeros_like(drive.used))
    found = expected(world, blind, right_noise(drive), "none")
    assert [
        len(part)
        for part in (
            found.feature_errors.features,
            found.feature_errors.errors,
            found.feature_errors.error_cov,
            found.feature_errors.log_likelihood,
        )
    ] == [0] * 4
    np.testing.assert_array_equal(found.T_curr_prev, drive.T_curr_prev)


def slipping_drive(seed: int, steps: int, *, patches: int = 60) -> DriveInMemory:
    """Return a drive among so many patches whose disparities have time-correlated errors, with
    exact truth at both ends."""
    tracks_of_steps = slipping_steps(np.random.default_rng(seed), steps, 10)
    share = 300 // patches
    kept = [tracks.subset(np.flatnonzero(tracks.ids % share == 0)) for tracks in tracks_of_steps]
    counts = [len(tracks) for tracks in kept]
    drive = Drive(
        T_curr_prev=np.tile(STEP, (len(kept), 1, 1)),
        numbers=np.arange(len(kept)),
        first_of_step=np.cumsum([0, *counts]),
        prev_px=np.concatenate([tracks.prev_px for tracks in kept]),
        curr_px=np.concatenate([tracks.curr_px for tracks in kept]),
        ids=np.concatenate([tracks.ids for tracks in kept]),
        phi=np.zeros((sum(counts), 1)),
        used=np.ones(sum(counts), np.bool_),
    )
    ends = np.array([0, len(kept)])
    poses = se3.chain_motions(drive.T_curr_prev)[ends]
    return DriveInMemory(drive, CAMERA, Supervision("sparse", ends, poses))


def test_with_time_correlated_errors_a_stretch_is_consistent_with_its_truth() -> None:
    """Ten drives of 20 steps that share tracks: the NEES of their whole motion is 6, where
    independent steps would have 25, and steps that are conditioned on it have 6 as well."""
    steps = 20
    sigma = np.repeat([1e-3, 1e-4], 3)
    of_stretches = []
    of_steps = []
    for seed in range(10):
        drive = slipping_drive(seed, steps)
        found = solve_drive(drive, SLIPPING.predict, SolverConfig())
        assert found.correlations is not None
        stretch = Stretch.of(
            found.T_curr_prev,
            found.cov,
            found.correlations,
            first=0,
            end=steps,
            T_world_cam=drive.supervision.T_world_cam,
        )
        distance = stretch.distance
        of_stretches.append(distance @ np.linalg.solve(stretch.cov, distance))
        T, cov = conditioned(
            found.T_curr_prev,
            found.cov,
            drive.supervision,
            truth_sigma=sigma,
            correlations=found.correlations,
        )
        of_steps.append(normalized_error_squared(np.broadcast_to(STEP, T.shape), T, cov).mean())
    low, high = chi2_interval(6, len(of_stretches), confidence=0.99)
    assert low < np.mean(of_stretches) < high
    assert 0.8 * 6.0 < np.mean(of_steps) < 1.2 * 6.0


def test_errors_of_tracks_with_a_history_have_the_size_of_their_noise() -> None:
    """Six drives of 40 steps among 25 patches, without truth: motion and latent errors of the
    disparities largely cancel in the residuals, and errors and spread together scatter as the
    noise does, within 4 %. By the motion alone it is 15 % more."""
    information = np.linalg.inv(SLIPPING.scale)
    sizes = []
    for seed in range(6):
        drive = slipping_drive(seed, 40, patches=25)
        unknown = replace(drive, supervision=replace(drive.supervision, kind="none"))
        found = expect(unknown, SLIPPING.predict, SolverConfig(), truth_sigma=None).feature_errors
        # The profile says nothing of κ where the track has a history.
        has_history = found.profile[:, 2] == 0.0
        errors = found.errors[has_history]
        squared = np.einsum("ni,ij,nj->n", errors, information, errors)
        spread = np.einsum("ij,nji->n", information, found.error_cov[has_history])
        sizes.append(np.mean(squared + spread) / 4.0)
    assert 0.96 < np.mean(sizes) < 1.04

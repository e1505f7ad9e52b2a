"""The E-step: motions from features and truth together, and the errors that are then left."""

from dataclasses import replace

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo.config import SolverConfig
from probevo.geometry import se3
from probevo.noise import StereoNoise
from probevo.simulation.point_world import PointWorld
from probevo.training.drive import Drive
from probevo.training.expectation import LOOP_SIGMA, UNSOLVED_SIGMA, Expectation, conditioned, expect, solve_drive
from probevo.training.lesson import HeldLesson
from probevo.training.supervision import Supervision
from training.lessons import drive_of, known, point_world, true_motions

STEPS = 12
EXACT = np.zeros(6)


def motions(count: int = STEPS, seed: int = 0) -> FloatArray:
    """Of a car that turns, T_curr_prev, [K − 1, 4, 4]."""
    xi = np.array([0.02, 0.01, -0.3, 0.003, 0.05, -0.002])
    return se3.exp(xi + 0.2 * np.abs(xi) * np.random.default_rng([seed, 0]).normal(size=(count, 6)))


def covariances(count: int = STEPS, sigma: float = 1e-3, seed: int = 0) -> FloatArray:
    """Full ones, of σ each, [K − 1, 6, 6]."""
    factor = np.random.default_rng([seed, 1]).normal(size=(count, 6, 6)) / np.sqrt(6.0)
    return sigma**2 * (factor @ factor.mT + 0.1 * np.eye(6))


def disturbed(T: FloatArray, cov: FloatArray, seed: int = 0) -> FloatArray:
    """Each by a perturbation of its covariance, on the left."""
    white = np.random.default_rng([seed, 2]).normal(size=(len(T), 6, 1))
    return se3.exp((np.linalg.cholesky(cov) @ white)[..., 0]) @ T


def truth(T: FloatArray, every: int = 1, kind: str = "gt") -> Supervision:
    """The path of these motions, known at each so many frames."""
    frames = np.arange(0, len(T) + 1, every)
    return Supervision(kind, frames, se3.chain_motions(T)[frames])  # type: ignore[arg-type]


def over(T: FloatArray, first: int, last: int) -> FloatArray:
    """The motion from one frame to another, [4, 4]."""
    total = np.eye(4)
    for step in T[first:last]:
        total = step @ total
    return total


def test_of_single_steps_it_is_the_fusion_of_two_gaussians() -> None:
    """Information adds up, and the mean is weighed by it (in the tangent space at the features' motion)."""
    true, cov = motions(), covariances()
    seen, sigma = disturbed(true, cov), np.array([1e-3, 2e-3, 5e-4, 1e-3, 3e-3, 7e-4])
    fused, posterior = conditioned(seen, cov, truth(true), sigma)
    for k in range(STEPS):
        own, other = np.linalg.inv(cov[k]), np.diag(sigma**-2.0)
        expected = np.linalg.inv(own + other)
        np.testing.assert_allclose(posterior[k], expected, rtol=1e-7, atol=1e-15)
        distance = se3.log(true[k] @ se3.inverse(seen[k]))
        moved = se3.log(fused[k] @ se3.inverse(seen[k]))
        np.testing.assert_allclose(moved, expected @ other @ distance, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("every", [1, 3, 12])
def test_exact_truth_decides(every: int) -> None:
    """Over each stretch, the motion is the true one, but for the square of how far the features were off."""
    true, cov = motions(), covariances()
    fused, _ = conditioned(disturbed(true, cov), cov, truth(true, every, "sparse"), EXACT)
    for first in range(0, STEPS, every):
        left = se3.log(over(true, first, first + every) @ se3.inverse(over(fused, first, first + every)))
        assert np.abs(left).max() < 1e-4


def test_exact_truth_of_each_step_leaves_no_doubt() -> None:
    _, posterior = conditioned(motions(), covariances(), truth(motions()), EXACT)
    assert np.trace(posterior, axis1=1, axis2=2).max() < 1e-7


@pytest.mark.parametrize("every", [1, 4])
def test_truth_that_is_not_known_at_all_says_nothing(every: int) -> None:
    true, cov = motions(), covariances()
    seen = disturbed(true, cov)
    fused, posterior = conditioned(seen, cov, truth(true, every, "sparse"), np.full(6, 1e6))
    np.testing.assert_allclose(fused, seen, atol=1e-12)
    np.testing.assert_allclose(posterior, cov, rtol=1e-9)


@pytest.mark.parametrize("every", [1, 4])
def test_what_is_conditioned_is_surer_and_still_a_covariance(every: int) -> None:
    cov = covariances()
    _, posterior = conditioned(motions(), cov, truth(motions(), every, "sparse"), np.full(6, 1e-3))
    assert np.linalg.eigvalsh(posterior).min() > 0.0
    assert np.linalg.eigvalsh(cov - posterior).min() > -1e-15


def test_the_posterior_is_as_wide_as_it_says() -> None:
    """Of 2,000 drives of three steps whose both ends are known within σ: the squared distance of each step from the
    truth, in units of its covariance, is 6 on average."""
    true, cov, sigma = motions(3), covariances(3), np.full(6, 5e-4)
    squared = []
    for seed in range(2000):
        seen = disturbed(true, cov, seed)
        noise = sigma * np.random.default_rng([seed, 3]).normal(size=6)
        ends = np.stack([np.eye(4), se3.inverse(se3.exp(noise) @ over(true, 0, 3))])
        fused, posterior = conditioned(seen, cov, Supervision("sparse", np.array([0, 3]), ends), sigma)
        left = se3.log(true @ se3.inverse(fused))
        squared.append(np.einsum("ki,kij,kj->k", left, np.linalg.inv(posterior), left))
    np.testing.assert_allclose(np.mean(squared, axis=0), 6.0, rtol=0.08)  # standard error 0.08


def test_steps_outside_of_all_stretches_stay_as_they_are() -> None:
    true, cov = motions(), covariances()
    seen = disturbed(true, cov)
    middle = Supervision("sparse", np.array([3, 7]), se3.chain_motions(true)[[3, 7]])
    fused, posterior = conditioned(seen, cov, middle, EXACT)
    outside = np.r_[0:3, 7:STEPS]
    np.testing.assert_array_equal(fused[outside], seen[outside])
    np.testing.assert_array_equal(posterior[outside], cov[outside])
    assert (np.abs(fused[3:7] - seen[3:7]).max(axis=(1, 2)) > 0.0).all()


LOOP = 40


def circle() -> FloatArray:
    """Once around in 40 steps."""
    return np.tile(se3.exp(np.array([0.0, 0.0, -0.3, 0.0, 2.0 * np.pi / LOOP, 0.0])), (LOOP, 1, 1))


def around(kind: str = "loop") -> Supervision:
    return Supervision(kind, np.array([0, LOOP]), np.stack([np.eye(4)] * 2))  # type: ignore[arg-type]


def gap(T: FloatArray) -> FloatArray:
    return se3.log(over(T, 0, LOOP))


def test_a_loop_closes_to_within_its_sigma() -> None:
    """Off by half a metre and far less sure than that, it ends within its σ of where it began."""
    true, cov = circle(), np.tile(np.diag(np.r_[np.full(3, 0.1), np.full(3, 0.02)] ** 2), (LOOP, 1, 1))
    seen = disturbed(true, cov)
    fused, _ = conditioned(seen, cov, around(), None)
    assert np.linalg.norm(gap(seen) / LOOP_SIGMA) > 3.0
    assert (np.abs(gap(fused)) < LOOP_SIGMA).all()


def test_a_loop_is_closed_by_the_steps_that_are_least_sure() -> None:
    """One step of ten times σ: it takes as much of the correction, in units of its own σ², as all others."""
    true, cov = circle(), np.tile(1e-6 * np.eye(6), (LOOP, 1, 1))
    cov[7] *= 100.0
    seen = true.copy()
    seen[20] = se3.exp(np.array([0.03, 0.0, 0.0, 0.0, 0.0, 0.0])) @ seen[20]
    fused, _ = conditioned(seen, cov, around(), np.full(6, 1e-3))
    moved = np.linalg.norm(se3.log(fused @ se3.inverse(seen)), axis=1)
    assert moved[7] > 0.5 * moved.sum()
    assert moved[7] / moved[[6, 8]].mean() == pytest.approx(100.0, rel=0.1)


@pytest.mark.parametrize("every", [1, 5])
def test_how_far_the_truth_is_off_is_estimated(every: int) -> None:
    """From 400 steps whose truth is off by twice what the features are: σ within 20 %, as by conditioning with it."""
    count, cov = 400, np.tile(1e-6 * np.eye(6), (400, 1, 1))
    true, stretches = motions(count), count // every
    sigma = np.full(6, 4e-3)
    noise = sigma * np.random.default_rng(5).normal(size=(stretches, 6))
    ends = np.array([se3.exp(noise[i]) @ over(true, i * every, (i + 1) * every) for i in range(stretches)])
    off = Supervision("sparse", np.arange(0, count + 1, every), se3.chain_motions(ends))
    seen = disturbed(true, cov)
    found = conditioned(seen, cov, off, None)[1]
    less, more = (conditioned(seen, cov, off, factor * sigma)[1] for factor in (0.8, 1.2))
    sums = [np.trace(posterior, axis1=1, axis2=2).sum() for posterior in (less, found, more)]
    assert sums[0] < sums[1] < sums[2]


def test_exact_truth_is_found_to_be_so() -> None:
    """Estimated, it is better than the features, by which it is judged: the motions are nearer to the true ones."""
    true, cov = motions(400), covariances(400)
    seen = disturbed(true, cov)
    fused, _ = conditioned(seen, cov, truth(true), None)
    before, after = (np.abs(se3.log(true @ se3.inverse(T))).mean() for T in (seen, fused))
    assert after < 0.4 * before


@pytest.fixture(scope="module")
def world() -> PointWorld:
    """All of σ = 0.3 px."""
    return point_world("constant", frames=40, sigma_px=(0.3, 0.3))


@pytest.fixture(scope="module")
def drive(world: PointWorld) -> Drive:
    return drive_of(world)


SIGMA = 0.3
R = SIGMA**2 * np.eye(4)


def right_noise(drive: Drive, refers_to: str = "observation", bias: FloatArray | None = None) -> StereoNoise:
    """What the features truly have."""
    count = len(drive.phi)
    bias = np.zeros(4) if bias is None else bias
    return StereoNoise(np.tile(R, (count, 1, 1)), np.full(count, np.inf), np.tile(bias, (count, 1)), refers_to)  # type: ignore[arg-type]


def expected(world: PointWorld, drive: Drive, noise: StereoNoise, kind: str = "gt") -> Expectation:
    nothing = Supervision("none", np.arange(len(world)), np.full((len(world), 4, 4), np.nan))
    supervision = nothing if kind == "none" else known(world, kind)
    return expect(HeldLesson(drive, world.camera, supervision), lambda _: noise, SolverConfig(), EXACT)


def test_motions_without_truth_are_those_of_the_solver(world: PointWorld, drive: Drive) -> None:
    noise = right_noise(drive)
    alone, _ = solve_drive([drive], lambda _: noise, world.camera, SolverConfig())
    found = expected(world, drive, noise, "none")
    np.testing.assert_array_equal(found.T_curr_prev, alone)
    np.testing.assert_array_equal(found.T_alone, alone)


def test_with_exact_truth_the_motions_are_true(world: PointWorld, drive: Drive) -> None:
    found = expected(world, drive, right_noise(drive))
    assert np.abs(se3.log(true_motions(world) @ se3.inverse(found.T_curr_prev))).max() < 2e-4
    assert np.abs(se3.log(true_motions(world) @ se3.inverse(found.T_alone))).max() > 2e-3


def test_errors_of_observations_have_the_covariance_of_one(world: PointWorld, drive: Drive) -> None:
    """Though residuals are larger, by the noise of the point: 5,000 errors at the true motion scatter as R, within 6 %,
    and so do those of the nearest and of the farthest half alone."""
    found = expected(world, drive, right_noise(drive))
    assert len(found.left_over.errors) > 4000
    disparity = drive.prev_px[found.left_over.features, 0] - drive.prev_px[found.left_over.features, 2]
    near = disparity > np.median(disparity)
    for some in (near, ~near):
        scatter = found.left_over.errors[some].T @ found.left_over.errors[some] / some.sum()
        assert np.linalg.norm(scatter - R) < 0.06 * np.linalg.norm(R)


def test_residuals_are_larger_than_errors_of_observations(world: PointWorld, drive: Drive) -> None:
    """By the noise of the earlier observation, which a moved point carries along: more than half as much again."""
    residuals, errors = (
        expected(world, drive, right_noise(drive, refers_to)).left_over.errors
        for refers_to in ("residual", "observation")
    )
    assert np.sum(residuals**2) > 1.5 * np.sum(errors**2)


@pytest.mark.parametrize(("refers_to", "off"), [("observation", 0.08), ("residual", 0.02)])
def test_the_spread_is_what_the_doubt_about_the_motion_makes_of_the_errors(
    world: PointWorld, drive: Drive, refers_to: str, off: float
) -> None:
    """J C Jᵀ, J by central differences of the errors by the motion, and C the covariance of the step. Errors of
    observations hang on the motion by the Σ that they are scaled with, too, by some 4 %, which is left aside."""
    noise, step, h = right_noise(drive, refers_to), 5, 1e-6
    found = expected(world, drive, noise, "none")
    _, cov = solve_drive([drive], lambda _: noise, world.camera, SolverConfig())

    def errors_at(T: FloatArray) -> FloatArray:
        """With the motion given, as if it were the exact truth."""
        poses = se3.chain_motions(T[None])
        frames = np.array([step, step + 1])
        lesson = HeldLesson(drive, world.camera, Supervision("sparse", frames, poses))
        given = expect(lesson, lambda _: noise, SolverConfig(), EXACT)
        return given.left_over.errors[drive.step_of_feature[given.left_over.features] == step]

    at, T = drive.step_of_feature[found.left_over.features] == step, found.T_curr_prev[step]
    # Exact truth is off by 1e-4 at best, so that a motion follows it by a gain only, which is taken out again.
    J = np.stack(
        [(errors_at(se3.exp(h * axis) @ T) - errors_at(se3.exp(-h * axis) @ T)) for axis in np.eye(6)], axis=-1
    )
    gain = cov[step] @ np.linalg.inv(cov[step] + np.diag(np.r_[np.full(3, 1e-4), np.full(3, 1e-5)] ** 2))
    J = J / (2.0 * h) @ np.linalg.inv(gain)
    by_differences, spread = J @ cov[step] @ J.mT, found.left_over.spread[at]
    assert np.linalg.norm(spread - by_differences) < off * np.linalg.norm(by_differences)


def test_errors_and_spread_together_scatter_as_the_noise_does(world: PointWorld, drive: Drive) -> None:
    """Without truth, the motion follows the features, and residuals are too small: by just the spread, within 4 %."""
    found = expected(world, drive, right_noise(drive), "none")
    scatter = found.left_over.errors.T @ found.left_over.errors / len(found.left_over.errors)
    assert np.trace(scatter) < 0.99 * np.trace(R)
    whole = scatter + found.left_over.spread.mean(axis=0)
    assert np.linalg.norm(whole - R) < 0.04 * np.linalg.norm(R)


@pytest.mark.parametrize("refers_to", ["observation", "residual"])
def test_errors_hold_the_bias_that_the_noise_takes_off(world: PointWorld, drive: Drive, refers_to: str) -> None:
    """So that what is learned is the bias, and not what is left of it: here of an image that is off by a pixel."""
    bias = np.array([0.5, -0.3, 0.5, -0.3])
    off = replace(drive, curr_px=drive.curr_px + bias)
    found = expected(world, off, right_noise(off, refers_to, bias))
    np.testing.assert_allclose(found.left_over.errors.mean(axis=0), bias, atol=0.05)
    plain = expected(world, drive, right_noise(drive, refers_to))
    np.testing.assert_allclose(found.left_over.log_likelihood.mean(), plain.left_over.log_likelihood.mean(), rtol=1e-6)


def test_the_right_noise_is_the_likeliest(world: PointWorld, drive: Drive) -> None:
    """Of observations, though what is judged are residuals."""
    noise = right_noise(drive)
    likelihoods = [
        expected(world, drive, noise.scaled(np.full(len(drive.phi), factor))).left_over.log_likelihood.mean()
        for factor in (0.8, 1.0, 1.25)
    ]
    assert likelihoods[1] > max(likelihoods[0], likelihoods[2])


def test_a_step_of_too_few_features_keeps_its_motion_and_teaches_nothing(world: PointWorld, drive: Drive) -> None:
    """And is as good as unknown."""
    used = drive.used.copy()
    used[drive.rows(4)] = False
    used[drive.rows(4).start : drive.rows(4).start + 2] = True
    few, noise = replace(drive, used=used), right_noise(drive)
    T, cov = solve_drive([few], lambda _: noise, world.camera, SolverConfig())
    np.testing.assert_array_equal(T[4], drive.T_curr_prev[4])
    np.testing.assert_array_equal(cov[4], np.diag(UNSOLVED_SIGMA**2))
    found = expected(world, few, noise)
    assert not (drive.step_of_feature[found.left_over.features] == 4).any()
    assert np.isfinite(found.T_curr_prev).all()


def test_of_features_that_are_not_used_nothing_is_learned(world: PointWorld, drive: Drive) -> None:
    used = np.arange(len(drive.phi)) % 3 > 0
    found = expected(world, replace(drive, used=used), right_noise(drive))
    assert used[found.left_over.features].all()
    assert (np.diff(found.left_over.features) > 0).all()


def test_without_any_step_to_solve_there_is_nothing(world: PointWorld, drive: Drive) -> None:
    blind = replace(drive, used=np.zeros_like(drive.used))
    found = expected(world, blind, right_noise(drive), "none")
    assert [
        len(part)
        for part in (
            found.left_over.features,
            found.left_over.errors,
            found.left_over.spread,
            found.left_over.log_likelihood,
        )
    ] == [0] * 4
    np.testing.assert_array_equal(found.T_curr_prev, drive.T_curr_prev)

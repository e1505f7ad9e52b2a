"""Fusion of motions with the truth: Gaussian closed forms, limits, Monte Carlo, gating."""

import numpy as np
import pytest

from probevo.arrays import BoolArray, FloatArray
from probevo.geometry import se3
from probevo.training.gk.conditioning import (
    MAX_COMMON,
    StepCorrelations,
    conditioned,
)
from probevo.training.gk.expectation import UNSOLVED_SIGMA
from probevo.training.supervision import LOOP_SIGMA, Supervision

STEPS = 12
EXACT = np.zeros(6)


def motions(count: int = STEPS, seed: int = 0) -> FloatArray:
    """Return the T_curr_prev of a car that turns, [K − 1, 4, 4]."""
    xi = np.array([0.02, 0.01, -0.3, 0.003, 0.05, -0.002])
    return se3.exp(xi + 0.2 * np.abs(xi) * np.random.default_rng([seed, 0]).normal(size=(count, 6)))


def covariances(count: int = STEPS, sigma: float = 1e-3, seed: int = 0) -> FloatArray:
    """Return full covariances of about σ², [K − 1, 6, 6]."""
    factor = np.random.default_rng([seed, 1]).normal(size=(count, 6, 6)) / np.sqrt(6.0)
    cov: FloatArray = sigma**2 * (factor @ factor.mT + 0.1 * np.eye(6))
    return cov


def disturbed(T: FloatArray, cov: FloatArray, seed: int = 0) -> FloatArray:
    """Perturb each motion on the left by noise of its covariance."""
    white = np.random.default_rng([seed, 2]).normal(size=(len(T), 6, 1))
    return se3.exp((np.linalg.cholesky(cov) @ white)[..., 0]) @ T


def truth(T: FloatArray, every: int = 1, kind: str = "gt") -> Supervision:
    """Return the path of these motions as truth, known at every so many frames."""
    frames = np.arange(0, len(T) + 1, every)
    return Supervision(kind, frames, se3.chain_motions(T)[frames])  # type: ignore[arg-type]


def over(T: FloatArray, first: int, last: int) -> FloatArray:
    """Return the motion from one frame to another, [4, 4]."""
    total = np.eye(4)
    for step in T[first:last]:
        total = step @ total
    return total


def test_of_single_steps_it_is_the_fusion_of_two_gaussians() -> None:
    """Information adds up, and the mean is weighed by it (in the tangent space at the features'
    motion)."""
    true = motions()
    cov = covariances()
    seen = disturbed(true, cov)
    sigma = np.array([1e-3, 2e-3, 5e-4, 1e-3, 3e-3, 7e-4])
    fused, posterior = conditioned(seen, cov, truth(true), truth_sigma=sigma)
    for k in range(STEPS):
        own = np.linalg.inv(cov[k])
        other = np.diag(sigma**-2.0)
        expected = np.linalg.inv(own + other)
        np.testing.assert_allclose(posterior[k], expected, rtol=1e-7, atol=1e-15)
        distance = se3.log(true[k] @ se3.inverse(seen[k]))
        moved = se3.log(fused[k] @ se3.inverse(seen[k]))
        np.testing.assert_allclose(moved, expected @ other @ distance, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("every", [1, 3, 12])
def test_exact_truth_decides(every: int) -> None:
    """Over each stretch, the motion is the true one, but for the square of how far the features
    were off."""
    true = motions()
    cov = covariances()
    fused, _ = conditioned(
        disturbed(true, cov), cov, truth(true, every, "sparse"), truth_sigma=EXACT
    )
    for first in range(0, STEPS, every):
        left = se3.log(
            over(true, first, first + every) @ se3.inverse(over(fused, first, first + every))
        )
        assert np.abs(left).max() < 1e-4


def test_exact_truth_of_each_step_leaves_no_uncertainty() -> None:
    _, posterior = conditioned(motions(), covariances(), truth(motions()), truth_sigma=EXACT)
    assert np.trace(posterior, axis1=1, axis2=2).max() < 1e-7


@pytest.mark.parametrize("every", [1, 4])
def test_truth_that_is_not_known_at_all_says_nothing(every: int) -> None:
    true = motions()
    cov = covariances()
    seen = disturbed(true, cov)
    fused, posterior = conditioned(
        seen, cov, truth(true, every, "sparse"), truth_sigma=np.full(6, 1e6)
    )
    np.testing.assert_allclose(fused, seen, atol=1e-12)
    np.testing.assert_allclose(posterior, cov, rtol=1e-9)


@pytest.mark.parametrize("every", [1, 4])
def test_the_posterior_covariance_is_smaller_and_positive_definite(every: int) -> None:
    cov = covariances()
    _, posterior = conditioned(
        motions(), cov, truth(motions(), every, "sparse"), truth_sigma=np.full(6, 1e-3)
    )
    assert np.linalg.eigvalsh(posterior).min() > 0.0
    assert np.linalg.eigvalsh(cov - posterior).min() > -1e-15


def test_the_posterior_is_consistent() -> None:
    """Of 2,000 drives of three steps whose both ends are known within σ: the squared distance of
    each step from the truth, in units of its covariance, is 6 on average."""
    true = motions(3)
    cov = covariances(3)
    sigma = np.full(6, 5e-4)
    squared = []
    for seed in range(2000):
        seen = disturbed(true, cov, seed)
        noise = sigma * np.random.default_rng([seed, 3]).normal(size=6)
        ends = np.stack([np.eye(4), se3.inverse(se3.exp(noise) @ over(true, 0, 3))])
        fused, posterior = conditioned(
            seen, cov, Supervision("sparse", np.array([0, 3]), ends), truth_sigma=sigma
        )
        left = se3.log(true @ se3.inverse(fused))
        squared.append(np.einsum("ki,kij,kj->k", left, np.linalg.inv(posterior), left))
    np.testing.assert_allclose(np.mean(squared, axis=0), 6.0, rtol=0.08)  # standard error 0.08


def correlated_through_common_errors(seed: int = 0) -> tuple[StepCorrelations, FloatArray]:
    """Draw steps whose errors depend on common ones, and return their joint covariance,
    [K − 1, 6, K − 1, 6]."""
    rng = np.random.default_rng([seed, 4])
    # w whitened errors: given c before the step, the step moves with the first six, and the last
    # are what is not known of c.
    size = 6 + MAX_COMMON
    roots = 1e-3 * rng.normal(size=(STEPS, 6, size))
    before = 0.9 * np.linalg.qr(rng.normal(size=(STEPS, size, MAX_COMMON)))[0].mT
    after = np.linalg.qr(rng.normal(size=(STEPS, size, MAX_COMMON)))[0]
    correlations = StepCorrelations(
        with_before=roots @ before.mT, with_after=roots @ after, transition=before @ after
    )
    joint = np.zeros((STEPS, 6, STEPS, 6))
    for j in range(STEPS):
        joint[j, :, j] = roots[j] @ roots[j].T
        # The covariance of step j with c after it, and after each of the steps that follow.
        with_common = correlations.with_after[j]
        for k in range(j + 1, STEPS):
            joint[j, :, k] = with_common @ correlations.with_before[k].T
            joint[k, :, j] = joint[j, :, k].T
            with_common = with_common @ correlations.transition[k]
    return correlations, joint


def test_correlated_steps_move_as_their_joint_gaussian_does() -> None:
    """A stretch of eight steps: mean and covariance of each given the motion of all, in closed
    form; the steps before and after it stay as they are."""
    first = 2
    end = 10
    true = motions()
    correlations, joint = correlated_through_common_errors()
    cov = np.array([joint[k, :, k] for k in range(STEPS)])
    assert np.linalg.eigvalsh(joint.reshape(6 * STEPS, 6 * STEPS)).min() > 0.0
    seen = disturbed(true, cov)
    sigma = np.full(6, 5e-4)
    poses = se3.chain_motions(true)[[first, end]]
    known = Supervision("sparse", np.array([first, end]), poses)
    fused, posterior = conditioned(seen, cov, known, truth_sigma=sigma, correlations=correlations)
    # H = (Ad_1, …, Ad_m) maps the perturbations of the steps to that of the whole motion.
    H = np.hstack([se3.adjoint(over(seen, k + 1, end)) for k in range(first, end)])
    of_stretch = joint[first:end, :, first:end].reshape(len(H.T), len(H.T))
    innovation_cov = H @ of_stretch @ H.T + np.diag(sigma**2)
    gain = of_stretch @ H.T @ np.linalg.inv(innovation_cov)
    distance = se3.log(over(true, first, end) @ se3.inverse(over(seen, first, end)))
    moved = se3.log(fused[first:end] @ se3.inverse(seen[first:end]))
    np.testing.assert_allclose(moved.ravel(), gain @ distance, rtol=1e-6, atol=1e-12)
    left = of_stretch - gain @ H @ of_stretch
    for k in range(end - first):
        own = slice(6 * k, 6 * k + 6)
        np.testing.assert_allclose(posterior[first + k], left[own, own], rtol=1e-7, atol=1e-15)
    outside = np.r_[0:first, end:STEPS]
    np.testing.assert_array_equal(fused[outside], seen[outside])


def test_steps_outside_of_all_stretches_stay_as_they_are() -> None:
    true = motions()
    cov = covariances()
    seen = disturbed(true, cov)
    middle = Supervision("sparse", np.array([3, 7]), se3.chain_motions(true)[[3, 7]])
    fused, posterior = conditioned(seen, cov, middle, truth_sigma=EXACT)
    outside = np.r_[0:3, 7:STEPS]
    np.testing.assert_array_equal(fused[outside], seen[outside])
    np.testing.assert_array_equal(posterior[outside], cov[outside])
    assert (np.abs(fused[3:7] - seen[3:7]).max(axis=(1, 2)) > 0.0).all()


LOOP = 40


def circle() -> FloatArray:
    """Return the motions once around a circle in 40 steps."""
    return np.tile(se3.exp(np.array([0.0, 0.0, -0.3, 0.0, 2.0 * np.pi / LOOP, 0.0])), (LOOP, 1, 1))


def around(kind: str = "loop") -> Supervision:
    return Supervision(kind, np.array([0, LOOP]), np.stack([np.eye(4)] * 2))  # type: ignore[arg-type]


def gap(T: FloatArray) -> FloatArray:
    return se3.log(over(T, 0, LOOP))


def test_a_loop_closes_to_within_its_sigma() -> None:
    """Off by half a metre and far less sure than that, it ends within its σ of where it began."""
    true = circle()
    cov = np.tile(np.diag(np.r_[np.full(3, 0.1), np.full(3, 0.02)] ** 2), (LOOP, 1, 1))
    seen = disturbed(true, cov)
    fused, _ = conditioned(seen, cov, around(), truth_sigma=None)
    assert np.linalg.norm(gap(seen) / LOOP_SIGMA) > 3.0
    assert (np.abs(gap(fused)) < LOOP_SIGMA).all()


def test_a_loop_is_closed_by_the_steps_that_are_least_sure() -> None:
    """One step of ten times σ: it takes as much of the correction, in units of its own σ², as all
    others."""
    true = circle()
    cov = np.tile(1e-6 * np.eye(6), (LOOP, 1, 1))
    cov[7] *= 100.0
    seen = true.copy()
    seen[20] = se3.exp(np.array([0.03, 0.0, 0.0, 0.0, 0.0, 0.0])) @ seen[20]
    fused, _ = conditioned(seen, cov, around(), truth_sigma=np.full(6, 1e-3))
    moved = np.linalg.norm(se3.log(fused @ se3.inverse(seen)), axis=1)
    assert moved[7] > 0.5 * moved.sum()
    assert moved[7] / moved[[6, 8]].mean() == pytest.approx(100.0, rel=0.1)


@pytest.mark.parametrize("every", [1, 5])
def test_how_far_the_truth_is_off_is_estimated(every: int) -> None:
    """From 400 steps whose truth is off by twice what the features are: σ within 20 %, as by
    conditioning with it."""
    count = 400
    cov = np.tile(1e-6 * np.eye(6), (400, 1, 1))
    true = motions(count)
    stretches = count // every
    sigma = np.full(6, 4e-3)
    noise = sigma * np.random.default_rng(5).normal(size=(stretches, 6))
    ends = np.array(
        [se3.exp(noise[i]) @ over(true, i * every, (i + 1) * every) for i in range(stretches)]
    )
    off = Supervision("sparse", np.arange(0, count + 1, every), se3.chain_motions(ends))
    seen = disturbed(true, cov)
    found = conditioned(seen, cov, off, truth_sigma=None)[1]
    less, more = (
        conditioned(seen, cov, off, truth_sigma=factor * sigma)[1] for factor in (0.8, 1.2)
    )
    sums = [np.trace(posterior, axis1=1, axis2=2).sum() for posterior in (less, found, more)]
    assert sums[0] < sums[1] < sums[2]


@pytest.mark.parametrize("axes", [(1.0, 1.0, 5.0), (1.0, 3.0, 8.0)])
def test_how_far_the_truth_is_off_is_estimated_where_the_axes_differ(
    axes: tuple[float, float, float],
) -> None:
    """As those of a stereo camera do: σ of the truth within 20 %, 1 mm beside up to 8 mm of the
    features."""
    count = 400
    cov = np.tile(np.diag(1e-3 * np.r_[axes, axes]) ** 2, (count, 1, 1))
    true = motions(count)
    sigma = np.full(6, 1e-3)
    known = truth(disturbed(true, np.tile(np.diag(sigma) ** 2, (count, 1, 1)), seed=7))
    seen = disturbed(true, cov)
    found = conditioned(seen, cov, known, truth_sigma=None)[1]
    less, more = (
        conditioned(seen, cov, known, truth_sigma=factor * sigma)[1] for factor in (0.8, 1.2)
    )
    for axis in range(6):
        sums = [posterior[:, axis, axis].sum() for posterior in (less, found, more)]
        assert sums[0] < sums[1] < sums[2]


def unsolved_in(stretches: int, every: int, solved_stretches: int) -> BoolArray:
    """Return which steps are solved: the last stretches have one step each that is not."""
    is_solved = np.ones(stretches * every, np.bool_)
    is_solved[solved_stretches * every :: every] = False
    return is_solved


@pytest.mark.parametrize(("stretches", "solved_stretches"), [(100, 40), (19, 8)])
def test_unsolved_steps_do_not_count_for_how_far_the_truth_is_off(
    stretches: int, solved_stretches: int
) -> None:
    """Truth off by 5 cm, and features by a mm, but for one step in most of the stretches: σ within
    a factor of two, whether the stretches are many or few. The made-up σ of 1 m would hide the
    scatter of the truth from the estimate, so that it seems exact if they are many, and bad if they
    are few."""
    every = 5
    is_solved = unsolved_in(stretches, every, solved_stretches)
    true = motions(stretches * every)
    cov = np.tile(1e-6 * np.eye(6), (len(true), 1, 1))
    seen = disturbed(true, cov)
    cov[~is_solved] = np.diag(UNSOLVED_SIGMA**2)
    sigma = np.full(6, 0.05)
    noise = sigma * np.random.default_rng(6).normal(size=(stretches, 6))
    ends = [se3.exp(noise[i]) @ over(true, i * every, (i + 1) * every) for i in range(stretches)]
    frames = np.arange(0, len(true) + 1, every)
    off = Supervision("sparse", frames, se3.chain_motions(np.array(ends)))

    found = conditioned(seen, cov, off, truth_sigma=None, is_solved=is_solved)[1]
    less, more = (
        conditioned(seen, cov, off, truth_sigma=factor * sigma)[1] for factor in (0.5, 2.0)
    )
    # The uncertainty that is left in the steps without a solve is that of the truth.
    sums = [
        np.trace(posterior[~is_solved], axis1=1, axis2=2).sum() for posterior in (less, found, more)
    ]
    assert sums[0] < sums[1] < sums[2]


def test_without_a_stretch_that_is_solved_the_truth_is_not_used() -> None:
    """Nothing says how far it is off, unless it is given."""
    true = motions(60)
    cov = covariances(60)
    is_solved = unsolved_in(12, 5, 0)
    cov[~is_solved] = np.diag(UNSOLVED_SIGMA**2)
    seen = disturbed(true, covariances(60))
    known = truth(true, 5, "sparse")
    fused, posterior = conditioned(seen, cov, known, truth_sigma=None, is_solved=is_solved)
    np.testing.assert_array_equal(fused, seen)
    np.testing.assert_array_equal(posterior, cov)
    given, _ = conditioned(seen, cov, known, truth_sigma=EXACT, is_solved=is_solved)
    assert (given != seen).any()


def test_exact_truth_is_found_to_be_so() -> None:
    """Estimated, it is better than the features, by which it is judged: the motions are nearer to
    the true ones."""
    true = motions(400)
    cov = covariances(400)
    seen = disturbed(true, cov)
    fused, _ = conditioned(seen, cov, truth(true), truth_sigma=None)
    before, after = (np.abs(se3.log(true @ se3.inverse(T))).mean() for T in (seen, fused))
    assert after < 0.4 * before


def test_where_the_sigma_of_truth_is_estimated_a_true_pose_that_is_far_off_is_gated_out() -> None:
    """Otherwise both steps that meet in it follow it by half a metre or more, as with given σ."""
    true = motions(60)
    cov = covariances(60)
    seen = disturbed(true, cov)
    off = truth(true)
    off.T_world_cam[30, :3, 3] += 2.0
    fused = (
        conditioned(seen, cov, off, truth_sigma=sigma)[0] for sigma in (None, np.full(6, 1e-3))
    )
    without, with_sigma = (np.linalg.norm((T - seen)[:, :3, 3], axis=1) for T in fused)
    np.testing.assert_array_equal(without[29:31], 0.0)
    assert (np.delete(without, [29, 30]) > 0.0).mean() > 0.9
    assert with_sigma[29:31].min() > 0.5


def test_a_loop_closes_however_far_it_is_off() -> None:
    true = circle()
    cov = np.tile(1e-6 * np.eye(6), (LOOP, 1, 1))
    seen = true.copy()
    seen[20] = se3.exp(np.array([9.0, 0.0, 0.0, 0.0, 0.0, 0.0])) @ seen[20]
    assert np.abs(conditioned(seen, cov, around(), truth_sigma=None)[0] - seen).max() > 0.0


def test_a_loop_whose_ends_are_measured_is_as_good_as_sparse_truth() -> None:
    """Only one that is assumed to close is taken to be parked by hand."""
    true = motions(60)
    cov = covariances(60)
    ends = se3.chain_motions(true)[[0, -1]]
    loop, sparse = (Supervision(kind, np.array([0, 60]), ends) for kind in ("loop", "sparse"))
    assert not loop.is_assumed
    assert around().is_assumed
    for one, other in zip(
        *(
            conditioned(disturbed(true, cov), cov, known, truth_sigma=None)
            for known in (loop, sparse)
        ),
        strict=True,
    ):
        np.testing.assert_array_equal(one, other)

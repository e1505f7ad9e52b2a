"""The stereo observations of a frame as one measurement of two poses."""

from dataclasses import replace

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo.estimation.reprojection import solve_reprojection
from probevo.geometry import se3
from probevo.measurements.robust_loss import LossName, RobustLoss
from probevo.measurements.stereo_numba import BEHIND
from probevo.measurements.stereo_observations import StereoObservations
from probevo.measurements.variables import PosePair, Values, pose_of, retract
from probevo.noise import StereoNoise, StudentT
from worlds import CAMERA, FORWARD, moved, random_pixels, seen_twice

COUNT = 25
PREV = pose_of(1)
CURR = pose_of(2)


def random_covariances(rng: np.random.Generator, sigma_px: float) -> FloatArray:
    factor = rng.normal(size=(COUNT, 4, 4))
    return sigma_px**2 * (factor @ factor.mT + 0.3 * np.eye(4))


def observations_and_poses(
    rng: np.random.Generator, loss: LossName = "noise", *, has_prev: bool = True
) -> tuple[StereoObservations, Values]:
    """Noisy features, linearised at poses in an arbitrary world, a little off the true motion."""
    tracks = seen_twice(rng, COUNT, sigma_px=0.3, depth_m=(5.0, 30.0))
    T_curr_prev = se3.exp(0.003 * rng.normal(size=6)) @ FORWARD
    T_prev_world = se3.exp(rng.normal(size=6)) if has_prev else np.eye(4)
    values = {PREV: T_prev_world, CURR: T_curr_prev @ T_prev_world}
    observations = StereoObservations.of(
        tracks.prev_px,
        tracks.curr_px,
        StudentT(5.0).predict(np.zeros((COUNT, 0))),
        camera=CAMERA,
        poses=PosePair(CURR, PREV if has_prev else None),
        loss=RobustLoss.named(loss),
    )
    return observations.propagated(values), values


def test_a_feature_without_a_variance_leaves_least_squares_its_information() -> None:
    """A learned model may give one a dof of 2, whose tails RANSAC has cut off."""
    rng = np.random.default_rng(0)
    tracks = seen_twice(rng, COUNT, sigma_px=0.2)
    covs = []
    for dof in (np.inf, 2.0):
        noise = StudentT(5.0).predict(np.zeros((COUNT, 0)))
        noise = replace(noise, dof=np.append(noise.dof[1:], dof))
        observations = StereoObservations.of(
            tracks.prev_px, tracks.curr_px, noise, camera=CAMERA, loss=RobustLoss.l2()
        )
        covs.append(solve_reprojection(observations, guess=FORWARD).cov)
    assert np.isfinite(covs[1]).all()
    np.testing.assert_allclose(covs[1], covs[0], rtol=0.1)


@pytest.mark.parametrize("has_prev", [False, True])
@pytest.mark.parametrize("loss", ["noise", "l2", "cauchy"])
def test_gradient_over_both_poses_is_minus_the_slope_of_the_cost(
    loss: LossName, has_prev: bool
) -> None:
    """At held Σ, by fourth-order differences over the six or twelve degrees of freedom."""
    rng = np.random.default_rng(0)
    step = 1e-5
    stencil = np.array([1.0, -8.0, 8.0, -1.0]) / (12.0 * step)
    for _ in range(10):
        observations, values = observations_and_poses(rng, loss, has_prev=has_prev)
        slopes = []
        for variable in observations.variables:
            for unit in step * np.eye(6):
                costs = []
                for factor in (-2.0, -1.0, 1.0, 2.0):
                    changed = retract(values[variable], factor * unit)
                    costs.append(observations.linearize({**values, variable: changed}).cost)
                slopes.append(stencil @ costs)
        found = observations.linearize(values)
        assert found.gradient.shape == (12 if has_prev else 6,)
        # In units of the features' pulls before they cancel.
        pulls = np.sqrt(np.diag(found.hessian) * 2.0 * found.cost)
        np.testing.assert_allclose((found.gradient + slopes) / pulls, 0.0, atol=1e-6)


@pytest.mark.parametrize("newton", [False, True])
def test_both_poses_share_one_motion(newton: bool) -> None:
    """Moving the world moves nothing: ξ_prev and Ad(T) ξ_prev for the current pose cancel."""
    observations, values = observations_and_poses(np.random.default_rng(1))
    found = observations.linearize(values, newton=newton)
    T_curr_prev = values[CURR] @ se3.inverse(values[PREV])
    along = np.vstack([np.eye(6), se3.adjoint(T_curr_prev)])
    scale = np.abs(found.hessian).max()
    np.testing.assert_allclose(found.hessian @ along / scale, 0.0, atol=1e-12)
    np.testing.assert_allclose(along.T @ found.gradient / np.sqrt(scale), 0.0, atol=1e-9)
    information = observations.information(values)
    np.testing.assert_allclose(information @ along / scale, 0.0, atol=1e-12)


def test_a_held_previous_pose_gives_the_equations_of_the_motion() -> None:
    """Those of the current pose, whether or not the previous pose is a variable."""
    rng = np.random.default_rng(2)
    of_both, values = observations_and_poses(rng)
    of_motion = of_both.at(values)
    np.testing.assert_allclose(of_both.information(values)[6:, 6:], of_motion.information)
    one_pose, curr_only = observations_and_poses(np.random.default_rng(3), has_prev=False)
    assert one_pose.variables == (CURR,)
    np.testing.assert_array_equal(
        one_pose.information(curr_only), one_pose.at(curr_only).information
    )


def warp(T: FloatArray, s: FloatArray) -> FloatArray:
    """(u, v, d) in the previous frame, [N, 3], to the observation in the current one, [N, 4]."""
    u, v, d = s.T
    return moved(np.column_stack([u, v, u - d, v]), T)


def test_noise_of_the_earlier_observation_enters_with_its_own_scale() -> None:
    """Σ = R' + A S Aᵀ with S = (Hᵀ R⁻¹ H)⁻¹ of the earlier scale R, at s = S Hᵀ R⁻¹ y."""
    rng = np.random.default_rng(4)
    prev_px = random_pixels(rng, COUNT, (5.0, 30.0))
    curr_px = moved(prev_px, FORWARD)
    prev_px = prev_px + 0.2 * rng.normal(size=(COUNT, 4))
    prev_scale = random_covariances(rng, 0.4)
    scale = random_covariances(rng, 0.2)
    observations = StereoObservations.of(
        prev_px,
        curr_px,
        StereoNoise(
            scale=scale,
            dof=np.full(COUNT, np.inf),
            bias=np.zeros((COUNT, 4)),
            refers_to="observation",
            prev_scale=prev_scale,
        ),
        camera=CAMERA,
        poses=PosePair(CURR),
    )
    H = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    weights = np.linalg.inv(prev_scale)
    S = np.linalg.inv(H.T @ weights @ H)
    s = (S @ H.T @ weights @ prev_px[..., None])[..., 0]
    step = 1e-4
    columns = [
        (warp(FORWARD, s + h) - warp(FORWARD, s - h)) / (2.0 * step) for h in step * np.eye(3)
    ]
    A = np.stack(columns, axis=2)
    sigma = scale + A @ S @ A.mT
    np.testing.assert_allclose(observations.points.point, s, rtol=1e-9)
    found = observations.propagated({CURR: FORWARD})
    unit = np.broadcast_to(np.eye(4), sigma.shape)
    np.testing.assert_allclose(found.propagated_noise.information @ sigma, unit, atol=1e-6)
    e = curr_px - warp(FORWARD, s)
    squared = np.einsum("ni,nij,nj->n", e, np.linalg.inv(sigma), e)
    np.testing.assert_allclose(found.outcome({CURR: FORWARD}).mahalanobis_sq, squared, rtol=0.05)


def test_an_equal_earlier_scale_is_the_same_as_none() -> None:
    rng = np.random.default_rng(5)
    tracks = seen_twice(rng, COUNT, sigma_px=0.3)
    scale = random_covariances(rng, 0.3)
    informations = []
    for prev_scale in (None, scale):
        noise = StereoNoise(
            scale=scale,
            dof=np.full(COUNT, 5.0),
            bias=np.zeros((COUNT, 4)),
            refers_to="observation",
            prev_scale=prev_scale,
        )
        observations = StereoObservations.of(
            tracks.prev_px, tracks.curr_px, noise, camera=CAMERA, poses=PosePair(CURR)
        )
        informations.append(observations.propagated({CURR: FORWARD}).information({CURR: FORWARD}))
    np.testing.assert_array_equal(informations[0], informations[1])


def test_propagation_yields_a_new_value() -> None:
    observations, values = observations_and_poses(np.random.default_rng(6), has_prev=False)
    before = [array.copy() for array in observations.propagated_noise]
    elsewhere = observations.propagated({CURR: se3.exp(0.1 * np.ones(6)) @ values[CURR]})
    for array, kept in zip(observations.propagated_noise, before, strict=True):
        np.testing.assert_array_equal(array, kept)
    assert elsewhere is not observations
    found = elsewhere.propagated_noise.information
    assert np.abs(found - observations.propagated_noise.information).max() > 1e-3


def test_a_feature_that_is_far_off_counts_as_it_did_in_the_solve() -> None:
    """By 40 px, with a σ of 0.1 px: by least squares, its weight is one like any other's."""
    tracks = seen_twice(np.random.default_rng(8), 5)
    curr_px = tracks.curr_px.copy()
    curr_px[0] += 40.0
    noise = StudentT(np.inf, 0.01 * np.eye(4)).predict(np.zeros((5, 0)))
    observations = StereoObservations.of(
        tracks.prev_px, curr_px, noise, camera=CAMERA, poses=PosePair(CURR)
    ).propagated({CURR: FORWARD})
    outcome = observations.outcome({CURR: FORWARD})
    assert outcome.mahalanobis_sq[0] > BEHIND
    assert not outcome.gated.any()
    np.testing.assert_array_equal(outcome.weight, np.ones(5))
    solved = observations.linearize({CURR: FORWARD})
    np.testing.assert_allclose(observations.at({CURR: FORWARD}).hessian, solved.hessian)


def test_outcome_says_which_points_are_behind_the_camera() -> None:
    """Half a metre ahead: the camera drives through it."""
    tracks = seen_twice(np.random.default_rng(7), 5)
    passed = CAMERA.project(np.array([[0.3, 0.2, 0.5]]))
    observations = StereoObservations.of(
        np.vstack([tracks.prev_px, passed]),
        np.vstack([tracks.curr_px, passed]),
        StudentT(5.0).predict(np.zeros((6, 0))),
        camera=CAMERA,
        poses=PosePair(CURR),
    )
    assert len(observations) == 6
    outcome = observations.propagated({CURR: FORWARD}).outcome({CURR: FORWARD})
    assert outcome.gated.tolist() == [False] * 5 + [True]
    np.testing.assert_allclose(outcome.weight, [1.0] * 5 + [0.0], atol=1e-12)
    np.testing.assert_allclose(outcome.mahalanobis_sq[:5], 0.0, atol=1e-9)
    assert outcome.mahalanobis_sq[5] == BEHIND

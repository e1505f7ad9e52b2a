"""The reprojection solve: whether the motion is right, and its covariance consistent."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest

from intervals import chi2_interval
from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.estimation.reprojection import (
    ReprojectionSolution,
    solve_reprojection,
)
from probevo.geometry import se3, so3
from probevo.geometry.uncertainty import normalized_error_squared
from probevo.measurements.point_priors import observation_to_point
from probevo.measurements.relative_rotation import RelativeRotation
from probevo.measurements.robust_loss import RobustLoss
from probevo.measurements.stereo_numba import (
    normal_equations,
    propagate_noise,
    residual_jacobians,
    sum_information,
    weigh,
)
from probevo.measurements.stereo_observations import StereoObservations
from probevo.measurements.variables import MOTION
from probevo.noise import Fixed, NoiseModel, StereoNoise, StudentT
from worlds import seen_twice

CAMERA = StereoCamera(fu_px=707.0, fv_px=709.0, cu_px=601.0, cv_px=183.0, baseline_m=0.537)
T_CURR_PREV = se3.exp(np.array([0.02, 0.01, -1.2, 0.003, 0.01, -0.002]))
GUESS = se3.exp(np.array([0.02, -0.03, 0.05, 0.004, -0.003, 0.005])) @ T_CURR_PREV
"""As far off as RANSAC leaves it."""
NO_PREDICTORS = np.zeros((10_000, 0))
CORRELATED = np.array(
    [[1.0, 0.1, 0.6, 0.0], [0.1, 1.0, 0.0, -0.3], [0.6, 0.0, 1.2, 0.1], [0.0, -0.3, 0.1, 0.9]]
)


@dataclass(frozen=True)
class Scene:
    prev_px: FloatArray
    curr_px: FloatArray


def scene(
    rng: np.random.Generator, count: int, *, depth_m: tuple[float, float] = (5.0, 60.0)
) -> Scene:
    """Points spread over the image, uniform in inverse depth, before and after T_CURR_PREV; without
    noise."""
    rho = rng.uniform(1.0 / depth_m[1], 1.0 / depth_m[0], count)
    u = rng.uniform(0.0, 1226.0, count)
    v = rng.uniform(0.0, 370.0, count)
    prev_px = np.column_stack([u, v, u - CAMERA.fu_px * CAMERA.baseline_m * rho, v])
    return Scene(prev_px, CAMERA.project(se3.transform(T_CURR_PREV, CAMERA.triangulate(prev_px))))


def with_noise(rng: np.random.Generator, clean: Scene, scale: FloatArray, dof: float) -> Scene:
    """Both observations of a feature disturbed by one Student-t of eight dimensions, whose mixing
    weight is common to both."""
    count = len(clean.prev_px)
    mixing = np.ones((count, 1)) if np.isinf(dof) else np.sqrt(dof / rng.chisquare(dof, (count, 1)))
    factor = np.linalg.cholesky(scale)
    prev_noise, curr_noise = (mixing * (rng.normal(size=(count, 4)) @ factor.T) for _ in range(2))
    return Scene(clean.prev_px + prev_noise, clean.curr_px + curr_noise)


def solve(seen: Scene, model: NoiseModel, **options: object) -> ReprojectionSolution:
    noise = model.predict(NO_PREDICTORS[: len(seen.prev_px)])
    return solve_reprojection(
        StereoObservations.of(seen.prev_px, seen.curr_px, noise, camera=CAMERA),
        guess=GUESS,
        **options,
    )


def error_of(T_curr_prev: FloatArray, T_true: FloatArray = T_CURR_PREV) -> FloatArray:
    """Log(T_curr_prev T_true⁻¹), [6]."""
    return se3.log(T_curr_prev @ se3.inverse(T_true))


def test_noiseless_motion_is_found_exactly() -> None:
    solution = solve(scene(np.random.default_rng(0), 50), StudentT())
    assert solution.converged
    assert np.abs(error_of(solution.T_curr_prev)).max() < 1e-6


@pytest.mark.parametrize("off_m", [0.02, 0.2, 0.5, 1.2])
def test_converged_solves_are_at_the_optimum(off_m: float) -> None:
    """From any guess: within 0.05σ of where the solve that starts at the truth ends."""
    rng = np.random.default_rng(11)
    for _ in range(20):
        seen = with_noise(rng, scene(rng, 200), 0.04 * np.eye(4), np.inf)
        noise = StudentT().predict(NO_PREDICTORS[:200])
        off = rng.normal(size=3)
        guess = se3.exp(np.r_[off_m * off / np.linalg.norm(off), 0.01 * off_m * off]) @ T_CURR_PREV
        near = solve_reprojection(
            StereoObservations.of(seen.prev_px, seen.curr_px, noise, camera=CAMERA),
            guess=T_CURR_PREV,
        )
        far = solve_reprojection(
            StereoObservations.of(seen.prev_px, seen.curr_px, noise, camera=CAMERA), guess=guess
        )
        if far.converged:
            squared = normalized_error_squared(near.T_curr_prev, far.T_curr_prev, near.cov)
            assert np.sqrt(squared) < 0.05


def test_motion_is_found_from_afar() -> None:
    """From the identity, 1.2 m off."""
    clean = scene(np.random.default_rng(0), 50)
    solution = solve_reprojection(
        StereoObservations.of(
            clean.prev_px, clean.curr_px, StudentT().predict(NO_PREDICTORS[:50]), camera=CAMERA
        ),
        guess=np.eye(4),
    )
    assert solution.converged
    assert np.abs(error_of(solution.T_curr_prev)).max() < 1e-4


@pytest.mark.parametrize("dof", [3.0, 5.0, np.inf])
@pytest.mark.parametrize("count", [60, 300])
def test_motion_covariance_is_consistent(dof: float, count: int) -> None:
    """Average NEES over 400 noisy solves lies in the 99.9 % interval of χ²(6)/400, for correlated
    noise with a known scale matrix."""
    rng = np.random.default_rng(count)
    scale = 0.3**2 * CORRELATED
    model = Fixed(scale) if np.isinf(dof) else StudentT(dof, scale)
    solutions = [solve(with_noise(rng, scene(rng, count), scale, dof), model) for _ in range(400)]
    nees = [normalized_error_squared(T_CURR_PREV, s.T_curr_prev, s.cov) for s in solutions]
    low, high = chi2_interval(6, len(nees))
    assert low < np.mean(nees) < high


def test_plain_irls_hessian_is_overconfident() -> None:
    """Its inverse lacks the factor (ν+d)/(ν+d+2): average NEES falls outside what 200 consistent
    runs could give."""
    rng = np.random.default_rng(1)
    scale = 0.3**2 * CORRELATED
    nees = []
    for _ in range(200):
        solution = solve(with_noise(rng, scene(rng, 300), scale, 5.0), StudentT(5.0, scale))
        cov = np.linalg.inv(solution.hessian)
        nees.append(normalized_error_squared(T_CURR_PREV, solution.T_curr_prev, cov))
    assert np.mean(nees) > chi2_interval(6, len(nees), confidence=0.9998)[1]
    assert np.mean(nees) > 6.5


def test_covariance_follows_the_residuals_where_the_noise_is_larger_than_the_model_says() -> None:
    """Gaussian noise of 0.6 px under a Student-t model of 0.2 px: still consistent within 30 %."""
    rng = np.random.default_rng(2)
    nees = []
    for _ in range(100):
        solution = solve(
            with_noise(rng, scene(rng, 200), 0.6**2 * np.eye(4), np.inf),
            StudentT(5.0, 0.04 * np.eye(4)),
        )
        nees.append(normalized_error_squared(T_CURR_PREV, solution.T_curr_prev, solution.cov))
    # The noise is estimated from the residuals of a wrong model: overconfident by up to 30 %.
    low, _ = chi2_interval(6, len(nees))
    assert low < np.mean(nees) < 1.3 * 6.0


def test_small_noisy_disparities_do_not_shorten_the_motion() -> None:
    """Disparities of 3 to 6 px with 0.5 px of noise: without refining the points, the step is 1.5 %
    short."""
    rng = np.random.default_rng(3)
    scale = 0.5**2 * np.eye(4)
    far = (60.0, 120.0)
    steps = [
        solve(with_noise(rng, scene(rng, 400, depth_m=far), scale, np.inf), Fixed(scale))
        for _ in range(60)
    ]
    lengths = np.array([-s.T_curr_prev[2, 3] for s in steps])
    expected = -T_CURR_PREV[2, 3]
    standard_error = lengths.std() / np.sqrt(len(lengths)) / expected
    assert abs(lengths.mean() / expected - 1.0) < 3.0 * standard_error + 0.002


def test_points_at_infinity_fix_the_rotation_but_not_the_translation() -> None:
    rng = np.random.default_rng(4)
    u = rng.uniform(0.0, 1226.0, 40)
    v = rng.uniform(0.0, 370.0, 40)
    C = so3.exp(np.array([0.01, -0.02, 0.005]))
    x, y = CAMERA.normalized(u, v)
    rays = np.column_stack([x, y, np.ones(40)]) @ C.T
    u_curr = CAMERA.fu_px * rays[:, 0] / rays[:, 2] + CAMERA.cu_px
    v_curr = CAMERA.fv_px * rays[:, 1] / rays[:, 2] + CAMERA.cv_px
    far = Scene(np.column_stack([u, v, u, v]), np.column_stack([u_curr, v_curr, u_curr, v_curr]))
    solution = solve(far, Fixed())
    assert np.abs(so3.log(solution.T_curr_prev[:3, :3] @ C.T)).max() < 1e-5
    assert not np.isfinite(solution.cov).any()
    mixed = scene(rng, 10)
    back = se3.from_parts(C, T_CURR_PREV[:3, 3])
    near_curr = CAMERA.project(se3.transform(back, CAMERA.triangulate(mixed.prev_px)))
    both = Scene(np.vstack([far.prev_px, mixed.prev_px]), np.vstack([far.curr_px, near_curr]))
    assert np.abs(error_of(solve(both, Fixed()).T_curr_prev, back)).max() < 1e-5


def test_residual_noise_is_taken_as_it_is() -> None:
    """A model of the residual as a whole, with a bias, which is removed; the point's noise is not
    added."""
    rng = np.random.default_rng(5)
    clean = scene(rng, 200)
    bias = np.array([0.4, -0.3, 0.8, 0.2])
    noise = StereoNoise(
        scale=np.tile(0.04 * np.eye(4), (200, 1, 1)),
        dof=np.full(200, 5.0),
        bias=np.tile(bias, (200, 1)),
    )
    solution = solve_reprojection(
        StereoObservations.of(clean.prev_px, clean.curr_px + bias, noise, camera=CAMERA),
        guess=GUESS,
    )
    assert np.abs(error_of(solution.T_curr_prev)).max() < 1e-6
    assert np.allclose(solution.features.information, 25.0 * np.eye(4))


@pytest.mark.parametrize("name", ["l2", "huber", "cauchy", "tukey"])
def test_every_loss_is_consistent_under_gaussian_noise(name: str) -> None:
    rng = np.random.default_rng(6)
    scale = 0.3**2 * np.eye(4)
    loss = RobustLoss.named(name)
    noise = Fixed(scale).predict(NO_PREDICTORS[:150])
    nees = []
    for _ in range(150):
        seen = with_noise(rng, scene(rng, 150), scale, np.inf)
        solution = solve_reprojection(
            StereoObservations.of(seen.prev_px, seen.curr_px, noise, camera=CAMERA, loss=loss),
            guess=T_CURR_PREV,
        )
        nees.append(normalized_error_squared(T_CURR_PREV, solution.T_curr_prev, solution.cov))
    low, high = chi2_interval(6, len(nees))
    assert low < np.mean(nees) < high


def test_outliers_hardly_move_a_robust_solve() -> None:
    rng = np.random.default_rng(7)
    seen = with_noise(rng, scene(rng, 200), 0.04 * np.eye(4), np.inf)
    seen.curr_px[:40] += rng.uniform(-30.0, 30.0, (40, 4))
    solution = solve(seen, StudentT())
    assert np.abs(error_of(solution.T_curr_prev)[:3]).max() < 0.02
    assert solution.features.weight[:40].mean() < 0.1


def test_measured_rotation_pulls_by_its_information() -> None:
    """Features and a measured rotation that disagree meet where their information balances."""
    rng = np.random.default_rng(8)
    scale = 0.09 * np.eye(4)
    seen = with_noise(rng, scene(rng, 100), scale, np.inf)
    features_only = solve(seen, Fixed(scale))
    off = np.array([0.002, -0.001, 0.0015])
    C_measured = so3.exp(off) @ features_only.T_curr_prev[:3, :3]
    gyro = RelativeRotation(C_measured, 1e-7 * np.eye(3), curr=MOTION)
    both = solve(seen, Fixed(scale), others=[gyro])
    padded = np.zeros((6, 6))
    padded[3:, 3:] = 1e7 * np.eye(3)
    pull = padded @ np.r_[0.0, 0.0, 0.0, off]
    expected = np.linalg.solve(features_only.hessian + padded, pull)
    moved = error_of(both.T_curr_prev, features_only.T_curr_prev)
    assert np.allclose(moved, expected, rtol=0.02, atol=1e-5)
    assert np.all(np.diagonal(both.cov)[3:] < np.diagonal(features_only.cov)[3:])


@pytest.mark.parametrize("count", [0, 1])
def test_too_few_features_give_no_covariance(count: int) -> None:
    solution = solve(scene(np.random.default_rng(9), count), StudentT())
    assert np.isfinite(solution.T_curr_prev).all()
    assert not np.isfinite(solution.cov).any()


def test_points_that_pass_behind_the_camera_do_not_contribute() -> None:
    clean = scene(np.random.default_rng(10), 50)
    near = CAMERA.project(
        np.array([[0.3, 0.2, 0.5]])
    )  # half a metre ahead: the camera drives through it
    seen = Scene(np.vstack([clean.prev_px, near]), np.vstack([clean.curr_px, near]))
    solution = solve(seen, Fixed())
    assert solution.features.weight[-1] == 0.0
    assert np.abs(error_of(solution.T_curr_prev)).max() < 1e-6


def with_time_correlated_error(
    rng: np.random.Generator, clean: Scene, sigma_px: float, correlated_px: float
) -> Scene:
    """New noise in every observation, and an error of the disparity that is the same in both
    frames."""
    seen = with_noise(rng, clean, sigma_px**2 * np.eye(4), np.inf)
    error = np.zeros((len(clean.prev_px), 4))
    error[:, 2] = -rng.normal(scale=correlated_px, size=len(error))
    return Scene(seen.prev_px + error, seen.curr_px + error)


@pytest.mark.parametrize(("depth_m", "correlated_px"), [((5.0, 60.0), 0.5), ((20.0, 80.0), 0.7)])
def test_time_correlated_error_makes_a_motion_overconfident_unless_modelled(
    depth_m: tuple[float, float], correlated_px: float
) -> None:
    """Disparities known to 0.1 px from frame to frame, but those of each feature off by one and the
    same 0.5 px."""
    rng = np.random.default_rng(9)
    scale = 0.1**2 * np.eye(4)
    seen = [
        with_time_correlated_error(rng, scene(rng, 200, depth_m=depth_m), 0.1, correlated_px)
        for _ in range(300)
    ]
    nees = {}
    for modelled_px in (correlated_px, 0.0):
        ratio = modelled_px / (0.1 * math.sqrt(2.0))
        model = StudentT(1e6, scale, time_correlation_ratio=ratio)
        solutions = [solve(each, model) for each in seen]
        nees[modelled_px] = np.mean(
            [normalized_error_squared(T_CURR_PREV, s.T_curr_prev, s.cov) for s in solutions]
        )
        lengths = np.array([-s.T_curr_prev[2, 3] for s in solutions])
        assert abs(np.mean(lengths) / -T_CURR_PREV[2, 3] - 1.0) < 0.002
    low, high = chi2_interval(6, len(seen))
    assert low < nees[correlated_px] < high
    assert nees[0.0] > 8.0


COMPILED_LOOPS = (
    normal_equations,
    observation_to_point,
    propagate_noise,
    residual_jacobians,
    sum_information,
    weigh,
)


def test_every_noise_model_uses_the_same_compiled_loops() -> None:
    """One scale for all or one each, read-only or not: Numba compiles for each kind of array anew,
    which takes 10 s."""
    tracks = seen_twice(np.random.default_rng(0), 20)
    scale = 0.04 * np.eye(4)
    each = np.tile(scale, (20, 1, 1))
    locked = each.copy()
    locked.setflags(write=False)
    compiled = set()
    for given in (np.broadcast_to(scale, (20, 4, 4)), each, locked):
        for prev_scale in (None, given):
            for dof in (np.full(20, 5.0), np.broadcast_to(5.0, (20,))):
                noise = StereoNoise(
                    scale=given,
                    dof=dof,
                    bias=np.zeros((20, 4)),
                    refers_to="observation",
                    prev_scale=prev_scale,
                )
                solve_reprojection(
                    StereoObservations.of(tracks.prev_px, tracks.curr_px, noise, camera=CAMERA),
                    guess=np.eye(4),
                )
                compiled.add(tuple(len(loop.signatures) for loop in COMPILED_LOOPS))
    assert len(compiled) == 1


def test_a_singular_scale_is_that_of_an_unknown_point_in_any_order() -> None:
    known = 0.04 * np.eye(4)
    scales = np.array([known, np.zeros((4, 4)), 100.0 * known])
    observed = np.ascontiguousarray(np.tile([300.0, 200.0, 280.0, 200.0], (3, 1)))
    for order in ([0, 1, 2], [2, 1, 0], [1, 0, 2]):
        point_cov = np.zeros((3, 4, 4))
        observation_to_point(
            observed, scales[order], True, point=np.empty((3, 3)), point_cov=point_cov
        )
        variance = point_cov[:, 0, 0]
        np.testing.assert_allclose(variance[order.index(0)], 0.04, rtol=0.01)
        np.testing.assert_allclose(variance[order.index(2)], 4.0, rtol=0.01)
        assert variance[order.index(1)] == 1e6

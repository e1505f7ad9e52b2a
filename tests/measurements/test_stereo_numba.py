"""The compiled loops over stereo observations against their definitions, by central differences."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.camera.transfer_numba import Intrinsics
from probevo.geometry import se3
from probevo.measurements.robust_loss_numba import LossKind
from probevo.measurements.stereo_numba import (
    BEHIND,
    LossParameters,
    NormalEquations,
    PointPairs,
    PropagatedNoise,
    StereoJacobians,
    normal_equations,
    propagate_noise,
    residual_jacobians,
)

CAMERA = StereoCamera(fu_px=718.9, fv_px=720.1, cu_px=607.2, cv_px=185.2, baseline_m=0.54)
INTRINSICS = Intrinsics.of(CAMERA)
NUM_POINTS = 6
S_FROM_Y = np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [1, 0, -1, 0]])
"""s = (u, v, d) of an observation whose rows agree."""
PARAMETER = {
    LossKind.L2: np.nan,
    LossKind.HUBER: 1.3,
    LossKind.CAUCHY: 2.0,
    LossKind.TUKEY: 6.0,
    LossKind.STUDENT_T: 5.0,
}


@dataclass(frozen=True)
class Scene:
    """A motion and points in view before and after it, however far it turns."""

    T: FloatArray
    seen: FloatArray
    """(u, v, d) in the previous frame, [N, 3], px."""
    points: FloatArray
    """The same in the previous frame, [N, 3], m."""


def random_scene(rng: np.random.Generator) -> Scene:
    """Points of one cluster, turned by up to π about any axis and then put into view again."""
    depths = rng.uniform(4.0, 40.0, 2)
    before, after = (z * np.append(rng.uniform(-0.4, 0.4, 2), 1.0) for z in depths)
    axis = rng.normal(size=3)
    turn = se3.exp(
        np.concatenate([np.zeros(3), rng.uniform(0.0, np.pi) * axis / np.linalg.norm(axis)])
    )
    T = se3.from_parts(turn[:3, :3], after - turn[:3, :3] @ before)
    points = before + rng.uniform(-1.0, 1.0, (NUM_POINTS, 3))
    return Scene(T, CAMERA.project(points) @ S_FROM_Y.T, points)


@pytest.fixture(scope="module")
def scenes() -> list[Scene]:
    """1,000 of them."""
    rng = np.random.default_rng(0)
    return [random_scene(rng) for _ in range(1000)]


def warp(T: FloatArray, s: FloatArray) -> FloatArray:
    """h(s): (u, v, d) in the previous frame, [..., 3], to the observation in the current one, [...,
    4], px."""
    u, v, d = np.moveaxis(s, -1, 0)
    return CAMERA.project(se3.transform(T, CAMERA.triangulate(np.stack([u, v, u - d, v], axis=-1))))


def random_covariances(rng: np.random.Generator, count: int, dim: int, sigma: float) -> FloatArray:
    factor = rng.normal(size=(count, dim, dim))
    return sigma**2 * (factor @ factor.mT + 0.3 * np.eye(dim))


def linearized_at(
    refined: FloatArray, offset: FloatArray, information: FloatArray
) -> PropagatedNoise:
    """Noise as the normal equations take it; they do not look at the cross-covariance."""
    return PropagatedNoise(
        refined=refined,
        offset=offset,
        information=information,
        cross_cov=np.full((len(refined), 4, 2), np.nan),
    )


def system(
    T: FloatArray,
    curr: FloatArray,
    propagated: PropagatedNoise,
    kind: LossKind = LossKind.L2,
    *,
    newton: bool = False,
) -> tuple[float, NormalEquations]:
    """Cost and normal equations of one pass."""
    count = len(curr)
    equations = NormalEquations(
        hessian=np.empty((6, 6)), gradient=np.empty(6), squared=np.empty(count)
    )
    cost = normal_equations(
        np.ascontiguousarray(T),
        INTRINSICS,
        curr,
        propagated=propagated,
        loss=LossParameters(int(kind), np.full(count, PARAMETER[kind])),
        newton=newton,
        system=equations,
    )
    return cost, equations


def propagate(
    T: FloatArray,
    point: FloatArray,
    point_cov: FloatArray,
    *,
    curr: FloatArray,
    scale: FloatArray,
    refined: FloatArray | None = None,
    time_correlated: FloatArray | None = None,
) -> PropagatedNoise:
    """The noise of one pass, linearised at ``refined``, by default at the points themselves."""
    count = len(point)
    joint = np.zeros((count, 4, 4))
    joint[:, :3, :3] = point_cov
    if time_correlated is not None:
        joint[:, 2:, 2:] += time_correlated[:, None, None] * np.array([[1.0, -1.0], [-1.0, 1.0]])
    propagated = PropagatedNoise(
        refined=point.copy() if refined is None else refined.copy(),
        offset=np.full((count, 4), np.nan),
        information=np.full((count, 4, 4), np.nan),
        cross_cov=np.full((count, 4, 2), np.nan),
    )
    pairs = PointPairs(point=point, point_cov=joint, curr=curr, curr_scale=scale)
    propagate_noise(np.ascontiguousarray(T), INTRINSICS, pairs, propagated)
    return propagated


def relative_error(actual: FloatArray, expected: FloatArray) -> float:
    return float(np.linalg.norm(actual - expected) / np.linalg.norm(expected))


def derivative_of_warp(T: FloatArray, s: FloatArray, step: float = 1e-4) -> FloatArray:
    """A = ∂h/∂s by central differences, [N, 4, 3]."""
    columns = [(warp(T, s + h) - warp(T, s - h)) / (2 * step) for h in step * np.eye(3)]
    return np.stack(columns, axis=2)


def test_jacobian_against_central_differences(scenes: list[Scene]) -> None:
    """1,000 motions: with a unit residual and unit information the gradient is a row of J = ∂h/∂ξ,
    T ← Exp(ξ) T."""
    step = 1e-5
    worst = 0.0
    forward = se3.exp(step * np.eye(6))
    back = se3.exp(-step * np.eye(6))
    for scene in scenes:
        s = scene.seen[:1]
        propagated = linearized_at(s, np.zeros((1, 4)), np.eye(4)[None])
        rows = [
            system(scene.T, warp(scene.T, s) + unit, propagated)[1].gradient for unit in np.eye(4)
        ]
        J = (warp(forward @ scene.T, s) - warp(back @ scene.T, s)).T / (2 * step)
        worst = max(worst, relative_error(np.array(rows), J))
    assert worst < 1e-6


def test_residuals_and_jacobians_of_all_features(scenes: list[Scene]) -> None:
    """e, J = ∂h/∂ξ and ∂h/∂d by central differences, and Σ⁻¹ J, for 100 motions."""
    rng = np.random.default_rng(9)
    step = 1e-5
    forward = se3.exp(step * np.eye(6))
    back = se3.exp(-step * np.eye(6))
    for scene in scenes[:100]:
        offset = rng.normal(size=(NUM_POINTS, 4))
        curr = warp(scene.T, scene.seen) + rng.normal(size=(NUM_POINTS, 4))
        information = np.linalg.inv(random_covariances(rng, NUM_POINTS, 4, 1.0))
        found = StereoJacobians(
            residual=np.empty((NUM_POINTS, 4)),
            motion=np.empty((NUM_POINTS, 4, 6)),
            white=np.empty((NUM_POINTS, 4, 6)),
            disparity=np.empty((NUM_POINTS, 4)),
            squared=np.empty(len(scene.seen)),
            contributes=np.empty(len(scene.seen), dtype=np.bool_),
        )
        residual_jacobians(
            np.ascontiguousarray(scene.T),
            INTRINSICS,
            curr,
            propagated=linearized_at(scene.seen, offset, information),
            out=found,
        )
        e = curr - warp(scene.T, scene.seen) - offset
        plus, minus = (warp((shift @ scene.T)[:, None], scene.seen) for shift in (forward, back))
        J = np.moveaxis(plus - minus, 0, 2) / (2 * step)
        np.testing.assert_allclose(found.residual, e, atol=1e-9)
        assert relative_error(found.motion, J) < 1e-6
        assert relative_error(found.white, information @ J) < 1e-6
        of_disparity = derivative_of_warp(scene.T, scene.seen)[..., 2]
        assert relative_error(found.disparity, of_disparity) < 1e-6


@pytest.mark.parametrize("kind", list(LossKind))
def test_gradient_is_that_of_the_cost(kind: LossKind, scenes: list[Scene]) -> None:
    """1,000 motions, with offsets and full information matrices: ∂cost/∂ξ = −gradient, by
    fourth-order differences.

    Each component is measured in units of the features' pulls before they cancel, √(H_ii Σ s).
    """
    rng = np.random.default_rng(1)
    step = 2e-5
    worst = 0.0
    stencil = np.array([1.0, -8.0, 8.0, -1.0]) / (12.0 * step)
    shifts = se3.exp(
        step * np.array([-2.0, -1.0, 1.0, 2.0])[:, None] * np.eye(6)[:, None]
    )  # [6, 4, 4, 4]
    for scene in scenes:
        offset = rng.normal(size=(NUM_POINTS, 4))
        curr = warp(scene.T, scene.seen) + offset + rng.normal(scale=2.0, size=(NUM_POINTS, 4))
        information = np.linalg.inv(random_covariances(rng, NUM_POINTS, 4, 1.0))
        propagated = linearized_at(scene.seen, offset, information)
        _, equations = system(scene.T, curr, propagated, kind)
        if is_at_a_kink(kind, equations.squared):
            continue
        costs = np.array(
            [
                [system(shift @ scene.T, curr, propagated, kind)[0] for shift in axis]
                for axis in shifts
            ]
        )
        pulls = np.sqrt(np.diag(equations.hessian) * equations.squared.sum())
        off = (costs @ stencil + equations.gradient) / pulls
        worst = max(worst, float(np.linalg.norm(off)))
    assert worst < 1e-6


def is_at_a_kink(kind: LossKind, squared: FloatArray) -> bool:
    """Whether a residual is so close to where the loss changes its form that the differences
    straddle it."""
    return kind in (LossKind.HUBER, LossKind.TUKEY) and bool(
        (np.abs(np.sqrt(squared) / PARAMETER[kind] - 1.0) < 0.05).any()
    )


def test_hessian_is_that_of_gauss_newton(scenes: list[Scene]) -> None:
    """Σ w Jᵀ Σ⁻¹ J, with J by central differences and w from the squared lengths."""
    rng = np.random.default_rng(2)
    step = 1e-5
    forward = se3.exp(step * np.eye(6))
    back = se3.exp(-step * np.eye(6))
    for scene in scenes[:100]:
        curr = warp(scene.T, scene.seen) + rng.normal(size=(NUM_POINTS, 4))
        information = np.linalg.inv(random_covariances(rng, NUM_POINTS, 4, 1.0))
        propagated = linearized_at(scene.seen, np.zeros((NUM_POINTS, 4)), information)
        cost, equations = system(scene.T, curr, propagated, LossKind.STUDENT_T)
        squared = equations.squared
        plus, minus = (warp((shift @ scene.T)[:, None], scene.seen) for shift in (forward, back))
        J = np.moveaxis(plus - minus, 0, 2) / (2 * step)
        e = curr - warp(scene.T, scene.seen)
        np.testing.assert_allclose(squared, np.einsum("ni,nij,nj->n", e, information, e), rtol=1e-8)
        assert cost == pytest.approx(4.5 * np.log1p(squared / 5.0).sum(), rel=1e-10)
        expected = np.einsum("n,nia,nij,njb->ab", 9.0 / (5.0 + squared), J, information, J)
        assert relative_error(equations.hessian, expected) < 1e-6
        np.testing.assert_array_equal(equations.hessian, equations.hessian.T)


def test_newton_s_hessian_has_the_curvature_of_the_loss(scenes: list[Scene]) -> None:
    """Σ w Jᵀ Σ⁻¹ J + 2 w' (Jᵀ Σ⁻¹ e)(Jᵀ Σ⁻¹ e)ᵀ, with w' = −(ν + 4)/(ν + s)² of the Student-t."""
    rng = np.random.default_rng(10)
    step = 1e-5
    forward = se3.exp(step * np.eye(6))
    back = se3.exp(-step * np.eye(6))
    for scene in scenes[:100]:
        curr = warp(scene.T, scene.seen) + rng.normal(size=(NUM_POINTS, 4))
        information = np.linalg.inv(random_covariances(rng, NUM_POINTS, 4, 1.0))
        propagated = linearized_at(scene.seen, np.zeros((NUM_POINTS, 4)), information)
        irls_cost, irls = system(scene.T, curr, propagated, LossKind.STUDENT_T)
        cost, newton = system(scene.T, curr, propagated, LossKind.STUDENT_T, newton=True)
        plus, minus = (warp((shift @ scene.T)[:, None], scene.seen) for shift in (forward, back))
        J = np.moveaxis(plus - minus, 0, 2) / (2 * step)
        e = curr - warp(scene.T, scene.seen)
        pull = np.einsum("nia,nij,nj->na", J, information, e)
        expected = np.einsum("n,na,nb->ab", -2.0 * 9.0 / (5.0 + irls.squared) ** 2, pull, pull)
        assert relative_error(newton.hessian - irls.hessian, expected) < 1e-6
        assert cost == irls_cost
        np.testing.assert_array_equal(newton.gradient, irls.gradient)


def test_points_at_infinity_constrain_the_rotation_only() -> None:
    """d = 0: they see no translation, however large, and their rotation is that of rays."""
    rng = np.random.default_rng(3)
    T = se3.exp(np.array([5.0, -3.0, 8.0, 0.1, -0.2, 0.3]))
    seen = np.column_stack([rng.uniform(300, 900, 5), rng.uniform(100, 300, 5), np.zeros(5)])
    rays = np.column_stack([(seen[:, 0] - 607.2) / 718.9, (seen[:, 1] - 185.2) / 720.1, np.ones(5)])

    def project_rays(T: FloatArray) -> FloatArray:
        far = CAMERA.project(rays @ T[:3, :3].T)
        return np.stack([far[:, 0], far[:, 1], far[:, 0], far[:, 1]], axis=1)

    curr = project_rays(T) + rng.normal(size=(5, 4))
    information = np.tile(np.eye(4), (5, 1, 1))
    _, equations = system(T, curr, linearized_at(seen, np.zeros((5, 4)), information))
    squared = np.sum((curr - project_rays(T)) ** 2, axis=1)
    np.testing.assert_allclose(equations.squared, squared, rtol=1e-9)
    np.testing.assert_array_equal(equations.gradient[:3], 0.0)
    np.testing.assert_array_equal(equations.hessian[:3], 0.0)
    steps = 1e-5 * np.eye(6)[3:]
    changes = [project_rays(se3.exp(s) @ T) - project_rays(se3.exp(-s) @ T) for s in steps]
    J = np.stack(changes, axis=2) / 2e-5
    assert relative_error(equations.hessian[3:, 3:], np.einsum("nia,nib->ab", J, J)) < 1e-6


def test_points_behind_the_camera_are_ignored() -> None:
    """They get no information, add nothing to the system, and are called far off."""
    rng = np.random.default_rng(4)
    passed = np.array([607.2, 185.2, 40.0])  # 9.7 m ahead
    seen = np.vstack(
        [
            np.column_stack([rng.uniform(300, 900, 5), rng.uniform(100, 300, 5), np.full(5, 10.0)]),
            passed,
        ]
    )
    T = se3.from_parts(np.eye(3), np.array([0.0, 0.0, -20.0]))  # 20 m driven
    curr = warp(T, seen) + rng.normal(size=(6, 4))
    unit = np.tile(np.eye(4), (6, 1, 1))
    propagated = propagate(T, seen, np.tile(np.eye(3), (6, 1, 1)), curr=curr, scale=unit)
    np.testing.assert_array_equal(propagated.information[5], 0.0)
    np.testing.assert_array_equal(propagated.refined[5], passed)

    all_six = linearized_at(propagated.refined, propagated.offset, unit)
    in_front = linearized_at(propagated.refined[:5], propagated.offset[:5], unit[:5])
    _, equations = system(T, curr, all_six)
    _, expected = system(T, curr[:5], in_front)
    np.testing.assert_array_equal(equations.gradient, expected.gradient)
    np.testing.assert_array_equal(equations.hessian, expected.hessian)
    assert equations.squared[5] == BEHIND


def test_noise_of_points_is_propagated_by_the_derivative_of_the_warp(scenes: list[Scene]) -> None:
    """Σ = R' + A S Aᵀ and ŝ = s + S Aᵀ Σ⁻¹ e with A by central differences, for 1,000 motions."""
    rng = np.random.default_rng(5)
    worst = 0.0
    for scene in scenes:
        point_cov = random_covariances(rng, NUM_POINTS, 3, 0.5)
        scale = random_covariances(rng, NUM_POINTS, 4, 0.7)
        curr = warp(scene.T, scene.seen) + rng.normal(size=(NUM_POINTS, 4))
        propagated = propagate(scene.T, scene.seen, point_cov, curr=curr, scale=scale)
        A = derivative_of_warp(scene.T, scene.seen)
        expected = np.linalg.inv(scale + A @ point_cov @ A.mT)
        move = point_cov @ A.mT @ expected @ (curr - warp(scene.T, scene.seen))[..., None]
        offset = (A @ (scene.seen - propagated.refined)[..., None])[..., 0]
        worst = max(
            worst,
            relative_error(propagated.information, expected),
            relative_error(propagated.refined - scene.seen, move[..., 0]),
            relative_error(propagated.offset, offset),
        )
    assert worst < 1e-6


def test_time_correlated_error_enters_by_the_joint_gaussian_of_both_frames(
    scenes: list[Scene],
) -> None:
    """Errors (p, n', δ) of point, observation and disparity: e = n' − δ (0, 0, 1, 0) − A (p + (0,
    0, δ)), by means."""
    rng = np.random.default_rng(8)
    S = random_covariances(rng, NUM_POINTS, 3, 0.2)
    R = random_covariances(rng, NUM_POINTS, 4, 0.2)
    time_correlated = rng.uniform(0.0, 1.0, NUM_POINTS)
    for scene in scenes[:50]:
        curr = warp(scene.T, scene.seen) + rng.normal(scale=0.3, size=(NUM_POINTS, 4))
        propagated = propagate(
            scene.T, scene.seen, S, curr=curr, scale=R, time_correlated=time_correlated
        )
        A = derivative_of_warp(scene.T, scene.seen)
        unit = np.broadcast_to(np.eye(4), (NUM_POINTS, 4, 4))
        of_delta = -A[..., 2:] - np.array([[0], [0], [1], [0]])
        to_error = np.concatenate([-A, unit, of_delta], axis=2)
        joint = np.zeros((NUM_POINTS, 8, 8))
        joint[:, :3, :3] = S
        joint[:, 3:7, 3:7] = R
        joint[:, 7, 7] = time_correlated
        sigma = to_error @ joint @ to_error.mT
        e = curr - warp(scene.T, scene.seen)
        mean = (joint @ to_error.mT @ np.linalg.solve(sigma, e[..., None]))[..., 0]
        mean[:, 2] += mean[:, 7]  # both errors of the measured disparity
        np.testing.assert_allclose(propagated.information @ sigma, unit, atol=1e-5)
        np.testing.assert_allclose(propagated.refined, scene.seen - mean[:, :3], atol=1e-5)
        # The true disparity is the measured one less both of its errors.
        state = np.zeros((2, 8))
        state[0, 2] = state[0, 7] = -1.0
        state[1, 7] = 1.0
        np.testing.assert_allclose(propagated.cross_cov, to_error @ joint @ state.T, atol=1e-5)


def test_points_without_noise_stay_where_they_are_seen() -> None:
    rng = np.random.default_rng(6)
    scene = random_scene(rng)
    scale = random_covariances(rng, NUM_POINTS, 4, 0.7)
    curr = warp(scene.T, scene.seen) + rng.normal(size=(NUM_POINTS, 4))
    exact = np.zeros((NUM_POINTS, 3, 3))
    propagated = propagate(scene.T, scene.seen, exact, curr=curr, scale=scale)
    np.testing.assert_array_equal(propagated.refined, scene.seen)
    np.testing.assert_array_equal(propagated.offset, 0.0)
    expected = np.linalg.inv(scale)
    np.testing.assert_allclose(propagated.information, expected, rtol=1e-9, atol=1e-12)


def test_repeated_refinement_ends_at_the_most_likely_point() -> None:
    """It minimises (y' − h(ŝ))ᵀ R'⁻¹ (y' − h(ŝ)) + (s − ŝ)ᵀ S⁻¹ (s − ŝ): the gradient vanishes."""
    rng = np.random.default_rng(7)
    scene = random_scene(rng)
    S = random_covariances(rng, NUM_POINTS, 3, 0.2)
    R = random_covariances(rng, NUM_POINTS, 4, 0.2)
    curr = warp(scene.T, scene.seen) + rng.normal(scale=0.3, size=(NUM_POINTS, 4))
    refined = scene.seen
    for _ in range(30):
        propagated = propagate(scene.T, scene.seen, S, curr=curr, scale=R, refined=refined)
        refined = propagated.refined

    def misfit(s: FloatArray) -> FloatArray:
        e = curr - warp(scene.T, s)
        moved = scene.seen - s
        of_observation = np.linalg.solve(R, e[..., None])[..., 0]
        of_point = np.linalg.solve(S, moved[..., None])[..., 0]
        return np.sum(e * of_observation, axis=1) + np.sum(moved * of_point, axis=1)

    for axis in 1e-6 * np.eye(3):
        slope = (misfit(refined + axis) - misfit(refined - axis)) / 2e-6
        np.testing.assert_allclose(slope, 0.0, atol=1e-5)
    # There, the squared length with Σ of the residual less the offset is that least misfit.
    e = curr - warp(scene.T, refined) - propagated.offset
    squared = np.einsum("ni,nij,nj->n", e, propagated.information, e)
    np.testing.assert_allclose(squared, misfit(refined), rtol=1e-8)

"""The compiled inner loops against what they claim to compute, by central differences."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.geometry import se3
from probevo.measurements.normal_equations_numba import BEHIND, normal_equations
from probevo.measurements.robust_loss_numba import LossKind
from probevo.measurements.stereo_numba import linearize_noise

CAMERA = StereoCamera(fu_px=718.9, fv_px=720.1, cu_px=607.2, cv_px=185.2, baseline_m=0.54)
CONSTANTS = np.array([718.9, 720.1, 607.2, 185.2, 718.9 * 0.54])
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


def system(
    T: FloatArray,
    refined: FloatArray,
    offset: FloatArray,
    curr: FloatArray,
    information: FloatArray,
    kind: LossKind = LossKind.L2,
) -> tuple[float, FloatArray, FloatArray, FloatArray]:
    """Cost, gradient [6], hessian [6, 6] and squared lengths [N] of one pass."""
    hessian = np.empty((6, 6))
    gradient = np.empty(6)
    squared = np.empty(len(refined))
    cost = normal_equations(
        np.ascontiguousarray(T[:3, :3]),
        np.ascontiguousarray(T[:3, 3]),
        CONSTANTS,
        refined=refined,
        offset=offset,
        curr=curr,
        information=information,
        kind=int(kind),
        parameter=np.full(len(refined), PARAMETER[kind]),
        near=False,
        hessian=hessian,
        gradient=gradient,
        squared=squared,
    )
    return cost, gradient, hessian, squared


def fold_noise(
    T: FloatArray,
    seen: FloatArray,
    point_cov: FloatArray,
    curr: FloatArray,
    scale: FloatArray,
    refined: FloatArray,
    time_correlation: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Refined points [N, 3], offsets [N, 4] and information [N, 4, 4] of one pass, from
    ``refined``."""
    refined = refined.copy()
    offset = np.full((len(seen), 4), np.nan)
    information = np.full((len(seen), 4, 4), np.nan)
    C = np.ascontiguousarray(T[:3, :3])
    t = np.ascontiguousarray(T[:3, 3])
    joint = np.zeros((len(seen), 4, 4))
    joint[:, :3, :3] = point_cov
    if time_correlated is not None:
        joint[:, 2:, 2:] += time_correlated[:, None, None] * np.array([[1.0, -1.0], [-1.0, 1.0]])
    linearize_noise(
        C,
        t,
        CONSTANTS,
        seen=seen,
        point_cov=joint,
        curr=curr,
        scale=scale,
        refined=refined,
        offset=offset,
        information=information,
        shared=np.empty((len(seen), 4, 2)),
    )
    return refined, offset, information


def relative_error(actual: FloatArray, expected: FloatArray) -> float:
    return float(np.linalg.norm(actual - expected) / np.linalg.norm(expected))


def test_jacobian_against_central_differences(scenes: list[Scene]) -> None:
    """1,000 motions: with a unit residual and unit information the gradient is a row of J = ∂h/∂ξ,
    T ← Exp(ξ) T."""
    step = 1e-5
    worst = 0.0
    forward = se3.exp(step * np.eye(6))
    back = se3.exp(-step * np.eye(6))
    for scene in scenes:
        s = scene.seen[:1]
        rows = [
            system(scene.T, s, np.zeros((1, 4)), warp(scene.T, s) + unit, np.eye(4)[None])[1]
            for unit in np.eye(4)
        ]
        J = (warp(forward @ scene.T, s) - warp(back @ scene.T, s)).T / (2 * step)
        worst = max(worst, relative_error(np.array(rows), J))
    assert worst < 1e-6


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
        fixed = (scene.seen, offset, curr, information, kind)
        _, gradient, hessian, squared = system(scene.T, *fixed)
        if is_at_a_kink(kind, squared):
            continue
        costs = np.array(
            [[system(shift @ scene.T, *fixed)[0] for shift in axis] for axis in shifts]
        )
        pulls = np.sqrt(np.diag(hessian) * squared.sum())
        worst = max(worst, float(np.linalg.norm((costs @ stencil + gradient) / pulls)))
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
        cost, _, hessian, squared = system(
            scene.T, scene.seen, np.zeros((NUM_POINTS, 4)), curr, information, LossKind.STUDENT_T
        )
        plus, minus = (warp((shift @ scene.T)[:, None], scene.seen) for shift in (forward, back))
        J = np.moveaxis(plus - minus, 0, 2) / (2 * step)
        e = curr - warp(scene.T, scene.seen)
        np.testing.assert_allclose(squared, np.einsum("ni,nij,nj->n", e, information, e), rtol=1e-8)
        assert cost == pytest.approx(4.5 * np.log1p(squared / 5.0).sum(), rel=1e-10)
        expected = np.einsum("n,nia,nij,njb->ab", 9.0 / (5.0 + squared), J, information, J)
        assert relative_error(hessian, expected) < 1e-6
        np.testing.assert_array_equal(hessian, hessian.T)


def test_points_at_infinity_tell_of_rotation_alone() -> None:
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
    _, gradient, hessian, squared = system(T, seen, np.zeros((5, 4)), curr, information)
    np.testing.assert_allclose(squared, np.sum((curr - project_rays(T)) ** 2, axis=1), rtol=1e-9)
    np.testing.assert_array_equal(gradient[:3], 0.0)
    np.testing.assert_array_equal(hessian[:3], 0.0)
    step = 1e-5 * np.eye(6)[3:]
    J = (
        np.stack(
            [project_rays(se3.exp(s) @ T) - project_rays(se3.exp(-s) @ T) for s in step], axis=2
        )
        / 2e-5
    )
    assert relative_error(hessian[3:, 3:], np.einsum("nia,nib->ab", J, J)) < 1e-6


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
    refined, offset, information = fold_noise(
        T, seen, np.tile(np.eye(3), (6, 1, 1)), curr, np.tile(np.eye(4), (6, 1, 1)), seen
    )
    np.testing.assert_array_equal(information[5], 0.0)
    np.testing.assert_array_equal(refined[5], passed)

    _, gradient, hessian, squared = system(T, refined, offset, curr, np.tile(np.eye(4), (6, 1, 1)))
    _, expected_gradient, expected_hessian, _ = system(
        T, refined[:5], offset[:5], curr[:5], np.tile(np.eye(4), (5, 1, 1))
    )
    np.testing.assert_array_equal(gradient, expected_gradient)
    np.testing.assert_array_equal(hessian, expected_hessian)
    assert squared[5] == BEHIND


def test_noise_of_points_is_propagated_by_the_derivative_of_the_warp(scenes: list[Scene]) -> None:
    """Σ = R' + A S Aᵀ and ŝ = s + S Aᵀ Σ⁻¹ e with A by central differences, for 1,000 motions."""
    rng = np.random.default_rng(5)
    step = 1e-4
    worst = 0.0
    for scene in scenes:
        point_cov = random_covariances(rng, NUM_POINTS, 3, 0.5)
        scale = random_covariances(rng, NUM_POINTS, 4, 0.7)
        curr = warp(scene.T, scene.seen) + rng.normal(size=(NUM_POINTS, 4))
        refined, offset, information = fold_noise(
            scene.T, scene.seen, point_cov, curr, scale, scene.seen
        )
        shifts = step * np.eye(3)
        A = np.stack(
            [warp(scene.T, scene.seen + s) - warp(scene.T, scene.seen - s) for s in shifts], axis=2
        )
        A /= 2 * step
        expected = np.linalg.inv(scale + A @ point_cov @ A.mT)
        move = point_cov @ A.mT @ expected @ (curr - warp(scene.T, scene.seen))[..., None]
        worst = max(
            worst,
            relative_error(information, expected),
            relative_error(refined - scene.seen, move[..., 0]),
            relative_error(offset, (A @ (scene.seen - refined)[..., None])[..., 0]),
        )
    assert worst < 1e-6


def test_a_lasting_error_enters_by_the_joint_gaussian_of_both_frames(scenes: list[Scene]) -> None:
    """Errors (p, n', δ) of point, observation and disparity: e = n' − δ (0, 0, 1, 0) − A (p + (0,
    0, δ)), by means."""
    rng = np.random.default_rng(8)
    S = random_covariances(rng, NUM_POINTS, 3, 0.2)
    R = random_covariances(rng, NUM_POINTS, 4, 0.2)
    time_correlated = rng.uniform(0.0, 1.0, NUM_POINTS)
    for scene in scenes[:50]:
        curr = warp(scene.T, scene.seen) + rng.normal(scale=0.3, size=(NUM_POINTS, 4))
        refined, _, information = fold_noise(
            scene.T, scene.seen, S, curr, R, scene.seen, time_correlated
        )
        A = np.stack(
            [
                (warp(scene.T, scene.seen + h) - warp(scene.T, scene.seen - h)) / 2e-4
                for h in 1e-4 * np.eye(3)
            ],
            axis=-1,
        )
        to_error = np.concatenate(
            [
                -A,
                np.broadcast_to(np.eye(4), (NUM_POINTS, 4, 4)),
                -A[..., 2:] - np.array([[0], [0], [1], [0]]),
            ],
            axis=2,
        )
        joint = np.zeros((NUM_POINTS, 8, 8))
        joint[:, :3, :3] = S
        joint[:, 3:7, 3:7] = R
        joint[:, 7, 7] = lasting
        sigma = to_error @ joint @ to_error.mT
        mean = (
            joint
            @ to_error.mT
            @ np.linalg.solve(sigma, (curr - warp(scene.T, scene.seen))[..., None])
        )[..., 0]
        mean[:, 2] += mean[:, 7]  # both errors of the disparity seen
        np.testing.assert_allclose(
            information @ sigma, np.broadcast_to(np.eye(4), sigma.shape), atol=1e-5
        )
        np.testing.assert_allclose(refined, scene.seen - mean[:, :3], atol=1e-5)


def test_points_without_noise_stay_where_they_are_seen() -> None:
    rng = np.random.default_rng(6)
    scene = random_scene(rng)
    scale = random_covariances(rng, NUM_POINTS, 4, 0.7)
    curr = warp(scene.T, scene.seen) + rng.normal(size=(NUM_POINTS, 4))
    refined, offset, information = fold_noise(
        scene.T, scene.seen, np.zeros((NUM_POINTS, 3, 3)), curr, scale, scene.seen
    )
    np.testing.assert_array_equal(refined, scene.seen)
    np.testing.assert_array_equal(offset, 0.0)
    np.testing.assert_allclose(information, np.linalg.inv(scale), rtol=1e-9, atol=1e-12)


def test_repeated_refinement_ends_at_the_most_likely_point() -> None:
    """It minimises (y' − h(ŝ))ᵀ R'⁻¹ (y' − h(ŝ)) + (s − ŝ)ᵀ S⁻¹ (s − ŝ): the gradient vanishes."""
    rng = np.random.default_rng(7)
    scene = random_scene(rng)
    S = random_covariances(rng, NUM_POINTS, 3, 0.2)
    R = random_covariances(rng, NUM_POINTS, 4, 0.2)
    curr = warp(scene.T, scene.seen) + rng.normal(scale=0.3, size=(NUM_POINTS, 4))
    refined = scene.seen
    for _ in range(30):
        refined, offset, information = fold_noise(scene.T, scene.seen, S, curr, R, refined)

    def misfit(s: FloatArray) -> FloatArray:
        e = curr - warp(scene.T, s)
        moved = scene.seen - s
        solved = (
            np.linalg.solve(R, e[..., None])[..., 0],
            np.linalg.solve(S, moved[..., None])[..., 0],
        )
        return np.sum(e * solved[0], axis=1) + np.sum(moved * solved[1], axis=1)

    for axis in 1e-6 * np.eye(3):
        slope = (misfit(refined + axis) - misfit(refined - axis)) / 2e-6
        np.testing.assert_allclose(slope, 0.0, atol=1e-5)
    # There, the squared length with Σ of the residual less the offset is that least misfit.
    e = curr - warp(scene.T, refined) - offset
    np.testing.assert_allclose(
        np.einsum("ni,nij,nj->n", e, information, e), misfit(refined), rtol=1e-8
    )

"""Matrix-weighted alignment: exact without noise, consistent with it, and never NaN."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.estimation.alignment import solve_alignment
from probevo.evaluation.trajectory_errors import rigid_alignment
from probevo.geometry import se3
from probevo.geometry.uncertainty import normalized_error_squared

CAMERA = StereoCamera(fu_px=718.9, fv_px=720.1, cu_px=607.2, cv_px=185.2, baseline_m=0.54)
MOTION = se3.exp(np.array([0.1, -0.05, -0.6, 0.01, 0.04, -0.02]))
COV_PX = np.diag([0.3, 0.2, 0.3, 0.2]) ** 2


def near_points(rng: np.random.Generator, count: int) -> FloatArray:
    """3 to 10 m ahead of the previous frame, [N, 3], m."""
    z = rng.uniform(3.0, 10.0, count)
    return np.stack(
        [rng.uniform(-0.7, 0.7, count) * z, rng.uniform(-0.25, 0.25, count) * z, z], axis=1
    )


def observe(points: FloatArray, T: FloatArray = MOTION) -> tuple[FloatArray, FloatArray]:
    """Noiseless pixels in both frames, [N, 4] each."""
    return CAMERA.project(points), CAMERA.project(se3.transform(T, points))


def test_exact_pixels_give_the_exact_motion() -> None:
    """From the identity, for a turn of 90° too."""
    points = near_points(np.random.default_rng(0), 30)
    turned = se3.from_parts(
        se3.exp(np.array([0, 0, 0, 0, 0, np.pi / 2]))[:3, :3], np.array([0.1, 0.2, 0.3])
    )
    for motion in (MOTION, turned):
        result = solve_alignment(
            *observe(points, motion),
            COV_PX,
            cov_curr_px=COV_PX,
            camera=CAMERA,
            guess=np.eye(4),
        )
        np.testing.assert_allclose(result.T_curr_prev, motion, atol=1e-9)
        assert result.converged


def test_covariance_is_consistent() -> None:
    """Average NEES over 200 noisy solves of near points lies in the 95 % interval of χ²(6)/200."""
    rng = np.random.default_rng(0)
    solved = []
    covs = []
    for _ in range(200):
        prev_px, curr_px = (
            y + rng.multivariate_normal(np.zeros(4), COV_PX, 60)
            for y in observe(near_points(rng, 60))
        )
        guess = rigid_alignment(CAMERA.triangulate(prev_px), CAMERA.triangulate(curr_px))
        result = solve_alignment(
            prev_px, curr_px, COV_PX, cov_curr_px=COV_PX, camera=CAMERA, guess=guess
        )
        assert result.converged
        solved.append(result.T_curr_prev)
        covs.append(result.cov)
    nees = normalized_error_squared(MOTION, np.array(solved), np.array(covs))
    low, high = np.asarray(chi2.ppf([0.025, 0.975], df=6 * 200)) / 200
    assert low < nees.mean() < high


def test_solution_is_stationary() -> None:
    """The gradient of ½ Σ eᵀ Γ e, Γ held, vanishes under left perturbations, by central
    differences."""
    rng = np.random.default_rng(1)
    prev_px, curr_px = (
        y + rng.normal(scale=0.5, size=y.shape) for y in observe(near_points(rng, 40))
    )
    T, cov, _, converged = solve_alignment(
        prev_px, curr_px, COV_PX, cov_curr_px=COV_PX, camera=CAMERA, guess=np.eye(4)
    )
    assert converged

    p = CAMERA.triangulate(prev_px)
    q = CAMERA.triangulate(curr_px)
    G_prev = T[:3, :3] @ CAMERA.triangulate_jacobian(prev_px)
    G_curr = CAMERA.triangulate_jacobian(curr_px)
    Gamma = np.linalg.inv(G_curr @ COV_PX @ G_curr.mT + G_prev @ COV_PX @ G_prev.mT)

    def cost(xi: FloatArray) -> float:
        e = q - se3.transform(se3.exp(xi) @ T, p)
        return 0.5 * float(np.einsum("ni,nij,nj", e, Gamma, e))

    step = 1e-6
    gradient = np.array([cost(step * axis) - cost(-step * axis) for axis in np.eye(6)]) / (2 * step)
    assert (
        np.abs(gradient) * np.sqrt(np.diag(cov)) < 1e-4
    ).all()  # in standard deviations of the motion


def test_one_covariance_stands_for_all() -> None:
    prev_px, curr_px = observe(near_points(np.random.default_rng(2), 20))
    every = np.broadcast_to(COV_PX, (20, 4, 4))
    one = solve_alignment(
        prev_px, curr_px, COV_PX, cov_curr_px=COV_PX, camera=CAMERA, guess=np.eye(4)
    )
    each = solve_alignment(
        prev_px, curr_px, every, cov_curr_px=every, camera=CAMERA, guess=np.eye(4)
    )
    np.testing.assert_array_equal(one.cov, each.cov)


def test_points_are_weighed_by_their_covariance() -> None:
    """A grossly wrong point does no harm if its covariance says so."""
    rng = np.random.default_rng(3)
    prev_px, curr_px = observe(near_points(rng, 20))
    curr_px[0] += [9.0, -7.0, 3.0, -7.0]
    covs = np.tile(COV_PX, (20, 1, 1))
    covs[0] *= 1e10
    result = solve_alignment(
        prev_px, curr_px, COV_PX, cov_curr_px=covs, camera=CAMERA, guess=np.eye(4)
    )
    np.testing.assert_allclose(result.T_curr_prev, MOTION, atol=1e-8)


def test_points_without_disparity_are_left_out() -> None:
    prev_px, curr_px = observe(near_points(np.random.default_rng(4), 20))
    curr_px[3, 2] = curr_px[3, 0]
    prev_px[5, 2] = prev_px[5, 0] + 1.0
    result = solve_alignment(
        prev_px, curr_px, COV_PX, cov_curr_px=COV_PX, camera=CAMERA, guess=np.eye(4)
    )
    np.testing.assert_allclose(result.T_curr_prev, MOTION, atol=1e-9)


@pytest.mark.parametrize("count", [0, 1, 2])
def test_too_few_points_leave_a_huge_covariance(count: int) -> None:
    """Finite, positive definite, and so wide that nobody would call the motion known."""
    prev_px, curr_px = observe(near_points(np.random.default_rng(5), count))
    result = solve_alignment(
        prev_px, curr_px, COV_PX, cov_curr_px=COV_PX, camera=CAMERA, guess=np.eye(4)
    )
    assert np.isfinite(result.T_curr_prev).all()
    eigenvalues = np.linalg.eigvalsh(result.cov)
    assert eigenvalues[0] > 0
    assert eigenvalues[-1] > 1e6

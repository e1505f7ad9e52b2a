"""The pose in the world: compounded motions, and Kalman updates by measurements of the pose."""

from __future__ import annotations

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo.estimation.motion_estimate import COMMON_MODE_COLUMNS, MotionEstimate, Status
from probevo.estimation.pose_filter import MIN_SIGMA, PoseFilter
from probevo.evaluation.consistency import drift_covariances
from probevo.geometry import se3
from probevo.measurements.variables import Values, Variable, pose_of
from probevo.measurements.vector_measurement import VectorMeasurement

POSE = pose_of(9)


class LinearInPose(VectorMeasurement):
    """A measurement z = H ξ of ξ = Log(T_cam_world T_reference⁻¹): linear around the reference."""

    def __init__(
        self, T_reference: FloatArray, H: FloatArray, z: FloatArray, covariance: FloatArray
    ) -> None:
        super().__init__(covariance)
        self.T_reference = T_reference
        self.H = H
        self.z = z

    @property
    def variables(self) -> tuple[Variable, ...]:
        return (POSE,)

    def residual(self, values: Values) -> FloatArray:
        xi = se3.log(values[POSE] @ se3.inverse(self.T_reference))
        return self.z - self.H @ xi


class Position(VectorMeasurement):
    """A measured place of the camera in the world, [3], m, as a satellite receiver gives it."""

    def __init__(self, place_m: FloatArray, covariance: FloatArray, **options: float) -> None:
        super().__init__(covariance, **options)
        self.place_m = place_m

    @property
    def variables(self) -> tuple[Variable, ...]:
        return (POSE,)

    def residual(self, values: Values) -> FloatArray:
        return self.place_m - se3.inverse(values[POSE])[:3, 3]


def random_covariance(rng: np.random.Generator, dim: int, sigma: float) -> FloatArray:
    root = rng.normal(size=(dim, dim))
    return sigma**2 * (root @ root.T + 0.3 * np.eye(dim))


def random_motion(rng: np.random.Generator, *, has_cross_cov: bool = True) -> MotionEstimate:
    common_mode = rng.normal(scale=0.02, size=(6, COMMON_MODE_COLUMNS))
    cross_cov = rng.normal(scale=1e-3, size=(6, 6)) if has_cross_cov else np.zeros((6, 6))
    return MotionEstimate(
        T_curr_prev=se3.exp(rng.normal(scale=[0.1, 0.1, 0.8, 0.02, 0.05, 0.02])),
        cov=random_covariance(rng, 6, 0.05) + common_mode @ common_mode.T,
        status=Status.OK,
        num_tracks=100,
        common_mode=common_mode,
        path_cross_cov=cross_cov,
    )


def random_pose(rng: np.random.Generator) -> PoseFilter:
    return PoseFilter(
        T_world_cam=se3.exp(rng.normal(size=6)),
        own_cov=random_covariance(rng, 6, 0.1),
        common_mode=rng.normal(scale=0.1, size=(6, COMMON_MODE_COLUMNS)),
    )


def is_positive_semidefinite(cov: FloatArray) -> bool:
    scale = np.sqrt(np.maximum(np.diagonal(cov), 1e-300))
    return bool(np.linalg.eigvalsh(cov / np.outer(scale, scale))[0] > -1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_compounding_adds_up_as_the_drift_does(seed: int) -> None:
    """Covariances of 40 random motions, common mode and cross-covariances included."""
    rng = np.random.default_rng(seed)
    motions = [random_motion(rng) for _ in range(40)]
    pose = PoseFilter.at_origin()
    covs = [pose.cov]
    T_cam_world = np.eye(4)
    for motion in motions:
        pose = pose.advanced(motion)
        covs.append(pose.cov)
        T_cam_world = motion.T_curr_prev @ T_cam_world
        np.testing.assert_allclose(pose.T_world_cam, se3.inverse(T_cam_world), atol=1e-12)
    expected = drift_covariances(
        np.array([motion.T_curr_prev for motion in motions]),
        np.array([motion.cov for motion in motions]),
        common_mode=np.array([motion.common_mode for motion in motions]),
        path_cross_cov=np.array([motion.path_cross_cov for motion in motions]),
    )
    scale = np.abs(expected).max(axis=(1, 2), keepdims=True) + 1e-300
    np.testing.assert_allclose(covs / scale, expected / scale, atol=1e-12)


def test_the_first_pose_is_the_origin_for_certain() -> None:
    pose = PoseFilter.at_origin()
    np.testing.assert_array_equal(pose.T_world_cam, np.eye(4))
    np.testing.assert_array_equal(pose.cov, np.zeros((6, 6)))


@pytest.mark.parametrize("dim", [1, 3, 6])
def test_update_is_that_of_kalman(dim: int) -> None:
    """Mean and covariance in closed form, of 20 random poses and linear measurements of each.

    At the updated mean, ξ away from the old one, errors are left perturbations of another pose:
    the closed form is exact only without an innovation.
    """
    rng = np.random.default_rng(dim)
    for _ in range(20):
        pose = random_pose(rng)
        T_cam_world = se3.inverse(pose.T_world_cam)
        P = pose.cov + np.diag(MIN_SIGMA**2)
        H = rng.normal(size=(dim, 6))
        R = random_covariance(rng, dim, 0.1)
        z = rng.multivariate_normal(np.zeros(dim), 0.01 * (H @ P @ H.T + R))
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
        cov = (np.eye(6) - K @ H) @ P
        updated = pose.updated([LinearInPose(T_cam_world, H, z, R)], POSE)
        xi = se3.log(se3.inverse(updated.T_world_cam) @ pose.T_world_cam)
        off = xi - K @ z
        assert np.sqrt(off @ np.linalg.solve(cov, off)) < 1e-4  # standard deviations
        np.testing.assert_allclose(updated.cov, cov, atol=0.1 * np.abs(cov).max())
        confirmed = pose.updated([LinearInPose(T_cam_world, H, 0.0 * z, R)], POSE)
        np.testing.assert_allclose(confirmed.T_world_cam, pose.T_world_cam, atol=1e-12)
        np.testing.assert_allclose(confirmed.cov, cov, atol=1e-6 * np.abs(cov).max())


def test_several_measurements_are_one_update() -> None:
    """Two at once are as good as one after the other, where both are linear."""
    rng = np.random.default_rng(4)
    pose = random_pose(rng)
    T_cam_world = se3.inverse(pose.T_world_cam)
    parts = [
        LinearInPose(T_cam_world, rng.normal(size=(2, 6)), np.zeros(2), 0.01 * np.eye(2))
        for _ in range(2)
    ]
    at_once = pose.updated(parts, POSE)
    one_by_one = pose.updated(parts[:1], POSE).updated(parts[1:], POSE)
    atol = 1e-6 * np.abs(at_once.cov).max()
    np.testing.assert_allclose(one_by_one.cov, at_once.cov, atol=atol)
    np.testing.assert_allclose(one_by_one.common_mode, at_once.common_mode, atol=1e-6)


def test_common_mode_shrinks_with_the_update() -> None:
    """By A = P⁺ P⁻¹ = 1 − K H; what is left of P⁺ is the pose's own, and a covariance."""
    rng = np.random.default_rng(5)
    for _ in range(20):
        pose = random_pose(rng)
        P = pose.cov + np.diag(MIN_SIGMA**2)
        H = rng.normal(size=(3, 6))
        R = random_covariance(rng, 3, 0.05)
        T_cam_world = se3.inverse(pose.T_world_cam)
        updated = pose.updated([LinearInPose(T_cam_world, H, np.zeros(3), R)], POSE)
        A = np.eye(6) - P @ H.T @ np.linalg.inv(H @ P @ H.T + R) @ H
        np.testing.assert_allclose(updated.common_mode, A @ pose.common_mode, atol=1e-6)
        own_cov = updated.cov - updated.common_mode @ updated.common_mode.T
        np.testing.assert_allclose(updated.own_cov, own_cov, atol=1e-12)
        assert is_positive_semidefinite(updated.own_cov)
        # The common-mode part of what was measured shrinks, as the rest of it does.
        before = np.linalg.norm(H @ pose.common_mode, ord=2)
        assert np.linalg.norm(H @ updated.common_mode, ord=2) < before


def test_a_certain_measurement_leaves_no_common_mode_in_what_it_measures() -> None:
    rng = np.random.default_rng(6)
    pose = random_pose(rng)
    T_cam_world = se3.inverse(pose.T_world_cam)
    certain = LinearInPose(T_cam_world, np.eye(6), np.zeros(6), 1e-12 * np.eye(6))
    updated = pose.updated([certain], POSE)
    np.testing.assert_allclose(updated.common_mode, 0.0, atol=1e-6)
    np.testing.assert_allclose(updated.cov, 1e-12 * np.eye(6), atol=1e-14)


def test_covariance_stays_positive_semidefinite_over_many_updates() -> None:
    """200 steps, each with a measured place that is off by its noise, and now and then by 50 m."""
    rng = np.random.default_rng(7)
    pose = PoseFilter.at_origin()
    T_world_true = np.eye(4)
    for index in range(200):
        motion = random_motion(rng, has_cross_cov=False)
        error = rng.multivariate_normal(np.zeros(6), motion.cov)
        pose = pose.advanced(motion)
        T_world_true = T_world_true @ se3.inverse(se3.exp(error) @ motion.T_curr_prev)
        R = random_covariance(rng, 3, 0.2)
        place_m = T_world_true[:3, 3] + rng.multivariate_normal(np.zeros(3), R)
        place_m[0] += 50.0 if index % 20 == 19 else 0.0
        pose = pose.updated([Position(place_m, R, dof=4.0)], POSE)
        assert np.isfinite(pose.T_world_cam).all()
        np.testing.assert_allclose(pose.cov, pose.cov.T, atol=1e-9 * np.abs(pose.cov).max())
        assert is_positive_semidefinite(pose.cov)
        assert is_positive_semidefinite(pose.own_cov)
    assert np.linalg.norm(pose.T_world_cam[:3, 3] - T_world_true[:3, 3]) < 3.0


def test_without_measurements_nothing_changes() -> None:
    pose = random_pose(np.random.default_rng(8))
    assert pose.updated([], POSE) is pose


def test_a_measurement_that_tells_nothing_changes_no_later_covariance() -> None:
    """That of the steps with the path before them counts as if it had not been there."""
    rng = np.random.default_rng(9)
    pose = random_pose(rng)
    nowhere = Position(np.zeros(3), 1e18 * np.eye(3))
    corrected = pose.updated([nowhere], POSE)
    assert corrected.is_corrected
    for _ in range(5):
        motion = random_motion(rng)
        pose = pose.advanced(motion)
        corrected = corrected.advanced(motion)
        assert corrected.is_corrected
        np.testing.assert_allclose(corrected.own_cov, pose.own_cov, atol=1e-6)
        np.testing.assert_allclose(corrected.common_mode, pose.common_mode, atol=1e-6)


@pytest.mark.parametrize("sigma_m", [0.03, 0.3, 3.0])
def test_the_covariance_of_a_corrected_path_is_that_of_its_errors(sigma_m: float) -> None:
    """Steps with the same unknown velocity, then one that takes back what they had wrong, as behind
    a blackout; measured positions before, within and after. The errors of 40,000 paths under the
    gains of the filter scatter as it claims, within 5 %."""
    rng = np.random.default_rng(10)
    count = 40_000
    velocity = rng.normal(0.0, 0.2, (count, 3))
    w = np.zeros((count, 3))
    f = np.zeros((count, 3))
    reckoned = np.zeros((count, 3))
    variance = np.zeros(3)
    filtered = PoseFilter.at_origin()
    for k in range(14):
        # Errors: each step has 0.1 m of its own; 4 to 8 have a velocity in common; 9 removes it.
        epsilon = rng.normal(0.0, 0.1, (count, 3))
        if 4 <= k <= 8:
            epsilon += velocity
            reckoned += velocity
        elif k == 9:
            epsilon -= reckoned
        cov = np.zeros((6, 6))
        cross_cov = np.zeros((6, 6))
        cov[:3, :3] = epsilon.T @ epsilon / count
        cross_cov[:3, :3] = w.T @ epsilon / count
        cov[3:, 3:] = 1e-12 * np.eye(3)
        motion = MotionEstimate(
            T_curr_prev=np.eye(4),
            cov=cov,
            status=Status.OK,
            num_tracks=100,
            path_cross_cov=cross_cov,
        )
        filtered = filtered.advanced(motion)
        w += epsilon
        f += epsilon
        if k in (2, 5, 7, 11):
            before = filtered.cov[:3, :3]
            measured = Position(np.zeros(3), sigma_m**2 * np.eye(3))
            filtered = filtered.updated([measured], POSE)
            A = filtered.cov[:3, :3] @ np.linalg.inv(before)
            f = f @ A.T + rng.normal(0.0, sigma_m, (count, 3)) @ (np.eye(3) - A).T
        variance = f.var(axis=0)
        np.testing.assert_allclose(np.diagonal(filtered.cov)[:3], variance, rtol=0.05)

"""Points with covariances: those of repeated observations, and of the last solve of an odometry."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.stats import chi2

import probevo as pv
from probevo.estimation.landmarks import triangulated
from probevo.noise import StereoNoise
from worlds import CAMERA, drive, random_pixels


def noise_of(scale: np.ndarray, count: int, dof: float = np.inf) -> StereoNoise:
    return StereoNoise(
        np.tile(scale, (count, 1, 1)),
        np.full(count, dof),
        bias=np.zeros((count, 4)),
        refers_to="observation",
    )


def test_the_covariance_is_that_of_repeated_observations() -> None:
    """Mean NEES over 3,000 noisy observations of near points, χ²(3)."""
    rng = np.random.default_rng(0)
    count = 3000
    true_px = random_pixels(rng, count, depth_m=(5.0, 15.0))
    scale = np.diag([0.04, 0.03, 0.05, 0.03])
    scale[0, 2] = scale[2, 0] = 0.01
    seen_px = true_px + rng.multivariate_normal(np.zeros(4), scale, count)
    found = triangulated(np.arange(count), seen_px, noise_of(scale, count), CAMERA)
    error = found.points_m - CAMERA.triangulate(true_px)
    nees = np.einsum("ni,nij,nj->n", error, np.linalg.inv(found.cov_m2), error)
    low, high = np.asarray(chi2.ppf([0.005, 0.995], 3 * count)) / count
    assert low < nees.mean() < 1.02 * high  # triangulation is not quite linear


def test_the_error_of_the_disparity_that_lasts_is_in_it() -> None:
    """Mean NEES over 3,000 points, each with one such error, χ²(3)."""
    rng = np.random.default_rng(4)
    count = 3000
    true_px = random_pixels(rng, count, depth_m=(5.0, 15.0))
    noise = replace(noise_of(0.04 * np.eye(4), count), time_correlated=np.full(count, 0.09))
    seen_px = true_px + 0.2 * rng.normal(size=(count, 4))
    seen_px[:, 2] += 0.3 * rng.normal(size=count)
    found = triangulated(np.arange(count), seen_px, noise, CAMERA)
    error = found.points_m - CAMERA.triangulate(true_px)
    nees = np.einsum("ni,nij,nj->n", error, np.linalg.inv(found.cov_m2), error)
    low, high = np.asarray(chi2.ppf([0.005, 0.995], 3 * count)) / count
    assert low < nees.mean() < 1.05 * high  # triangulation is not quite linear


def test_a_student_t_has_the_covariance_of_its_degrees_of_freedom() -> None:
    pixels = random_pixels(np.random.default_rng(1), 5)
    ids = np.arange(5)
    gaussian = triangulated(ids, pixels, noise_of(0.04 * np.eye(4), 5), CAMERA)
    student = triangulated(ids, pixels, noise_of(0.04 * np.eye(4), 5, dof=4.0), CAMERA)
    np.testing.assert_allclose(student.cov_m2, 2.0 * gaussian.cov_m2)
    # With heavier tails it would be infinite: that of ν = 3 then, never a smaller one.
    for dof in (1.5, 2.0, 2.05, 3.0):
        heavy = triangulated(ids, pixels, noise_of(0.04 * np.eye(4), 5, dof=dof), CAMERA)
        np.testing.assert_allclose(heavy.cov_m2, 3.0 * gaussian.cov_m2)


def test_points_at_infinity_are_left_out() -> None:
    pixels = random_pixels(np.random.default_rng(2), 4)
    pixels[1, 2] = pixels[1, 0] + 0.1
    found = triangulated(np.array([7, 8, 9, 10]), pixels, noise_of(np.eye(4), 4), CAMERA)
    assert found.ids.tolist() == [7, 9, 10]


def test_the_odometry_gives_those_of_its_last_solve() -> None:
    odometry = pv.StereoOdometry(CAMERA)
    assert len(odometry.landmarks) == 0
    for frame in drive(np.random.default_rng(3), 4):
        odometry.step(frame)
    landmarks = odometry.landmarks
    assert len(landmarks) == odometry.used.sum() > 100
    assert set(landmarks.ids) <= set(odometry.tracks.ids)
    assert np.linalg.eigvalsh(landmarks.cov_m2).min() > 0.0
    # Depth is by far the least certain of a far point: σ_z = z²/(f b) σ_d.
    far = landmarks.points_m[:, 2].argmax()
    z_m = landmarks.points_m[far, 2]
    sigma_z_m = float(np.sqrt(landmarks.cov_m2[far, 2, 2]))
    sigma_d_px = sigma_z_m * CAMERA.fu_px * CAMERA.baseline_m / z_m**2
    assert 0.1 < sigma_d_px < 2.0
    assert repr(landmarks).startswith(f"Landmarks({len(landmarks)}, ")


def test_a_step_without_a_solve_has_none() -> None:
    frames = drive(np.random.default_rng(4), 3)
    odometry = pv.StereoOdometry(CAMERA)
    odometry.step(frames[0])
    assert len(odometry.landmarks) == 0

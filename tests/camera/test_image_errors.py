"""The errors of a rig's images as a Gaussian estimate, and its prior that is learned."""

import numpy as np
import pytest

from probevo.camera.distortion_field import NUM_COEFFICIENTS
from probevo.camera.image_errors import (
    DISPARITY_SIGMA_PX,
    INITIAL_SIGMA_PX,
    NUM_ERRORS,
    ImageErrors,
)

NO_RADIAL = np.zeros(NUM_ERRORS)


def test_two_steps_are_one_least_squares_problem() -> None:
    """Prior and both measurements at once; τ is that before the second step."""
    rng = np.random.default_rng(7)
    truth = rng.normal(scale=0.3, size=NUM_ERRORS)
    errors = ImageErrors.initial()
    total = np.zeros((NUM_ERRORS, NUM_ERRORS))
    moment = np.zeros(NUM_ERRORS)
    for _ in range(2):
        sigma_px = errors.distortion_sigma_px
        root = rng.normal(size=(NUM_ERRORS, 2 * NUM_ERRORS))
        information = root @ root.T
        measured = truth + rng.normal(scale=0.1, size=NUM_ERRORS)
        errors = errors.with_step(information, information @ (measured - errors.mean), NO_RADIAL)
        total += information
        moment += information @ measured
    prior = np.concatenate([DISPARITY_SIGMA_PX, np.full(NUM_COEFFICIENTS, sigma_px)]) ** -2.0
    information = total + np.diag(prior)
    np.testing.assert_allclose(errors.mean, np.linalg.solve(information, moment), rtol=1e-9)
    np.testing.assert_allclose(errors.cov, np.linalg.inv(information), rtol=1e-9)
    np.testing.assert_array_equal(errors.disparity_cov, errors.cov[:2, :2])


@pytest.mark.parametrize("tau_px", [0.02, 0.1, 0.5])
def test_the_prior_becomes_as_wide_as_the_errors_are(tau_px: float) -> None:
    """Of 45 coefficients, the mean square is known to 21 %: 3 of its σ are 0.34 of τ."""
    rng = np.random.default_rng(int(1000 * tau_px))
    truth = np.concatenate([np.zeros(2), rng.normal(scale=tau_px, size=NUM_COEFFICIENTS)])
    information = np.eye(NUM_ERRORS) / 0.05**2
    errors = ImageErrors.initial()
    for _ in range(100):
        measured = truth + 0.05 * rng.normal(size=NUM_ERRORS)
        errors = errors.with_step(information, information @ (measured - errors.mean), NO_RADIAL)
    assert abs(errors.distortion_sigma_px / tau_px - 1.0) < 0.34
    np.testing.assert_allclose(errors.mean, truth, atol=0.03)


def test_a_lens_without_distortion_gets_no_field() -> None:
    """What white noise makes of the field vanishes with its prior: a tenth of what is left with the
    prior that is not learned."""
    rng = np.random.default_rng(5)
    information = np.eye(NUM_ERRORS) / 0.5**2
    errors = ImageErrors.initial()
    for _ in range(100):
        measured = 0.5 * rng.normal(size=NUM_ERRORS)
        errors = errors.with_step(information, information @ (measured - errors.mean), NO_RADIAL)
    prior = np.append(DISPARITY_SIGMA_PX, np.full(NUM_COEFFICIENTS, INITIAL_SIGMA_PX)) ** -2.0
    fixed = np.linalg.solve(errors.seen + np.diag(prior), errors.moment)
    rms = np.sqrt(np.mean(errors.distortion**2))
    assert rms < 0.3 * np.sqrt(np.mean(fixed[2:] ** 2))


def test_nothing_seen_leaves_the_prior() -> None:
    nothing = np.zeros((NUM_ERRORS, NUM_ERRORS))
    errors = ImageErrors.initial().with_step(nothing, np.zeros(NUM_ERRORS), NO_RADIAL)
    np.testing.assert_array_equal(errors.mean, 0.0)
    assert errors.distortion_sigma_px == pytest.approx(INITIAL_SIGMA_PX, rel=1e-12)

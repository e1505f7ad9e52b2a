"""The field that changes from place to place: its covariance is that of simulated paths."""

import numpy as np

from probevo.camera.distortion_field import NUM_COEFFICIENTS
from probevo.estimation.window.field_variation import LASTS_FRAMES, SHARE, FieldVariation
from probevo.geometry import se3
from worlds import FORWARD

SIGMA_PX = 0.3


def test_the_covariance_is_that_of_fields_that_change() -> None:
    """Of 20,000 fields with the correlation exp(−1/10) from frame to frame."""
    rng = np.random.default_rng(1)
    gains = [0.01 * rng.normal(size=(6, NUM_COEFFICIENTS)) for _ in range(25)]
    adjoint = se3.adjoint(FORWARD)
    decay = np.exp(-1.0 / LASTS_FRAMES)
    sigma_px = np.sqrt(SHARE) * SIGMA_PX
    field = sigma_px * rng.normal(size=(20_000, NUM_COEFFICIENTS))
    error = np.zeros((20_000, 6))
    variation = FieldVariation.none()
    for gain in gains:
        fresh = sigma_px * rng.normal(size=field.shape)
        field = decay * field + np.sqrt(1.0 - decay**2) * fresh
        error = error @ adjoint.T + field @ gain.T
        variation = variation.with_new_frame(-1, FORWARD).with_step(gain)
    sampled = error.T @ error / len(error)
    claimed = variation.pose_cov(-1, SIGMA_PX)
    sigma = np.sqrt(np.diagonal(claimed))
    np.testing.assert_allclose(
        sampled / np.outer(sigma, sigma), claimed / np.outer(sigma, sigma), atol=0.05
    )


def test_it_does_not_cancel_on_the_way_back() -> None:
    """Where the field of the lenses does: each step back has the same gain, the other way."""
    gain = np.zeros((6, NUM_COEFFICIENTS))
    gain[2, 0] = 0.01
    ahead = np.eye(4)
    variation = FieldVariation.none()
    for sign in (1.0,) * 40 + (-1.0,) * 40:
        variation = variation.with_new_frame(-1, ahead).with_step(sign * gain)
    there = variation.pose_cov(40, SIGMA_PX)[2, 2]
    back = variation.pose_cov(80, SIGMA_PX)[2, 2]
    assert back > 1.5 * there


def test_a_field_of_nothing_moves_nothing() -> None:
    gain = np.ones((6, NUM_COEFFICIENTS))
    variation = FieldVariation.none().with_new_frame(-1, FORWARD).with_step(gain)
    assert not variation.pose_cov(-1, 0.0).any()

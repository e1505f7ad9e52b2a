"""How an error of the lenses' distortion moves the poses of a window."""

from dataclasses import replace

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.distortion_field import NUM_COEFFICIENTS
from probevo.camera.image_errors import ImageErrors
from probevo.estimation.window.distortion_effect import DistortionEffect
from probevo.geometry import se3
from worlds import FORWARD, image_errors

STEPS = 5


def of_lenses(distortion_px: FloatArray) -> ImageErrors:
    """Return an estimate of a field that is the same everywhere (``window.field_variation``)."""
    return replace(image_errors(distortion_px=distortion_px), distortion_sigma_px=0.0)


def walked(
    rng: np.random.Generator,
) -> tuple[DistortionEffect, list[FloatArray], list[FloatArray], ImageErrors]:
    """Return the effect after some steps; the gain of each, what it was corrected by, and the
    newest estimate."""
    effect = DistortionEffect.none()
    gains = [0.01 * rng.normal(size=(6, NUM_COEFFICIENTS)) for _ in range(STEPS)]
    used = [0.1 * rng.normal(size=NUM_COEFFICIENTS) for _ in range(STEPS)]
    errors = of_lenses(0.1 * rng.normal(size=NUM_COEFFICIENTS))
    for gain, used_px in zip(gains, used, strict=True):
        effect = effect.carried_to_new(-1, FORWARD)
        effect = effect.with_step(gain, np.zeros(6), used_px=used_px, errors=errors)
    return effect, gains, used, errors


def test_the_second_moment_is_that_of_errors_that_add_up() -> None:
    """Against errors G_k (c − ĉ_k) of single steps, for 20,000 fields of the newest estimate."""
    rng = np.random.default_rng(1)
    effect, gains, used, errors = walked(rng)
    root = np.linalg.cholesky(errors.distortion_cov)
    fields = errors.distortion + rng.normal(size=(20_000, NUM_COEFFICIENTS)) @ root.T
    adjoint = se3.adjoint(FORWARD)
    of_pose = [np.zeros((len(fields), 6))]
    for gain, used_px in zip(gains, used, strict=True):
        of_pose.append(of_pose[-1] @ adjoint.T + (fields - used_px) @ gain.T)
    last = of_pose[-1]
    sampled = last.T @ last / len(last)
    claimed = effect.of_pose(STEPS)
    sigma = np.sqrt(np.diagonal(claimed))
    np.testing.assert_allclose(
        sampled / np.outer(sigma, sigma), claimed / np.outer(sigma, sigma), atol=0.05
    )
    # The motion between two frames, by the adjoint over three steps.
    over_three = np.linalg.matrix_power(adjoint, 3)
    between = last - of_pose[2] @ over_three.T
    sampled = between.T @ between / len(between)
    claimed = effect.between(STEPS, 2, over_three)
    sigma = np.sqrt(np.diagonal(claimed))
    np.testing.assert_allclose(
        sampled / np.outer(sigma, sigma), claimed / np.outer(sigma, sigma), atol=0.05
    )


def test_an_error_of_the_focal_length_adds_up_and_moves_the_field() -> None:
    """With a field that is known but for it: the root of the second moment is the sum over the
    steps, of which one to the right takes back one to the left."""
    rng = np.random.default_rng(4)
    errors = of_lenses(np.zeros(NUM_COEFFICIENTS))
    with_focal = rng.normal(size=len(errors.mean))
    errors = replace(errors, cov=1e-9 * np.eye(len(errors.mean)), with_focal=with_focal)
    adjoint = se3.adjoint(FORWARD)
    for second, turns in ((1.0, "alike"), (-1.0, "back")):
        effect = DistortionEffect.none()
        expected = np.zeros(6)
        for sign in (1.0, second):
            gain = sign * rng.normal(size=(6, NUM_COEFFICIENTS))
            focal_gain = sign * np.array([0.0, 0.0, 0.0, 0.0, 0.05, 0.0])
            effect = effect.carried_to_new(-1, FORWARD)
            effect = effect.with_step(
                gain, focal_gain, used_px=np.zeros(NUM_COEFFICIENTS), errors=errors
            )
            moved = focal_gain + gain @ errors.distortion_shift_by_focal
            expected = adjoint @ expected + moved
        claimed = effect.of_pose(2) - effect.sensitivity[2] @ effect.cov @ effect.sensitivity[2].T
        expected *= errors.focal_rms
        np.testing.assert_allclose(claimed, np.outer(expected, expected), atol=1e-12, err_msg=turns)


def test_a_field_that_is_what_all_steps_were_corrected_by_and_is_known_moves_nothing() -> None:
    rng = np.random.default_rng(2)
    errors = of_lenses(0.1 * rng.normal(size=NUM_COEFFICIENTS))
    errors = replace(errors, cov=1e-18 * np.eye(len(errors.mean)))
    effect = DistortionEffect.none()
    for _ in range(STEPS):
        effect = effect.carried_to_new(-1, FORWARD)
        gain = 0.01 * rng.normal(size=(6, NUM_COEFFICIENTS))
        effect = effect.with_step(gain, np.zeros(6), used_px=errors.distortion, errors=errors)
    np.testing.assert_allclose(effect.of_pose(STEPS), 0.0, atol=1e-15)


def test_frames_are_left_out_by_mask_and_by_slice() -> None:
    effect, *_ = walked(np.random.default_rng(3))
    last = effect.of_pose(STEPS)
    np.testing.assert_array_equal(effect.subset(slice(1, None)).of_pose(STEPS - 1), last)
    keep = np.array([True, False, True, True, False, True])
    np.testing.assert_array_equal(effect.subset(keep).of_pose(3), last)

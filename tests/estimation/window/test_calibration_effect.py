"""How an error of the lenses' distortion moves the poses of a window."""

from dataclasses import replace

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.distortion_field import NUM_COEFFICIENTS
from probevo.camera.image_errors import ImageErrors, ScalarEquations
from probevo.estimation.rig_update import CommonMode
from probevo.estimation.window.calibration_effect import CalibrationEffect
from probevo.geometry import se3
from worlds import FORWARD, image_errors

STEPS = 5
NO_COV = np.zeros((6, 6))
"""The velocity within a step is known."""


def of_lenses(distortion_px: FloatArray) -> ImageErrors:
    """Return an estimate of a field that is the same everywhere (``window.field_variation``)."""
    return replace(image_errors(distortion_px=distortion_px), distortion_sigma_px=0.0)


def moves(
    distortion_gain: FloatArray,
    focal_gain: FloatArray | None = None,
    readout_gain: FloatArray | None = None,
) -> CommonMode:
    """Return how errors of the calibration move a step."""
    return CommonMode.none()._replace(
        distortion_gain=distortion_gain,
        focal_gain=np.zeros(6) if focal_gain is None else focal_gain,
        readout_gain=np.zeros(6) if readout_gain is None else readout_gain,
    )


def walked(
    rng: np.random.Generator,
) -> tuple[CalibrationEffect, list[FloatArray], list[FloatArray], ImageErrors]:
    """Return the effect after some steps; the gain of each, what it was corrected by, and the
    newest estimate."""
    effect = CalibrationEffect.none()
    gains = [0.01 * rng.normal(size=(6, NUM_COEFFICIENTS)) for _ in range(STEPS)]
    used = [0.1 * rng.normal(size=NUM_COEFFICIENTS) for _ in range(STEPS)]
    errors = of_lenses(0.1 * rng.normal(size=NUM_COEFFICIENTS))
    for gain, used_px in zip(gains, used, strict=True):
        effect = effect.with_new_frame(-1, FORWARD)
        effect = effect.with_step(
            moves(gain), used=of_lenses(used_px), errors=errors, velocity_cov=NO_COV
        )
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
    claimed = effect.pose_cov(STEPS)
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
    seen = ScalarEquations(with_focal, 0.0, 0.0)
    errors = replace(errors, cov=1e-9 * np.eye(len(errors.mean)), focal_seen=seen)
    adjoint = se3.adjoint(FORWARD)
    for second, turns in ((1.0, "alike"), (-1.0, "back")):
        effect = CalibrationEffect.none()
        expected = np.zeros(6)
        for sign in (1.0, second):
            gain = sign * rng.normal(size=(6, NUM_COEFFICIENTS))
            focal_gain = sign * np.array([0.0, 0.0, 0.0, 0.0, 0.05, 0.0])
            effect = effect.with_new_frame(-1, FORWARD)
            effect = effect.with_step(
                moves(gain, focal_gain), used=errors, errors=errors, velocity_cov=NO_COV
            )
            moved = focal_gain + gain @ errors.distortion_shift_by_focal
            expected = adjoint @ expected + moved
        S = effect.path.field[2]
        claimed = effect.pose_cov(2) - S @ errors.distortion_cov @ S.T
        expected *= errors.focal_rms
        np.testing.assert_allclose(claimed, np.outer(expected, expected), atol=1e-12, err_msg=turns)


def test_a_readout_that_is_noticed_late_has_moved_the_steps_before() -> None:
    """Against errors g_k (τ − τ_k) + G_k (c − ĉ) of single steps, for 20,000 readout times of the
    newest estimate, along which the field moves."""
    rng = np.random.default_rng(5)
    known = of_lenses(np.zeros(NUM_COEFFICIENTS))
    known = replace(known, cov=1e-12 * np.eye(len(known.mean)))
    with_readout = 1e11 * rng.normal(size=len(known.mean))
    seen = ScalarEquations(with_readout, 1e13, 0.0)
    noticed = replace(known, readout_seen=seen, readout_s=0.02)
    seen = seen._replace(information=1e6 - with_readout @ noticed.shift_by_readout)
    noticed = replace(noticed, readout_seen=seen)
    sigma_s = noticed.readout_sigma_s
    assert 5e-4 < sigma_s < 2e-3
    readout_s = 0.02 + sigma_s * rng.normal(size=20_000)
    fields = np.outer(readout_s - 0.02, noticed.distortion_shift_by_readout)
    adjoint = se3.adjoint(FORWARD)
    effect = CalibrationEffect.none()
    error = np.zeros((len(readout_s), 6))
    for k in range(STEPS):
        used = known if k < 3 else noticed
        gain = 0.01 * rng.normal(size=(6, NUM_COEFFICIENTS))
        readout_gain = rng.normal(size=6)
        effect = effect.with_new_frame(-1, FORWARD)
        effect = effect.with_step(
            moves(gain, readout_gain=readout_gain), used=used, errors=noticed, velocity_cov=NO_COV
        )
        error = error @ adjoint.T + fields @ gain.T
        error += np.outer(readout_s - used.readout_s, readout_gain)
    claimed = effect.pose_cov(STEPS)
    sigma = np.sqrt(np.diagonal(claimed))
    sampled = error.T @ error / len(error)
    np.testing.assert_allclose(
        sampled / np.outer(sigma, sigma), claimed / np.outer(sigma, sigma), atol=0.05
    )
    # Until it is noticed, the shutter is taken for a global one.
    effect = CalibrationEffect.none().with_new_frame(-1, FORWARD)
    effect = effect.with_step(
        moves(gain, readout_gain=readout_gain), used=known, errors=known, velocity_cov=NO_COV
    )
    np.testing.assert_allclose(effect.pose_cov(1), gain @ known.distortion_cov @ gain.T, atol=1e-18)


def test_a_field_that_is_what_all_steps_were_corrected_by_and_is_known_moves_nothing() -> None:
    rng = np.random.default_rng(2)
    errors = of_lenses(0.1 * rng.normal(size=NUM_COEFFICIENTS))
    errors = replace(errors, cov=1e-18 * np.eye(len(errors.mean)))
    effect = CalibrationEffect.none()
    for _ in range(STEPS):
        effect = effect.with_new_frame(-1, FORWARD)
        gain = 0.01 * rng.normal(size=(6, NUM_COEFFICIENTS))
        effect = effect.with_step(moves(gain), used=errors, errors=errors, velocity_cov=NO_COV)
    np.testing.assert_allclose(effect.pose_cov(STEPS), 0.0, atol=1e-15)


def test_frames_are_left_out_by_mask_and_by_slice() -> None:
    effect, *_ = walked(np.random.default_rng(3))
    last = effect.pose_cov(STEPS)
    np.testing.assert_array_equal(effect.subset(slice(1, None)).pose_cov(STEPS - 1), last)
    keep = np.array([True, False, True, True, False, True])
    np.testing.assert_array_equal(effect.subset(keep).pose_cov(3), last)


def test_what_is_unknown_of_the_velocity_moves_the_pose_of_its_frame_only() -> None:
    """Half of it is that of either frame: the motion of two that follow each other has all."""
    rng = np.random.default_rng(4)
    errors = of_lenses(np.zeros(NUM_COEFFICIENTS))
    root = rng.normal(size=(6, 6))
    cov = root @ root.T
    effect = CalibrationEffect.none()
    for _ in range(2):
        effect = effect.with_new_frame(-1, np.eye(4))
        effect = effect.with_step(CommonMode.none(), used=errors, errors=errors, velocity_cov=cov)
    effect = effect.with_new_frame(-1, np.eye(4))
    np.testing.assert_allclose(effect.pose_cov(2), 0.5 * cov)
    np.testing.assert_allclose(effect.pose_cov(3), 0.0)
    np.testing.assert_allclose(effect.between(2, 1, np.eye(6)), cov)
    np.testing.assert_allclose(effect.between(2, 2, np.eye(6)), 0.0)
    turned = se3.adjoint(FORWARD)
    np.testing.assert_allclose(effect.between(3, 2, turned), turned @ (0.5 * cov) @ turned.T)
    np.testing.assert_allclose(effect.subset(slice(2, None)).pose_cov(0), 0.5 * cov)

"""The rig's calibration as a value: its correction, and what stereo matches teach of the rows."""

from dataclasses import replace

import numpy as np
import pytest

from probevo.camera.image_errors import NUM_ERRORS, ImageEquations, ScalarEquations
from probevo.camera.rig_calibration import (
    CONSTANT_SIGMA_PX,
    CORRELATED_FEATURES,
    ROW_SIGMA_PX,
    RigCalibration,
    row_basis,
)
from probevo.camera.rig_rows_numba import RADIAL, ROLL
from worlds import (
    CAMERA,
    RIG_DISPARITY_PX,
    RIG_ROWS_PX,
    image_errors,
    misrectified,
    seen_twice,
)


def test_correction_undoes_the_error() -> None:
    """A calibration that is the truth gives back what a flawless pair would show."""
    clean = seen_twice(np.random.default_rng(4), 100)
    rig = replace(RigCalibration.initial(), rows=RIG_ROWS_PX, image=image_errors(RIG_DISPARITY_PX))
    for pixels in (clean.prev_px, clean.curr_px):
        corrected = rig.corrected(misrectified(pixels), CAMERA)
        np.testing.assert_allclose(corrected, pixels, atol=1e-10)


def test_correction_leaves_the_left_image_and_its_argument_as_they_are() -> None:
    pixels = misrectified(seen_twice(np.random.default_rng(4), 100).prev_px)
    before = pixels.copy()
    rig = replace(RigCalibration.initial(), rows=RIG_ROWS_PX, image=image_errors(RIG_DISPARITY_PX))
    corrected = rig.corrected(pixels, CAMERA)
    np.testing.assert_array_equal(corrected[:, :2], before[:, :2])
    np.testing.assert_array_equal(pixels, before)


def test_initial_calibration_corrects_nothing() -> None:
    pixels = seen_twice(np.random.default_rng(4), 100).prev_px
    np.testing.assert_array_equal(RigCalibration.initial().corrected(pixels, CAMERA), pixels)


def test_tracks_are_corrected_in_both_frames() -> None:
    clean = seen_twice(np.random.default_rng(4), 100)
    rig = replace(RigCalibration.initial(), rows=RIG_ROWS_PX, image=image_errors(RIG_DISPARITY_PX))
    tracks = replace(
        clean, prev_px=misrectified(clean.prev_px), curr_px=misrectified(clean.curr_px)
    )
    corrected = tracks.corrected(rig, CAMERA)
    np.testing.assert_allclose(corrected.prev_px, clean.prev_px, atol=1e-10)
    np.testing.assert_allclose(corrected.curr_px, clean.curr_px, atol=1e-10)


def test_rows_of_one_frame_are_least_squares_under_the_prior() -> None:
    """Ridge regression in closed form: without noise all weights of the Student-t tend to 6/5."""
    pixels = misrectified(seen_twice(np.random.default_rng(5), 3000).curr_px)
    rig = RigCalibration.initial().with_rows(pixels, CAMERA)
    basis = row_basis(pixels, CAMERA)
    weight = 1.2 / (0.2**2 * 20.0)
    information = np.diag(ROW_SIGMA_PX**-2.0) + weight * basis.T @ basis
    rows = np.linalg.solve(information, weight * basis.T @ (pixels[:, 3] - pixels[:, 1]))
    np.testing.assert_allclose(rig.rows_information, information, rtol=0.02)
    np.testing.assert_allclose(rig.rows, rows, atol=0.005)


def test_the_roll_of_the_right_image_is_undone() -> None:
    """A right camera that is rolled by 0.5° moves u_r by up to 2 px. Its rows show the roll, and of
    the disparity's error less than 0.1 px is left."""
    rng = np.random.default_rng(8)
    clean = seen_twice(rng, 1000).curr_px
    roll_rad = np.deg2rad(0.5)
    seen = clean.copy()
    center_px = np.array([CAMERA.cu_px, CAMERA.cv_px])
    turn = np.array([[np.cos(roll_rad), -np.sin(roll_rad)], [np.sin(roll_rad), np.cos(roll_rad)]])
    seen[:, 2:] = (clean[:, 2:] - center_px) @ turn.T + center_px
    rig = RigCalibration.initial()
    for _ in range(5):
        rig = rig.with_rows(seen, CAMERA)
    np.testing.assert_allclose(rig.rows[ROLL], CAMERA.fv_px * roll_rad, rtol=0.05)
    corrected = rig.corrected(seen, CAMERA)
    assert np.abs(seen[:, 2] - clean[:, 2]).max() > 1.0
    assert np.abs(corrected[:, 2] - clean[:, 2]).max() < 0.1
    assert np.abs(corrected[:, 3] - clean[:, 3]).max() < 0.1


def test_what_the_right_lens_distorts_by_more_is_undone() -> None:
    """Distorted by r² in proportion: the rows show it, and u_r is mended by it, too."""
    clean = seen_twice(np.random.default_rng(9), 1000).curr_px
    clean = clean[clean[:, 2] > 0.0]
    center_px = np.array([CAMERA.cu_px, CAMERA.cv_px])
    focal_px = np.array([CAMERA.fu_px, CAMERA.fv_px])
    place = (clean[:, 2:] - center_px) / focal_px
    seen = clean.copy()
    distorted = place * (1.0 + 0.01 * (place**2).sum(axis=1, keepdims=True))
    seen[:, 2:] = distorted * focal_px + center_px
    rig = RigCalibration.initial()
    for _ in range(20):
        rig = rig.with_rows(seen, CAMERA)
    corrected = rig.corrected(seen, CAMERA)
    assert np.abs(seen[:, 2] - clean[:, 2]).max() > 0.8
    assert np.abs(corrected[:, 2] - clean[:, 2]).max() < 0.15
    assert np.abs(corrected[:, 3] - clean[:, 3]).max() < 0.03


def test_wrong_matches_hardly_move_the_rows() -> None:
    rng = np.random.default_rng(6)
    pixels = misrectified(seen_twice(rng, 500).curr_px)
    clean = RigCalibration.initial().with_rows(pixels, CAMERA)
    pixels[:50, 3] += rng.uniform(3.0, 20.0, 50)
    disturbed = RigCalibration.initial().with_rows(pixels, CAMERA)
    assert np.abs(disturbed.rows - clean.rows).max() < 0.1


def test_no_matches_teach_nothing() -> None:
    rig = RigCalibration.initial().with_rows(np.zeros((0, 4)), CAMERA)
    np.testing.assert_array_equal(rig.rows, np.zeros(7))
    np.testing.assert_array_equal(rig.rows_information, RigCalibration.initial().rows_information)


def test_another_radial_error_changes_the_image_errors_with_it() -> None:
    """As if all motions so far had been solved with the new a₆: their normal equations say so."""
    rng = np.random.default_rng(10)
    pixels = misrectified(seen_twice(rng, 400).curr_px)
    with_radial = rng.normal(scale=30.0, size=NUM_ERRORS)
    root = rng.normal(size=(NUM_ERRORS, 2 * NUM_ERRORS))
    information = root @ root.T
    truth = rng.normal(scale=0.2, size=NUM_ERRORS)
    before = RigCalibration.initial().with_image_errors(
        ImageEquations(
            information,
            information @ truth,
            with_radial,
            focal=ScalarEquations.none(),
            readout=ScalarEquations.none(),
        )
    )
    after = before.with_rows(pixels, CAMERA)
    change_px = after.rows[RADIAL] - before.rows[RADIAL]
    assert abs(change_px) > 0.1
    gradient = -with_radial / CORRELATED_FEATURES * change_px
    moved = before.image.cov @ gradient
    np.testing.assert_allclose(after.image.mean, before.image.mean + moved, atol=1e-12)
    np.testing.assert_array_equal(after.image.cov, before.image.cov)


def test_neighbouring_features_count_for_less_in_the_image_errors() -> None:
    information = 100.0 * np.eye(NUM_ERRORS)
    rig = RigCalibration.initial().with_image_errors(
        ImageEquations(
            information,
            np.zeros(NUM_ERRORS),
            np.zeros(NUM_ERRORS),
            focal=ScalarEquations(np.zeros(NUM_ERRORS), 200.0, 0.0),
            readout=ScalarEquations.none(),
        )
    )
    np.testing.assert_allclose(rig.image.seen, information / CORRELATED_FEATURES, rtol=1e-12)
    assert rig.image.focal_seen.information == pytest.approx(200.0 / CORRELATED_FEATURES)


def test_disparity_covariance_holds_the_constant_that_is_not_estimated() -> None:
    rig = RigCalibration.initial()
    expected = np.zeros((3, 3))
    expected[0, 0] = CONSTANT_SIGMA_PX**2
    expected[1:, 1:] = rig.image.disparity_cov
    np.testing.assert_allclose(rig.disparity_and_field_cov[:3, :3], expected, rtol=1e-12)

"""Errors of the rectification that are known because they were put in: are they found, and is their
doubt honest?"""

from dataclasses import replace

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo.estimation.reprojection import ReprojectionSolution, solve_reprojection
from probevo.estimation.rig_calibration import (
    CONSTANT_SIGMA_PX,
    DISPARITY_SIGMA_PX,
    ROW_SIGMA_PX,
    SelfCalibration,
    disparity_basis,
    disparity_sensitivity,
    row_basis,
)
from probevo.geometry import se3
from probevo.noise import Fixed, StudentT
from probevo.tracking.tracks import Tracks
from worlds import CAMERA, FORWARD, motion_error, seen_twice

ROWS_PX = np.array([0.6, -0.4, 0.3, 0.5, 4.0, -0.5])
"""True a₀ … a₅; a₄ is of the size that KITTI shows."""
DISPARITY_PX = np.array([0.4, -1.2])
"""True b₁, b₂."""


def misrectified(
    pixels: FloatArray,
    rows_px: FloatArray = ROWS_PX,
    disparity_px: FloatArray = DISPARITY_PX,
    b0_px: float = 0.0,
) -> FloatArray:
    """What a pair with these errors shows of points that a flawless one would show at ``pixels``,
    [N, 4], px."""
    seen = pixels.copy()
    seen[:, 2] += (
        disparity_basis(pixels, CAMERA) @ np.r_[b0_px, disparity_px]
    )  # true minus measured disparity
    seen[:, 3] += row_basis(pixels, CAMERA) @ rows_px
    return seen


def misrectified_tracks(tracks: Tracks, *errors: FloatArray | float) -> Tracks:
    """Both observations of clean tracks, disturbed."""
    return replace(
        tracks,
        prev_px=misrectified(tracks.prev_px, *errors),
        curr_px=misrectified(tracks.curr_px, *errors),
    )


def with_noise(rng: np.random.Generator, tracks: Tracks, sigma_px: float | FloatArray) -> Tracks:
    prev_noise, curr_noise = sigma_px * rng.normal(size=(2, len(tracks), 4))
    return replace(tracks, prev_px=tracks.prev_px + prev_noise, curr_px=tracks.curr_px + curr_noise)


def solve(
    tracks: Tracks, noise: Fixed | StudentT, guess: FloatArray = FORWARD
) -> ReprojectionSolution:
    predicted = noise.predict(np.zeros((len(tracks), 0)))
    return solve_reprojection(tracks.prev_px, tracks.curr_px, predicted, guess=guess, camera=CAMERA)


def learn(
    rng: np.random.Generator,
    frames: int = 60,
    *,
    disparity_px: FloatArray = DISPARITY_PX,
    sigma_px: float | FloatArray = 0.2,
    depth_m: tuple[float, float] = (5.0, 60.0),
) -> tuple[SelfCalibration, FloatArray]:
    """The belief after a drive, and the motion's error ξ of each frame, [frames, 6]."""
    belief = SelfCalibration.initial()
    errors = []
    for _ in range(frames):
        clean = seen_twice(rng, 200, depth_m=depth_m)
        tracks = with_noise(rng, misrectified_tracks(clean, ROWS_PX, disparity_px), sigma_px)
        belief = belief.with_rows(tracks.curr_px, CAMERA)
        corrected = belief.corrected_tracks(tracks, CAMERA)
        solution = solve(corrected, StudentT())
        belief, _ = belief.with_motion(corrected, solution, CAMERA)
        errors.append(motion_error(solution.T_curr_prev))
    return belief, np.array(errors)


def sigma_of(information: FloatArray) -> FloatArray:
    return np.sqrt(np.diagonal(np.linalg.inv(information)))


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_rows_converge_to_the_truth(seed: int) -> None:
    belief, _ = learn(np.random.default_rng(seed))
    sigma = sigma_of(belief.rows_information)
    assert (np.abs(belief.rows - ROWS_PX) < 3.0 * sigma).all()
    assert (sigma < 0.35 * ROW_SIGMA_PX).all()  # y² is known least: the image is low


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_disparity_converges_to_the_truth(seed: int) -> None:
    """σ counts twenty features as one, so that independent ones end well inside of it."""
    belief, _ = learn(np.random.default_rng(seed))
    sigma = sigma_of(belief.disparity_information)
    assert (np.abs(belief.disparity - DISPARITY_PX) < 2.0 * sigma).all()
    assert (sigma < 0.25 * DISPARITY_SIGMA_PX).all()


def test_the_scale_of_the_motion_is_mended() -> None:
    """Uncorrected, points at the sides seem too near; later frames have less than a third of the
    first one's error."""
    _, errors = learn(np.random.default_rng(3))
    assert np.abs(errors[-20:, 2].mean()) < np.abs(errors[0, 2]) / 3.0


def test_correction_undoes_the_error() -> None:
    """A belief that is the truth gives back what a flawless pair would show."""
    clean = seen_twice(np.random.default_rng(4), 100)
    belief = replace(SelfCalibration.initial(), rows=ROWS_PX, disparity=DISPARITY_PX)
    mended = belief.corrected_tracks(misrectified_tracks(clean), CAMERA)
    np.testing.assert_allclose(mended.prev_px, clean.prev_px, atol=1e-10)
    np.testing.assert_allclose(mended.curr_px, clean.curr_px, atol=1e-10)


def test_rows_of_one_frame_are_least_squares_under_the_prior() -> None:
    """Ridge regression in closed form: without noise the weights of the Student-t all tend to 6/5."""
    pixels = misrectified(seen_twice(np.random.default_rng(5), 3000).curr_px)
    belief = SelfCalibration.initial().with_rows(pixels, CAMERA)
    basis = row_basis(pixels, CAMERA)
    weight = 1.2 / (0.2**2 * 20.0)
    information = np.diag(ROW_SIGMA_PX**-2.0) + weight * basis.T @ basis
    rows = np.linalg.solve(information, weight * basis.T @ (pixels[:, 3] - pixels[:, 1]))
    np.testing.assert_allclose(belief.rows_information, information, rtol=0.02)
    np.testing.assert_allclose(belief.rows, rows, atol=0.005)


def test_wrong_matches_hardly_move_the_rows() -> None:
    rng = np.random.default_rng(6)
    pixels = misrectified(seen_twice(rng, 500).curr_px)
    alone = SelfCalibration.initial().with_rows(pixels, CAMERA)
    pixels[:50, 3] += rng.uniform(3.0, 20.0, 50)
    assert np.abs(SelfCalibration.initial().with_rows(pixels, CAMERA).rows - alone.rows).max() < 0.1


def test_a_flawless_pair_stays_uncorrected() -> None:
    belief, _ = learn(np.random.default_rng(7), disparity_px=np.zeros(2))
    assert (np.abs(belief.disparity) < 2.0 * sigma_of(belief.disparity_information)).all()
    assert np.abs(belief.disparity).max() < 0.1


def test_disparity_noise_alone_does_not_make_it_run_away() -> None:
    """1 px on disparities of 4 to 13 px, five times what the model says, and no error of the
    rectification."""
    sigma_px = np.array([0.2, 0.2, 1.0, 0.2])
    belief, _ = learn(
        np.random.default_rng(8), disparity_px=np.zeros(2), sigma_px=sigma_px, depth_m=(30.0, 100.0)
    )
    assert np.abs(belief.disparity).max() < 0.25


def test_at_rest_nothing_is_learned() -> None:
    """Both views move alike with the disparity's error: the information stays the prior's."""
    tracks = misrectified_tracks(seen_twice(np.random.default_rng(9), 300, np.eye(4)))
    belief = SelfCalibration.initial()
    for _ in range(20):
        solution = solve(tracks, StudentT(), np.eye(4))
        belief, _ = belief.with_motion(tracks, solution, CAMERA)
    np.testing.assert_allclose(
        belief.disparity_information, np.diag(DISPARITY_SIGMA_PX**-2.0), atol=1e-9
    )
    np.testing.assert_allclose(belief.disparity, 0.0, atol=1e-9)


def test_noise_at_rest_teaches_hardly_anything() -> None:
    """200 pairs of frames, in which the noise passes for a motion of millimetres."""
    rng = np.random.default_rng(13)
    belief = SelfCalibration.initial()
    for _ in range(200):
        tracks = seen_twice(rng, 200, np.eye(4), sigma_px=0.2)
        belief, _ = belief.with_motion(tracks, solve(tracks, StudentT(), np.eye(4)), CAMERA)
    assert (sigma_of(belief.disparity_information) > 0.95 * DISPARITY_SIGMA_PX).all()
    assert np.abs(belief.disparity).max() < 0.15


def test_what_is_learned_does_not_depend_on_the_motion_that_it_is_seen_from() -> None:
    """At the optimum, or half a standard deviation beside it, where the motion is pulled back."""
    rng = np.random.default_rng(14)
    tracks = misrectified_tracks(seen_twice(rng, 300, sigma_px=0.1))
    best = solve(tracks, Fixed())
    beside = se3.exp(0.5 * np.linalg.cholesky(best.cov) @ rng.normal(size=6)) @ best.T_curr_prev
    noise = Fixed().predict(np.zeros((300, 0)))
    there = solve_reprojection(
        tracks.prev_px, tracks.curr_px, noise, guess=beside, camera=CAMERA, max_iterations=0
    )
    learned = [
        SelfCalibration.initial().with_motion(tracks, each, CAMERA)[0].disparity
        for each in (best, there)
    ]
    assert np.abs(learned[0]).max() > 0.1
    np.testing.assert_allclose(learned[1], learned[0], atol=0.02 * np.abs(learned[0]).max())


def test_sensitivity_is_the_derivative_of_the_residuals() -> None:
    """∂e/∂b against central differences of y' − f(T g(y)), T held."""
    tracks = seen_twice(np.random.default_rng(10), 50)
    solution = solve(tracks, Fixed())

    def residuals(b: FloatArray) -> FloatArray:
        prev_px = tracks.prev_px.copy()
        curr_px = tracks.curr_px.copy()
        prev_px[:, 2] -= disparity_basis(tracks.prev_px, CAMERA) @ b
        curr_px[:, 2] -= disparity_basis(tracks.curr_px, CAMERA) @ b
        return curr_px - CAMERA.project(
            se3.transform(solution.T_curr_prev, CAMERA.triangulate(prev_px))
        )

    steps = 1e-5 * np.eye(3)
    numeric = np.stack([(residuals(step) - residuals(-step)) / 2e-5 for step in steps], axis=-1)
    np.testing.assert_allclose(disparity_sensitivity(tracks, solution, CAMERA), numeric, atol=1e-6)


def test_shared_error_is_the_spread_over_the_doubt() -> None:
    """400 motions solved with b₀, b₁, b₂ drawn from the belief: variances agree within 25 % (3.5 of
    their own σ), and so does the largest direction. Points are near enough for the disparity's
    error to act linearly."""
    rng = np.random.default_rng(11)
    clean = seen_twice(rng, 100, depth_m=(4.0, 12.0))
    belief = replace(
        SelfCalibration.initial(), disparity_information=np.diag([0.4**-2.0, 0.6**-2.0])
    )
    _, columns = belief.with_motion(clean, solve(clean, Fixed()), CAMERA)
    claimed = columns @ columns.T
    errors = []
    for b in rng.normal(size=(400, 3)) * [CONSTANT_SIGMA_PX, 0.4, 0.6]:
        tracks = misrectified_tracks(clean, np.zeros(6), b[1:], b[0])
        errors.append(motion_error(solve(tracks, Fixed()).T_curr_prev))
    spread = np.cov(np.array(errors).T)
    np.testing.assert_allclose(np.diagonal(spread), np.diagonal(claimed), rtol=0.25)
    scale = np.sqrt(np.diagonal(claimed))
    assert np.abs((spread - claimed) / np.outer(scale, scale)).max() < 0.25


def test_shared_error_shrinks_with_the_doubt_to_that_of_the_constant() -> None:
    clean = seen_twice(np.random.default_rng(12), 100)
    solution = solve(clean, Fixed())
    sure = replace(SelfCalibration.initial(), disparity_information=1e12 * np.eye(2))
    columns = (b.with_motion(clean, solution, CAMERA)[1] for b in (SelfCalibration.initial(), sure))
    doubtful, certain = (c @ c.T for c in columns)
    assert np.linalg.eigvalsh(doubtful - certain)[0] > -1e-12
    assert np.linalg.matrix_rank(certain / certain.max(), tol=1e-6) == 1


def test_no_matches_teach_nothing() -> None:
    belief = SelfCalibration.initial().with_rows(np.zeros((0, 4)), CAMERA)
    np.testing.assert_array_equal(belief.rows, np.zeros(6))
    np.testing.assert_array_equal(
        belief.rows_information, SelfCalibration.initial().rows_information
    )


def test_features_that_fix_no_motion_teach_nothing() -> None:
    """Three of them at one point; a gyro may make up for it, but the normal equations of the
    features are singular."""
    clean = seen_twice(np.random.default_rng(8), 1).kept(np.zeros(3, np.int64))
    belief = SelfCalibration.initial()
    solution = solve(clean, StudentT())
    assert np.isnan(solution.cov).all()
    after, doubt = belief.with_motion(clean, replace(solution, hessian=np.zeros((6, 6))), CAMERA)
    assert after is belief
    np.testing.assert_array_equal(doubt, 0.0)

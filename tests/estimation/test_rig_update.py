"""Known errors of the rectification: the residuals reveal them, with a consistent covariance."""

from dataclasses import replace

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo.camera.distortion_field import NUM_COEFFICIENTS, root_mean_square_px
from probevo.camera.image_errors import DISPARITY_SIGMA_PX, FOCAL_SIGMA, NUM_ERRORS
from probevo.camera.rig_calibration import (
    CONSTANT_SIGMA_PX,
    ROW_SIGMA_PX,
    RigCalibration,
    disparity_basis,
)
from probevo.camera.rig_jitter import RigJitter
from probevo.camera.rolling_shutter import Twists, without_readout
from probevo.camera.transfer import transfer
from probevo.estimation.reprojection import ReprojectionSolution, solve_reprojection
from probevo.estimation.rig_update import calibration_sensitivity, update_rig
from probevo.geometry import se3
from probevo.measurements.stereo_observations import StereoObservations
from probevo.noise import Fixed, StudentT
from probevo.tracking.tracks import Tracks
from worlds import (
    CAMERA,
    FORWARD,
    RIG_DISPARITY_PX,
    RIG_ROWS_PX,
    image_errors,
    misrectified,
    motion_error,
    random_pixels,
    seen_twice,
    tracks_of,
)

TWIST_S = 10.0 * se3.log(FORWARD)
TWISTS = Twists(TWIST_S, TWIST_S)
"""A tenth of a second between two frames."""


def misrectified_tracks(
    tracks: Tracks,
    rows_px: FloatArray = RIG_ROWS_PX,
    disparity_px: FloatArray = RIG_DISPARITY_PX,
    b0_px: float = 0.0,
) -> Tracks:
    """Both observations of clean tracks, disturbed."""
    return replace(
        tracks,
        prev_px=misrectified(tracks.prev_px, rows_px, disparity_px, b0_px),
        curr_px=misrectified(tracks.curr_px, rows_px, disparity_px, b0_px),
    )


def with_noise(rng: np.random.Generator, tracks: Tracks, sigma_px: float | FloatArray) -> Tracks:
    prev_noise, curr_noise = sigma_px * rng.normal(size=(2, len(tracks), 4))
    return replace(tracks, prev_px=tracks.prev_px + prev_noise, curr_px=tracks.curr_px + curr_noise)


def solve(
    tracks: Tracks, noise: Fixed | StudentT, guess: FloatArray = FORWARD
) -> ReprojectionSolution:
    predicted = noise.predict(np.zeros((len(tracks), 0)))
    return solve_reprojection(
        StereoObservations.of(tracks.prev_px, tracks.curr_px, predicted, camera=CAMERA), guess=guess
    )


def learn(
    rng: np.random.Generator,
    frames: int = 60,
    *,
    rows_px: FloatArray = RIG_ROWS_PX,
    disparity_px: FloatArray = RIG_DISPARITY_PX,
    sigma_px: float | FloatArray = 0.2,
    depth_m: tuple[float, float] = (5.0, 60.0),
) -> tuple[RigCalibration, FloatArray]:
    """The calibration after a drive, and the motion's error ξ of each frame, [frames, 6]."""
    rig = RigCalibration.initial()
    errors = []
    for _ in range(frames):
        clean = seen_twice(rng, 200, depth_m=depth_m)
        tracks = with_noise(rng, misrectified_tracks(clean, rows_px, disparity_px), sigma_px)
        rig = rig.with_rows(tracks.curr_px, CAMERA)
        corrected = tracks.corrected(rig, CAMERA)
        solution = solve(corrected, StudentT())
        rig, _ = update_rig(rig, corrected, solution, CAMERA, TWISTS)
        errors.append(motion_error(solution.T_curr_prev))
    return rig, np.array(errors)


def sigma_of(information: FloatArray) -> FloatArray:
    return np.sqrt(np.diagonal(np.linalg.inv(information)))


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_rows_converge_to_the_truth(seed: int) -> None:
    rig, _ = learn(np.random.default_rng(seed))
    sigma = sigma_of(rig.rows_information)
    assert (np.abs(rig.rows - RIG_ROWS_PX) < 3.0 * sigma).all()
    assert (sigma < 0.35 * ROW_SIGMA_PX).all()  # y² is known least: the image is low


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_disparity_converges_to_the_truth(seed: int) -> None:
    """σ counts twenty features as one, so that independent ones end well inside of it."""
    rig, _ = learn(np.random.default_rng(seed))
    sigma = np.sqrt(np.diagonal(rig.image.disparity_cov))
    assert (np.abs(rig.disparity - RIG_DISPARITY_PX) < 2.0 * sigma).all()
    assert (sigma < 0.25 * DISPARITY_SIGMA_PX).all()


def test_the_scale_of_the_motion_is_corrected() -> None:
    """Uncorrected, points at the sides seem too near; later frames have less than a third of the
    first one's error."""
    _, errors = learn(np.random.default_rng(3))
    assert np.abs(errors[-20:, 2].mean()) < np.abs(errors[0, 2]) / 3.0


def test_a_flawless_pair_stays_uncorrected() -> None:
    rig, _ = learn(np.random.default_rng(7), rows_px=np.zeros(7), disparity_px=np.zeros(2))
    assert np.abs(rig.disparity).max() < 0.1
    # b is that which belongs to a₆: what both do together is what counts.
    clean = seen_twice(np.random.default_rng(8), 1000).curr_px
    correction_px = (rig.corrected(clean, CAMERA) - clean)[:, 2]
    assert np.sqrt(np.mean(correction_px**2)) < 0.03


def test_disparity_noise_does_not_make_it_run_away() -> None:
    """1 px on disparities of 4 to 13 px, five times what the model says, and no error of the
    rectification."""
    sigma_px = np.array([0.2, 0.2, 1.0, 0.2])
    rig, _ = learn(
        np.random.default_rng(8), disparity_px=np.zeros(2), sigma_px=sigma_px, depth_m=(30.0, 100.0)
    )
    assert np.abs(rig.disparity).max() < 0.25


def test_at_rest_nothing_is_learned() -> None:
    """Both views move alike with the disparity's error: the information stays the prior's."""
    tracks = misrectified_tracks(seen_twice(np.random.default_rng(9), 300, np.eye(4)))
    rig = RigCalibration.initial()
    for _ in range(20):
        solution = solve(tracks, StudentT(), np.eye(4))
        rig, _ = update_rig(rig, tracks, solution, CAMERA, TWISTS)
    np.testing.assert_allclose(rig.image.seen, 0.0, atol=1e-9)
    np.testing.assert_allclose(rig.image.mean, 0.0, atol=1e-9)


def test_noise_at_rest_teaches_hardly_anything() -> None:
    """200 pairs of frames, in which the noise passes for a motion of millimetres."""
    rng = np.random.default_rng(13)
    rig = RigCalibration.initial()
    for _ in range(200):
        tracks = seen_twice(rng, 200, np.eye(4), sigma_px=0.2)
        solution = solve(tracks, StudentT(), np.eye(4))
        rig, _ = update_rig(rig, tracks, solution, CAMERA, TWISTS)
    sigma_px = np.sqrt(np.diagonal(rig.image.disparity_cov))
    assert (sigma_px > 0.95 * DISPARITY_SIGMA_PX).all()
    assert np.abs(rig.disparity).max() < 0.15


def test_what_is_learned_does_not_depend_on_the_motion_that_it_is_seen_from() -> None:
    """At the optimum, or half a standard deviation beside it, where the motion is pulled back."""
    rng = np.random.default_rng(14)
    tracks = misrectified_tracks(seen_twice(rng, 300, sigma_px=0.1))
    best = solve(tracks, Fixed())
    beside = se3.exp(0.5 * np.linalg.cholesky(best.cov) @ rng.normal(size=6)) @ best.T_curr_prev
    noise = Fixed().predict(np.zeros((300, 0)))
    there = solve_reprojection(
        StereoObservations.of(tracks.prev_px, tracks.curr_px, noise, camera=CAMERA),
        guess=beside,
        max_iterations=0,
    )
    learned = [
        update_rig(RigCalibration.initial(), tracks, each, CAMERA, TWISTS)[0].disparity
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
    sensitivity = calibration_sensitivity(tracks, solution, CAMERA, TWISTS)[:, :, :3]
    np.testing.assert_allclose(sensitivity, numeric, atol=1e-6)


def test_the_distortion_field_acts_on_the_residuals_as_its_sensitivity_says() -> None:
    """∂e/∂(coefficients) against central differences of y' − f(T g(y)), T held."""
    tracks = seen_twice(np.random.default_rng(15), 50)
    solution = solve(tracks, Fixed())

    def residuals(coefficients_px: FloatArray) -> FloatArray:
        rig = replace(RigCalibration.initial(), image=image_errors(distortion_px=coefficients_px))
        moved = tracks.corrected(rig, CAMERA)
        return moved.curr_px - CAMERA.project(
            se3.transform(solution.T_curr_prev, CAMERA.triangulate(moved.prev_px))
        )

    steps = 1e-5 * np.eye(NUM_COEFFICIENTS)
    numeric = np.stack([(residuals(step) - residuals(-step)) / 2e-5 for step in steps], axis=-1)
    sensitivity = calibration_sensitivity(tracks, solution, CAMERA, TWISTS)[:, :, 3:-3]
    np.testing.assert_allclose(sensitivity, numeric, atol=1e-6)


@pytest.mark.parametrize("readout_s", [0.0, 0.02])
def test_the_readout_time_acts_on_the_residuals_as_its_sensitivity_says(readout_s: float) -> None:
    """∂e/∂τ against central differences of y' − f(T g(y)), T held, with other velocities at the two
    frames."""
    seen = seen_twice(np.random.default_rng(16), 50)
    change = np.array([0.5, -0.2, 1.0, 0.3, -0.4, 0.2])
    twists = Twists(TWIST_S - change, TWIST_S + change, duration_s=0.1)

    def corrected(readout_s: float) -> Tracks:
        acceleration = 2.0 * change / 0.1
        return replace(
            seen,
            prev_px=without_readout(seen.prev_px, readout_s, twists.prev, CAMERA, acceleration),
            curr_px=without_readout(seen.curr_px, readout_s, twists.curr, CAMERA, acceleration),
        )

    solution = solve(corrected(readout_s), Fixed())

    def residuals(readout_s: float) -> FloatArray:
        tracks = corrected(readout_s)
        return tracks.curr_px - CAMERA.project(
            se3.transform(solution.T_curr_prev, CAMERA.triangulate(tracks.prev_px))
        )

    numeric = (residuals(readout_s + 1e-6) - residuals(readout_s - 1e-6)) / 2e-6
    sensitivity = calibration_sensitivity(
        corrected(readout_s), solution, CAMERA, twists, readout_s=readout_s
    )
    # The derivative is taken at the refined points and to first order in τ.
    tolerance = 1e-4 if readout_s == 0.0 else 0.03
    np.testing.assert_allclose(
        sensitivity[:, :, -1], numeric, atol=tolerance * np.abs(numeric).max()
    )


def distorted(tracks: Tracks, coefficients_px: FloatArray) -> Tracks:
    """Return what lenses with this distortion field show: the correction gives the tracks back."""
    rig = replace(RigCalibration.initial(), image=image_errors(distortion_px=coefficients_px))
    seen = tracks
    for _ in range(10):
        corrected = seen.corrected(rig, CAMERA)
        seen = replace(
            seen,
            prev_px=seen.prev_px + tracks.prev_px - corrected.prev_px,
            curr_px=seen.curr_px + tracks.curr_px - corrected.curr_px,
        )
    return seen


def learn_field(
    rng: np.random.Generator, coefficients_px: FloatArray, frames: int
) -> tuple[RigCalibration, FloatArray]:
    """The calibration after a drive with turns, and the motion's error of each frame, [frames,
    6]."""
    rig = RigCalibration.initial()
    errors = []
    for k in range(frames):
        # Straight on, to the left, straight on, to the right.
        turn = se3.exp(np.array([0.0, 0.0, 0.0, 0.0, 0.03 * np.sin(0.5 * k), 0.0]))
        T_curr_prev = turn @ FORWARD
        clean = seen_twice(rng, 200, T_curr_prev, depth_m=(5.0, 60.0))
        tracks = with_noise(rng, distorted(clean, coefficients_px), 0.1)
        corrected = tracks.corrected(rig, CAMERA)
        solution = solve(corrected, StudentT(), T_curr_prev)
        rig, _ = update_rig(rig, corrected, solution, CAMERA, TWISTS)
        errors.append(motion_error(solution.T_curr_prev, T_curr_prev))
    return rig, np.array(errors)


@pytest.mark.parametrize("seed", [0, 1])
def test_the_distortion_field_converges_to_the_truth(seed: int) -> None:
    """Of 45 coefficients the errors are 1.3 of their σ at most in the mean square: twenty features
    count as one, and independent ones end inside of it. Motions, noise included, err by a third
    less."""
    rng = np.random.default_rng(20 + seed)
    truth_px = rng.normal(scale=0.3, size=NUM_COEFFICIENTS)
    rig, errors = learn_field(rng, truth_px, 120)
    sigma_px = np.sqrt(np.diagonal(rig.image.cov))[2:]
    off = (rig.image.distortion - truth_px) / sigma_px
    assert np.sqrt(np.mean(off**2)) < 1.3
    assert 0.15 < rig.image.distortion_sigma_px < 0.45
    left = np.sqrt(np.mean(errors[-30:] ** 2, axis=0)) / np.sqrt(np.mean(errors[:5] ** 2, axis=0))
    assert np.median(left) < 0.67


def test_lenses_without_distortion_stay_uncorrected() -> None:
    rng = np.random.default_rng(30)
    rig, _ = learn_field(rng, np.zeros(NUM_COEFFICIENTS), 120)
    assert max(root_mean_square_px(rig.image.distortion)) < 0.03
    assert rig.image.distortion_sigma_px < 0.03


def test_common_mode_error_is_the_spread_over_the_uncertainty() -> None:
    """400 motions solved with b₀, b₁, b₂ drawn from the prior: variances agree within 25 % (3.5 of
    their own σ), and so does the largest direction. Points are near enough for the disparity's
    error to act linearly."""
    rng = np.random.default_rng(11)
    clean = seen_twice(rng, 100, depth_m=(4.0, 12.0))
    initial = RigCalibration.initial()
    known = np.concatenate([[0.4, 0.6], np.full(NUM_COEFFICIENTS, 1e-6)])
    rig = replace(initial, image=replace(initial.image, cov=np.diag(known**2.0)))
    _, common_mode = update_rig(rig, clean, solve(clean, Fixed()), CAMERA, TWISTS)
    columns = common_mode.columns[:, :-1]  # the last one is for the focal length
    claimed = columns @ columns.T
    errors = []
    for b in rng.normal(size=(400, 3)) * [CONSTANT_SIGMA_PX, 0.4, 0.6]:
        tracks = misrectified_tracks(clean, np.zeros(7), b[1:], b[0])
        errors.append(motion_error(solve(tracks, Fixed()).T_curr_prev))
    spread = np.cov(np.array(errors).T)
    np.testing.assert_allclose(np.diagonal(spread), np.diagonal(claimed), rtol=0.25)
    scale = np.sqrt(np.diagonal(claimed))
    assert np.abs((spread - claimed) / np.outer(scale, scale)).max() < 0.25


def test_common_mode_error_is_that_of_the_joint_covariance() -> None:
    """After a drive, b and the distortion field are correlated: the part of the covariance of a
    motion is G Σ Gᵀ, with Σ that of both together and G = H⁻¹ Jᵀ w Σ_e⁻¹ D."""
    rig, _ = learn_field(np.random.default_rng(22), np.zeros(NUM_COEFFICIENTS), 20)
    assert np.abs(rig.image.cov[:2, 2:]).max() > 0.0
    tracks = seen_twice(np.random.default_rng(14), 200)
    solution = solve(tracks, StudentT())
    _, common_mode = update_rig(rig, tracks, solution, CAMERA, TWISTS)
    D = calibration_sensitivity(tracks, solution, CAMERA, TWISTS)[:, :, : 1 + NUM_ERRORS]
    weighted = solution.features.irls_weight[:, None, None] * (solution.features.information @ D)
    gain = np.linalg.solve(
        solution.hessian, np.einsum("nij,nik->jk", solution.features.jacobian, weighted)
    )
    covariance = np.zeros((1 + NUM_ERRORS, 1 + NUM_ERRORS))
    covariance[0, 0] = CONSTANT_SIGMA_PX**2
    covariance[1:, 1:] = rig.image.cov
    expected = gain @ covariance @ gain.T
    columns = common_mode.columns[:, :-1]  # the last one is for the focal length
    claimed = columns @ columns.T
    np.testing.assert_allclose(claimed, expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("turn_rad", [0.0, 0.05])
def test_a_wrong_focal_length_moves_the_motion_as_claimed(turn_rad: float) -> None:
    """f b is right: a straight motion is that without the error, and a turn is too small where f is
    too long. Image errors are known."""
    turn = se3.exp(np.array([0.0, 0.0, 0.0, 0.0, turn_rad, 0.0]))
    T_curr_prev = turn @ se3.from_parts(np.eye(3), FORWARD[:3, 3])
    epsilon = 1e-3
    true_camera = replace(
        CAMERA,
        fu_px=np.exp(epsilon) * CAMERA.fu_px,
        fv_px=np.exp(epsilon) * CAMERA.fv_px,
        baseline_m=np.exp(-epsilon) * CAMERA.baseline_m,
    )
    prev_px = random_pixels(np.random.default_rng(15), 300)
    curr_px = transfer(prev_px, T_curr_prev, true_camera)
    tracks = tracks_of(prev_px, curr_px)
    solution = solve(tracks, Fixed(), T_curr_prev)
    initial = RigCalibration.initial()
    known = replace(initial, image=replace(initial.image, cov=1e-18 * np.eye(NUM_ERRORS)))
    _, common_mode = update_rig(known, tracks, solution, CAMERA, TWISTS)
    left = se3.log(T_curr_prev @ se3.inverse(solution.T_curr_prev))
    scale = 1e-3 * epsilon * max(turn_rad, 0.01)
    np.testing.assert_allclose(epsilon * common_mode.focal_gain, left, rtol=0.02, atol=scale)
    np.testing.assert_allclose(
        common_mode.columns[:, -1], FOCAL_SIGMA * common_mode.focal_gain, rtol=1e-9, atol=1e-12
    )


def test_common_mode_error_shrinks_with_the_uncertainty_to_that_of_the_constant() -> None:
    clean = seen_twice(np.random.default_rng(12), 100)
    solution = solve(clean, Fixed())
    initial = RigCalibration.initial()
    certain = replace(initial, image=replace(initial.image, cov=1e-12 * np.eye(NUM_ERRORS)))
    covs = []
    for rig in (initial, certain):
        _, common_mode = update_rig(rig, clean, solution, CAMERA, TWISTS)
        columns = common_mode.columns[:, :-1]
        covs.append(columns @ columns.T)
    assert np.linalg.eigvalsh(covs[0] - covs[1])[0] > -1e-12
    assert np.linalg.matrix_rank(covs[1] / covs[1].max(), tol=1e-6) == 1


def test_features_that_fix_no_motion_teach_nothing() -> None:
    """Three of them at one point; a gyro may make up for it, but the normal equations of the
    features are singular."""
    clean = seen_twice(np.random.default_rng(8), 1).subset(np.zeros(3, np.int64))
    rig = RigCalibration.initial()
    solution = solve(clean, StudentT())
    assert np.isnan(solution.cov).all()
    singular = replace(solution, hessian=np.zeros((6, 6)))
    after, common_mode = update_rig(rig, clean, singular, CAMERA, TWISTS)
    assert after is rig
    np.testing.assert_array_equal(common_mode.columns, 0.0)


def test_features_that_a_loss_has_rejected_teach_nothing() -> None:
    """An alignment may have a finite covariance where the reprojection has no weight left."""
    tracks = seen_twice(np.random.default_rng(9), 60)
    rig = RigCalibration.initial()
    solution = solve(tracks, StudentT())
    nothing = replace(
        solution,
        features=replace(solution.features, irls_weight=np.zeros(60)),
        hessian=np.zeros_like(solution.hessian),
    )
    after, common_mode = update_rig(rig, tracks, nothing, CAMERA, TWISTS)
    assert after is rig
    np.testing.assert_array_equal(common_mode.columns, 0.0)


def test_a_rig_that_stands_teaches_no_more_than_a_few_frames() -> None:
    """Features repeat their errors, and the rig one flexure, for 200 frames: driving on, rows and
    jitter are learned as if it had stood for a moment."""
    rng = np.random.default_rng(20)
    clean = seen_twice(rng, 200)
    standing = replace(clean, curr_px=clean.prev_px + 0.01)
    noisy = with_noise(rng, standing, np.array([0.0, 0.3, 0.0, 0.3]))
    noisy = replace(noisy, prev_px=noisy.curr_px - 0.01)
    rig = RigCalibration.initial()
    first = None
    for _ in range(200):
        rig = rig.with_rows(noisy.curr_px, CAMERA, novelty=noisy.novelty)
        first = first or rig
        corrected = noisy.corrected(rig, CAMERA)
        noise = replace(StudentT().predict(np.zeros((len(noisy), 0))), jitter_cov=rig.jitter.cov)
        observations = StereoObservations.of(
            corrected.prev_px, corrected.curr_px, noise, camera=CAMERA
        )
        solution = solve_reprojection(observations, guess=np.eye(4))
        rig, _ = update_rig(rig, corrected, solution, CAMERA, Twists(np.zeros(6), np.zeros(6)))
    assert first is not None
    assert sigma_of(rig.rows_information)[0] > 0.9 * sigma_of(first.rows_information)[0]
    np.testing.assert_allclose(rig.jitter.sigma_rad, RigJitter.initial().sigma_rad, rtol=0.05)

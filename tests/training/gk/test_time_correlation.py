"""Time-correlated errors of disparities: the profile is the likelihood; it peaks at the true κ."""

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo.estimation.reprojection import solve_reprojection
from probevo.geometry import se3
from probevo.measurements.stereo_observations import StereoObservations
from probevo.noise import StereoNoise, StudentT
from probevo.training.gk.time_correlation import (
    TimeCorrelationProfile,
    log_likelihood,
    smallest_likely_ratio,
    time_correlation_profile,
)
from worlds import CAMERA

T_CURR_PREV = se3.exp(np.array([0.02, 0.01, -1.2, 0.003, 0.01, -0.002]))
SIGMA_PX = 0.1


def observations(
    rng: np.random.Generator, count: int, ratio: float, dof: float
) -> tuple[FloatArray, FloatArray]:
    """Draw both observations of points 5 to 60 m away, with Student-t errors.

    The time-correlated error of the disparity is ``ratio`` times the new one.
    """
    z = rng.uniform(5.0, 60.0, count)
    x = rng.uniform(-0.6, 0.6, count)
    y = rng.uniform(-0.2, 0.2, count)
    points = np.column_stack([x * z, y * z, z])
    mixing = np.ones((count, 1)) if np.isinf(dof) else np.sqrt(dof / rng.chisquare(dof, (count, 1)))
    time_correlated = np.zeros((count, 4))
    time_correlated[:, 2] = -rng.normal(scale=ratio * SIGMA_PX * np.sqrt(2.0), size=count)
    observed = []
    for p in (points, se3.transform(T_CURR_PREV, points)):
        new = rng.normal(scale=SIGMA_PX, size=(count, 4))
        observed.append(CAMERA.project(p) + mixing * (time_correlated + new))
    prev_px, curr_px = observed
    return prev_px, curr_px


def profile_of(
    seen: tuple[FloatArray, FloatArray], model: StudentT
) -> tuple[TimeCorrelationProfile, FloatArray]:
    """Return the profile, and the log likelihood of the residuals under the model, [N]."""
    prev_px, curr_px = seen
    count = len(prev_px)
    noise = model.predict(np.zeros((count, 0)))
    solution = solve_reprojection(
        StereoObservations.of(prev_px, curr_px, noise, camera=CAMERA),
        guess=T_CURR_PREV,
        max_iterations=0,
    )
    scale: FloatArray = np.linalg.inv(solution.features.information).astype(np.float64)
    residual_noise = StereoNoise(scale, noise.dof, np.zeros((count, 4)))
    profile = time_correlation_profile(solution.features, noise, np.arange(count))
    return profile, residual_noise.log_likelihood(solution.features.residuals)


@pytest.mark.parametrize("dof", [4.0, np.inf])
def test_the_profile_tells_the_likelihood_of_every_other_model(dof: float) -> None:
    """Compare with the likelihoods that models of other κ give themselves.

    Each refines the points a little differently.
    """
    seen = observations(np.random.default_rng(0), 400, 1.0, np.inf)
    scale = SIGMA_PX**2 * np.eye(4)
    models = {
        ratio: StudentT(dof, scale, time_correlation_ratio=ratio) for ratio in (0.0, 0.5, 2.0)
    }
    profiles = {}
    likelihoods = {}
    for ratio, model in models.items():
        profiles[ratio], likelihoods[ratio] = profile_of(seen, model)
    for solved in models:
        for other in models:
            profile = profiles[solved]
            by_profile = log_likelihood(profile, other) - log_likelihood(profile, solved)
            directly = float(np.mean(likelihoods[other] - likelihoods[solved]))
            assert by_profile == pytest.approx(directly, abs=0.01)


@pytest.mark.parametrize("dof", [3.0, np.inf])
@pytest.mark.parametrize("ratio", [1.0, 4.0])
def test_the_true_ratio_is_the_likeliest(ratio: float, dof: float) -> None:
    seen = observations(np.random.default_rng(1), 4000, ratio, dof)
    for predicted in (0.0, ratio):
        model = StudentT(dof, SIGMA_PX**2 * np.eye(4), time_correlation_ratio=predicted)
        profile, _ = profile_of(seen, model)
        assert smallest_likely_ratio(profile, tie=0.0) == pytest.approx(ratio, rel=0.1)


def test_of_equally_likely_ratios_the_smallest_is_taken() -> None:
    """It is less likely by just the tie; with a large tie it is 0."""
    seen = observations(np.random.default_rng(4), 4000, 1.0, 5.0)
    profile, _ = profile_of(seen, StudentT(5.0, SIGMA_PX**2 * np.eye(4)))
    likeliest = smallest_likely_ratio(profile, tie=0.0)
    smallest = smallest_likely_ratio(profile, tie=0.005)
    assert 0.0 < smallest < likeliest
    loss = log_likelihood(profile, likeliest) - log_likelihood(profile, smallest)
    assert loss == pytest.approx(0.005, abs=1e-4)
    assert smallest_likely_ratio(profile, tie=1.0) == 0.0


def test_errors_that_are_new_in_each_frame_have_a_small_ratio() -> None:
    seen = observations(np.random.default_rng(2), 4000, 0.0, 5.0)
    profile, _ = profile_of(seen, StudentT(5.0, SIGMA_PX**2 * np.eye(4)))
    assert smallest_likely_ratio(profile) < 0.3


def test_rows_give_the_profile_back_and_what_is_left_out_is_as_likely_for_every_ratio() -> None:
    seen = observations(np.random.default_rng(3), 50, 1.0, 5.0)
    profile, _ = profile_of(seen, StudentT(5.0, SIGMA_PX**2 * np.eye(4)))
    for value, again in zip(profile, TimeCorrelationProfile.of_rows(profile.rows()), strict=True):
        np.testing.assert_array_equal(again, value)
    silent = profile.without_information(np.ones(50, bool))
    assert log_likelihood(silent, 4.0) == log_likelihood(silent, 0.0)
    assert log_likelihood(silent, 0.0) == log_likelihood(profile, 0.0)

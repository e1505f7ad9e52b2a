"""How much of a disparity's error lasts: the profile is the likelihood, and its peak lies where the
world was made."""

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo.estimation.reprojection import solve_reprojection
from probevo.geometry import se3
from probevo.noise import StereoNoise, StudentT
from probevo.training.gk.time_correlation import (
    time_correlation_profile,
    log_likelihood,
    smallest_likely_ratio,
)
from worlds import CAMERA

T_CURR_PREV = se3.exp(np.array([0.02, 0.01, -1.2, 0.003, 0.01, -0.002]))
SIGMA_PX = 0.1


def observations(
    rng: np.random.Generator, count: int, ratio: float, dof: float
) -> tuple[FloatArray, FloatArray]:
    """Both observations of points 5 to 60 m away, their errors Student-t; what lasts is ``ratio``
    times what is new."""
    z = rng.uniform(5.0, 60.0, count)
    x = rng.uniform(-0.6, 0.6, count)
    y = rng.uniform(-0.2, 0.2, count)
    points = np.column_stack([x * z, y * z, z])
    mixing = np.ones((count, 1)) if np.isinf(dof) else np.sqrt(dof / rng.chisquare(dof, (count, 1)))
    time_correlated = np.zeros((count, 4))
    time_correlated[:, 2] = -rng.normal(scale=ratio * SIGMA_PX * np.sqrt(2.0), size=count)
    prev, curr = (
        CAMERA.project(p) + mixing * (lasting + rng.normal(scale=SIGMA_PX, size=(count, 4)))
        for p in (points, se3.transform(T_CURR_PREV, points))
    )
    return prev, curr


def profile_of(
    seen: tuple[FloatArray, FloatArray], model: StudentT
) -> tuple[FloatArray, FloatArray]:
    """The profile, [N, 4], and the log-likelihood of the residuals under the model itself, [N]."""
    noise = model.predict(np.zeros((len(seen[0]), 0)))
    count = len(seen[0])
    solution = solve_reprojection(*seen, noise, T_CURR_PREV, CAMERA, max_iterations=0)
    residual_noise = StereoNoise(
        np.linalg.inv(solution.information), noise.dof, np.zeros((count, 4))
    )
    return time_correlation_profile(
        solution, noise, np.arange(count)
    ), residual_noise.log_likelihood(solution.residuals)


@pytest.mark.parametrize("dof", [4.0, np.inf])
def test_the_profile_tells_the_likelihood_of_every_other_model(dof: float) -> None:
    """Differences of what models of other κ say themselves; the points are refined a little
    differently by each."""
    seen = observations(np.random.default_rng(0), 400, 1.0, np.inf)
    scale = SIGMA_PX**2 * np.eye(4)
    models = {
        ratio: StudentT(dof, scale, time_correlation_ratio=ratio) for ratio in (0.0, 0.5, 2.0)
    }
    profiles = {}
    likelihoods = {}
    for ratio, model in models.items():
        profiles[ratio], likelihoods[ratio] = profile_of(seen, model)
    for told in models:
        for asked in models:
            by_profile = log_likelihood(profiles[told], asked) - log_likelihood(
                profiles[told], told
            )
            directly = float(np.mean(likelihoods[asked] - likelihoods[told]))
            assert by_profile == pytest.approx(directly, abs=0.01)


@pytest.mark.parametrize("dof", [3.0, np.inf])
@pytest.mark.parametrize("ratio", [1.0, 4.0])
def test_it_is_most_likely_what_it_was(ratio: float, dof: float) -> None:
    seen = observations(np.random.default_rng(1), 4000, ratio, dof)
    for told in (0.0, ratio):
        profile, _ = profile_of(
            seen, StudentT(dof, SIGMA_PX**2 * np.eye(4), time_correlation_ratio=told)
        )
        assert smallest_likely_ratio(profile, tie=0.0) == pytest.approx(ratio, rel=0.1)


def test_of_those_as_likely_the_smallest_is_taken() -> None:
    """It is as likely as it may be less, and of errors that hardly last there are none."""
    seen = observations(np.random.default_rng(4), 4000, 1.0, 5.0)
    profile, _ = profile_of(seen, StudentT(5.0, SIGMA_PX**2 * np.eye(4)))
    likeliest = smallest_likely_ratio(profile, tie=0.0)
    smallest = smallest_likely_ratio(profile, tie=0.005)
    assert 0.0 < smallest < likeliest
    loss = log_likelihood(profile, likeliest) - log_likelihood(profile, smallest)
    assert loss == pytest.approx(0.005, abs=1e-4)
    assert smallest_likely_ratio(profile, tie=1.0) == 0.0


def test_where_nothing_lasts_little_is_found() -> None:
    seen = observations(np.random.default_rng(2), 4000, 0.0, 5.0)
    profile, _ = profile_of(seen, StudentT(5.0, SIGMA_PX**2 * np.eye(4)))
    assert smallest_likely_ratio(profile) < 0.3

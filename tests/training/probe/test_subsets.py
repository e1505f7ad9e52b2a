"""Random subsets: which features are drawn and how often, seeds, and the α of their motions."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from probevo.arrays import FloatArray, IntArray
from probevo.estimation.two_frame import TwoFrameEstimator
from probevo.noise import Fixed
from probevo.training.drive import Drive
from probevo.training.probe.subsets import SubsetSampler
from probevo.training.supervision import Supervision
from training.supervised_drives import drive_of, known, point_world, sampler_of

WORLD = point_world("constant", frames=13, sigma_px=(0.2, 0.2))
DRIVE = drive_of(WORLD)
SUBSET = 8


def sampler(drive: Drive = DRIVE, kind: str = "gt", **options: object) -> SubsetSampler:
    return sampler_of(drive, known(WORLD, kind), WORLD.camera, **{"subset": SUBSET} | options)  # type: ignore[arg-type]


def shortened(count: int) -> Drive:
    """Return the first two steps with their first features."""
    rows = np.concatenate([np.arange(count) + first for first in DRIVE.first_of_step[:2]])
    arrays = {
        name: getattr(DRIVE, name)[rows] for name in ("prev_px", "curr_px", "ids", "phi", "used")
    }
    return replace(
        DRIVE,
        T_curr_prev=DRIVE.T_curr_prev[:2],
        first_of_step=np.array([0, count, 2 * count]),
        **arrays,
    )


def by_step(drive: Drive, features: IntArray) -> list[IntArray]:
    step = drive.step_of_feature[features]
    return [features[step == k] for k in range(len(drive.T_curr_prev))]


@pytest.mark.parametrize("contrast", [0.0, 3.0, 100.0])
@pytest.mark.parametrize("kind", ["gt", "loop"])
def test_a_draw_has_one_subset_of_each_step_without_repetition(kind: str, contrast: float) -> None:
    features, alphas = sampler(kind=kind, contrast=contrast).iterate(0)
    assert len(features) == len(alphas) == SUBSET * len(DRIVE.T_curr_prev)
    for chosen, alpha in zip(
        by_step(DRIVE, features), np.split(alphas, len(DRIVE.T_curr_prev)), strict=True
    ):
        assert len(np.unique(chosen)) == SUBSET
        assert (alpha == alpha[0]).all()


def test_only_features_that_were_used_are_drawn() -> None:
    used = np.random.default_rng(0).random(len(DRIVE.used)) < 0.3
    one = sampler(replace(DRIVE, used=used))
    for iteration in range(5):
        features, _ = one.iterate(iteration)
        assert used[features].all()


def test_the_same_seed_draws_the_same() -> None:
    """Whatever was drawn before: an iteration does not depend on others."""
    one = sampler()
    other = sampler()
    one.iterate(0)
    for first, second in zip(one.iterate(4), other.iterate(4), strict=True):
        assert first.tobytes() == second.tobytes()


def test_iterations_steps_drives_and_seeds_draw_differently() -> None:
    draws = [
        sampler(seed=seed).iterate(iteration)[0]
        for seed in ((0, 0), (0, 1), (1, 0))
        for iteration in range(3)
    ]
    steps = [chosen - DRIVE.first_of_step[k] for k, chosen in enumerate(by_step(DRIVE, draws[0]))]
    assert len({draw.tobytes() for draw in draws}) == len(draws)
    assert len({step.tobytes() for step in steps}) == len(steps)


def test_without_contrast_every_feature_is_drawn_as_often() -> None:
    """χ² of the counts over 400 draws of 8 out of 40, within its 99.9 % interval; twice, for two
    steps.

    A draw without repetition has the covariance p (1 − p) n/(n − 1) (1 − 11ᵀ/n), p = 8/40.
    """
    n = 40
    draws = 400
    p = SUBSET / 40
    one = sampler(shortened(n), contrast=0.0)
    one = replace(one, supervision=Supervision("gt", np.arange(3), WORLD.T_world_cam[:3]))
    counts = np.bincount(
        np.concatenate([one.iterate(k)[0] for k in range(draws)]), minlength=2 * n
    ).reshape(2, n)
    statistic = np.sum((counts - draws * p) ** 2, axis=1) / (draws * p * (1.0 - p) * n / (n - 1))
    assert (statistic > chi2.ppf(0.0005, df=n - 1)).all()
    assert (statistic < chi2.ppf(0.9995, df=n - 1)).all()


def lean(one: SubsetSampler, iteration: int) -> FloatArray:
    """Return the subset's mean minus that of all features of its step, [solved steps, M]."""
    features, _ = one.iterate(iteration)
    drive = one.drive
    return np.array(
        [
            one.coordinates[chosen].mean(axis=0) - one.coordinates[drive.rows(k)].mean(axis=0)
            for k, chosen in enumerate(by_step(drive, features))
            if len(chosen)
        ]
    )


@pytest.fixture(scope="module")
def two_dimensional() -> Drive:
    """Return a drive whose two columns both vary; in a world of constant noise ln σ does not."""
    return replace(DRIVE, phi=np.random.default_rng(1).normal(size=(len(DRIVE.used), 2)))


def test_with_contrast_the_features_of_a_subset_are_alike(two_dimensional: Drive) -> None:
    """Their mean is farther out than that of random subsets, which is about 1/√8."""
    plain, leaning = (
        np.concatenate([lean(sampler(two_dimensional, contrast=contrast), k) for k in range(10)])
        for contrast in (0.0, 3.0)
    )
    assert np.linalg.norm(plain, axis=1).mean() < 0.6
    assert np.linalg.norm(leaning, axis=1).mean() > 1.2


def test_subsets_of_a_stretch_lean_in_one_direction(two_dimensional: Drive) -> None:
    """So that the error of the stretch tells of one region; where each step is its own stretch,
    each its own way."""
    cosines = {}
    for kind in ("loop", "gt"):
        leans = [lean(sampler(two_dimensional, kind, contrast=3.0), k) for k in range(20)]
        unit = [each / np.linalg.norm(each, axis=1, keepdims=True) for each in leans]
        cosines[kind] = np.mean(np.concatenate([each[:-1] @ each[-1] for each in unit]))
    assert cosines["loop"] > 0.8
    assert abs(cosines["gt"]) < 0.25


def test_over_many_draws_every_direction_comes_up(two_dimensional: Drive) -> None:
    """On average draws lean to no side, and features in the middle of the space are drawn too."""
    one = sampler(two_dimensional, contrast=3.0)
    leans = np.concatenate([lean(one, k) for k in range(80)])
    assert np.linalg.norm(leans.mean(axis=0)) < 0.3
    drawn = one.coordinates[np.unique(np.concatenate([one.iterate(k)[0] for k in range(80)]))]
    assert (np.linalg.norm(drawn, axis=1) < 0.5).sum() > 20


def test_steps_with_too_few_features_are_skipped() -> None:
    """Step 3 has one feature less than a subset: it keeps its motion, and no feature of it is a
    sample."""
    used = DRIVE.used.copy()
    used[DRIVE.rows(3)] = np.arange(len(used[DRIVE.rows(3)])) < SUBSET - 1
    for kind in ("gt", "loop"):
        features, alphas = sampler(replace(DRIVE, used=used), kind).iterate(0)
        counts = [len(chosen) for chosen in by_step(DRIVE, features)]
        assert counts == [0 if k == 3 else SUBSET for k in range(len(DRIVE.T_curr_prev))]
        assert np.isfinite(alphas).all()


def test_where_no_step_has_enough_there_is_no_sample() -> None:
    features, alphas = sampler(subset=10_000).iterate(0)
    assert (features.shape, alphas.shape) == ((0,), (0,))
    assert features.dtype == np.int64


def test_steps_without_truth_are_skipped() -> None:
    frames = np.array([2, 3, 7, 8])
    one = replace(sampler(), supervision=Supervision("sparse", frames, WORLD.T_world_cam[frames]))
    features, _ = one.iterate(0)
    np.testing.assert_array_equal(np.unique(DRIVE.step_of_feature[features]), range(2, 8))


def test_alpha_is_the_error_of_the_subset_s_motion() -> None:
    """Solved by hand from the features that were drawn: √(‖Δr‖²/3)."""
    features, alphas = sampler(contrast=0.0).iterate(2)
    noise = sampler().base.predict(np.zeros((SUBSET, 0)))
    for k, chosen in enumerate(by_step(DRIVE, features)):
        tracks = DRIVE.tracks(k).subset(chosen - DRIVE.first_of_step[k])
        estimator = TwoFrameEstimator(WORLD.camera, sampler().solver)
        motion = estimator.solve(tracks, noise, guess=DRIVE.T_curr_prev[k]).T_curr_prev
        T_true = np.linalg.inv(WORLD.T_world_cam[k + 1]) @ WORLD.T_world_cam[k]
        error_m = np.linalg.norm((np.linalg.inv(motion) - np.linalg.inv(T_true))[:3, 3])
        np.testing.assert_allclose(
            alphas[k * SUBSET : (k + 1) * SUBSET], error_m / np.sqrt(3.0), rtol=1e-9
        )


@pytest.mark.parametrize("contrast", [0.0, 3.0])
def test_relative_alphas_are_one_if_the_noise_is_as_expected(contrast: float) -> None:
    """In RMS, whatever the geometry of the subset; in metres they differ by its width."""
    world = point_world("constant", frames=25, sigma_px=(0.2, 0.2), seed=1)
    drive = drive_of(world, base=Fixed())
    one = sampler_of(
        drive,
        known(world),
        world.camera,
        base=Fixed(),
        subset=20,
        contrast=contrast,
        relative=True,
    )
    alphas = np.concatenate([one.iterate(k)[1] for k in range(20)])
    assert np.sqrt(np.mean(alphas**2)) == pytest.approx(1.0, rel=0.15)
    in_m = np.concatenate(
        [replace(one, divides_by_predicted=False).iterate(k)[1] for k in range(20)]
    )
    assert np.std(np.log(alphas)) < np.std(np.log(in_m))

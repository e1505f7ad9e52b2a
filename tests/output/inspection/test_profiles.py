import numpy as np

from probevo.output.inspection.profiles import MAX_BINS, profile_along


def test_a_straight_line_is_found_and_explains_its_share() -> None:
    """ln α = 2x + unit noise, x uniform on 0 … 1: x explains 4/12 of a variance of 4/12 + 1."""
    rng = np.random.default_rng(0)
    x = rng.uniform(size=40_000)
    profile = profile_along(x, 2.0 * x + rng.normal(size=len(x)))
    assert len(profile.center) == MAX_BINS
    assert np.all(np.abs(profile.mean - 2.0 * profile.center) < 4.0 * profile.standard_error)
    np.testing.assert_allclose(profile.standard_error, 1.0 / np.sqrt(len(x) / MAX_BINS), rtol=0.1)
    np.testing.assert_allclose(profile.share_explained, 0.25, atol=0.01)
    assert profile.undefined is None


def test_chance_explains_nothing() -> None:
    """Twenty bins would explain 20/2000 of pure noise, if what chance gives were not taken off."""
    rng = np.random.default_rng(1)
    shares = [
        profile_along(rng.normal(size=2000), rng.normal(size=2000)).share_explained
        for _ in range(20)
    ]
    assert np.mean(shares) < 0.004


def test_samples_of_one_subset_count_as_one() -> None:
    """The same subsets with eight times as many members know no more."""
    rng = np.random.default_rng(2)
    x, log_alpha = rng.normal(size=(2, 4000))
    once = profile_along(x, log_alpha)
    often = profile_along(np.repeat(x, 8), np.repeat(log_alpha, 8))
    np.testing.assert_allclose(often.mean, once.mean, atol=0.02)
    np.testing.assert_allclose(often.standard_error, once.standard_error, rtol=0.05)


def test_what_is_undefined_stands_apart() -> None:
    x = np.r_[np.full(100, np.nan), np.linspace(0.0, 1.0, 300)]
    profile = profile_along(x, np.r_[np.tile([0.9, 1.1], 50), np.zeros(300)])
    assert profile.undefined is not None
    np.testing.assert_allclose(profile.undefined[0], 1.0)
    np.testing.assert_allclose(profile.share_undefined, 0.25)
    np.testing.assert_allclose(profile.mean, 0.0, atol=1e-12)
    assert profile.share_explained > 0.9


def test_a_constant_column_is_one_bin_and_tells_nothing() -> None:
    profile = profile_along(np.ones(500), np.random.default_rng(3).normal(size=500))
    assert profile.center.tolist() == [1.0]
    assert profile.share_explained == 0.0
    nothing = profile_along(np.full(10, np.nan), np.ones(10))
    assert len(nothing.center) == 0
    assert nothing.undefined is not None

"""What a generalized kernel chooses by the likelihood of errors left out."""

import numpy as np
import pytest

from probevo.noise.gk.folds import MAX_HELD_OUT, folds_of
from probevo.noise.gk.hyperparameter_search import choose_shape, is_better
from probevo.noise.gk.posterior import KernelSamples


@pytest.mark.parametrize(
    ("mean", "scatter", "count", "better"),
    [
        (0.05, 0.5, 3000, True),
        (0.05, 0.5, 60, False),
        (0.05, 5.0, 3000, False),
        (0.001, 0.0, 3000, False),
    ],
)
def test_better_is_what_gains_enough_and_more_than_chance_explains(
    mean: float, scatter: float, count: int, *, better: bool
) -> None:
    """The features are the same before and after, so that only the difference counts, not how they
    scatter."""
    rng = np.random.default_rng(0)
    before = 10.0 * rng.normal(size=count)
    more = rng.normal(size=count)
    more = mean + scatter * (more - more.mean()) / more.std()
    assert is_better(before + more, before, np.arange(count)) == better


@pytest.mark.parametrize(("mean", "better"), [(0.05, False), (0.08, True)])
def test_gains_that_all_features_of_a_group_share_count_once(mean: float, *, better: bool) -> None:
    """3,000 features in 60 groups of 20 to 80: as good as 60 features, whose standard error is
    about 0.065."""
    rng = np.random.default_rng(0)
    groups = np.repeat(np.arange(60), np.tile([20, 80], 30))
    of_group = rng.normal(size=60)
    more = of_group[groups]
    more = mean + 0.5 * (more - more.mean()) / more.std()
    before = 10.0 * rng.normal(size=3000)
    shuffled = rng.permutation(3000)
    for order in (np.arange(3000), shuffled):
        assert is_better((before + more)[order], before[order], groups[order]) == better


def test_a_fold_knows_the_groups_of_what_it_holds_out() -> None:
    """Also if it is thinned out; groups may have any numbers."""
    count = 10 * MAX_HELD_OUT
    rng = np.random.default_rng(0)
    groups = rng.integers(7, size=count)
    samples = KernelSamples(groups[:, None].astype(np.float64), rng.normal(size=(count, 4)), None)
    folds = folds_of(samples, 100 * groups - 300, published=False)
    for fold in folds:
        assert len(fold.groups) == len(fold.held_out.errors) == MAX_HELD_OUT
        np.testing.assert_array_equal(fold.groups, fold.held_out.coordinates[:, 0])
    assert sum(len(np.unique(fold.groups)) for fold in folds) == 7


def test_a_column_that_gains_in_few_of_the_groups_is_left_out() -> None:
    """σ depends on the place and on the block of time. The second column is a random number of the
    block, which by chance gains three times the standard error that independent features would
    have."""
    rng = np.random.default_rng(5)
    groups = np.repeat(np.arange(20), 60)
    place = rng.normal(size=len(groups))
    of_block = rng.normal(size=(20, 2))
    sigma = np.exp(0.7 * place + 0.5 * of_block[groups, 0])
    errors = sigma[:, None] * rng.normal(size=(len(groups), 4))
    samples = KernelSamples(np.column_stack([place, of_block[groups, 1]]), errors)
    given = {"neighbors": 150, "prior_counts": 8.0, "dof_counts": 30.0, "bias_counts": np.inf}
    weights, _, _ = choose_shape(samples, groups, given, published=False)
    np.testing.assert_array_equal(weights, [1.0, 0.0])

"""What a generalized kernel chooses by the likelihood of errors left out."""

import numpy as np
import pytest

from probevo.noise.gk.hyperparameter_search import is_better


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
    assert is_better(before + more, before) == better

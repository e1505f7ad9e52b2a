"""The domain of a network: what is usual is not widened, what is far away is, and by how much."""

from __future__ import annotations

import numpy as np
import pytest

from probevo.nets.domain import Domain


@pytest.fixture(scope="module")
def domain() -> Domain:
    rng = np.random.default_rng(0)
    root = rng.normal(size=(6, 6))
    return Domain.of(rng.normal(size=(5000, 6)) @ root, rng.normal(size=(1000, 6)) @ root)


def test_one_percent_of_what_was_left_out_is_widened(domain: Domain) -> None:
    rng = np.random.default_rng(0)
    root = rng.normal(size=(6, 6))
    rng.normal(size=(5000, 6))
    left_out = rng.normal(size=(1000, 6)) @ root
    assert np.mean(domain.widening(left_out) > 1.0) == pytest.approx(0.01, abs=0.002)


def test_the_sigma_grows_with_the_squared_distance(domain: Domain) -> None:
    far = domain.mean + 100.0 * np.ones((1, 6))
    farther = domain.mean + 200.0 * np.ones((1, 6))
    assert domain.widening(far) > 1.0
    np.testing.assert_allclose(domain.widening(farther), 16.0 * domain.widening(far))


def test_a_feature_that_never_varied_decides_little() -> None:
    """Without shrinkage its distance would be infinite."""
    rng = np.random.default_rng(1)
    features = np.hstack([rng.normal(size=(500, 3)), np.zeros((500, 1))])
    found = Domain.of(features, features).widening(np.array([[0.0, 0.0, 0.0, 0.1]]))
    assert found == 1.0

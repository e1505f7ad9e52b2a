"""The domain of a generalized kernel: which features are unlike all training data."""

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo.noise import GeneralizedKernel
from probevo.noise.gk.centers import Centers
from probevo.noise.gk.generalized_kernel import MAX_DOMAIN_SAMPLES


@pytest.fixture(scope="module")
def places() -> FloatArray:
    return np.random.default_rng(0).normal(size=(20_000, 4))


@pytest.fixture(scope="module")
def model(places: FloatArray) -> GeneralizedKernel:
    """σ grows with the first column."""
    errors = np.exp(0.5 * places[:, :1]) * np.random.default_rng(1).normal(size=(len(places), 4))
    return GeneralizedKernel(
        neighbors=400, prior_counts=4.0, dof_counts=100.0, bias_counts=np.inf, weights=np.ones(4)
    ).fit(places, errors)


def test_hardly_any_similar_data_are_out_of_domain(model: GeneralizedKernel) -> None:
    out_of_domain = model.predict(np.random.default_rng(2).normal(size=(5000, 4))).out_of_domain
    assert out_of_domain is not None
    assert out_of_domain.mean() < 0.002


@pytest.mark.parametrize(("shift", "least"), [(5.0, 0.4), (6.0, 0.75), (8.0, 0.99)])
def test_what_lies_apart_is_out_of_domain(
    model: GeneralizedKernel, shift: float, least: float
) -> None:
    """Moved along one of four columns by so many standard deviations of the training data."""
    out_of_domain = model.predict(
        np.random.default_rng(3).normal(shift * np.eye(4)[0], 1.0, (2000, 4))
    ).out_of_domain
    assert out_of_domain is not None
    assert out_of_domain.mean() > least


def test_far_away_it_is_as_wide_as_the_worst_tenth(
    model: GeneralizedKernel, places: FloatArray
) -> None:
    near, far = (model.predict(where).scale for where in (places[::20], np.full((1, 4), 50.0)))
    sizes = np.linalg.slogdet(near)[1]
    size = np.linalg.slogdet(far)[1][0]
    assert np.mean(sizes < size) == pytest.approx(0.9, abs=0.03)


def test_the_domain_is_that_of_so_many_samples_at_most(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also if there are more, but less than twice as many."""
    counts = []
    radius_of = Centers.domain_radius_of

    def counted(centers: Centers, coordinates: FloatArray) -> float:
        counts.append(len(coordinates))
        return radius_of(centers, coordinates)

    monkeypatch.setattr(Centers, "domain_radius_of", counted)
    rng = np.random.default_rng(5)
    for count in (MAX_DOMAIN_SAMPLES, 2 * MAX_DOMAIN_SAMPLES - 1):
        GeneralizedKernel(
            neighbors=60,
            prior_counts=8.0,
            dof_counts=30.0,
            bias_counts=np.inf,
            weights=np.ones(2),
            centers=50,
        ).fit(rng.normal(size=(50 + count, 2)), rng.normal(size=(50 + count, 4)))
    assert counts == [MAX_DOMAIN_SAMPLES, MAX_DOMAIN_SAMPLES]


@pytest.mark.parametrize("more", [0, 1, 2, 5, 100])
def test_hardly_more_samples_than_centers_are_like_as_many(more: int) -> None:
    """None of the few others may lie far out, so they do not determine where the domain ends."""
    rng = np.random.default_rng(4)
    places = rng.normal(size=(400 + more, 3))
    errors = rng.normal(size=(400 + more, 4))
    found = GeneralizedKernel(
        neighbors=60,
        prior_counts=8.0,
        dof_counts=30.0,
        bias_counts=np.inf,
        weights=np.ones(3),
        centers=400,
    ).fit(places, errors)
    assert found.predict(rng.normal(size=(2000, 3))).out_of_domain.mean() < 0.01  # type: ignore[union-attr]

"""The noise at a place from the errors around it, against the formulas of PROBE-GK written out in
NumPy."""

import numpy as np
import pytest
from scipy.stats import multivariate_t

import probevo.noise.gk.posterior as module
from probevo.arrays import FloatArray
from probevo.noise import StereoNoise
from probevo.noise.gk.posterior import KernelPosterior, KernelSamples, KernelShape, prior_of
from probevo.noise.student_t_arrays import Neighborhoods, StudentTBatch, StudentTPrior
from probevo.noise.student_t_fit import fit_static, fit_student_ts

DIM = 4
COUNT = 300


def samples(seed: int = 0, count: int = COUNT, columns: int = 2) -> tuple[FloatArray, FloatArray]:
    """Places, and errors whose σ grows along the first column."""
    rng = np.random.default_rng(seed)
    places = rng.normal(size=(count, columns))
    return places, np.exp(places[:, :1]) * rng.standard_t(5.0, (count, DIM))


def posterior(
    seed: int = 0, *, published: bool = False, error_cov: FloatArray | None = None
) -> KernelPosterior:
    return KernelPosterior.of(KernelSamples(*samples(seed), error_cov), published=published)


def published_by_hand(
    place: FloatArray, shape: KernelShape, seed: int = 0
) -> tuple[FloatArray, float]:
    """Ψ* and ν* (PROBE-GK eqs. 8, 9), sample after sample."""
    places, errors = samples(seed)
    psi = shape.prior_counts * errors.T @ errors / len(errors)
    nu = shape.prior_counts
    for x, e in zip(places, errors, strict=True):
        k = 1.0 - np.sum((x - place) ** 2) / shape.reach**2
        if k > 0.0:
            psi = psi + k * np.outer(e, e)
            nu = nu + k
    return psi, nu


PLACES = np.array([[0.0, 0.0], [1.0, -0.5], [-2.0, 2.0], [3.5, 0.0]])
PUBLISHED = KernelShape(reach=0.7, prior_counts=12.0)


@pytest.mark.parametrize("place", PLACES)
def test_as_published_it_is_the_posterior_of_an_inverse_wishart(place: FloatArray) -> None:
    """Scale Ψ*/(ν* − d + 1), dof ν* − d + 1 (eq. 12), no bias; and Σk."""
    psi, nu = published_by_hand(place, PUBLISHED)
    found, counts = posterior(published=True).at(place[None], PUBLISHED)
    np.testing.assert_allclose(found.scale[0], psi / (nu - DIM + 1.0), rtol=1e-4, atol=1e-5)
    assert found.dof[0] == pytest.approx(nu - DIM + 1.0, rel=1e-12)
    assert counts[0] == pytest.approx(nu - PUBLISHED.prior_counts, abs=1e-9)
    np.testing.assert_array_equal(found.bias[0], np.zeros(DIM))


def test_without_a_sample_in_reach_it_is_the_prior() -> None:
    """Its scale was fitted together with its own ν, not with the one that is best under the scale
    of each place."""
    shape = KernelShape(reach=0.5, neighbors=40, dof=30.0, prior_counts=4.0)
    model = posterior()
    found, counts = model.at(np.array([[0.0, 0.0], [500.0, 0.0]]), shape)
    np.testing.assert_array_equal(counts > 0.0, [True, False])
    np.testing.assert_array_equal(found.scale[1], model.prior.scale[0])
    np.testing.assert_array_equal(found.dof[1], model.prior.dof[0])
    np.testing.assert_array_equal(found.bias[1], 0.0)
    assert found.dof[0] > 2.0 * found.dof[1]


def test_the_published_predictive_density_is_that_of_scipy() -> None:
    """The Student-t of eq. (13), whose covariance is the mean of the inverse Wishart."""
    psi, nu = published_by_hand(PLACES[1], PUBLISHED)
    dof = nu - DIM + 1.0
    errors = np.geomspace(0.01, 50.0, 6)[:, None] * np.random.default_rng(1).normal(size=(6, DIM))
    found, _ = posterior(published=True).at(np.tile(PLACES[1], (6, 1)), PUBLISHED)
    own = StereoNoise(found.scale, found.dof, found.bias).log_likelihood(errors)
    np.testing.assert_allclose(
        own, multivariate_t(np.zeros(DIM), psi / dof, df=dof).logpdf(errors), rtol=1e-4
    )
    covariance = found.dof[0] / (found.dof[0] - 2.0) * found.scale[0]
    np.testing.assert_allclose(covariance, psi / (nu - DIM - 1.0), rtol=1e-4, atol=1e-5)


def test_the_published_prior_is_the_mean_square_of_all_errors() -> None:
    places, errors = samples()
    prior = prior_of(KernelSamples(places, errors), published=True)
    np.testing.assert_allclose(prior.scale[0], errors.T @ errors / COUNT, rtol=1e-4, atol=1e-5)


def robust_by_hand(place: FloatArray, shape: KernelShape) -> tuple[StudentTBatch, float]:
    """Neighbours by sorting all distances; then the fit to them."""
    places, errors = samples()
    distance = np.sqrt(np.sum((places - place) ** 2, axis=1))
    near = np.argsort(distance)[: shape.neighbors]
    near = near[distance[near] < shape.reach]
    whole = len(near) == min(shape.neighbors, COUNT)
    support = (distance[near[-1]] if whole else shape.reach) * (1.0 + 1e-3)
    kernel = 1.0 - (distance[near] / support) ** 2
    static = fit_static(errors)
    prior = StudentTPrior(
        static.scale[0],
        float(static.dof[0]),
        shape.prior_counts,
        dof_counts=shape.dof_counts,
        bias_counts=shape.bias_counts,
    )
    return fit_student_ts(
        errors, Neighborhoods(np.array([0, len(near)]), near, kernel), prior
    ), float(kernel.sum())


@pytest.mark.parametrize("shape", [KernelShape(neighbors=40), KernelShape(neighbors=40, reach=0.6)])
@pytest.mark.parametrize("place", PLACES)
def test_ours_is_the_fit_to_the_nearest(place: FloatArray, shape: KernelShape) -> None:
    """The kernel ends at the K-th or at the reach, whichever is nearer."""
    if np.sqrt(np.sum((samples()[0] - place) ** 2, axis=1)).min() > shape.reach:
        shape = KernelShape(neighbors=40, reach=3.0)
    expected, counts = robust_by_hand(place, shape)
    found, found_counts = posterior().at(place[None], shape)
    assert found_counts[0] == pytest.approx(counts, rel=1e-9)
    for name in ("scale", "dof", "bias"):
        np.testing.assert_allclose(
            getattr(found, name), getattr(expected, name), rtol=1e-6, atol=1e-9
        )


@pytest.mark.parametrize("published", [False, True])
def test_samples_all_in_one_place_all_count(published: bool) -> None:
    """Forty samples at the very place, and any K: their kernel is one, and the K-th neighbour is at
    no distance."""
    errors = np.random.default_rng(2).normal(size=(40, DIM))
    coincident = KernelPosterior.of(KernelSamples(np.ones((40, 2)), errors), published=published)
    shape = KernelShape(neighbors=40, reach=0.5, prior_counts=6.0)
    found, counts = coincident.at(np.ones((1, 2)), shape)
    assert counts[0] == pytest.approx(40.0)
    assert np.isfinite(found.scale).all()


def test_with_fewer_samples_than_k_all_are_neighbours() -> None:
    one, other = (posterior().at(PLACES, KernelShape(neighbors=k)) for k in (COUNT, 10 * COUNT))
    np.testing.assert_array_equal(one[0].scale, other[0].scale)
    np.testing.assert_array_equal(one[1], other[1])


@pytest.mark.parametrize("published", [False, True])
def test_beyond_the_reach_of_all_the_prior_holds(published: bool) -> None:
    known = posterior(published=published)
    shape = KernelShape(neighbors=50, reach=0.5, prior_counts=12.0)
    found, counts = known.at(np.array([[40.0, 40.0]]), shape)
    assert counts[0] == 0.0
    if not published:
        np.testing.assert_allclose(found.scale, known.prior.scale, atol=1e-5)
        np.testing.assert_array_equal(found.dof, known.prior.dof)
    else:
        np.testing.assert_allclose(found.scale, known.prior.scale * 12.0 / 9.0, atol=1e-5)
        np.testing.assert_array_equal(found.dof, [9.0])
    np.testing.assert_array_equal(found.bias, np.zeros((1, DIM)))


def test_at_the_very_reach_a_sample_has_no_influence() -> None:
    """So that nothing jumps where one comes into reach."""
    lonely = KernelPosterior.of(
        KernelSamples(np.zeros((1, 1)), np.full((1, DIM), 3.0)), published=True
    )
    shape = KernelShape(reach=1.0, prior_counts=5.0)
    _, counts = lonely.at(np.array([[0.0], [0.5], [0.999999], [1.0], [1.000001]]), shape)
    np.testing.assert_allclose(counts, [1.0, 0.75, 2e-6, 0.0, 0.0], atol=1e-9)


@pytest.mark.parametrize("published", [False, True])
def test_the_noise_has_no_jumps(published: bool) -> None:
    """Along a line through the samples in steps of a thousandth, no entry of the scale moves by
    more than 2 %."""
    line = np.column_stack([np.linspace(-1.0, 1.0, 2001), np.zeros(2001)])
    shape = KernelShape(neighbors=60, reach=0.8, prior_counts=12.0)
    found, _ = posterior(published=published).at(line, shape)
    assert np.abs(np.diff(np.log(found.scale[:, 0, 0]))).max() < 0.02


@pytest.mark.parametrize("published", [False, True])
def test_places_one_at_a_time_and_in_blocks_are_the_same(
    monkeypatch: pytest.MonkeyPatch, published: bool
) -> None:
    """However few are held in memory at a time; and no place is fine, too."""
    known = posterior(published=published)
    shape = KernelShape(neighbors=50, reach=0.8, prior_counts=12.0)
    whole, counts = known.at(PLACES, shape)
    monkeypatch.setattr(module, "MAX_PAIRS", 1)
    blocks, block_counts = known.at(PLACES, shape)
    for name in ("scale", "dof", "bias"):
        np.testing.assert_allclose(getattr(whole, name), getattr(blocks, name), rtol=1e-12)
    np.testing.assert_allclose(counts, block_counts, rtol=1e-12)
    nothing, none = known.at(np.zeros((0, 2)), shape)
    assert (nothing.scale.shape, nothing.dof.shape, none.shape) == ((0, DIM, DIM), (0,), (0,))


@pytest.mark.parametrize("published", [False, True])
def test_an_error_cov_counts_as_errors_do(published: bool) -> None:
    """An error of which all is hidden: what is unknown of it makes up the scale."""
    places, errors = samples()
    squares = errors[:, :, None] * errors[:, None, :]
    shape = KernelShape(neighbors=50, reach=0.8, prior_counts=12.0, bias_counts=np.inf)
    exact = KernelSamples(places, errors)
    unknown = KernelSamples(places, np.zeros_like(errors), squares)
    seen, _ = KernelPosterior.of(exact, published=published).at(PLACES, shape)
    hidden, _ = KernelPosterior.of(unknown, published=published).at(PLACES, shape)
    if published:
        np.testing.assert_allclose(hidden.scale, seen.scale, rtol=1e-9)
    else:  # The start of the static fit differs, and so its limit by a hair.
        np.testing.assert_allclose(hidden.scale, seen.scale, rtol=0.05, atol=0.02)


def test_the_radius_is_the_distance_to_the_kth_nearest() -> None:
    places, _ = samples()
    distance = np.sort(np.linalg.norm(places[None] - PLACES[:, None], axis=2), axis=1)
    for k in (1, 7, COUNT):
        np.testing.assert_allclose(posterior().radius(PLACES, k), distance[:, k - 1])
    np.testing.assert_allclose(posterior().radius(PLACES, 10 * COUNT), distance[:, -1])


def test_of_samples_at_one_place_all_times_have_a_part() -> None:
    """Of 2,000 at each of two places, the noise of the second half being ten times that of the
    first: the nearest 400 are of both, and so is the σ."""
    half = 2000
    rng = np.random.default_rng(2)
    places = (rng.random((2 * half, 1)) < 0.5).astype(np.float64)
    errors = np.repeat([0.1, 1.0], half)[:, None] * rng.normal(size=(2 * half, DIM))
    own = KernelPosterior.of(KernelSamples(places, errors))
    near = own.around(np.array([[0.0], [1.0]]), KernelShape(neighbors=400))
    early = [
        np.mean(near.members[start:end] < half)
        for start, end in zip(near.first, near.first[1:], strict=False)
    ]
    np.testing.assert_allclose(early, 0.5, atol=0.1)
    np.testing.assert_array_equal(places[near.members, 0], np.repeat([0.0, 1.0], 400))

"""Interpolation between centers: exact at them, valid between them, the prior far from them."""

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo.noise import GeneralizedKernel
from probevo.noise.gk.centers import Centers
from probevo.noise.student_t_arrays import StudentTBatch

PRIOR = StudentTBatch(np.diag([9.0, 8.0, 7.0, 6.0])[None], np.array([30.0]), np.zeros((1, 4)))
DOMAIN_RADIUS = 2.0


def random_students(count: int, seed: int = 0) -> StudentTBatch:
    """Scales of all directions and sizes."""
    rng = np.random.default_rng(seed)
    factor = np.exp(rng.normal(size=(count, 1, 1))) * rng.normal(size=(count, 4, 4))
    return StudentTBatch(
        factor @ factor.mT + 1e-4 * np.eye(4),
        rng.uniform(2.0, 50.0, count),
        rng.normal(size=(count, 4)),
    )


def grid() -> FloatArray:
    """Of 25 places, one apart, [25, 2]."""
    return np.stack(np.meshgrid(np.arange(5.0), np.arange(5.0)), axis=-1).reshape(-1, 2)


def at(
    centers: Centers, queries: FloatArray, domain_radius: float = DOMAIN_RADIUS
) -> StudentTBatch:
    return centers.at(queries, domain_radius, PRIOR)[0]


def test_a_single_center_says_what_was_fitted_there() -> None:
    """In single precision."""
    students = random_students(1)
    found = at(Centers.of(np.array([[1.0, -2.0]]), students), np.array([[1.0, -2.0]]))
    for name in ("scale", "dof", "bias"):
        np.testing.assert_allclose(
            getattr(found, name), getattr(students, name), rtol=1e-5, atol=1e-6
        )


def test_at_each_center_it_is_nearly_what_was_fitted_there() -> None:
    """The others' part is below 3 %, so that nothing is spiked: here of ln σ, whose range is 6."""
    count = 25
    rng = np.random.default_rng(1)
    sigma = np.exp(rng.uniform(-3.0, 3.0, count))
    students = StudentTBatch(
        sigma[:, None, None] ** 2 * np.eye(4), np.full(count, 5.0), np.zeros((count, 4))
    )
    found = at(Centers.of(grid(), students), grid())
    np.testing.assert_allclose(0.5 * np.log(found.scale[:, 0, 0]), np.log(sigma), atol=0.03 * 6.0)


@pytest.mark.parametrize("seed", range(5))
def test_between_centers_every_scale_is_positive_definite(seed: int) -> None:
    """Of whatever scales, within their range of determinants; away from all of them, too."""
    students = random_students(25, seed)
    rng = np.random.default_rng([seed, 1])
    found = at(Centers.of(grid(), students), rng.uniform(-3.0, 7.0, (500, 2)))
    assert np.linalg.eigvalsh(found.scale).min() > 0.0
    log_dets = [np.linalg.slogdet(scale)[1] for scale in (found.scale, students.scale, PRIOR.scale)]
    bounds = np.concatenate(log_dets[1:])
    assert log_dets[0].min() >= bounds.min() - 1e-4
    assert log_dets[0].max() <= bounds.max() + 1e-4


def test_between_two_sigmas_lies_their_geometric_mean() -> None:
    """Half way from σ = 0.1 px to 10 px it is 1 px; the prior has no
    influence."""
    students = StudentTBatch(
        np.array([0.01, 100.0])[:, None, None] * np.eye(4), np.array([4.0, 9.0]), np.zeros((2, 4))
    )
    centers = Centers.of(np.array([[0.0], [1.0]]), students)
    found = at(centers, np.array([[0.5]]), domain_radius=1e3)
    np.testing.assert_allclose(found.scale[0], np.eye(4), rtol=1e-3, atol=1e-6)
    assert found.dof[0] == pytest.approx(6.0, rel=1e-3)


def test_where_all_centers_agree_so_does_everything_between() -> None:
    one = random_students(1, seed=2)
    students = StudentTBatch(
        scale=np.repeat(one.scale, 25, axis=0),
        dof=np.repeat(one.dof, 25),
        bias=np.repeat(one.bias, 25, axis=0),
    )
    queries = np.random.default_rng(2).uniform(0.0, 4.0, (50, 2))
    found = at(Centers.of(grid(), students), queries, domain_radius=100.0)
    np.testing.assert_allclose(found.scale, np.repeat(one.scale, 50, axis=0), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("distance", [2.0, 2.01, 50.0, 1e3])
def test_out_of_reach_it_is_the_prior_and_out_of_domain(distance: float) -> None:
    centers = Centers.of(grid(), random_students(25))
    found, outside = centers.at(np.array([[4.0 + distance, 4.0]]), DOMAIN_RADIUS, PRIOR)
    assert outside.tolist() == [True]
    for name in ("scale", "dof", "bias"):
        np.testing.assert_allclose(getattr(found, name), getattr(PRIOR, name), rtol=1e-5, atol=1e-6)


def test_within_reach_it_is_not_out_of_domain() -> None:
    centers = Centers.of(grid(), random_students(25))
    assert not centers.at(np.array([[5.9, 4.0], [2.3, 1.1]]), DOMAIN_RADIUS, PRIOR)[1].any()


@pytest.mark.parametrize(
    ("distance", "share"), [(0.0, 1.0), (1.3, 1.0), (1.5, 0.75), (1.8, 0.3), (1.99, 0.015)]
)
def test_the_centers_fade_over_the_last_third_of_the_domain(distance: float, share: float) -> None:
    """In a straight line: here of the bias, which the prior has at zero."""
    bias = np.array([1.0, -2.0, 0.5, 0.0])
    centers = Centers.of(np.zeros((1, 1)), StudentTBatch(PRIOR.scale, PRIOR.dof, bias[None]))
    np.testing.assert_allclose(
        at(centers, np.array([[distance]])).bias[0], share * bias, rtol=1e-5, atol=1e-6
    )


def test_the_domain_reaches_half_as_far_again_as_the_samples() -> None:
    centers = Centers.of(np.zeros((1, 1)), random_students(1))
    assert centers.domain_radius_of(np.linspace(-1.0, 1.0, 5001)[:, None]) == pytest.approx(
        1.5, rel=2e-3
    )


@pytest.mark.parametrize(
    ("samples", "domain_radius"), [(0, 1.5), (1, 1.5), (999, 1.5), (1001, 0.15)]
)
def test_too_few_samples_do_not_say_where_the_domain_ends(
    samples: int, domain_radius: float
) -> None:
    """Each is a tenth from a center, and the centers are one apart."""
    found = Centers.of(grid(), random_students(25)).domain_radius_of(
        np.tile([[2.1, 2.0]], (samples, 1))
    )
    assert found == pytest.approx(domain_radius, rel=1e-6)


@pytest.mark.parametrize("far", [1e6, 1e18, 1e19, 1e30, 3e38])
def test_beyond_single_precision_it_is_out_of_domain(far: float) -> None:
    """Squares of distances overflow: nothing is read that is not there."""
    centers = Centers.of(grid(), random_students(25))
    found, outside = centers.at(np.array([[far, -far], [far, 0.0]]), DOMAIN_RADIUS, PRIOR)
    assert outside.all()
    np.testing.assert_allclose(found.scale, np.repeat(PRIOR.scale, 2, axis=0), rtol=1e-5)


def test_no_query_no_noise() -> None:
    found, outside = Centers.of(grid(), random_students(25)).at(np.zeros((0, 2)), 1.0, PRIOR)
    assert (found.scale.shape, found.dof.shape, found.bias.shape, outside.shape) == (
        (0, 4, 4),
        (0,),
        (0, 4),
        (0,),
    )


def test_queries_do_not_change_the_centers() -> None:
    centers = Centers.of(grid(), random_students(25))
    before = centers.points.tobytes(), centers.parameters.tobytes()
    at(centers, np.random.default_rng(3).normal(size=(20, 2)))
    assert (centers.points.tobytes(), centers.parameters.tobytes()) == before


@pytest.mark.parametrize("variant", ["robust", "published"])
def test_from_centers_it_predicts_as_well_as_from_all_samples(variant: str) -> None:
    """From 20,000 samples to 4,000 centers: the mean log-likelihood of held-out errors is within
    0.05 nats of the exact one's, where σ ranges over a factor of 30."""
    rng = np.random.default_rng(4)
    places = rng.normal(size=(21_000, 3))
    sigma = np.exp(np.sin(2.0 * places[:, 0]) + 0.7 * places[:, 1])
    errors = sigma[:, None] * rng.standard_t(6.0, (21_000, 4))
    train = slice(0, 20_000)
    test = slice(20_000, None)
    model = GeneralizedKernel(
        variant,
        neighbors=200,
        reach=0.6,
        prior_counts=8.0,
        dof_counts=np.inf,
        bias_counts=np.inf,
        weights=np.ones(3),
        centers=4000,
    )
    model.fit(places[train], errors[train])
    interpolated, exact = (
        noise.log_likelihood(errors[test]).mean()
        for noise in (model.predict(places[test]), model.predict_exact(places[test]))
    )
    assert interpolated > exact - 0.05

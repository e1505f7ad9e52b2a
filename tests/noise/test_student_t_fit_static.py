"""Student-t distributions fitted to samples of known ones: what went in comes out, and it is the
likeliest."""

import numpy as np
import pytest
from scipy.special import digamma
from scipy.stats import multivariate_t

from probevo.arrays import FloatArray
from probevo.errors import InputError
from probevo.noise import StereoNoise
from probevo.noise.student_t_arrays import Neighborhoods, StudentTBatch, StudentTPrior
from probevo.noise.student_t_fit import fit_static, fit_student_ts
from probevo.noise.student_t_numba import (
    MAX_DOF,
    MIN_DOF,
    MIN_SIGMA_PX,
    _dof_slope,
    weighted_log_sum,
)

SCALE = np.array(
    [[1.0, 0.1, 0.8, 0.0], [0.1, 0.5, 0.0, 0.2], [0.8, 0.0, 1.2, -0.1], [0.0, 0.2, -0.1, 0.3]]
)
"""px²; left and right image go together."""
BIAS = np.array([0.3, -0.2, 0.25, 0.05])
FREE = StudentTPrior(np.eye(4), dof=5.0, counts=0.01, dof_counts=0.01, bias_counts=0.01)
"""It counts for next to nothing."""
HELD = StudentTPrior(2.0 * SCALE, dof=4.0, counts=20.0, dof_counts=np.inf, bias_counts=np.inf)


def drawn(
    count: int, *, dof: float = 4.0, bias: FloatArray | None = None, seed: int = 0
) -> FloatArray:
    """Errors of the known distribution, [N, 4], px."""
    mean = np.zeros(4) if bias is None else bias
    return multivariate_t(mean, SCALE, df=dof).rvs(count, random_state=np.random.default_rng(seed))


def fitted(
    errors: FloatArray,
    prior: StudentTPrior = FREE,
    error_cov: FloatArray | None = None,
    *,
    robust: bool = True,
) -> StudentTBatch:
    near = Neighborhoods.of_all(len(errors))
    return fit_student_ts(errors, near, prior, error_cov=error_cov, iterations=200, robust=robust)


def distance(found: FloatArray, expected: FloatArray = SCALE) -> float:
    """Relative, of two matrices (Frobenius)."""
    return float(np.linalg.norm(found - expected) / np.linalg.norm(expected))


def mean_log_likelihood(
    errors: FloatArray, scale: FloatArray, dof: float, bias: FloatArray
) -> float:
    noise = StereoNoise(
        *(np.broadcast_to(x, (len(errors), *x.shape)) for x in (scale, np.array(dof), bias))
    )
    return float(noise.log_likelihood(errors).mean())


@pytest.mark.parametrize("dof", [1.0, 1.6, 5.0, 50.0, 200.0])
def test_the_likelihood_rises_with_dof_as_its_density_says(dof: float) -> None:
    """By scipy's digamma; halved, as of ln f."""
    half = 0.5 * dof
    expected = np.log(half) - digamma(half) + digamma(half + 2.0) - np.log(half + 2.0) + 1.0
    assert _dof_slope(dof) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("dof", [2.0, 4.0, 10.0])
def test_scale_dof_and_bias_come_out_as_they_went_in(dof: float) -> None:
    """Of 50,000 errors. Standard errors, as of 200 repetitions: scale 1 %, dof 1 % to 4 %, bias
    0.005 px."""
    found = fitted(drawn(50_000, dof=dof, bias=BIAS))
    assert distance(found.scale[0]) < 0.03
    assert found.dof[0] == pytest.approx(dof, rel=0.12)
    np.testing.assert_allclose(found.bias[0], BIAS, atol=0.02)


def test_more_errors_give_a_better_estimate() -> None:
    """Ten times as many, averaged over seeds, are three times as near."""
    few, many = (
        np.mean([distance(fitted(drawn(count, seed=seed)).scale[0]) for seed in range(20)])
        for count in (300, 3000)
    )
    assert many < 0.5 * few


def test_of_gaussian_errors_the_dof_are_large_and_the_scale_is_the_covariance() -> None:
    rng = np.random.default_rng(1)
    found = fitted(rng.multivariate_normal(np.zeros(4), SCALE, 20_000))
    assert found.dof[0] > 50.0
    assert distance(found.scale[0]) < 0.05


PERTURBATIONS = {
    "a larger scale": lambda scale, dof, bias: (1.03 * scale, dof, bias),
    "a smaller scale": lambda scale, dof, bias: (0.97 * scale, dof, bias),
    "more correlation": lambda scale, dof, bias: (
        scale + 0.02 * (np.eye(4)[::-1] + np.eye(4)),
        dof,
        bias,
    ),
    "less correlation": lambda scale, dof, bias: (
        scale - 0.02 * np.ones((4, 4)) + 0.03 * np.eye(4),
        dof,
        bias,
    ),
    "more dof": lambda scale, dof, bias: (scale, 1.05 * dof, bias),
    "fewer dof": lambda scale, dof, bias: (scale, 0.95 * dof, bias),
    "another bias": lambda scale, dof, bias: (scale, dof, bias + np.array([0.02, 0.0, 0.0, 0.0])),
    "the opposite bias": lambda scale, dof, bias: (
        scale,
        dof,
        bias - np.array([0.02, 0.0, 0.0, 0.0]),
    ),
    "more of all": lambda scale, dof, bias: (1.01 * scale, 1.02 * dof, bias + 0.005),
}


@pytest.mark.parametrize("name", PERTURBATIONS)
def test_the_fit_is_the_likeliest(name: str) -> None:
    """Of 2,000 errors, whatever they were drawn from: no distribution nearby is likelier. So the
    weights are right."""
    errors = drawn(2000, bias=BIAS, seed=2)
    found = fitted(errors)
    own = found.scale[0], float(found.dof[0]), found.bias[0]
    assert mean_log_likelihood(errors, *PERTURBATIONS[name](*own)) < mean_log_likelihood(
        errors, *own
    )


def test_the_likelihood_is_level_at_the_fit() -> None:
    """Its derivative by ln scale, ln dof and bias, by central differences, is zero: the mean weight
    is one, too."""
    errors = drawn(2000, bias=BIAS, seed=3)
    found = fitted(errors)
    scale = found.scale[0]
    dof = float(found.dof[0])
    bias = found.bias[0]
    h = 1e-4
    slopes = [
        mean_log_likelihood(errors, np.exp(h) * scale, dof, bias)
        - mean_log_likelihood(errors, np.exp(-h) * scale, dof, bias),
        mean_log_likelihood(errors, scale, np.exp(h) * dof, bias)
        - mean_log_likelihood(errors, scale, np.exp(-h) * dof, bias),
        *(
            mean_log_likelihood(errors, scale, dof, bias + h * axis)
            - mean_log_likelihood(errors, scale, dof, bias - h * axis)
            for axis in np.eye(4)
        ),
    ]
    np.testing.assert_allclose(
        np.array(slopes) / (2.0 * h), 0.0, atol=1e-4
    )  # the prior counts for 0.01 of 2,000


def test_every_iteration_makes_the_errors_likelier() -> None:
    errors = drawn(500, seed=4)
    near = Neighborhoods.of_all(len(errors))
    likelihoods = []
    for iterations in range(1, 30):
        found = fit_student_ts(errors, near, FREE, iterations=iterations)
        likelihoods.append(
            mean_log_likelihood(errors, found.scale[0], float(found.dof[0]), found.bias[0])
        )
    assert (np.diff(likelihoods) > -1e-6).all()
    assert likelihoods[-1] > likelihoods[0]


def test_what_is_not_known_of_each_error_is_added_to_what_is_seen() -> None:
    """Errors of which a part of covariance U, other for each, is hidden: with U as their error_cov,
    the scale is whole."""
    rng = np.random.default_rng(5)
    whole = rng.multivariate_normal(np.zeros(4), SCALE, 40_000)
    share = rng.uniform(0.0, 0.9, len(whole))
    # Of e ~ N(0, S) seen with noise: its mean is (1 − share) S in covariance, and share · S is
    # left.
    noise = rng.multivariate_normal(np.zeros(4), SCALE, len(whole))
    seen = (1.0 - share)[:, None] * whole + np.sqrt(share * (1.0 - share))[:, None] * noise
    error_cov = share[:, None, None] * SCALE
    gaussian = FREE._replace(dof=MAX_DOF, dof_counts=np.inf, bias_counts=np.inf)
    assert distance(fitted(seen, gaussian, error_cov).scale[0]) < 0.03
    assert distance(fitted(seen, gaussian).scale[0]) > 0.3


def test_no_error_cov_is_one_of_zero() -> None:
    errors = drawn(300, seed=6)
    one = fitted(errors)
    other = fitted(errors, error_cov=np.zeros((300, 4, 4)))
    np.testing.assert_allclose(one.scale, other.scale, rtol=1e-12)
    np.testing.assert_allclose(one.dof, other.dof, rtol=1e-9)


def test_every_entry_of_an_error_cov_is_in_its_place() -> None:
    """Not robust, the scale is the mean of e eᵀ + U."""
    rng = np.random.default_rng(7)
    factor = rng.normal(size=(30, 4, 4))
    errors = rng.normal(size=(30, 4))
    error_cov = factor @ factor.mT
    expected = np.mean(errors[:, :, None] * errors[:, None, :] + error_cov, axis=0)
    found = fitted(errors, HELD._replace(counts=1e-9), error_cov, robust=False)
    np.testing.assert_allclose(found.scale[0], expected, rtol=1e-5)


def test_without_robustness_it_is_the_closed_form() -> None:
    """Ψ*/(ν₀ + Σk), Ψ* = ν₀ S₀ + Σ k e eᵀ (PROBE-GK eqs. 8, 9); dof and bias are those of the
    prior."""
    rng = np.random.default_rng(8)
    errors = drawn(50, bias=BIAS, seed=8)
    kernel = rng.uniform(0.0, 1.0, 50)
    found = fit_student_ts(
        errors, Neighborhoods(np.array([0, 50]), np.arange(50), kernel), HELD, robust=False
    )
    total = 20.0 * HELD.scale + np.einsum("n,ni,nj->ij", kernel, errors, errors)
    np.testing.assert_allclose(found.scale[0], total / (20.0 + kernel.sum()), rtol=1e-5)
    assert found.dof[0] == HELD.dof
    np.testing.assert_array_equal(found.bias[0], np.zeros(4))


@pytest.mark.parametrize("robust", [True, False])
def test_without_any_error_the_prior_holds(robust: bool) -> None:
    prior = StudentTPrior(SCALE, dof=7.0, counts=4.0, dof_counts=10.0, bias_counts=10.0)
    near = Neighborhoods(np.array([0, 0, 0]), np.zeros(0, np.int64), np.zeros(0))
    found = fit_student_ts(np.zeros((0, 4)), near, prior, robust=robust)
    np.testing.assert_allclose(found.scale, [SCALE, SCALE], atol=1e-5)
    np.testing.assert_array_equal(found.dof, [7.0, 7.0])
    np.testing.assert_array_equal(found.bias, np.zeros((2, 4)))


def test_errors_without_weight_are_as_none() -> None:
    found = fit_student_ts(
        drawn(10), Neighborhoods(np.array([0, 10]), np.arange(10), np.zeros(10)), HELD
    )
    np.testing.assert_allclose(found.scale[0], HELD.scale, atol=1e-5)


def test_the_prior_counts_as_errors_do() -> None:
    """Between the prior and the errors, the more it counts the nearer to it: scale, dof and bias
    each by their own."""
    errors = drawn(200, dof=3.0, bias=BIAS, seed=9)
    prior = StudentTPrior(9.0 * SCALE, dof=50.0, counts=0.1, dof_counts=0.1, bias_counts=0.1)
    counts = (0.1, 10.0, 200.0, 1e5)
    scales = [
        distance(fitted(errors, prior._replace(counts=c)).scale[0], prior.scale) for c in counts
    ]
    dofs = [fitted(errors, prior._replace(dof_counts=c)).dof[0] for c in counts]
    biases = [np.linalg.norm(fitted(errors, prior._replace(bias_counts=c)).bias) for c in counts]
    assert (np.diff(scales) < 0.0).all()
    assert scales[-1] < 0.01
    assert (np.diff(dofs) > 0.0).all()
    assert dofs[-1] == pytest.approx(50.0, rel=0.05)
    assert (np.diff(biases) < 0.0).all()
    assert biases[-1] < 1e-2


def test_an_infinite_prior_holds_dof_and_bias() -> None:
    found = fitted(drawn(500, dof=20.0, bias=BIAS, seed=10), HELD)
    assert found.dof[0] == HELD.dof
    np.testing.assert_array_equal(found.bias, np.zeros((1, 4)))


def test_each_neighbourhood_is_fitted_on_its_own() -> None:
    """Three at once, which share errors, equal one at a time."""
    rng = np.random.default_rng(11)
    errors = drawn(100, seed=11)
    kernel = rng.uniform(0.1, 1.0, 90)
    index = rng.integers(0, 100, 90)
    first = np.array([0, 30, 30, 90])
    prior = StudentTPrior(SCALE, 5.0, 4.0, dof_counts=10.0, bias_counts=10.0)
    together = fit_student_ts(errors, Neighborhoods(first, index, kernel), prior)
    for c in range(3):
        rows = slice(first[c], first[c + 1])
        near = Neighborhoods(np.array([0, first[c + 1] - first[c]]), index[rows], kernel[rows])
        separate = fit_student_ts(errors, near, prior)
        for name in ("scale", "dof", "bias"):
            np.testing.assert_array_equal(getattr(together, name)[c], getattr(separate, name)[0])


def test_a_kernel_of_two_is_the_error_twice() -> None:
    """Here of one half and of one: weights count as numbers of errors do, if the prior counts for
    half as much, too."""
    errors = drawn(60, seed=12)
    twice = np.concatenate([errors, errors[:30]])
    prior = StudentTPrior(SCALE, 5.0, 4.0, dof_counts=10.0, bias_counts=10.0)
    half = StudentTPrior(SCALE, 5.0, 2.0, dof_counts=5.0, bias_counts=5.0)
    kernel = np.where(np.arange(60) < 30, 1.0, 0.5)
    one = fit_student_ts(errors, Neighborhoods(np.array([0, 60]), np.arange(60), kernel), half)
    other = fit_student_ts(twice, Neighborhoods.of_all(90), prior)
    np.testing.assert_allclose(one.scale, other.scale, rtol=1e-5)
    np.testing.assert_allclose(one.dof, other.dof, rtol=1e-6)


def test_the_sums_of_kernels_are_the_counts() -> None:
    near = Neighborhoods(np.array([0, 2, 2, 5]), np.arange(5), np.array([0.5, 1.0, 0.1, 0.2, 0.3]))
    np.testing.assert_allclose(near.counts, [1.5, 0.0, 0.6])


def test_gross_outliers_hardly_move_the_robust_scale() -> None:
    """One error in twenty of 100 px: the robust fit stays within a factor of 2, the plain one is
    off by hundreds."""
    errors = np.random.default_rng(13).multivariate_normal(np.zeros(4), SCALE, 2000)
    errors[::20] *= 100.0
    robust, plain = fitted(errors), fitted(errors, robust=False)
    assert np.trace(robust.scale[0]) < 2.0 * np.trace(SCALE)
    assert np.trace(plain.scale[0]) > 100.0 * np.trace(SCALE)


@pytest.mark.parametrize("factor", [1e-2, 1e3])
def test_units_do_not_matter(factor: float) -> None:
    """But for the least σ of a thousandth of a pixel."""
    one = fit_static(drawn(500, seed=14))
    other = fit_static(factor * drawn(500, seed=14))
    np.testing.assert_allclose(
        other.scale, factor**2 * one.scale, rtol=0.05, atol=5.0 * MIN_SIGMA_PX**2
    )
    np.testing.assert_allclose(other.dof, one.dof, rtol=0.05)


@pytest.mark.parametrize(
    "errors", [np.zeros((20, 4)), np.ones((20, 4)), np.outer(np.arange(20.0), np.ones(4))]
)
def test_errors_that_span_nothing_leave_a_distribution(errors: FloatArray) -> None:
    found = fit_static(errors)
    assert np.linalg.eigvalsh(found.scale[0])[0] > 0.5 * MIN_SIGMA_PX**2
    assert MIN_DOF <= found.dof[0] <= MAX_DOF * 1.001


@pytest.mark.parametrize("count", [1, 2, 3, 5, 8, 20])
def test_few_errors_do_not_make_it_sure(count: int) -> None:
    """Of new errors, a median over twenty fits: within a factor of two, where so few may span no
    space at all."""
    new = np.random.default_rng(9).normal(size=(1000, 4))
    squared = []
    for seed in range(20):
        scale = fit_static(np.random.default_rng(seed).normal(size=(count, 4))).scale[0]
        squared.append(np.einsum("ni,ij,nj->n", new, np.linalg.inv(scale), new).mean() / 4.0)
    assert 0.5 < np.median(squared) < 2.0


def test_of_many_errors_what_is_added_for_the_few_is_not_noticed() -> None:
    """The fit with that prior against one with a hundredth of it; scale and ν of 5,000."""
    errors = drawn(5000, seed=15)
    found = fit_static(errors)
    light = StudentTPrior(SCALE, dof=5.0, counts=0.01, dof_counts=0.01, bias_counts=np.inf)
    bare = fit_student_ts(errors, Neighborhoods.of_all(5000), light, iterations=50)
    assert np.linalg.norm(found.scale - bare.scale) < 2e-3 * np.linalg.norm(bare.scale)
    np.testing.assert_allclose(found.dof, bare.dof, rtol=2e-3)


def test_a_static_fit_has_no_bias() -> None:
    np.testing.assert_array_equal(fit_static(drawn(300, bias=BIAS)).bias, np.zeros((1, 4)))


@pytest.mark.parametrize(
    ("errors", "message"),
    [
        (np.zeros((0, 4)), "residuals: there is none"),
        (np.zeros((5, 3)), r"residuals: their shape is \(5, 3\)"),
        (np.zeros(4), "residuals: their shape is"),
        (np.full((3, 4), np.nan), r"residuals: the residual of feature 0 \(from 0\) is \[nan"),
        (
            np.array([[0.0] * 4, [0.0, np.inf, 0.0, 0.0]]),
            r"residuals: the residual of feature 1 \(from 0\) is",
        ),
        (
            np.array([[0.0] * 4, [0.0, 0.0, -1e150, 0.0]]),
            r"residuals: the residual of feature 1 \(from 0\) is",
        ),
    ],
)
def test_errors_that_are_none_are_refused(errors: FloatArray, message: str) -> None:
    with pytest.raises(InputError, match=message):
        fit_static(errors)


@pytest.mark.parametrize(
    "error_cov", [np.zeros((2, 4, 4)), np.zeros((3, 4)), np.full((3, 4, 4), np.nan)]
)
def test_an_error_cov_that_is_none_is_refused(error_cov: FloatArray) -> None:
    """Compiled code would read beyond its end."""
    with pytest.raises(InputError, match="error_cov"):
        fit_static(np.ones((3, 4)), error_cov)


def test_logarithms_are_summed_to_twelve_digits() -> None:
    rng = np.random.default_rng(0)
    values = 10.0 ** rng.uniform(-300, 300, 999)
    factors = rng.uniform(size=999)
    scratch = np.empty((2, 999))
    each = [weighted_log_sum(values[i : i + 1], factors[i : i + 1], scratch) for i in range(999)]
    np.testing.assert_allclose(each, factors * np.log(values), rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(
        weighted_log_sum(values, factors, scratch), np.sum(factors * np.log(values)), rtol=1e-12
    )

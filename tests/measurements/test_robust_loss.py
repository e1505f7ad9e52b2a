"""Robust losses by their definitions, the information of M-estimates by Monte Carlo."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import ArrayLike

from probevo.arrays import FloatArray
from probevo.errors import InputError
from probevo.measurements.robust_loss import RobustLoss
from probevo.measurements.robust_loss_numba import (
    RESIDUAL_DIM,
    LossKind,
    robust_cost,
    robust_curvature,
)

LOSSES = [
    RobustLoss.l2(),
    RobustLoss.huber(),
    RobustLoss.cauchy(),
    RobustLoss.tukey(),
    RobustLoss.student_t(),
    RobustLoss.student_t(dof=3.0),
]
DOFS = [3.0, 5.0, np.inf]


def student_t(rng: np.random.Generator, dof: float, shape: tuple[int, ...]) -> FloatArray:
    """White Student-t residuals, [..., 4], of scale matrix 1."""
    residuals = rng.normal(size=(*shape, RESIDUAL_DIM))
    if np.isinf(dof):
        return residuals
    return residuals / np.sqrt(rng.chisquare(dof, size=(*shape, 1)) / dof)


def cost(loss: RobustLoss, squared: ArrayLike, dof: ArrayLike = np.inf) -> FloatArray:
    """ρ(s) at squared lengths s, [...]."""
    parameters, squared = np.broadcast_arrays(
        loss.parameters(dof), np.asarray(squared, dtype=np.float64)
    )
    costs = [
        robust_cost(int(loss.kind), *each)
        for each in zip(parameters.flat, squared.flat, strict=True)
    ]
    return np.reshape(costs, squared.shape)


def information_factor(loss: RobustLoss, dof: ArrayLike) -> FloatArray:
    """a²/b: what Σ_n Jᵀ Σ⁻¹ J must be multiplied by to be the inverse covariance of the M-estimate,
    [...].

    It is exact, for many features, if all have noise of the same dof, and 0 for L2 at dof ≤ 2.
    """
    a, b = loss.moments(dof)
    return a**2 / b


def test_weights_and_costs_are_those_of_the_textbooks() -> None:
    length = np.array([0.0, 0.5, 1.0, 2.0, 8.0])
    s = length**2
    np.testing.assert_allclose(RobustLoss.l2().weight(s), 1.0)
    np.testing.assert_allclose(cost(RobustLoss.l2(), s), s / 2)
    np.testing.assert_allclose(RobustLoss.huber(1.5).weight(s), [1, 1, 1, 0.75, 0.1875])
    np.testing.assert_allclose(RobustLoss.cauchy(2.0).weight(s), 1 / (1 + s / 4))
    np.testing.assert_allclose(RobustLoss.tukey(4.0).weight(s), np.maximum(1 - s / 16, 0) ** 2)
    np.testing.assert_allclose(RobustLoss.student_t(5.0).weight(s), 9 / (5 + s))
    np.testing.assert_allclose(cost(RobustLoss.student_t(), s, dof=5.0), 4.5 * np.log1p(s / 5))


@pytest.mark.parametrize("loss", LOSSES, ids=lambda loss: loss.kind.name)
def test_weight_is_twice_the_derivative_of_the_cost(loss: RobustLoss) -> None:
    s = np.geomspace(1e-2, 1e3, 200)
    step = 1e-5
    if loss.parameter is not None:
        s = s[
            np.abs(np.sqrt(s) / loss.parameter - 1.0) > 1e-3
        ]  # away from the kinks of Huber and Tukey
    slope = (cost(loss, s * (1 + step), dof=5.0) - cost(loss, s * (1 - step), dof=5.0)) / (
        2 * step * s
    )
    np.testing.assert_allclose(loss.weight(s, dof=5.0), 2 * slope, rtol=1e-7, atol=1e-8)


@pytest.mark.parametrize("loss", LOSSES, ids=lambda loss: loss.kind.name)
def test_cost_begins_at_zero_and_never_falls(loss: RobustLoss) -> None:
    costs = cost(loss, np.r_[0.0, np.geomspace(1e-6, 1e6, 500)], dof=5.0)
    assert costs[0] == 0.0
    assert (np.diff(costs) >= 0).all()


@pytest.mark.parametrize("dimension", [4, 5, 37])
@pytest.mark.parametrize("loss", LOSSES[1:4], ids=lambda loss: loss.kind.name.lower())
def test_curvature_is_the_mean_eigenvalue_of_the_hessian(loss: RobustLoss, dimension: int) -> None:
    """Of (n/4) ρ(rᵀr/(n/4)) in n dimensions, by second differences: as a window takes the mean of a
    landmark's observations."""
    scale = dimension / RESIDUAL_DIM
    parameter = float(loss.parameters(np.inf))
    rng = np.random.default_rng(3)
    r = rng.normal(size=dimension)
    step = 1e-4
    for length in (0.5, 1.6, 2.2, 3.5):
        here = length * np.sqrt(scale) * r / np.linalg.norm(r)
        moved = here + step * np.concatenate([np.eye(dimension), -np.eye(dimension)])
        squared = np.square(np.vstack([here, moved])).sum(axis=1)
        costs = scale * cost(loss, squared / scale)
        laplacian = (costs[1:].sum() - 2 * dimension * costs[0]) / step**2
        found = robust_curvature(int(loss.kind), parameter, length**2, dimension)
        assert found == pytest.approx(laplacian / dimension, rel=1e-4)


def test_student_t_of_infinite_dof_is_least_squares() -> None:
    s = np.array([0.0, 1.0, 50.0])
    np.testing.assert_array_equal(RobustLoss.student_t().weight(s, dof=np.inf), 1.0)
    np.testing.assert_array_equal(cost(RobustLoss.student_t(), s, dof=np.inf), s / 2)


def test_student_t_takes_the_dof_of_each_feature() -> None:
    dof = np.array([3.0, 5.0, np.inf])
    np.testing.assert_allclose(RobustLoss.student_t().weight(2.0, dof), [7 / 5, 9 / 7, 1])
    np.testing.assert_allclose(RobustLoss.student_t(4.0).weight(2.0, dof), 8 / 6)
    np.testing.assert_array_equal(RobustLoss.student_t().parameters(dof), dof)
    np.testing.assert_array_equal(RobustLoss.huber(2.0).parameters(dof), [2, 2, 2])


@pytest.mark.parametrize("kind", ["huber", "cauchy", "tukey"])
def test_default_gives_up_five_percent_of_gaussian_information(kind: str) -> None:
    loss: RobustLoss = getattr(RobustLoss, kind)()
    assert loss.kind is LossKind[kind.upper()]
    assert information_factor(loss, np.inf) == pytest.approx(0.95, abs=1e-5)


def test_names_are_those_of_the_constructors() -> None:
    assert RobustLoss.named("noise") == RobustLoss.student_t()
    assert RobustLoss.named("l2") == RobustLoss.l2()
    assert RobustLoss.named("huber") == RobustLoss.huber()
    assert RobustLoss.named("cauchy") == RobustLoss.cauchy()
    assert RobustLoss.named("tukey") == RobustLoss.tukey()


@pytest.mark.parametrize("parameter", [None, 0.0, -1.0, np.nan])
def test_losses_without_a_positive_parameter_are_refused(parameter: float | None) -> None:
    with pytest.raises(InputError, match="loss huber: its parameter is"):
        RobustLoss(LossKind.HUBER, parameter)


@pytest.mark.parametrize("dof", [1.0, 3.0, 5.0, 30.0, 1e4])
def test_quadrature_agrees_with_the_closed_form_of_student_t(dof: float) -> None:
    expected = (dof + 4) / (dof + 6)
    assert information_factor(RobustLoss.student_t(), dof) == pytest.approx(expected, rel=1e-14)
    assert information_factor(RobustLoss.student_t(dof), dof) == pytest.approx(expected, rel=1e-7)


@pytest.mark.parametrize("dof", [3.0, 5.0, np.inf])
@pytest.mark.parametrize("parameter", [1e-3, 1e4])
def test_quadrature_holds_at_extreme_parameters(dof: float, parameter: float) -> None:
    """Huber tends to least squares for a large k, and to the spatial median, weight 1/√s, for a
    small one."""
    huber = RobustLoss.huber(parameter)
    if parameter > 1.0:
        a, b = RobustLoss.l2().moments(dof)
    else:
        s = np.sum(student_t(np.random.default_rng(0), dof, (1_000_000,)) ** 2, axis=1)
        a = np.asarray(parameter * 0.75 * np.mean(s**-0.5))
        b = np.asarray(parameter**2 / 4)
    np.testing.assert_allclose(huber.moments(dof), (a, b), rtol=3e-3)


@pytest.mark.parametrize("dof", DOFS)
def test_no_loss_beats_the_likelihood_of_the_noise(dof: float) -> None:
    best = information_factor(RobustLoss.student_t(), dof)
    assert all(information_factor(loss, dof) <= best + 1e-9 for loss in LOSSES)


def test_factors_of_many_dofs_are_those_of_each() -> None:
    dof = np.array([[5.0, 3.0, np.inf], [3.0, 5.0, 8.0]])
    for loss in LOSSES:
        factors = information_factor(loss, dof)
        np.testing.assert_array_equal(
            factors, np.vectorize(lambda nu, m=loss: information_factor(m, nu))(dof)
        )


def test_least_squares_has_no_information_without_a_variance() -> None:
    np.testing.assert_array_equal(
        information_factor(RobustLoss.l2(), np.array([1.0, 2.0])), [0.0, 0.0]
    )
    np.testing.assert_allclose(information_factor(RobustLoss.l2(), [4.0, np.inf]), [0.5, 1.0])


@pytest.mark.parametrize("dof", DOFS)
@pytest.mark.parametrize("loss", LOSSES, ids=lambda loss: loss.kind.name)
def test_moments_are_the_expectations_that_define_them(loss: RobustLoss, dof: float) -> None:
    """E[w + (2/d) w' s] and E[w² s]/d over a million draws, w' by central differences."""
    s = np.sum(student_t(np.random.default_rng(0), dof, (1_000_000,)) ** 2, axis=1)
    w = loss.weight(s, dof)
    step = 1e-5 * s
    slope = (loss.weight(s + step, dof) - loss.weight(s - step, dof)) / (2 * step)
    a, b = loss.moments(dof)
    assert a == pytest.approx(np.mean(w + 2 / RESIDUAL_DIM * slope * s), rel=5e-3)
    if loss.kind is not LossKind.L2 or dof > 4:  # the mean of s itself converges too slowly below
        assert b == pytest.approx(np.mean(w**2 * s) / RESIDUAL_DIM, rel=5e-3)


def locate(loss: RobustLoss, residuals: FloatArray, dof: float) -> FloatArray:
    """M-estimate of the place of each cloud, [trials, N, 4] to [trials, 4], by iterated
    reweighting."""
    place = np.median(residuals, axis=1)
    for _ in range(30):
        w = loss.weight(np.sum((residuals - place[:, None]) ** 2, axis=2), dof)[..., None]
        place = np.sum(w * residuals, axis=1) / np.sum(w, axis=1)
    return place


@pytest.mark.parametrize("dof", [5.0, np.inf])
@pytest.mark.parametrize("loss", LOSSES, ids=lambda loss: loss.kind.name)
def test_factor_gives_the_covariance_of_a_location(loss: RobustLoss, dof: float) -> None:
    """Places of 1,000 clouds of 100 residuals scatter by 1/(N · factor); 8,000 numbers tell that to
    3 % (2σ)."""
    residuals = student_t(np.random.default_rng(1), dof, (1000, 100))
    scatter = 100 * np.mean(locate(loss, residuals, dof) ** 2)
    assert scatter * information_factor(loss, dof) == pytest.approx(1.0, abs=0.07)

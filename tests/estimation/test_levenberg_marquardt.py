"""Levenberg–Marquardt over several variables against SciPy's, closed forms, and hard cases."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from probevo.arrays import FloatArray
from probevo.estimation import levenberg_marquardt
from probevo.geometry import se3
from probevo.measurements.base import Linearization, Outcome
from probevo.measurements.pose_prior import PosePrior
from probevo.measurements.variables import Values, Variable, pose_of
from probevo.measurements.vector_measurement import VectorMeasurement

FIRST = pose_of(0)
SECOND = pose_of(1)
VECTOR = Variable("vector", 0)


class RelativePose(VectorMeasurement):
    """A measured T_second_first, with the covariance of its left perturbation."""

    def __init__(self, T_second_first: FloatArray, covariance: FloatArray) -> None:
        super().__init__(covariance)
        self.T_second_first = T_second_first

    @property
    def variables(self) -> tuple[Variable, ...]:
        return (FIRST, SECOND)

    def residual(self, values: Values) -> FloatArray:
        T_second_first = values[SECOND] @ se3.inverse(values[FIRST])
        return -se3.log(T_second_first @ se3.inverse(self.T_second_first))


class Linear(VectorMeasurement):
    """A measurement z = A x of a vector x."""

    def __init__(
        self, A: FloatArray, z: FloatArray, covariance: FloatArray, variable: Variable = VECTOR
    ) -> None:
        super().__init__(covariance)
        self.A = A
        self.z = z
        self.variable = variable

    @property
    def variables(self) -> tuple[Variable, ...]:
        return (self.variable,)

    def residual(self, values: Values) -> FloatArray:
        return self.z - self.A @ values[self.variable]

    def jacobians(self, values: Values) -> tuple[FloatArray, ...]:
        return (-self.A,)


def random_covariance(rng: np.random.Generator, dim: int, sigma: float) -> FloatArray:
    root = rng.normal(size=(dim, dim))
    return sigma**2 * (root @ root.T + 0.3 * np.eye(dim))


def two_poses(
    rng: np.random.Generator, sigma: float
) -> tuple[list[VectorMeasurement], dict[Variable, FloatArray]]:
    """Priors of two poses and a measurement of the motion between them, which disagree by their
    noise; and a start that is off by more."""
    true = {variable: se3.exp(rng.normal(size=6)) for variable in (FIRST, SECOND)}
    covariances = [random_covariance(rng, 6, sigma) for _ in range(3)]
    noises = [se3.exp(rng.multivariate_normal(np.zeros(6), cov)) for cov in covariances]
    T_second_first = true[SECOND] @ se3.inverse(true[FIRST])
    measurements: list[VectorMeasurement] = [
        PosePrior(FIRST, noises[0] @ true[FIRST], covariances[0]),
        PosePrior(SECOND, noises[1] @ true[SECOND], covariances[1]),
        RelativePose(noises[2] @ T_second_first, covariances[2]),
    ]
    start = {
        variable: se3.exp(rng.normal(scale=3.0 * sigma, size=6)) @ T for variable, T in true.items()
    }
    return measurements, start


def scipy_optimum(
    measurements: list[VectorMeasurement], start: dict[Variable, FloatArray]
) -> dict[Variable, FloatArray]:
    """The same problem over (ξ_first, ξ_second) from the start, with white residuals."""
    whitening = [np.linalg.inv(np.linalg.cholesky(each.covariance)) for each in measurements]

    def poses(step: FloatArray) -> dict[Variable, FloatArray]:
        return {
            FIRST: se3.exp(step[:6]) @ start[FIRST],
            SECOND: se3.exp(step[6:]) @ start[SECOND],
        }

    def residuals(step: FloatArray) -> FloatArray:
        values = poses(step)
        pairs = zip(whitening, measurements, strict=True)
        return np.concatenate([white @ each.residual(values) for white, each in pairs])

    found = least_squares(
        residuals, np.zeros(12), jac="3-point", xtol=1e-15, ftol=1e-15, gtol=1e-15, x_scale="jac"
    )
    return poses(found.x)


@pytest.mark.parametrize("seed", range(5))
def test_two_poses_and_three_measurements_end_where_scipy_ends(seed: int) -> None:
    measurements, start = two_poses(np.random.default_rng(seed), sigma=1e-3)
    optimum = levenberg_marquardt.minimize(measurements, start, [FIRST, SECOND])
    expected = scipy_optimum(measurements, start)
    assert optimum.converged
    for variable in (FIRST, SECOND):
        error = se3.log(optimum.values[variable] @ se3.inverse(expected[variable]))
        np.testing.assert_allclose(error, 0.0, atol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_converged_is_within_a_hundredth_of_a_standard_deviation(seed: int) -> None:
    """Where the noise is large, and the problem far from linear."""
    measurements, start = two_poses(np.random.default_rng(seed), sigma=0.1)
    optimum = levenberg_marquardt.minimize(measurements, start, [FIRST, SECOND])
    expected = scipy_optimum(measurements, start)
    information = levenberg_marquardt.information(measurements, optimum.values, [FIRST, SECOND])
    errors = [
        se3.log(optimum.values[variable] @ se3.inverse(expected[variable]))
        for variable in (FIRST, SECOND)
    ]
    error = np.concatenate(errors)
    assert optimum.converged
    assert error @ information @ error < 1e-4


def test_information_is_the_sum_over_the_variables_asked_for() -> None:
    """[n, n] in their order; a variable that is not asked for is held."""
    measurements, values = two_poses(np.random.default_rng(6), sigma=0.1)
    of_first, of_second, of_both = (each.information(values) for each in measurements)
    expected = of_both.copy()
    expected[:6, :6] += of_first
    expected[6:, 6:] += of_second
    found = levenberg_marquardt.information(measurements, values, [FIRST, SECOND])
    np.testing.assert_allclose(found, expected, rtol=1e-12)
    swapped = levenberg_marquardt.information(measurements, values, [SECOND, FIRST])
    order = np.r_[6:12, 0:6]
    np.testing.assert_allclose(swapped, expected[np.ix_(order, order)], rtol=1e-12)
    of_one = levenberg_marquardt.information(measurements, values, [SECOND])
    np.testing.assert_allclose(of_one, expected[6:, 6:], rtol=1e-12)
    np.testing.assert_array_equal(
        levenberg_marquardt.information([], values, [FIRST]), np.zeros((6, 6))
    )


def test_a_variable_that_is_not_free_stays_as_it_is() -> None:
    measurements, start = two_poses(np.random.default_rng(7), sigma=1e-3)
    optimum = levenberg_marquardt.minimize(measurements, start, [SECOND])
    np.testing.assert_array_equal(optimum.values[FIRST], start[FIRST])
    again = levenberg_marquardt.minimize([measurements[1], measurements[2]], start, [SECOND])
    error = se3.log(optimum.values[SECOND] @ se3.inverse(again.values[SECOND]))
    np.testing.assert_allclose(error, 0.0, atol=1e-12)


def test_a_plain_vector_is_solved_by_linear_least_squares() -> None:
    rng = np.random.default_rng(8)
    parts = []
    information = np.zeros((3, 3))
    moment = np.zeros(3)
    for dim in (2, 4):
        A = rng.normal(size=(dim, 3))
        z = rng.normal(size=dim)
        covariance = random_covariance(rng, dim, 0.1)
        parts.append(Linear(A, z, covariance))
        information += A.T @ np.linalg.inv(covariance) @ A
        moment += A.T @ np.linalg.solve(covariance, z)
    optimum = levenberg_marquardt.minimize(parts, {VECTOR: np.zeros(3)}, [VECTOR])
    assert optimum.converged
    expected = np.linalg.solve(information, moment)
    np.testing.assert_allclose(optimum.values[VECTOR], expected, rtol=1e-9)
    found = levenberg_marquardt.information(parts, optimum.values, [VECTOR])
    np.testing.assert_allclose(found, information, rtol=1e-12)


def test_poses_and_vectors_are_solved_together() -> None:
    """They have no measurement in common, so that each ends where it ends by itself."""
    rng = np.random.default_rng(9)
    of_poses, start = two_poses(rng, sigma=1e-3)
    of_vector = Linear(np.eye(2), np.array([0.3, -0.7]), 0.01 * np.eye(2))
    values = {**start, VECTOR: np.zeros(2)}
    both = levenberg_marquardt.minimize([*of_poses, of_vector], values, [VECTOR, SECOND, FIRST])
    poses_only = levenberg_marquardt.minimize(of_poses, start, [FIRST, SECOND])
    np.testing.assert_allclose(both.values[VECTOR], [0.3, -0.7], atol=1e-9)
    for variable in (FIRST, SECOND):
        error = se3.log(both.values[variable] @ se3.inverse(poses_only.values[variable]))
        np.testing.assert_allclose(error, 0.0, atol=1e-9)


@dataclass(frozen=True)
class Scalar:
    """A measurement of one number x with the cost ½ (x − 5)²/σ², σ as it was last propagated: 1 at
    x = 0, growing with |x|."""

    sigma: float = 1.0
    propagations: int = 0

    @property
    def variables(self) -> tuple[Variable, ...]:
        return (VECTOR,)

    def propagated(self, values: Values) -> Scalar:
        sigma = 1.0 + 0.1 * float(np.abs(values[VECTOR][0]))
        return replace(self, sigma=sigma, propagations=self.propagations + 1)

    def linearize(self, values: Values, *, newton: bool = False) -> Linearization:
        error = (5.0 - float(values[VECTOR][0])) / self.sigma
        return Linearization(
            cost=0.5 * error**2,
            hessian=np.array([[1.0 / self.sigma**2]]),
            gradient=np.array([error / self.sigma]),
        )

    def information(self, values: Values) -> FloatArray:
        return np.array([[1.0 / self.sigma**2]])

    def outcome(self, values: Values) -> Outcome:
        return Outcome(mahalanobis_sq=np.zeros(1), weight=np.ones(1), gated=np.zeros(1, np.bool_))


def test_no_iterations_keep_the_values_and_propagate_there() -> None:
    start = {VECTOR: np.array([2.0])}
    optimum = levenberg_marquardt.minimize([Scalar()], start, [VECTOR], max_iterations=0)
    np.testing.assert_array_equal(optimum.values[VECTOR], [2.0])
    assert optimum.iterations == 0
    assert optimum.converged
    assert optimum.measurements == (Scalar(sigma=1.2, propagations=1),)


def test_covariances_are_propagated_where_the_solve_ends() -> None:
    """Anew once the values have moved by more than a standard deviation, and not for less."""
    far = levenberg_marquardt.minimize([Scalar()], {VECTOR: np.zeros(1)}, [VECTOR])
    assert far.converged
    assert far.values[VECTOR] == pytest.approx(5.0, abs=1e-5)
    assert far.measurements == (Scalar(sigma=pytest.approx(1.5, abs=1e-5), propagations=2),)
    near = levenberg_marquardt.minimize([Scalar()], {VECTOR: np.array([4.5])}, [VECTOR])
    assert near.converged
    assert near.measurements == (Scalar(sigma=1.45, propagations=1),)


@dataclass(frozen=True)
class Creeping(Scalar):
    """Each propagation lets the solve go on by 1.5 σ, up to 30 σ."""

    target: float = 0.0

    def propagated(self, values: Values) -> Creeping:
        return replace(self, target=min(float(values[VECTOR][0]) + 1.5, 30.0))

    def linearize(self, values: Values, *, newton: bool = False) -> Linearization:
        error = self.target - values[VECTOR]
        return Linearization(cost=0.5 * float(error @ error), hessian=np.eye(1), gradient=error)


def test_a_solve_that_creeps_arrives() -> None:
    """In as many propagations as it takes, each more than 1 σ from the last one."""
    start = {VECTOR: np.zeros(1)}
    optimum = levenberg_marquardt.minimize([Creeping()], start, [VECTOR], max_iterations=50)
    assert optimum.converged
    assert optimum.values[VECTOR] == pytest.approx(30.0)


class Atan(VectorMeasurement):
    """z = atan(x): undamped Gauss–Newton diverges from |x − x̂| > 1.39."""

    @property
    def variables(self) -> tuple[Variable, ...]:
        return (VECTOR,)

    def residual(self, values: Values) -> FloatArray:
        return -np.arctan(values[VECTOR])


def test_a_step_that_raises_the_cost_is_damped() -> None:
    optimum = levenberg_marquardt.minimize(
        [Atan(0.01 * np.eye(1))], {VECTOR: np.array([3.0])}, [VECTOR], max_iterations=50
    )
    assert optimum.converged
    np.testing.assert_allclose(optimum.values[VECTOR], 0.0, atol=1e-5)


class Groups:
    """Numbers a around one x under the loss ln(1 + r²), in groups that pull apart.

    ``newton_hessian`` stands in for Newton's Hessian: np.inf is the true one, None that of IRLS.
    """

    def __init__(self, newton_hessian: float | None) -> None:
        rng = np.random.default_rng(12)
        self.a = np.concatenate([rng.normal(0.0, 0.5, 60), rng.normal(2.4, 0.5, 50)])
        self.newton_hessian = newton_hessian
        self.num_newton = 0

    @property
    def variables(self) -> tuple[Variable, ...]:
        return (VECTOR,)

    def propagated(self, values: Values) -> Groups:
        return self

    def linearize(self, values: Values, *, newton: bool = False) -> Linearization:
        r = self.a - values[VECTOR][0]
        weight = 2.0 / (1.0 + r**2)
        hessian = float(weight.sum())
        self.num_newton += newton
        if newton and self.newton_hessian is not None:
            true = float(np.sum(2.0 * (1.0 - r**2) / (1.0 + r**2) ** 2))
            hessian = true if np.isinf(self.newton_hessian) else self.newton_hessian
        return Linearization(
            cost=float(np.log1p(r**2).sum()),
            hessian=np.array([[hessian]]),
            gradient=np.array([weight @ r]),
        )

    def information(self, values: Values) -> FloatArray:
        return np.eye(1)

    def outcome(self, values: Values) -> Outcome:
        return Outcome(mahalanobis_sq=np.zeros(1), weight=np.ones(1), gated=np.zeros(1, np.bool_))


def solved(newton_hessian: float | None) -> tuple[levenberg_marquardt.Optimum, int]:
    """Where the groups end from x = 3, and how often Newton's Hessian was asked for."""
    groups = Groups(newton_hessian)
    start = {VECTOR: np.array([3.0])}
    optimum = levenberg_marquardt.minimize([groups], start, [VECTOR], max_iterations=100)
    return optimum, groups.num_newton


def test_newton_s_hessian_takes_fewer_iterations() -> None:
    """To the same minimum, where the groups pull apart."""
    by_newton, _ = solved(np.inf)
    by_irls, _ = solved(None)
    assert by_newton.converged
    assert by_irls.converged
    assert by_newton.iterations < by_irls.iterations
    grid = np.linspace(-1.0, 4.0, 100_001)
    groups = Groups(None)
    costs = np.sum([np.log1p((a - grid) ** 2) for a in groups.a], axis=0)
    minimum = grid[np.argmin(costs)]
    assert by_newton.values[VECTOR][0] == pytest.approx(minimum, abs=1e-4)
    assert by_irls.values[VECTOR][0] == pytest.approx(minimum, abs=1e-3)


@pytest.mark.parametrize("newton_hessian", [-1.0, 0.0, np.nan])
def test_an_indefinite_newton_hessian_falls_back_to_reweighted_least_squares(
    newton_hessian: float,
) -> None:
    """The step is taken again with the Hessian of IRLS: the way is the same, at more iterations."""
    by_irls, _ = solved(None)
    recovered, num_newton = solved(newton_hessian)
    assert num_newton > 2
    assert recovered.converged
    np.testing.assert_allclose(recovered.values[VECTOR], by_irls.values[VECTOR], atol=1e-12)
    assert by_irls.iterations < recovered.iterations <= 2 * by_irls.iterations


def test_what_nothing_constrains_does_not_converge() -> None:
    """Of two numbers, the measurement fixes the first only: the values stay where they were."""
    measurement = Linear(np.array([[1.0, 0.0]]), np.array([2.0]), np.eye(1))
    start = {VECTOR: np.array([0.5, 0.25])}
    optimum = levenberg_marquardt.minimize([measurement], start, [VECTOR])
    assert not optimum.converged
    np.testing.assert_array_equal(optimum.values[VECTOR], start[VECTOR])


def test_a_solve_that_is_cut_short_has_not_converged() -> None:
    measurements, start = two_poses(np.random.default_rng(10), sigma=0.1)
    optimum = levenberg_marquardt.minimize(measurements, start, [FIRST, SECOND], max_iterations=1)
    assert optimum.iterations == 1
    assert not optimum.converged


def test_the_start_is_left_as_it_was() -> None:
    measurements, start = two_poses(np.random.default_rng(11), sigma=0.1)
    before = {variable: value.copy() for variable, value in start.items()}
    levenberg_marquardt.minimize(measurements, start, [FIRST, SECOND])
    for variable, value in before.items():
        np.testing.assert_array_equal(start[variable], value)

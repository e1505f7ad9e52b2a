"""The normal equations, information and outcome of a measurement against its cost."""

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo.errors import InputError
from probevo.geometry import se3
from probevo.measurements.variables import Values, Variable, blocks_of, pose_of, retract
from probevo.measurements.vector_measurement import VectorMeasurement, numeric_jacobians

POSE = pose_of(3)
OFFSET = Variable("offset", 3)
POINTS_M = np.array([[1.0, -0.5, 6.0], [-2.0, 0.3, 9.0]])
COVARIANCE = np.array([[0.04, 0.01, 0.0], [0.01, 0.09, -0.02], [0.0, -0.02, 0.05]])


class PointSeen(VectorMeasurement):
    """A point of the world in the camera's frame, off by an unknown offset: d = 3."""

    def __init__(self, measured: FloatArray, **options: float) -> None:
        super().__init__(COVARIANCE, **options)
        self.measured = measured

    @property
    def variables(self) -> tuple[Variable, ...]:
        return (POSE, OFFSET)

    def residual(self, values: Values) -> FloatArray:
        seen = se3.transform(values[POSE], POINTS_M[:1])[0]
        return self.measured - seen - values[OFFSET]


class Linear(VectorMeasurement):
    """The residual −A x of a vector x, [3]."""

    A = np.array([[1.0, 0.2, 0.0], [-0.3, 2.0, 0.4], [0.0, 0.1, 0.7]])

    @property
    def variables(self) -> tuple[Variable, ...]:
        return (OFFSET,)

    def residual(self, values: Values) -> FloatArray:
        return -self.A @ values[OFFSET]

    def jacobians(self, values: Values) -> tuple[FloatArray, ...]:
        return (-self.A,)


def random_values(rng: np.random.Generator) -> Values:
    pose = se3.exp(rng.normal(size=6) * np.repeat([1.0, 0.5], 3))
    return {POSE: pose, OFFSET: rng.normal(scale=0.2, size=3)}


def point_seen(rng: np.random.Generator, values: Values, **options: float) -> PointSeen:
    """With an error of one to two standard deviations."""
    exact = PointSeen(np.zeros(3)).residual(values)
    return PointSeen(rng.normal(scale=0.4, size=3) - exact, **options)


def moved_by(values: Values, variables: tuple[Variable, ...], step: FloatArray) -> Values:
    """The values after a joint step of these variables, [n]."""
    blocks, _ = blocks_of(variables, values)
    free = {variable: retract(values[variable], step[at]) for variable, at in blocks.items()}
    return {**values, **free}


def slopes_of_cost(measurement: VectorMeasurement, values: Values) -> FloatArray:
    """∂cost/∂step by central differences, [n]."""
    step = 1e-5
    _, dof = blocks_of(measurement.variables, values)
    found = []
    for unit in step * np.eye(dof):
        ahead, behind = (
            measurement.linearize(moved_by(values, measurement.variables, sign * unit)).cost
            for sign in (1.0, -1.0)
        )
        found.append((ahead - behind) / (2.0 * step))
    return np.array(found)


def curvatures_of_cost(measurement: VectorMeasurement, values: Values) -> FloatArray:
    """∂²cost/∂step² by central differences of the gradient, [n, n]."""
    step = 1e-5
    _, dof = blocks_of(measurement.variables, values)
    found = []
    for unit in step * np.eye(dof):
        ahead, behind = (
            measurement.linearize(moved_by(values, measurement.variables, sign * unit)).gradient
            for sign in (1.0, -1.0)
        )
        found.append(-(ahead - behind) / (2.0 * step))
    return np.array(found)


@pytest.mark.parametrize("dof", [np.inf, 5.0, 1.0])
def test_gradient_is_minus_the_slope_of_the_cost(dof: float) -> None:
    """Over a pose and a vector, for 50 random values."""
    rng = np.random.default_rng(0)
    for _ in range(50):
        values = random_values(rng)
        measurement = point_seen(rng, values, dof=dof)
        slopes = slopes_of_cost(measurement, values)
        np.testing.assert_allclose(
            measurement.linearize(values).gradient, -slopes, atol=1e-6 * np.abs(slopes).max()
        )


def test_cost_is_the_negative_log_likelihood() -> None:
    """½ s of a Gaussian, ½ (ν + d) ln(1 + s/ν) of a Student-t, both zero for a perfect residual."""
    values = {OFFSET: np.array([0.3, -0.1, 0.2])}
    residual = Linear(COVARIANCE).residual(values)
    s = residual @ np.linalg.solve(COVARIANCE, residual)
    assert Linear(COVARIANCE).linearize(values).cost == pytest.approx(0.5 * s, rel=1e-12)
    student = Linear(COVARIANCE, dof=5.0)
    assert student.linearize(values).cost == pytest.approx(4.0 * np.log1p(s / 5.0), rel=1e-12)
    assert student.linearize({OFFSET: np.zeros(3)}).cost == 0.0


def test_hessian_of_a_linear_gaussian_is_that_of_the_cost() -> None:
    values = {OFFSET: np.array([0.3, -0.1, 0.2])}
    measurement = Linear(COVARIANCE)
    hessian = measurement.linearize(values).hessian
    expected = Linear.A.T @ np.linalg.inv(COVARIANCE) @ Linear.A
    np.testing.assert_allclose(hessian, expected, rtol=1e-6)
    np.testing.assert_allclose(curvatures_of_cost(measurement, values), hessian, rtol=1e-5)


@pytest.mark.parametrize("size", [0.0, 0.3, 3.0])
def test_hessian_of_a_student_t_is_that_of_reweighted_least_squares(size: float) -> None:
    """The cost's own lacks 2 (ν + d)/(ν + s)² (Jᵀ Σ⁻¹ e)(Jᵀ Σ⁻¹ e)ᵀ of it: less, but for e = 0."""
    dof = 5.0
    values = {OFFSET: size * np.array([0.6, -0.3, 0.7])}
    measurement = Linear(COVARIANCE, dof=dof)
    s = float(measurement.outcome(values).mahalanobis_sq[0])
    found = measurement.linearize(values)
    pull = found.gradient / ((dof + 3.0) / (dof + s))
    curvature = found.hessian - 2.0 * (dof + 3.0) / (dof + s) ** 2 * np.outer(pull, pull)
    atol = 1e-6 * np.abs(found.hessian).max()
    np.testing.assert_allclose(curvatures_of_cost(measurement, values), curvature, atol=atol)
    assert np.linalg.eigvalsh(found.hessian)[0] > 0.0


@pytest.mark.parametrize("dof", [np.inf, 5.0])
def test_beyond_the_gate_nothing_pulls(dof: float) -> None:
    """The cost stays where it is at the gate."""
    measurement = Linear(COVARIANCE, dof=dof, gate=9.0)
    direction = np.array([0.6, -0.3, 0.7])
    squared = Linear(COVARIANCE).outcome({OFFSET: direction}).mahalanobis_sq[0]
    at_gate = direction * np.sqrt(9.0 / squared)
    inside = measurement.linearize({OFFSET: 0.999999 * at_gate})
    for factor in (1.000001, 2.0, 1e3):
        values = {OFFSET: factor * at_gate}
        beyond = measurement.linearize(values)
        assert beyond.cost == pytest.approx(inside.cost, rel=1e-5)
        np.testing.assert_array_equal(beyond.gradient, 0.0)
        np.testing.assert_array_equal(beyond.hessian, 0.0)
        np.testing.assert_array_equal(measurement.information(values), 0.0)
        assert measurement.outcome(values).gated.tolist() == [True]
        assert measurement.outcome(values).weight.tolist() == [0.0]
    assert np.abs(inside.gradient).max() > 0.0


@pytest.mark.parametrize("dof", [2.0, 5.0, np.inf])
def test_information_is_the_scatter_of_the_gradient(dof: float) -> None:
    """On average it is Fisher's, (ν + d)/(ν + d + 2) Jᵀ Σ⁻¹ J of a Student-t.

    Over 20,000 draws, which scatter by 3 %.
    """
    rng = np.random.default_rng(1)
    count = 20_000
    measurement = Linear(COVARIANCE, dof=dof)
    mixing = 1.0 if np.isinf(dof) else np.sqrt(dof / rng.chisquare(dof, (count, 1)))
    residuals = mixing * rng.multivariate_normal(np.zeros(3), COVARIANCE, count)
    places = -residuals @ np.linalg.inv(Linear.A).T
    gradients = np.array([measurement.linearize({OFFSET: x}).gradient for x in places])
    information = np.mean([measurement.information({OFFSET: x}) for x in places], axis=0)
    plain = Linear.A.T @ np.linalg.inv(COVARIANCE) @ Linear.A
    share = 1.0 if np.isinf(dof) else (dof + 3.0) / (dof + 5.0)
    np.testing.assert_allclose(information, share * plain, rtol=0.01)
    white = np.linalg.inv(np.linalg.cholesky(information))
    scatter = white @ (gradients.T @ gradients / count) @ white.T
    np.testing.assert_allclose(scatter, np.eye(3), atol=0.03)


@pytest.mark.parametrize("count", [1, 3])
def test_an_outlier_of_a_student_t_tells_nothing(count: int) -> None:
    """1,000 σ off, it is given no weight, and no covariance may shrink by it."""

    class Plain(VectorMeasurement):
        """A measured vector."""

        variables = (OFFSET,)

        def residual(self, values: Values) -> FloatArray:
            """Return minus the value: what was measured is zero."""
            return -values[OFFSET]

    measurement = Plain(np.eye(count), dof=3.0)
    fits = measurement.information({OFFSET: np.zeros(count)})
    tells_nothing = measurement.information({OFFSET: np.full(count, 1e3)})
    np.testing.assert_allclose(fits, (3.0 + count) / 3.0 * np.eye(count), rtol=1e-6)
    assert np.abs(tells_nothing).max() < 1e-5


def test_outcome_is_distance_and_relative_weight() -> None:
    rng = np.random.default_rng(2)
    values = random_values(rng)
    measurement = point_seen(rng, values, dof=4.0)
    residual = measurement.residual(values)
    squared = residual @ np.linalg.solve(COVARIANCE, residual)
    outcome = measurement.outcome(values)
    assert outcome.mahalanobis_sq == pytest.approx(squared, rel=1e-12)
    assert outcome.weight == pytest.approx(4.0 / (4.0 + squared), rel=1e-12)
    assert not outcome.gated.any()
    assert point_seen(rng, values).outcome(values).weight.tolist() == [1.0]


def test_numeric_jacobians_are_those_of_the_chain_rule() -> None:
    """∂(p − T x − o) by ξ is −[1, −(T x)^], by o it is −1."""
    rng = np.random.default_rng(3)
    values = random_values(rng)
    x, y, z = se3.transform(values[POSE], POINTS_M[:1])[0]
    wedge = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    of_pose, of_offset = numeric_jacobians(point_seen(rng, values), values)
    np.testing.assert_allclose(of_pose, -np.hstack([np.eye(3), -wedge]), atol=1e-7)
    np.testing.assert_allclose(of_offset, -np.eye(3), atol=1e-9)


def test_covariance_that_depends_on_nothing_needs_no_propagation() -> None:
    measurement = Linear(COVARIANCE)
    assert measurement.propagated({OFFSET: np.ones(3)}) is measurement


@pytest.mark.parametrize(
    ("covariance", "message"),
    [
        (np.ones((2, 3)), "not symmetric and finite"),
        (np.ones(3), "not symmetric and finite"),
        (np.array([[1.0, 0.5, 0.0], [0.4, 1.0, 0.0], [0.0, 0.0, 1.0]]), "not symmetric and finite"),
        (np.diag([1.0, np.nan, 1.0]), "not symmetric and finite"),
        (np.diag([1.0, np.inf, 1.0]), "not symmetric and finite"),
        (np.diag([1.0, 0.0, 1.0]), "not positive definite"),
        (np.diag([1.0, -1.0, 1.0]), "not positive definite"),
    ],
)
def test_a_covariance_that_is_none_is_refused(covariance: FloatArray, message: str) -> None:
    with pytest.raises(InputError, match=f"Linear: its covariance is {message}"):
        Linear(covariance)


def test_the_information_of_a_narrow_covariance_is_positive_and_symmetric() -> None:
    """As after a step that is known to 10 µm but along the metre by which a solve differs."""
    direction = np.array([0.11, -0.05, 0.85])
    covariance = 1e-10 * np.eye(3) + np.outer(direction, direction)
    information = Linear(covariance).information({OFFSET: np.zeros(3)})
    assert (np.linalg.eigvalsh(information) > 0.0).all()
    assert np.abs(information - information.T).max() <= 1e-12 * np.abs(information).max()
    # Along A⁻¹ d the residual moves along d, the only direction that is hardly known.
    along = np.linalg.solve(Linear.A, direction)
    np.testing.assert_allclose(along @ information @ along, 1.0, rtol=1e-4)

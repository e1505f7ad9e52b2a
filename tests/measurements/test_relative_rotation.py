"""A measured rotation between two frames: its residual, its Jacobians, its covariance."""

import numpy as np
import pytest

from probevo.geometry import se3, so3
from probevo.measurements.relative import relative_motion
from probevo.measurements.relative_rotation import MIN_SIGMA_RAD, RelativeRotation
from probevo.measurements.variables import Values, pose_of
from probevo.measurements.vector_measurement import numeric_jacobians

PREV = pose_of(4)
CURR = pose_of(5)
COV = np.diag([1e-4, 2e-4, 3e-4])


def random_poses(rng: np.random.Generator) -> Values:
    return {variable: se3.exp(rng.normal(size=6)) for variable in (PREV, CURR)}


def measured(values: Values, *, has_prev: bool, off_rad: float = 0.0) -> RelativeRotation:
    """A rotation that is off by that angle about (1, 2, −2)/3."""
    prev = PREV if has_prev else None
    C_curr_prev = relative_motion(values, CURR, prev)[:3, :3]
    off = so3.exp(off_rad * np.array([1.0, 2.0, -2.0]) / 3.0)
    return RelativeRotation(off.T @ C_curr_prev, COV, curr=CURR, prev=prev)


@pytest.mark.parametrize("has_prev", [False, True])
def test_jacobians_against_central_differences(has_prev: bool) -> None:
    """Of both poses, for 100 random pairs, where the residual is zero."""
    rng = np.random.default_rng(0)
    for _ in range(100):
        values = random_poses(rng)
        measurement = measured(values, has_prev=has_prev)
        jacobians = measurement.jacobians(values)
        assert len(jacobians) == len(measurement.variables)
        for found, numeric in zip(jacobians, numeric_jacobians(measurement, values), strict=True):
            np.testing.assert_allclose(found, numeric, atol=1e-6)


def test_jacobians_elsewhere_are_off_by_half_the_angle_at_most() -> None:
    """The Jacobian of Log is taken as 1: it is 1 + φ^/2 + …."""
    rng = np.random.default_rng(1)
    for off_rad in (0.001, 0.01, 0.1):
        values = random_poses(rng)
        measurement = measured(values, has_prev=True, off_rad=off_rad)
        numerics = numeric_jacobians(measurement, values)
        for found, numeric in zip(measurement.jacobians(values), numerics, strict=True):
            assert np.linalg.norm(found - numeric, ord=2) < 0.51 * off_rad


@pytest.mark.parametrize("has_prev", [False, True])
def test_residual_is_minus_the_angle_to_the_measured_rotation(has_prev: bool) -> None:
    values = random_poses(np.random.default_rng(2))
    measurement = measured(values, has_prev=has_prev, off_rad=0.3)
    expected = -0.3 * np.array([1.0, 2.0, -2.0]) / 3.0
    np.testing.assert_allclose(measurement.residual(values), expected, atol=1e-12)


def test_translation_is_not_constrained() -> None:
    values = random_poses(np.random.default_rng(3))
    information = measured(values, has_prev=False).information(values)
    np.testing.assert_array_equal(information[:3], 0.0)
    np.testing.assert_allclose(information[3:, 3:], np.linalg.inv(COV), rtol=1e-6)


def test_no_rotation_is_known_better_than_the_least_sigma() -> None:
    """A gyro said to be without noise."""
    exact = RelativeRotation(np.eye(3), np.zeros((3, 3)), curr=CURR)
    np.testing.assert_array_equal(exact.covariance, MIN_SIGMA_RAD**2 * np.eye(3))


def test_relative_motion_maps_points_from_prev_to_curr() -> None:
    values = random_poses(np.random.default_rng(4))
    point = np.array([[0.3, -0.2, 5.0]])
    in_prev, in_curr = (se3.transform(values[variable], point) for variable in (PREV, CURR))
    T_curr_prev = relative_motion(values, CURR, PREV)
    np.testing.assert_allclose(se3.transform(T_curr_prev, in_prev), in_curr, atol=1e-12)
    np.testing.assert_array_equal(relative_motion(values, CURR, None), values[CURR])

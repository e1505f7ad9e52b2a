"""The example of "Add a measurement" in CONTRIBUTING.md runs, and corrects the attitude."""

from typing import Any

import numpy as np
import pytest

from contributing import example
from probevo.geometry import so3
from probevo.measurements.variables import pose_of
from probevo.measurements.vector_measurement import numeric_jacobians


@pytest.fixture(scope="module")
def names() -> dict[str, Any]:
    """What the example defines."""
    found: dict[str, Any] = {}
    exec(compile(example("Add a measurement"), "CONTRIBUTING.md", "exec"), found)
    return found


def attitude_sigma_rad(pose_cov: np.ndarray) -> np.ndarray:
    return np.sqrt(np.diagonal(pose_cov)[3:])


def test_the_attitude_is_known_to_what_the_direction_says(names: dict[str, Any]) -> None:
    """About the axes across the direction, but not about the direction itself."""
    without = attitude_sigma_rad(names["without"].state.pose.cov)
    corrected = attitude_sigma_rad(names["with_direction"].state.pose.cov)
    across = [0, 2]
    assert (without[across] > 2e-4).all()
    assert (corrected[across] < 1e-4).all()
    assert corrected[1] > 0.5 * without[1]


def test_the_attitude_is_corrected_towards_the_truth(names: dict[str, Any]) -> None:
    """The camera is at rest, so that the true pose is the identity."""
    T_world_cam = names["with_direction"].state.pose.T_world_cam
    tilt = T_world_cam[:3, :3] @ names["DOWN"] - names["DOWN"]
    assert np.linalg.norm(tilt) < 5e-4


def test_the_residual_moves_as_a_turned_direction_does(names: dict[str, Any]) -> None:
    """Under T = Exp(ξ) T̄ it changes by (C d)^ φ, and not with the position."""
    unit = np.array([0.6, 0.0, 0.8])
    direction = names["Direction"](pose_of(1), unit, unit, covariance=np.eye(3))
    (jacobian,) = numeric_jacobians(direction, {pose_of(1): np.eye(4)})
    np.testing.assert_allclose(jacobian[:, :3], 0.0, atol=1e-9)
    np.testing.assert_allclose(jacobian[:, 3:], so3.wedge(unit), atol=1e-9)

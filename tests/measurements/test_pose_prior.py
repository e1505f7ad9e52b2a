"""A Gaussian prior on a pose: its residual, its Jacobian, its information."""

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo.geometry import se3
from probevo.measurements.pose_prior import PosePrior
from probevo.measurements.variables import pose_of

POSE = pose_of(7)
COV = np.diag([0.04, 0.01, 0.09, 1e-4, 4e-4, 1e-4])


def prior_and_pose(rng: np.random.Generator, xi: FloatArray) -> tuple[PosePrior, FloatArray]:
    """A prior, and a pose Exp(ξ) away from its mean."""
    mean = se3.exp(rng.normal(size=6))
    return PosePrior(POSE, mean, COV), se3.exp(xi) @ mean


@pytest.mark.parametrize("size", [0.0, 0.1, 1.0])
def test_jacobian_against_central_differences(size: float) -> None:
    """By fourth-order differences with a step of their own."""
    rng = np.random.default_rng(0)
    step = 1e-3
    stencil = np.array([1.0, -8.0, 8.0, -1.0]) / (12.0 * step)
    for _ in range(50):
        direction = rng.normal(size=6)
        prior, T = prior_and_pose(rng, size * direction / np.linalg.norm(direction))
        (found,) = prior.jacobians({POSE: T})
        columns = []
        for unit in np.eye(6):
            steps = [se3.exp(factor * step * unit) for factor in (-2.0, -1.0, 1.0, 2.0)]
            columns.append(stencil @ [prior.residual({POSE: each @ T}) for each in steps])
        np.testing.assert_allclose(found, np.stack(columns, axis=1), atol=1e-6)


def test_jacobian_at_the_mean_is_minus_one() -> None:
    prior, T = prior_and_pose(np.random.default_rng(1), np.zeros(6))
    (found,) = prior.jacobians({POSE: T})
    np.testing.assert_allclose(found, -np.eye(6), atol=1e-8)


def test_residual_is_minus_the_left_perturbation() -> None:
    xi = np.array([0.3, -0.2, 0.5, 0.1, 0.2, -0.3])
    prior, T = prior_and_pose(np.random.default_rng(2), xi)
    np.testing.assert_allclose(prior.residual({POSE: T}), -xi, atol=1e-12)


def test_information_at_the_mean_is_the_inverse_covariance() -> None:
    prior, T = prior_and_pose(np.random.default_rng(3), np.zeros(6))
    assert prior.variables == (POSE,)
    sigma = np.sqrt(np.diag(COV))
    whitened = np.outer(sigma, sigma) * prior.information({POSE: T})
    np.testing.assert_allclose(whitened, np.eye(6), atol=1e-7)

"""The compiled perturbation of a pose is that of ``geometry.se3``."""

import numpy as np
import pytest

from probevo.geometry import se3
from probevo.geometry.se3_numba import perturb


@pytest.mark.parametrize("angle_rad", [0.0, 1e-12, 1e-6, 0.9e-3, 0.999e-3, 1.001e-3, 0.1, 1.0, 3.0])
def test_perturbation_is_exp_from_the_left(angle_rad: float) -> None:
    """On both sides of the angle below which it is a series."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        axis = rng.normal(size=3)
        phi = angle_rad * axis / np.linalg.norm(axis)
        xi = np.concatenate([rng.normal(size=3), phi])
        T = se3.exp(rng.normal(size=6))
        moved = np.full((4, 4), np.nan)
        perturb(xi, T, moved)
        np.testing.assert_allclose(moved, se3.exp(xi) @ T, atol=1e-14)

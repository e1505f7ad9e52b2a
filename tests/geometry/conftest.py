"""Random states shared by the tests of geometry."""

from __future__ import annotations

import numpy as np
import pytest

from probevo.arrays import FloatArray


@pytest.fixture(scope="session")
def rotation_vectors() -> FloatArray:
    """1,000 rotation vectors, [1000, 3], rad: one is 0, 199 have angles down to 1e-12, 200 come
    within 1e-5 of π."""
    rng = np.random.default_rng(0)
    angles = np.concatenate(
        [[0.0], np.geomspace(1e-12, 1e-2, 199), np.pi - np.geomspace(1e-5, 1e-2, 200)]
    )
    angles = np.concatenate([angles, rng.uniform(0.0, 3.1, 600)])
    axes = rng.normal(size=(1000, 3))
    return angles[:, None] * axes / np.linalg.norm(axes, axis=1, keepdims=True)


@pytest.fixture(scope="session")
def twists(rotation_vectors: FloatArray) -> FloatArray:
    """1,000 tangent vectors of SE(3), [1000, 6]: those rotations, and translations of metres."""
    return np.hstack([np.random.default_rng(1).normal(scale=5.0, size=(1000, 3)), rotation_vectors])

"""The variables of an estimate: steps of their values, and their places in the joint vector."""

import numpy as np

from probevo.geometry import se3
from probevo.measurements.variables import Variable, blocks_of, dimension, pose_of, retract

POSE = pose_of(3)
OFFSET = Variable("offset", 3)


def test_variables_are_poses_or_vectors() -> None:
    """A pose moves by Exp(ξ) from the left, a vector by addition; blocks follow one another."""
    rng = np.random.default_rng(4)
    T = se3.exp(rng.normal(size=6))
    xi = rng.normal(size=6)
    assert dimension(T) == 6
    np.testing.assert_allclose(retract(T, xi), se3.exp(xi) @ T, atol=1e-14)
    assert dimension(np.zeros(4)) == 4
    np.testing.assert_array_equal(retract(np.array([1.0, 2.0]), np.array([0.5, 1.0])), [1.5, 3.0])
    blocks, dof = blocks_of([OFFSET, POSE], {POSE: T, OFFSET: np.zeros(3)})
    assert blocks == {OFFSET: slice(0, 3), POSE: slice(3, 9)}
    assert dof == 9

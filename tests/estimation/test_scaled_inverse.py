"""Inverses do not depend on the units of the states."""

from collections.abc import Callable

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo.estimation.scaled_inverse import (
    inverse_or_nan,
    scaled_inverse,
    scaled_pseudo_inverse,
)

UNITS = np.logspace(-9.0, 9.0, 6)


def definite(seed: int) -> FloatArray:
    """A well-conditioned covariance, [6, 6]."""
    root = np.random.default_rng(seed).normal(size=(6, 6))
    return root @ root.T + np.eye(6)


@pytest.mark.parametrize("invert", [scaled_inverse, inverse_or_nan])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_inverse_in_other_units_is_as_accurate(
    invert: Callable[[FloatArray], FloatArray], seed: int
) -> None:
    """Also where the units differ by more than the precision of a float."""
    matrix = definite(seed)
    inverse = invert(UNITS[:, None] * matrix * UNITS)
    np.testing.assert_allclose(
        UNITS[:, None] * inverse * UNITS, np.linalg.inv(matrix), rtol=1e-12, atol=1e-14
    )


def test_the_scaled_inverse_is_symmetric_to_the_byte() -> None:
    inverse = scaled_inverse(UNITS[:, None] * definite(3) * UNITS)
    np.testing.assert_array_equal(inverse, inverse.T)


def test_the_scaled_inverse_of_a_singular_matrix_is_an_error() -> None:
    with pytest.raises(np.linalg.LinAlgError):
        scaled_inverse(np.ones((3, 3)))


def test_the_schur_complement_by_the_pseudo_inverse_is_that_of_the_range() -> None:
    """A direction that a block does not know leaves the rest as it is, in any units."""
    units = np.append(UNITS, np.ones(3))
    root = np.random.default_rng(13).normal(size=(9, 9))
    root[5, :] = root[4, :]  # the first six states are known in five directions
    whole = units[:, None] * (root @ root.T) * units
    gone, coupling = whole[:6, :6], whole[:6, 6:]
    found = whole[6:, 6:] - coupling.T @ scaled_pseudo_inverse(gone) @ coupling
    basis = np.linalg.qr(root[:6].T)[0][:, :5]
    expected = root[6:] @ (np.eye(9) - basis @ basis.T) @ root[6:].T
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)
    regular = definite(14)
    np.testing.assert_allclose(scaled_pseudo_inverse(regular), np.linalg.inv(regular), rtol=1e-10)


def test_information_that_is_not_positive_definite_has_no_inverse() -> None:
    """Singular to working precision or not finite: NaN all over."""
    root = np.random.default_rng(12).normal(size=(6, 5))
    assert np.isnan(inverse_or_nan(root @ root.T - 1e-3 * np.eye(6))).all()
    assert np.isnan(inverse_or_nan(np.full((6, 6), np.inf))).all()
    assert np.isnan(inverse_or_nan(np.zeros((6, 6)))).all()

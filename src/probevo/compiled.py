"""The compiler of the inner loops, and the small dense linear algebra that they use."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np
from numba import njit

from probevo.arrays import AnyArray, FloatArray

Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(function: Function) -> Function:
    """Compile an inner loop with Numba on its first call, and cache the machine code on disk.

    Division by zero gives infinity or NaN instead of an exception. The loop releases the GIL.

    The arithmetic is that of the source, in its order. If sums might be reordered ("fast math"),
    their rounding would depend on what the optimizer makes of each function, which differs between
    one that was compiled a moment ago and one that was read from the cache: two processes could
    then give different bytes for the same seed.
    """
    return cast(Function, njit(cache=True, nogil=True, error_model="numpy")(function))


def compiled_into_callers(function: Function) -> Function:
    """Make an inner loop a part of each compiled function that calls it.

    For loops so short that handing over their many arrays takes as long as they do.
    """
    inline = njit(cache=True, nogil=True, error_model="numpy", inline="always")
    return cast(Function, inline(function))


def compiled_with_free_order(function: Function) -> Function:
    """Compile a loop of sums, whose terms may be added in any order.

    The processor then adds many at once. The function must call no other compiled one.
    """
    compile_ = njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc"})
    return cast(Function, compile_(function))


@compiled_with_free_order
def dot_float32(a: AnyArray, b: AnyArray) -> np.float32:
    """Return the inner product of two contiguous vectors of float32 of the same length."""
    total = np.float32(0.0)
    for i in range(len(a)):
        total += a[i] * b[i]
    return np.float32(total)


@compiled_with_free_order
def multiply_float32(matrix: AnyArray, vector: AnyArray, product: FloatArray) -> None:
    """Set product to matrix · vector, of contiguous float32 [M, N] and [N]."""
    for m in range(matrix.shape[0]):
        total = np.float32(0.0)
        for i in range(matrix.shape[1]):
            total += matrix[m, i] * vector[i]
        product[m] = total


@compiled_with_free_order
def inner_products_float32(rows: AnyArray, products: FloatArray) -> None:
    """Set products to rows · rowsᵀ, [M, M], of contiguous float32 [M, N]."""
    for m in range(rows.shape[0]):
        for n in range(m + 1):
            total = np.float32(0.0)
            for i in range(rows.shape[1]):
                total += rows[m, i] * rows[n, i]
            products[m, n] = products[n, m] = total


@compiled_with_free_order
def sum_float32(values: AnyArray) -> np.float32:
    """Return the sum of a contiguous vector of float32."""
    total = np.float32(0.0)
    for i in range(len(values)):
        total += values[i]
    return np.float32(total)


@compiled_with_free_order
def sum_magnitudes_float32(values: AnyArray) -> np.float32:
    """Return the sum of the absolute values of a contiguous vector of float32."""
    total = np.float32(0.0)
    for i in range(len(values)):
        total += abs(values[i])
    return np.float32(total)


@compiled
def sum_in_lanes(values: FloatArray) -> float:
    """Return the sum of a vector, of eight partial sums that the processor adds up at once.

    The order of the terms is fixed, so that the bytes are the same from a cold compiler cache.
    """
    s0 = s1 = s2 = s3 = s4 = s5 = s6 = s7 = 0.0
    whole = len(values) - len(values) % 8
    for m in range(0, whole, 8):
        s0 += values[m]
        s1 += values[m + 1]
        s2 += values[m + 2]
        s3 += values[m + 3]
        s4 += values[m + 4]
        s5 += values[m + 5]
        s6 += values[m + 6]
        s7 += values[m + 7]
    for m in range(whole, len(values)):
        s0 += values[m]
    return ((s0 + s4) + (s2 + s6)) + ((s1 + s5) + (s3 + s7))


@compiled
def copy_into(target: FloatArray, source: FloatArray) -> None:
    """Copy ``source`` to ``target``; both are contiguous and of the same shape.

    The slice assignment ``target[:] = source`` would include an error message about shapes, which
    costs Numba 2 s of compilation on the very first run.
    """
    to = target.ravel()
    values = source.ravel()
    for i in range(len(to)):
        to[i] = values[i]


@compiled
def invert_symmetric_4(matrix: FloatArray, inverse: FloatArray, lower: FloatArray) -> bool:
    """Invert a symmetric positive definite 4×4 matrix by Cholesky factorisation.

    Args:
        matrix: [4, 4]; only its lower triangle is read.
        inverse: receives the inverse, [4, 4].
        lower: work space, [4, 4].

    Returns:
        False if the matrix is not positive definite to working precision; ``inverse`` is then
        undefined.
    """
    # Cholesky factor L with L Lᵀ = matrix.
    for i in range(4):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= lower[i, k] * lower[j, k]
            if i == j:
                if not total > 1e-13 * matrix[i, i]:
                    return False
                lower[i, i] = math.sqrt(total)
            else:
                lower[i, j] = total / lower[j, j]
    # Replace L by its inverse, column by column.
    for column in range(4):
        lower[column, column] = 1.0 / lower[column, column]
        for i in range(column + 1, 4):
            total = 0.0
            for k in range(column, i):
                total -= lower[i, k] * lower[k, column]
            lower[i, column] = total / lower[i, i]
    # The inverse of the matrix is L⁻ᵀ L⁻¹.
    for i in range(4):
        for j in range(i + 1):
            total = 0.0
            for k in range(i, 4):
                total += lower[k, i] * lower[k, j]
            inverse[i, j] = inverse[j, i] = total
    return True


@compiled
def solve_positive_definite(
    matrix: FloatArray, vector: FloatArray, lower: FloatArray, solution: FloatArray
) -> bool:
    """Solve matrix · solution = vector by Cholesky factorisation.

    Args:
        matrix: symmetric, [n, n].
        vector: right-hand side, [n].
        lower: work space, [n, n].
        solution: receives the solution, [n].

    Returns:
        False if the matrix is not positive definite to working precision.
    """
    if not factor(matrix, len(vector), lower):
        return False
    substitute(lower, vector, solution)
    return True


@compiled
def factor(matrix: FloatArray, n: int, lower: FloatArray) -> bool:
    """Compute the Cholesky factor of the first n rows and columns of a symmetric matrix.

    Returns:
        False if that block is not positive definite to working precision.
    """
    for i in range(n):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= lower[i, k] * lower[j, k]
            if i == j:
                if not total > 1e-13 * matrix[i, i]:
                    return False
                lower[i, i] = math.sqrt(total)
            else:
                lower[i, j] = total / lower[j, j]
    return True


@compiled
def substitute(lower: FloatArray, vector: FloatArray, solution: FloatArray) -> None:
    """Solve lower · lowerᵀ · solution = vector by forward and backward substitution."""
    n = len(vector)
    # Forward: lower · z = vector.
    for i in range(n):
        total = vector[i]
        for k in range(i):
            total -= lower[i, k] * solution[k]
        solution[i] = total / lower[i, i]
    # Backward: lowerᵀ · solution = z.
    for i in range(n - 1, -1, -1):
        total = solution[i]
        for k in range(i + 1, n):
            total -= lower[k, i] * solution[k]
        solution[i] = total / lower[i, i]


@compiled
def invert_positive_definite(matrix: FloatArray, lower: FloatArray, inverse: FloatArray) -> bool:
    """Invert a symmetric positive definite matrix, [n, n], by Cholesky factorisation.

    Returns:
        False if the matrix is not positive definite to working precision.
    """
    n = len(matrix)
    if not factor(matrix, n, lower):
        return False
    unit = np.zeros(n)
    column = np.empty(n)
    for k in range(n):
        unit[k] = 1.0
        substitute(lower, unit, column)
        unit[k] = 0.0
        for i in range(n):
            inverse[i, k] = column[i]
    return True

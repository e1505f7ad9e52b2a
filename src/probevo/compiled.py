"""The compiler of the inner loops, and the small dense linear algebra that they use."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np
from numba import njit

from probevo.arrays import FloatArray

Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(function: Function) -> Function:
    """Compile an inner loop with Numba on its first call, and cache the machine code on disk.

    Division by zero gives infinity or NaN instead of an exception. Sums may be reordered, but NaN
    and infinity keep their meaning. The loop releases the GIL.
    """
    compile_ = njit(
        cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"}
    )
    return cast(Function, compile_(function))


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
        False if the matrix is not positive definite; ``inverse`` is then undefined.
    """
    # Cholesky factor L with L Lᵀ = matrix.
    for i in range(4):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= lower[i, k] * lower[j, k]
            if i == j:
                if not total > 0.0:
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


@compiled
def perturb(
    xi: FloatArray, C: FloatArray, t: FloatArray, C_out: FloatArray, t_out: FloatArray
) -> None:
    """Compute (C_out, t_out) = Exp(ξ) (C, t) for ξ = [ρ; φ] (thesis eqs. 2.3, 2.14, 2.15).

    Args:
        xi: left perturbation, [6], m and rad.
        C: rotation, [3, 3].
        t: translation, [3], m.
        C_out: receives the perturbed rotation, [3, 3].
        t_out: receives the perturbed translation, [3], m.
    """
    x = xi[3]
    y = xi[4]
    z = xi[5]
    squared = x * x + y * y + z * z
    # a = sin θ / θ, b = (1 − cos θ) / θ², c = (θ − sin θ) / θ³, by their series near 0, where the
    # omitted terms are below the last bit.
    if squared < 1e-6:
        a = 1.0 - squared / 6.0
        b = 0.5 - squared / 24.0
        c = 1.0 / 6.0 - squared / 120.0
    else:
        angle = math.sqrt(squared)
        a = math.sin(angle) / angle
        b = (1.0 - math.cos(angle)) / squared
        c = (1.0 - a) / squared
    # Exp(φ) = 1 + a φ^ + b φ^φ^, and its left Jacobian J = 1 + b φ^ + c φ^φ^.
    wedge = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    wedge_2 = np.array(
        [
            [x * x - squared, x * y, x * z],
            [x * y, y * y - squared, y * z],
            [x * z, y * z, z * z - squared],
        ]
    )
    for i in range(3):
        moved = 0.0
        for k in range(3):
            rotation = a * wedge[i, k] + b * wedge_2[i, k]
            left_jacobian = b * wedge[i, k] + c * wedge_2[i, k]
            if i == k:
                rotation += 1.0
                left_jacobian += 1.0
            moved += rotation * t[k] + left_jacobian * xi[k]
        t_out[i] = moved
        for j in range(3):
            total = C[i, j]
            for k in range(3):
                total += (a * wedge[i, k] + b * wedge_2[i, k]) * C[k, j]
            C_out[i, j] = total


@compiled
def rotation_error(C: FloatArray, C_prior: FloatArray, error: FloatArray) -> None:
    """Compute the rotation error φ = Log(C C_priorᵀ), [3], rad.

    The angle comes from both its sine and its cosine. C must not be half a turn from C_prior, where
    the axis is undefined.
    """
    # D = C C_priorᵀ
    D = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                D[i, j] += C[i, k] * C_prior[j, k]
    # The skew-symmetric part of D is sin θ times its axis; its trace is 1 + 2 cos θ.
    x = 0.5 * (D[2, 1] - D[1, 2])
    y = 0.5 * (D[0, 2] - D[2, 0])
    z = 0.5 * (D[1, 0] - D[0, 1])
    sine = math.sqrt(x * x + y * y + z * z)
    cosine = 0.5 * (D[0, 0] + D[1, 1] + D[2, 2] - 1.0)
    ratio = math.atan2(sine, cosine) / sine if sine > 1e-9 else 1.0
    error[0] = ratio * x
    error[1] = ratio * y
    error[2] = ratio * z

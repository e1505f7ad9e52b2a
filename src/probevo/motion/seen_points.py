"""The point behind a stereo observation, and how noisy it is: a compiled inner loop of the reprojection solve."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.compiled import compiled, copy_into, invert_symmetric_4, solve_positive_definite


@compiled
def observation_to_point(
    observed: FloatArray, scale: FloatArray, propagate: bool, seen: FloatArray, point_cov: FloatArray
) -> None:
    """The point s = (u, v, d) behind each stereo observation y, and its scale matrix S.

    With ``propagate``, s = K y is the generalised least-squares estimate of y = H s under the scale R: the two rows are
    averaged by their information, and S = (Hᵀ R⁻¹ H)⁻¹. Without, s averages the rows plainly, as g does, and S is 0.
    Fills seen [N, 3] from observed [N, 4], px, and point_cov [N, 3, 3] from scale [N, 4, 4], px².
    """
    inverse, lower = np.empty((4, 4)), np.zeros((4, 4))
    normal, lower_3, unit, column = np.empty((3, 3)), np.zeros((3, 3)), np.zeros(3), np.zeros(3)
    K = np.zeros((3, 4))
    K[0, 0] = K[2, 0] = 1.0
    K[2, 2] = -1.0
    K[1, 1] = K[1, 3] = 0.5
    for n in range(len(observed)):
        is_new = n == 0
        for i in range(4):  # most models give all features one scale
            for j in range(4):
                is_new = is_new or scale[n, i, j] != scale[n - 1, i, j]
        if propagate and is_new:
            if not invert_symmetric_4(scale[n], inverse, lower):
                inverse[:] = 0.0
            # H maps (u, v, d) to (u, v, u − d, v)
            normal[0, 0] = inverse[0, 0] + 2.0 * inverse[0, 2] + inverse[2, 2]
            normal[1, 1] = inverse[1, 1] + 2.0 * inverse[1, 3] + inverse[3, 3]
            normal[2, 2] = inverse[2, 2]
            normal[0, 1] = normal[1, 0] = inverse[0, 1] + inverse[0, 3] + inverse[2, 1] + inverse[2, 3]
            normal[0, 2] = normal[2, 0] = -inverse[0, 2] - inverse[2, 2]
            normal[1, 2] = normal[2, 1] = -inverse[1, 2] - inverse[3, 2]
            for k in range(4):  # K = (Hᵀ R⁻¹ H)⁻¹ Hᵀ R⁻¹, column by column
                unit[0], unit[1], unit[2] = (
                    inverse[0, k] + inverse[2, k],
                    inverse[1, k] + inverse[3, k],
                    -inverse[2, k],
                )
                if solve_positive_definite(normal, unit, lower_3, column):
                    K[0, k], K[1, k], K[2, k] = column
            for k in range(3):
                unit[:] = 0.0
                unit[k] = 1.0
                if solve_positive_definite(normal, unit, lower_3, column):
                    point_cov[n, 0, k], point_cov[n, 1, k], point_cov[n, 2, k] = column
        elif propagate:
            copy_into(point_cov[n], point_cov[n - 1])
        for i in range(3):
            seen[n, i] = (
                K[i, 0] * observed[n, 0]
                + K[i, 1] * observed[n, 1]
                + K[i, 2] * observed[n, 2]
                + K[i, 3] * observed[n, 3]
            )

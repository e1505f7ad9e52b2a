"""Compiled loop of the interpolation between centers (see ``centers``)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from probevo.arrays import SingleArray
from probevo.compiled import compiled
from probevo.noise.gk.center_search_numba import NEAREST
from probevo.noise.student_t_arrays import NUM_PARAMETERS, StudentTBatch

if TYPE_CHECKING:
    from probevo.noise.gk.center_search import NearestCenters

DOMAIN_MARGIN = 1.5
"""Radius of the domain over the distance within which nearly all training data lie."""
FADE = DOMAIN_MARGIN / (DOMAIN_MARGIN - 1.0)
"""Slope of the transition to the prior, which begins at that distance and ends at the radius."""


@compiled
def interpolate(
    nearest: NearestCenters,
    parameters: SingleArray,
    prior: SingleArray,
    domain_radius: float,
    mixed: StudentTBatch,
) -> None:
    """Fill in the distributions from the parameters of the nearest centers and of the prior."""
    index = nearest.centers
    squared = nearest.squared
    count, num_nearest = index.shape
    mean = np.empty(NUM_PARAMETERS)
    lower = np.zeros((4, 4))
    weight = np.zeros(NEAREST)
    for n in range(count):
        # Weights of inverse squared distance, bounded where a center is very near.
        total = 0.0
        farthest = squared[n, num_nearest - 1]
        for k in range(num_nearest):
            weight[k] = (
                1.0 / (squared[n, k] + 0.01 * farthest + 1e-12) if farthest < np.inf else 0.0
            )
            total += weight[k]
        # If there are fewer than four centers, the indices repeat, with weights of zero.
        a = index[n, 0]
        b = index[n, 1 % num_nearest]
        c = index[n, 2 % num_nearest]
        d = index[n, 3 % num_nearest]
        # Share of the centers; that of the prior is the rest. It is 1 up to the distance radius /
        # DOMAIN_MARGIN, and falls linearly to 0 at the radius.
        share = (
            min(1.0, max(0.0, FADE * (1.0 - math.sqrt(squared[n, 0]) / domain_radius)))
            if total > 0.0
            else 0.0
        )
        part = share / total if share > 0.0 else 0.0
        wa = part * weight[0]
        wb = part * weight[1]
        wc = part * weight[2]
        wd = part * weight[3]
        for j in range(NUM_PARAMETERS):
            center_share = (
                wa * parameters[a, j]
                + wb * parameters[b, j]
                + wc * parameters[c, j]
                + wd * parameters[d, j]
            )
            mean[j] = (1.0 - share) * prior[j] + center_share
        # From the parameters back to bias, scale and ν: the inverse of
        # ``StudentTBatch.log_cholesky``.
        for i in range(4):
            mixed.bias[n, i] = mean[i]
            for j in range(i + 1):
                entry = mean[4 + i * (i + 1) // 2 + j]
                lower[i, j] = math.exp(entry) if i == j else entry
        # Σ = L Lᵀ
        for i in range(4):
            for j in range(i + 1):
                product = 0.0
                for k in range(j + 1):
                    product += lower[i, k] * lower[j, k]
                mixed.scale[n, i, j] = mixed.scale[n, j, i] = product
        mixed.dof[n] = math.exp(mean[14])

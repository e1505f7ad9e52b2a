"""How much the optical flow varies near a feature against farther around it (PROBE eq. 17)."""

from __future__ import annotations

import math

import numpy as np

from probevo.arrays import FloatArray
from probevo.compiled import compiled

MIN_FEATURES = 3
"""Within the small window, the feature itself included, for a variance to be one."""
FLOOR_PX2 = 1e-2
"""Variance of the flow that tracking alone makes; less than this counts as this."""


def flow_variance(
    previous_uv: FloatArray, uv: FloatArray, *, small_px: float = 50.0, large_px: float = 200.0
) -> FloatArray:
    """ln(σ̄²_small / σ̄²_large), σ̄² the mean of the variances of the horizontal and of the
    vertical flow in a window.

    The windows are squares around the feature's current place and hold the features up to their
    border. Both variances are at least ``FLOOR_PX2``, so that a standing camera yields 0 and
    features that move as one no −∞.

    The sign is the published one: more is said to tell of a moving object. In simulated traffic it
    is rather less that
    does: a car that fills the small window moves as one. More is where the window holds both the
        car and what is behind
    it, or near and far things that all stand.

    Args:
        previous_uv: features in the left image before, [N, 2], px.
        uv: the same in the current left image, [N, 2], px.
        small_px: half side of the small window; 50 px, and 200 px for the large one, are those of
            the paper's code, for images of KITTI's resolution (a focal length of about 720 px).
        large_px: half side of the large window.

    Returns:
        [N], 1; NaN where fewer than ``MIN_FEATURES`` features lie in the small window.
    """
    order = np.argsort(uv[:, 0], kind="stable")
    u, v = np.ascontiguousarray(uv[order].T)
    flow = uv - previous_uv
    # About their median, the flows are small enough that sums of squares lose nothing.
    du, dv = (
        np.ascontiguousarray((flow - np.median(flow, axis=0))[order].T)
        if len(uv)
        else np.zeros((2, 0))
    )
    small = np.empty(len(uv))
    large = np.empty(len(uv))
    _fill_variances(u, v, du, dv=dv, half_px=small_px, variances=small)
    _fill_variances(u, v, du, dv=dv, half_px=large_px, variances=large)
    values = np.empty(len(uv))
    values[order] = np.log(np.maximum(small, FLOOR_PX2) / np.maximum(large, FLOOR_PX2))
    return values


@compiled
def _fill_variances(
    u: FloatArray,
    v: FloatArray,
    du: FloatArray,
    dv: FloatArray,
    half_px: float,
    variances: FloatArray,
) -> None:
    """Mean of the variances of du and dv in the window around each feature; features are sorted by
    u. All are [N]."""
    first = 0
    end = 0
    for i in range(len(u)):
        while u[first] < u[i] - half_px:
            first += 1
        while end < len(u) and u[end] <= u[i] + half_px:
            end += 1
        count = 0.0
        sum_u = 0.0
        sum_v = 0.0
        squares = 0.0
        for j in range(first, end):
            inside = 1.0 if abs(v[j] - v[i]) <= half_px else 0.0
            count += inside
            sum_u += inside * du[j]
            sum_v += inside * dv[j]
            squares += inside * (du[j] * du[j] + dv[j] * dv[j])
        mean_u = sum_u / count
        mean_v = sum_v / count
        total = 0.5 * (squares / count - mean_u * mean_u - mean_v * mean_v)
        variances[i] = max(total, 0.0) if count >= MIN_FEATURES else math.nan

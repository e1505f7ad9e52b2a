"""The variance of the optical flow near a feature against that farther around it (PROBE eq. 17)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from probevo.arrays import FloatArray
from probevo.compiled import compiled
from probevo.predictors.base import Needs, Predictor, Step

MIN_FEATURES = 3
"""Minimum number of features in the small window, the feature itself included, for a variance."""
FLOOR_PX2 = 1e-2
"""Variance of the flow that the noise of tracking makes; smaller ones count as this."""
SMALL_PX = 50.0
"""Half side of the small window in the paper's code, for the focal length of KITTI's images."""
LARGE_PX = 200.0
"""Half side of the large window in the paper's code, for the focal length of KITTI's images."""
KITTI_FOCAL_LENGTH_PX = 720.0


def flow_variance(
    previous_uv: FloatArray,
    uv: FloatArray,
    *,
    small_px: float = SMALL_PX,
    large_px: float = LARGE_PX,
) -> FloatArray:
    """Compute ln(σ̄²_small / σ̄²_large) of the optical flow in two windows (PROBE eq. 17).

    σ̄² is the mean of the variances of the horizontal and of the vertical flow in a window. The
    windows are squares around the feature's current place, their borders included. Both variances
    are at least ``FLOOR_PX2``, so that a standing camera yields 0 and features that move as one do
    not yield −∞.

    According to the paper, a higher value tells of a moving object. In simulated traffic it is
    rather a lower value: a car that fills the small window moves as one. The value is high where
    the window holds both the car and its background, or near and far things that all stand.

    Args:
        previous_uv: features in the left image of the previous frame, [N, 2], px.
        uv: features in the current left image, [N, 2], px.
        small_px: half side of the small window.
        large_px: half side of the large window.

    Returns:
        [N], logarithm of a ratio; NaN where fewer than ``MIN_FEATURES`` features lie in the small
        window.
    """
    if not len(uv):
        return np.zeros(0)
    # Sorted by u, the features of a window are consecutive but for their rows
    order = np.argsort(uv[:, 0], kind="stable")
    flow = uv - previous_uv
    # Relative to their median, the flows are small enough for sums of squares to lose no precision
    centered = flow - np.median(flow, axis=0)
    sorted_flow = SortedFlow(
        u=np.ascontiguousarray(uv[order, 0]),
        v=np.ascontiguousarray(uv[order, 1]),
        du=np.ascontiguousarray(centered[order, 0]),
        dv=np.ascontiguousarray(centered[order, 1]),
    )
    small = np.empty(len(uv))
    large = np.empty(len(uv))
    _fill_variances(sorted_flow, small_px, small)
    _fill_variances(sorted_flow, large_px, large)
    # Back from the order of u to the order of the features
    values = np.empty(len(uv))
    values[order] = np.log(np.maximum(small, FLOOR_PX2) / np.maximum(large, FLOOR_PX2))
    return values


class SortedFlow(NamedTuple):
    """Features in ascending order of u, with their optical flow; each field is [N], px."""

    u: FloatArray
    v: FloatArray
    du: FloatArray
    dv: FloatArray


@compiled
def _fill_variances(flow: SortedFlow, half_px: float, variances: FloatArray) -> None:
    """Fill in the mean of the variances of du and dv in the window around each feature, [N]."""
    u = flow.u
    v = flow.v
    du = flow.du
    dv = flow.dv
    first = 0
    end = 0
    for i in range(len(u)):
        # Features are sorted by u: only those from first to end can lie in the window
        while u[first] < u[i] - half_px:
            first += 1
        while end < len(u) and u[end] <= u[i] + half_px:
            end += 1
        # Sum over the window without branches, so that the compiler can vectorise the loop
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
        # Mean of the two variances, E[x²] − E[x]² each
        mean_u = sum_u / count
        mean_v = sum_v / count
        total = 0.5 * (squares / count - mean_u * mean_u - mean_v * mean_v)
        variances[i] = max(total, 0.0) if count >= MIN_FEATURES else math.nan


def _compute(step: Step) -> FloatArray:
    """Compute the flow variance in windows of the paper's angular size."""
    return flow_variance(
        step.previous_uv,
        step.uv,
        small_px=SMALL_PX * step.camera.fu_px / KITTI_FOCAL_LENGTH_PX,
        large_px=LARGE_PX * step.camera.fu_px / KITTI_FOCAL_LENGTH_PX,
    )


FLOW_VARIANCE = Predictor(
    name="flow_variance",
    columns={"flow_variance": "ln of a ratio"},
    source="PROBE eq. (17)",
    needs=Needs.TRACKS,
    compute=_compute,
    undefined="where a feature has fewer than two neighbours",
)

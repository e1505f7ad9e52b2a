"""How unique a stereo match is along its row: a test against repeated texture, and a search.

A fence, a facade or a hedge looks alike at several disparities. Lucas–Kanade takes the one next to
where it starts, and neighbours that start alike agree on a wrong one. Such a match is recognised by
a second place in its row that fits nearly as well (Lowe, "Distinctive image features from
scale-invariant keypoints", IJCV 2004, who compares the distances of descriptors).
"""

from __future__ import annotations

import numpy as np

from probevo.arrays import AnyArray, BoolArray, FloatArray, Image
from probevo.compiled import compiled

MAX_RATIO = 0.8
"""Ratio of the differences of the best and the second-best place above which a match is ambiguous
(Lowe 2004)."""
REACH_PX = 32
"""Distance along the row within which there must be no second place: Lucas–Kanade does not reach
farther."""
BEST_WITHIN_PX = 2
"""The best place is taken as near to the match as this, since both are whole pixels."""


@compiled
def find_unique(
    left: Image,
    right: Image,
    left_px: FloatArray,
    right_px: FloatArray,
    window_px: int,
    outside: bool,
) -> BoolArray:
    """Return which of N stereo matches fit clearly better than any other place in their row, [N].

    Args:
        left: left image, [height, width], uint8.
        right: right image, [height, width], uint8.
        left_px: (u, v) in the left image, [N, 2], px.
        right_px: (u, v) in the right image, [N, 2], px.
        window_px: side of the window that is compared; odd.
        outside: what is returned for a match whose window or row is not inside of both images.
    """
    height, width = left.shape
    half = window_px // 2
    squared = np.empty(2 * REACH_PX + 1, np.int32)
    unique = np.empty(len(left_px), np.bool_)
    for n in range(len(left_px)):
        u = round(left_px[n, 0])
        v = round(left_px[n, 1])
        u_right = round(right_px[n, 0])
        v_right = round(right_px[n, 1])
        rows_inside = min(v, v_right) >= half and max(v, v_right) + half < height
        # Places in the row whose windows are inside of the image, relative to the first.
        first = max(u_right - REACH_PX, half)
        last = min(u_right + REACH_PX, width - 1 - half)
        if not rows_inside or u < half or u + half >= width or first > u_right or last < u_right:
            unique[n] = outside
            continue
        count = last - first + 1
        window = left[v - half : v + half + 1, u - half : u + half + 1]
        rows = right[v_right - half : v_right + half + 1, first - half : last + half + 1]
        _compare_along(window, rows, squared[:count])
        unique[n] = _is_best(squared[:count], u_right - first, half)
    return unique


@compiled
def find_along_row(
    left: Image, right: Image, left_px: FloatArray, reach_px: int, window_px: int
) -> FloatArray:
    """Return the disparity at which each of N points fits clearly better than at any other in its
    row, [N], px; NaN where there is none.

    Args:
        left: left image, [height, width], uint8.
        right: right image, [height, width], uint8.
        left_px: (u, v) in the left image, [N, 2], px.
        reach_px: largest disparity of either sign, which is searched.
        window_px: side of the window that is compared; odd.
    """
    height, width = left.shape
    half = window_px // 2
    squared = np.empty(2 * reach_px + 1, np.int32)
    disparity_px = np.full(len(left_px), np.nan)
    for n in range(len(left_px)):
        u = round(left_px[n, 0])
        v = round(left_px[n, 1])
        if u < half or u + half >= width or v < half or v + half >= height:
            continue
        first = max(u - reach_px, half)
        last = min(u + reach_px, width - 1 - half)
        count = last - first + 1
        window = left[v - half : v + half + 1, u - half : u + half + 1]
        rows = right[v - half : v + half + 1, first - half : last + half + 1]
        _compare_along(window, rows, squared[:count])
        best = int(np.argmin(squared[:count]))
        if _is_best(squared[:count], best, half):
            disparity_px[n] = u - (first + best)
    return disparity_px


@compiled
def _compare_along(window: Image, rows: Image, squared: AnyArray) -> None:
    """Compare a window with each of the same size in a strip of rows.

    Args:
        window: [side, side], uint8.
        rows: [side, count + side - 1], uint8.
        squared: becomes the sum of squared differences at each of the places, [count].
    """
    squared[:] = 0
    # All places at a time.
    for i in range(window.shape[0]):
        for j in range(window.shape[1]):
            grey = np.int32(window[i, j])
            row = rows[i, j : j + len(squared)]
            for k in range(len(squared)):
                difference = grey - np.int32(row[k])
                squared[k] += difference * difference


@compiled
def _is_best(squared: AnyArray, match: int, half: int) -> bool:
    """Return whether the places at a match differ clearly less than those beyond half a window.

    Args:
        squared: squared difference of the windows at each place of the row.
        match: index of the match.
        half: half the side of a window.
    """
    # Places in between share most of their window with the match, and compete with nothing.
    best = np.inf
    second = np.inf
    for k in range(len(squared)):
        distance = abs(k - match)
        if distance <= BEST_WITHIN_PX:
            best = min(best, squared[k])
        elif distance > half:
            second = min(second, squared[k])
    # The ratio is one of differences, which are squared here. Where both are zero, the texture
    # repeats exactly; without a second place, its difference is infinite.
    return best < MAX_RATIO**2 * second

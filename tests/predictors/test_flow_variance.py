"""The flow variance against its definition, and what is defined where it has none."""

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo.predictors.flow_variance import FLOOR_PX2, MIN_FEATURES, flow_variance


def slow_flow_variance(
    previous_uv: FloatArray, uv: FloatArray, small_px: float, large_px: float
) -> FloatArray:
    """PROBE eq. (17), feature by feature."""
    flow = uv - previous_uv
    values = np.full(len(uv), np.nan)
    for i, place in enumerate(uv):
        offset = np.abs(uv - place).max(axis=1)
        small = flow[offset <= small_px]
        large = flow[offset <= large_px]
        if len(small) >= MIN_FEATURES:
            small_px2, large_px2 = (
                max(np.var(part, axis=0).mean(), FLOOR_PX2) for part in (small, large)
            )
            values[i] = np.log(small_px2 / large_px2)
    return values


def scattered(seed: int, count: int) -> tuple[FloatArray, FloatArray]:
    """Previous and current features in KITTI's image, under large flows that vary smoothly."""
    rng = np.random.default_rng(seed)
    uv = rng.uniform(0.0, [1242.0, 375.0], (count, 2))
    return uv - 80.0 - 0.05 * uv - rng.normal(scale=0.3, size=(count, 2)), uv


@pytest.mark.parametrize("windows_px", [(50.0, 200.0), (20.0, 45.0), (150.0, 5000.0)])
@pytest.mark.parametrize("count", [4, 40, 400])
def test_it_is_the_slow_definition(windows_px: tuple[float, float], count: int) -> None:
    previous_uv, uv = scattered(0, count)
    values = flow_variance(previous_uv, uv, small_px=windows_px[0], large_px=windows_px[1])
    np.testing.assert_allclose(
        values, slow_flow_variance(previous_uv, uv, *windows_px), rtol=1e-9, atol=1e-9
    )


def test_features_on_the_border_of_a_window_or_on_each_other_count() -> None:
    """On whole pixels, many features share a column, and many lie exactly on a border."""
    previous_uv, uv = scattered(1, 300)
    uv = 25.0 * np.round(uv / 25.0)
    values = flow_variance(previous_uv, uv, small_px=25.0, large_px=100.0)
    np.testing.assert_allclose(
        values, slow_flow_variance(previous_uv, uv, 25.0, 100.0), rtol=1e-9, atol=1e-9
    )


def test_the_order_of_the_features_changes_nothing() -> None:
    previous_uv, uv = scattered(2, 200)
    order = np.random.default_rng(3).permutation(200)
    values = flow_variance(previous_uv, uv)
    np.testing.assert_allclose(
        flow_variance(previous_uv[order], uv[order]), values[order], atol=1e-9
    )


def test_a_border_between_motions_is_high_and_what_moves_as_one_low() -> None:
    """A block of 300 px that moves by 10 px, on a standing background, with noise of 0.1 px."""
    rng = np.random.default_rng(4)
    uv = rng.uniform(0.0, [1242.0, 375.0], (2000, 2))
    distance_px = np.abs(uv[:, 0] - 600.0)
    flow = np.where(distance_px < 150.0, 10.0, 0.0)[:, None] + rng.normal(scale=0.1, size=(2000, 2))
    values = flow_variance(uv - flow, uv)
    assert values[np.abs(distance_px - 150.0) < 10.0].min() > -1.0
    assert values[distance_px < 90.0].max() < -5.0


def test_without_variance_it_is_the_floor_that_counts() -> None:
    _, uv = scattered(5, 3000)
    np.testing.assert_array_equal(flow_variance(uv, uv), 0.0)
    flow = np.where(uv[:, :1] < 600.0, 0.0, 20.0)
    inside = np.abs(uv[:, 0] - 600.0) > 60.0
    values = flow_variance(uv - flow, uv, large_px=5000.0)[inside]
    np.testing.assert_allclose(values, np.log(FLOOR_PX2 / np.var(flow)), rtol=1e-9)


def test_features_with_fewer_than_two_neighbours_are_undefined() -> None:
    uv = np.array([[0.0, 0.0], [10.0, 0.0], [20.0, 0.0], [500.0, 0.0], [510.0, 0.0]])
    np.testing.assert_array_equal(
        np.isnan(flow_variance(uv - 1.0, uv)), [False, False, False, True, True]
    )


def test_no_features_no_values() -> None:
    assert flow_variance(np.zeros((0, 2)), np.zeros((0, 2))).shape == (0,)

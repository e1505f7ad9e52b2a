"""Slices of the IMU stream: what covers an interval, and what does not."""

import numpy as np
import pytest

from probevo.errors import InputError
from probevo.sequences.frame import ImuSamples
from probevo.sequences.imu import ImuStream, hold_over_interval

PERIOD_NS = 10_000_000
FRAMES_NS = np.array([0, 10 * PERIOD_NS])


def stream(stamps_ns: np.ndarray) -> ImuStream:
    values = np.repeat(np.arange(len(stamps_ns), dtype=float)[:, None], 3, axis=1)
    return ImuStream.checked(stamps_ns, values, values, frames_ns=FRAMES_NS, where="imu.csv")


def test_each_sample_is_recorded_once() -> None:
    """Neither the repetitions at both ends, nor the starts of intervals that hold a mean."""
    stamps_ns = PERIOD_NS * np.arange(20)
    momentary = stream(stamps_ns)
    np.testing.assert_array_equal(momentary.stamps_ns[momentary.recorded], stamps_ns)
    values = np.repeat(np.arange(20.0)[:, None], 3, axis=1)
    held_ns, held = hold_over_interval(stamps_ns, values)
    means = ImuStream.checked(held_ns, held, held, frames_ns=FRAMES_NS, where="oxts")
    np.testing.assert_array_equal(means.stamps_ns[means.recorded], stamps_ns[1:])
    np.testing.assert_array_equal(means.gyro_rad_s[means.recorded], values[1:])


@pytest.mark.parametrize("offset_ns", [0, 1, PERIOD_NS // 2, PERIOD_NS - 1])
def test_slice_is_the_tightest_that_covers_the_interval(offset_ns: int) -> None:
    start = 20 * PERIOD_NS + offset_ns
    end = 25 * PERIOD_NS + offset_ns
    samples = stream(PERIOD_NS * np.arange(100)).between(start, end)
    assert samples is not None
    assert samples.stamps_ns[0] <= start < samples.stamps_ns[1]
    assert samples.stamps_ns[-2] < end <= samples.stamps_ns[-1]
    np.testing.assert_array_equal(samples.gyro_rad_s[:, 0], samples.stamps_ns / PERIOD_NS)


def test_neighbouring_slices_share_the_sample_at_their_border() -> None:
    imu = stream(PERIOD_NS * np.arange(100))
    before = imu.between(0, 5 * PERIOD_NS)
    after = imu.between(5 * PERIOD_NS, 10 * PERIOD_NS)
    assert before is not None
    assert after is not None
    assert before.stamps_ns[-1] == after.stamps_ns[0] == 5 * PERIOD_NS


def test_an_interval_between_two_samples_gets_both() -> None:
    samples = stream(PERIOD_NS * np.arange(100)).between(PERIOD_NS + 1, PERIOD_NS + 2)
    assert samples is not None
    np.testing.assert_array_equal(samples.stamps_ns, [PERIOD_NS, 2 * PERIOD_NS])


@pytest.mark.parametrize(("late_periods", "covered"), [(1, True), (2, True), (3, False)])
def test_last_value_is_held_for_two_periods(late_periods: int, covered: bool) -> None:
    samples = stream(PERIOD_NS * np.arange(100)).between(
        90 * PERIOD_NS, (99 + late_periods) * PERIOD_NS
    )
    assert (samples is not None) == covered
    if samples is not None:
        np.testing.assert_array_equal(samples.gyro_rad_s[-2:], 99)


@pytest.mark.parametrize("interval", [(-50, -40), (-10, 5), (95, 110), (150, 160)])
def test_no_slice_where_samples_are_absent(interval: tuple[int, int]) -> None:
    start, end = np.multiply(interval, PERIOD_NS)
    assert stream(PERIOD_NS * np.arange(100)).between(start, end) is None


def test_no_slice_across_a_gap() -> None:
    imu = stream(PERIOD_NS * np.r_[0:50, 60:110])
    assert imu.between(45 * PERIOD_NS, 55 * PERIOD_NS) is None
    assert imu.between(60 * PERIOD_NS, 70 * PERIOD_NS) is not None


def test_samples_that_miss_the_frames_are_refused() -> None:
    with pytest.raises(InputError, match="same clock"):
        stream(PERIOD_NS * np.arange(1000, 1100))


def test_held_samples_integrate_to_rate_times_interval() -> None:
    """∫ of the interpolated samples over an interval is exactly its mean rate times its length."""
    stamps_ns = np.array([0, 90, 200, 310]) * 1_000_000
    rates = np.array([[9.0, 9, 9], [1, 2, 3], [4, 5, 6], [7, 8, 9]])
    held_ns, held = hold_over_interval(stamps_ns, rates)
    assert (np.diff(held_ns) > 0).all()
    areas = np.trapezoid(held.reshape(3, 2, 3), held_ns.reshape(3, 2, 1), axis=1)
    np.testing.assert_allclose(areas, rates[1:] * np.diff(stamps_ns)[:, None], rtol=1e-7)


@pytest.mark.parametrize("middle_ns", [5 * PERIOD_NS, 5 * PERIOD_NS + 1, 6 * PERIOD_NS - 1])
def test_slices_of_consecutive_intervals_join_to_that_of_both(middle_ns: int) -> None:
    imu = stream(PERIOD_NS * np.arange(100))
    before = imu.between(7, middle_ns)
    after = imu.between(middle_ns, 8 * PERIOD_NS + 3)
    both = imu.between(7, 8 * PERIOD_NS + 3)
    assert before is not None
    assert after is not None
    assert both is not None
    joined = before.followed_by(after)
    np.testing.assert_array_equal(joined.stamps_ns, both.stamps_ns)
    np.testing.assert_array_equal(joined.gyro_rad_s, both.gyro_rad_s)
    np.testing.assert_array_equal(joined.accel_m_s2, both.accel_m_s2)


def test_no_samples_join_to_those_of_the_other() -> None:
    nothing = ImuSamples(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3)))
    samples = stream(PERIOD_NS * np.arange(100)).between(7, 5 * PERIOD_NS)
    assert samples is not None
    for joined in (nothing.followed_by(samples), samples.followed_by(nothing)):
        np.testing.assert_array_equal(joined.stamps_ns, samples.stamps_ns)

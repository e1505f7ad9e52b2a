"""The IMU samples of a recording, and the slice of them that covers one frame interval."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from probevo.arrays import BoolArray, FloatArray, IntArray
from probevo.errors import InputError
from probevo.sequences.frame import ImuSamples
from probevo.sequences.stamps import check_stamps

HOLD_PERIODS = 2
"""For how many mean sample periods the first and last sample are held beyond the recording; a gap
of twice as many periods between samples is bridged, too."""

HELD_NS = 1_000
"""Stamps that are not farther apart are of one sample, which is held over an interval."""


@dataclass(frozen=True, eq=False)
class ImuStream:
    """All IMU samples of a recording, on the clock of the images; ``checked`` builds it."""

    stamps_ns: IntArray
    """Time of each sample, [J], ascending."""
    gyro_rad_s: FloatArray
    """Angular rate, [J, 3]."""
    accel_m_s2: FloatArray
    """Specific force, [J, 3]; NaN where not recorded."""
    longest_gap_ns: int
    """Longest time between two samples over which they are interpolated."""

    @staticmethod
    def checked(
        stamps_ns: IntArray,
        gyro_rad_s: FloatArray,
        accel_m_s2: FloatArray,
        frames_ns: IntArray,
        where: str | Path,
    ) -> ImuStream:
        """Build the stream; its first and last sample are held for two sample periods.

        Args:
            stamps_ns: time of each sample on the clock of the images, [J].
            gyro_rad_s: angular rates, [J, 3].
            accel_m_s2: specific forces, [J, 3]; NaN where not recorded.
            frames_ns: time of each frame, [K].
            where: file of the samples, for messages.

        Raises:
            InputError: there are fewer than two samples, their stamps do not ascend, or all of them
                are before or after the frames.
        """
        check_stamps(stamps_ns, where)
        if len(stamps_ns) < 2:
            raise InputError(where, f"{len(stamps_ns)} IMU samples; at least 2 are needed.")
        if stamps_ns[0] > frames_ns[-1] or stamps_ns[-1] < frames_ns[0]:
            what = (
                f"the IMU runs from {stamps_ns[0]} to {stamps_ns[-1]} ns, the frames from"
                f" {frames_ns[0]} to {frames_ns[-1]} ns."
            )
            raise InputError(where, what, "Both need the same clock, or a time offset.")
        # Repeat the first and the last sample some periods before and after their own times.
        hold_ns = HOLD_PERIODS * int(stamps_ns[-1] - stamps_ns[0]) // (len(stamps_ns) - 1)
        rows = np.r_[0, np.arange(len(stamps_ns)), len(stamps_ns) - 1]
        return ImuStream(
            stamps_ns=np.r_[stamps_ns[0] - hold_ns, stamps_ns, stamps_ns[-1] + hold_ns],
            gyro_rad_s=gyro_rad_s[rows],
            accel_m_s2=accel_m_s2[rows],
            longest_gap_ns=2 * hold_ns,
        )

    @property
    def recorded(self) -> BoolArray:
        """Which samples a sensor recorded, each once, [J].

        The first and the last are repetitions, and so is the start of an interval over which a mean
        is held.
        """
        recorded = np.ones(len(self.stamps_ns), np.bool_)
        recorded[[0, -1]] = False
        starts_interval = np.flatnonzero(np.diff(self.stamps_ns) <= HELD_NS) + 1
        if len(starts_interval):
            recorded[1] = False
            recorded[starts_interval] = False
        return recorded

    def between(self, start_ns: int, end_ns: int) -> ImuSamples | None:
        """Return the last sample at or before ``start_ns`` to the first at or after ``end_ns``.

        Returns:
            The samples; None if they do not cover the whole interval.
        """
        first = int(np.searchsorted(self.stamps_ns, start_ns, side="right")) - 1
        last = int(np.searchsorted(self.stamps_ns, end_ns, side="left"))
        if first < 0 or last == len(self.stamps_ns):
            return None
        rows = slice(first, last + 1)
        if np.diff(self.stamps_ns[rows]).max(initial=0) > self.longest_gap_ns:
            return None
        return ImuSamples(
            stamps_ns=self.stamps_ns[rows],
            gyro_rad_s=self.gyro_rad_s[rows],
            accel_m_s2=self.accel_m_s2[rows],
        )


def hold_over_interval(stamps_ns: IntArray, values: FloatArray) -> tuple[IntArray, FloatArray]:
    """Repeat each sample at both ends of the interval since the previous sample.

    This is for packets that hold the mean over that interval, such as OXTS's: interpolation then
    gives a step instead of a mixture of two intervals. On KITTI raw drive 0005, the gyro's rotation
    of a frame differs from the images' by 0.020° in the median; by 0.061° if the packets are taken
    as momentary rates, and by 0.027° if they are put in the middle of their intervals.

    Args:
        stamps_ns: time of each sample, [J].
        values: the samples, [J, 3].

    Returns:
        Stamps, [2J − 2], and values, [2J − 2, 3].
    """
    held_ns = np.stack([stamps_ns[:-1] + 1, stamps_ns[1:]], axis=1).ravel()
    return held_ns, np.repeat(values[1:], 2, axis=0)

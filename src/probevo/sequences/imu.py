"""The IMU samples of a whole recording, and the slice of them that covers one frame interval."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.errors import InputError
from probevo.sequences.frame import ImuSamples
from probevo.sequences.stamps import check_stamps

HOLD_PERIODS = 2
"""How many mean sample periods a sample may stand in for, before or after its own time, where
others are missing."""


@dataclass(frozen=True, eq=False)
class ImuStream:
    """All IMU samples of a recording, on the clock of the images. Build it with ``checked``."""

    stamps_ns: IntArray
    """[J], ascending."""
    gyro_rad_s: FloatArray
    """[J, 3]."""
    accel_m_s2: FloatArray
    """[J, 3]; NaN where not recorded."""
    longest_gap_ns: int
    """Samples further apart than this do not tell what happened between them."""

    @staticmethod
    def checked(
        stamps_ns: IntArray,
        gyro_rad_s: FloatArray,
        accel_m_s2: FloatArray,
        frames_ns: IntArray,
        where: str | Path,
    ) -> ImuStream:
        """The stream of samples [J], [J, 3], [J, 3]; its first and last value are held for two
        sample periods.

        Raises:
            InputError: fewer than two samples, stamps that do not ascend or lie wholly before or
                after the frames.
        """
        check_stamps(stamps_ns, where)
        if len(stamps_ns) < 2:
            raise InputError(where, f"{len(stamps_ns)} IMU samples; at least 2 are needed.")
        if stamps_ns[0] > frames_ns[-1] or stamps_ns[-1] < frames_ns[0]:
            what = (
                f"the IMU runs from {stamps_ns[0]} to {stamps_ns[-1]} ns, the frames from"
                f" {frames_ns[0]} to "
            )
            raise InputError(
                where, f"{what}{frames_ns[-1]} ns.", "Both need the same clock, or a time offset."
            )
        reach = HOLD_PERIODS * int(stamps_ns[-1] - stamps_ns[0]) // (len(stamps_ns) - 1)
        held = np.r_[0, np.arange(len(stamps_ns)), len(stamps_ns) - 1]
        stamps = np.r_[stamps_ns[0] - reach, stamps_ns, stamps_ns[-1] + reach]
        return ImuStream(stamps, gyro_rad_s[held], accel_m_s2[held], longest_gap_ns=2 * reach)

    def between(self, start_ns: int, end_ns: int) -> ImuSamples | None:
        """The last sample at or before ``start_ns`` up to the first at or after ``end_ns``.

        None where the samples leave a part of the interval uncovered.
        """
        first = int(np.searchsorted(self.stamps_ns, start_ns, side="right")) - 1
        last = int(np.searchsorted(self.stamps_ns, end_ns, side="left"))
        if first < 0 or last == len(self.stamps_ns):
            return None
        cut = slice(first, last + 1)
        if np.diff(self.stamps_ns[cut]).max(initial=0) > self.longest_gap_ns:
            return None
        return ImuSamples(self.stamps_ns[cut], self.gyro_rad_s[cut], self.accel_m_s2[cut])


def hold_over_interval(stamps_ns: IntArray, values: FloatArray) -> tuple[IntArray, FloatArray]:
    """Write each sample, [J], [J, 3], at both ends of the interval since the sample before: [2J −
    2], [2J − 2, 3].

    For packets that hold the mean over that interval (OXTS): interpolation then gives a step
    instead of a blend of two intervals. On KITTI raw drive 0005 the gyro's rotation of a frame is
    off the images' by 0.020° in the median; if the packets are taken as momentary rates, by 0.061°,
    and put in the middle of their intervals, by 0.027°.
    """
    return np.stack([stamps_ns[:-1] + 1, stamps_ns[1:]], axis=1).ravel(), np.repeat(
        values[1:], 2, axis=0
    )

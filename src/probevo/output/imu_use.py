"""The use of the IMU over the steps of a run, and the reason why it was not used at the end."""

from __future__ import annotations

from collections import Counter

from probevo.measurements.imu_reason import ImuFault, ImuReason


class ImuUse:
    """Record of how the window used the IMU, step by step."""

    def __init__(self) -> None:
        self._last_used: int | None = None
        self._is_left_out = False
        self._counts: Counter[ImuFault] = Counter()
        """Steps since the IMU was last used, by what was wrong in them."""
        self._reasons: dict[ImuFault, ImuReason] = {}
        """Last reason of each fault."""

    def add(self, frame: int, reason: ImuReason | None, *, is_in_window: bool) -> None:
        """Record a step.

        Args:
            frame: index of its frame.
            reason: why the IMU was not used in it (``MotionEstimate.imu_reason``).
            is_in_window: whether the poses of the window depend on the IMU.
        """
        self._is_left_out = reason is not None and not is_in_window
        if reason is not None:
            self._counts[reason.fault] += 1
            self._reasons[reason.fault] = reason
        elif is_in_window:
            self._last_used = frame
            self._counts.clear()

    @property
    def left_out(self) -> ImuReason | None:
        """Most frequent reason since the IMU was last used; None if it was used to the end, or
        there is none. That it is being tested counts only where nothing else was wrong."""
        if not self._is_left_out:
            return None
        faults = [fault for fault, _ in self._counts.most_common() if fault is not ImuFault.TESTING]
        return self._reasons[faults[0] if faults else ImuFault.TESTING]

    @property
    def num_tested(self) -> int:
        """Number of steps since the IMU was last used in which it was being tested; 0 if it was
        used to the end."""
        return self._counts[ImuFault.TESTING] if self._is_left_out else 0

    @property
    def unused_from(self) -> int | None:
        """Index of the first frame after the IMU was last used; None if it was used to the end, or
        never."""
        if not self._is_left_out or self._last_used is None:
            return None
        return self._last_used + 1

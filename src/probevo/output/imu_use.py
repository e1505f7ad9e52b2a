"""The use of the IMU over the steps of a run, and the reason why it was not used at the end."""

from __future__ import annotations

import re
from collections import Counter


class ImuUse:
    """What the steps of a run said of the IMU, as they come."""

    def __init__(self) -> None:
        self._last_used: int | None = None
        self._is_left_out = False
        self._counts: Counter[str] = Counter()
        """Steps since the IMU was last used, by the kind of their reason."""
        self._reasons: dict[str, str] = {}
        """Last reason of each kind."""

    def add(self, frame: int, reason: str, *, is_in_window: bool) -> None:
        """Record a step.

        Args:
            frame: index of its frame.
            reason: why the IMU was not used in it (``MotionEstimate.imu_left_out``).
            is_in_window: whether the poses of the window depend on the IMU.
        """
        self._is_left_out = bool(reason) and not is_in_window
        if reason:
            kind = kind_of(reason)
            self._counts[kind] += 1
            self._reasons[kind] = reason
        elif is_in_window:
            self._last_used = frame
            self._counts.clear()

    @property
    def left_out(self) -> str | None:
        """Most frequent reason since the IMU was last used; None if it was used to the end, or
        there is none."""
        if not self._is_left_out:
            return None
        return self._reasons[self._counts.most_common(1)[0][0]]

    @property
    def unused_from(self) -> int | None:
        """Index of the frame from which on the IMU was not used; None if it was used to the end,
        or never."""
        if not self._is_left_out or self._last_used is None:
            return None
        return self._last_used + 1


def kind_of(reason: str) -> str:
    """Return a reason without its numbers, and without what is added to it: its brackets, and
    that it counts for good."""
    text = reason.removeprefix("is left out for good: it ").split(" (")[0]
    return re.sub(r"[0-9][0-9.]*", "#", text)

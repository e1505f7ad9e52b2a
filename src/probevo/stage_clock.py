"""The wall time that each stage of a step takes."""

from __future__ import annotations

from time import perf_counter


class StageClock:
    """A stopwatch that adds the time since its last lap to the stage that ends.

    Args:
        times_ms: stages that were timed elsewhere, by name.
    """

    def __init__(self, **times_ms: float) -> None:
        self.times_ms: dict[str, float] = times_ms
        self._last = perf_counter()

    def lap(self, stage: str) -> None:
        """End a stage; several laps of one stage add up."""
        now = perf_counter()
        self.times_ms[stage] = self.times_ms.get(stage, 0.0) + 1e3 * (now - self._last)
        self._last = now

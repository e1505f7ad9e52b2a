"""Wall time of the stages of one step."""

from __future__ import annotations

from time import perf_counter


class StageClock:
    """Collects the time since the last lap under the name of the stage that it was spent on.

    Args:
        times_ms: stages already timed elsewhere.
    """

    def __init__(self, **times_ms: float) -> None:
        self.times_ms: dict[str, float] = times_ms
        self._last = perf_counter()

    def lap(self, stage: str) -> None:
        """End a stage; laps of the same name add up."""
        now = perf_counter()
        self.times_ms[stage] = self.times_ms.get(stage, 0.0) + 1e3 * (now - self._last)
        self._last = now

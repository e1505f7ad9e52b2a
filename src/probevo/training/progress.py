"""Progress of a training, counted in frames."""

from __future__ import annotations

from collections.abc import Callable

OnProgress = Callable[[int, int], None]
"""Takes the number of frames that are done, all iterations counted, and their total."""


class TrainingProgress:
    """Progress of a training: recording the frames counts once, each iteration once more.

    Args:
        frames: number of frames of all recordings.
        iterations: number of iterations over them.
        on_progress: called with frames done and frames in total; None reports nothing.
    """

    def __init__(
        self, frames: int = 0, iterations: int = 0, on_progress: OnProgress | None = None
    ) -> None:
        self.frames = frames
        self.total = frames * (1 + iterations)
        self.iterations_done = 0
        self.on_progress = on_progress

    def frames_recorded(self, done: int) -> None:
        """Report how many frames are recorded."""
        if self.on_progress is not None:
            self.on_progress(done, self.total)

    def iteration_done(self) -> None:
        """Report that one more iteration is complete."""
        self.iterations_done += 1
        self.frames_recorded(self.frames * (1 + self.iterations_done))

    def within_iteration(self, share: float) -> None:
        """Report which share of the current iteration is done, 0 … 1."""
        self.frames_recorded(round(self.frames * (1 + self.iterations_done + share)))

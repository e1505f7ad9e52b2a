"""The observation store: which landmark was seen where, and in which frame.

Observations are stored raw. The rig's calibration is an estimate that changes, so it is applied
only when they are linearised.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from probevo.arrays import FloatArray, IntArray
from probevo.noise.base import StereoNoise

MAX_FRAMES = 10
"""Frames that the store keeps."""


@dataclass(frozen=True)
class FrameObservations:
    """The N landmarks that one frame observed."""

    frame: int
    """Index of the frame."""
    stamp_ns: int
    landmarks: IntArray
    """Identity of each landmark, [N]."""
    pixels: FloatArray
    """Raw (u_l, v_l, u_r, v_r), [N, 4], px."""
    noise: StereoNoise | None = None
    """Noise of the M that the solve used, as predicted for this frame; None where none was."""
    noise_landmarks: IntArray | None = None
    """Identity of each of these, [M]."""


@dataclass(frozen=True)
class ObservationStore:
    """The observations of the last frames."""

    frames: tuple[FrameObservations, ...] = ()
    """The frames in the order of time; at most ``MAX_FRAMES``."""

    def with_frame(self, observations: FrameObservations) -> ObservationStore:
        """Return the store with one more frame; the oldest goes."""
        return replace(self, frames=(*self.frames, observations)[-MAX_FRAMES:])

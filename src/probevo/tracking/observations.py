"""The observation store: which landmark was seen where, and in which frame.

Observations are stored raw. The rig's calibration is an estimate that changes, so it is applied
only when they are linearised.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from probevo.arrays import FloatArray, IntArray, rows_of
from probevo.noise.base import StereoNoise
from probevo.tracking.anchor_patches import AnchorPatches

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
    patches: AnchorPatches | None = None
    """Anchor patch of each, from the frame that saw it first; None without images."""
    noise: StereoNoise | None = None
    """Noise of M of the observations at the time of this frame; None where none was predicted."""
    noise_landmarks: IntArray | None = None
    """Which landmarks these are, [M]."""

    def noise_rows(self, landmarks: IntArray) -> IntArray:
        """Return the row of each landmark in ``noise``, [K]; −1 where none was predicted."""
        if self.noise_landmarks is None:
            return np.full(len(landmarks), -1)
        return rows_of(landmarks, self.noise_landmarks)


@dataclass(frozen=True)
class LandmarkHistory:
    """The K observations of one landmark, in the order of time."""

    frames: IntArray
    """Index of each frame, [K]."""
    pixels: FloatArray
    """Raw observations, [K, 4], px."""
    scale: FloatArray
    """Scale matrix R of each observation at its own time, [K, 4, 4], px²; NaN where it was not
    predicted, as for the first observation of a landmark."""


@dataclass(frozen=True)
class ObservationStore:
    """The observations of the last frames."""

    frames: tuple[FrameObservations, ...] = ()
    """In the order of time; at most ``MAX_FRAMES``."""

    def with_frame(self, observations: FrameObservations) -> ObservationStore:
        """Return the store with one more frame; the oldest goes."""
        return replace(self, frames=(*self.frames, observations)[-MAX_FRAMES:])

    def history(self, landmark: int) -> LandmarkHistory:
        """Return all observations of one landmark."""
        frames = []
        pixels = []
        scales = []
        for observations in self.frames:
            for row in np.flatnonzero(observations.landmarks == landmark):
                noise_row = observations.noise_rows(np.array([landmark]))[0]
                known = observations.noise is not None and noise_row >= 0
                frames.append(observations.frame)
                pixels.append(observations.pixels[row])
                scales.append(
                    observations.noise.scale[noise_row]
                    if observations.noise is not None and known
                    else np.full((4, 4), np.nan)
                )
        return LandmarkHistory(
            frames=np.array(frames, np.int64),
            pixels=np.array(pixels).reshape(-1, 4),
            scale=np.array(scales).reshape(-1, 4, 4),
        )

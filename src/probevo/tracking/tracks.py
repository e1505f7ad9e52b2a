"""The waist of the design: stereo observations of the same points in two frames.

Everything left of it may be absent (a tracks file has no images); everything right of it never sees
an image.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from probevo.arrays import BoolArray, FloatArray, IntArray


@dataclass(frozen=True)
class Tracks:
    """N points, each observed by both cameras in the previous and in the current frame."""

    prev_px: FloatArray
    """(u_l, v_l, u_r, v_r) in the previous frame, [N, 4], px."""
    curr_px: FloatArray
    """The same points in the current frame, [N, 4], px."""
    ids: IntArray
    """Identity of each point, [N]. What no longer looks as at first sight goes on under another
    one."""
    age: IntArray
    """Number of frames, the current one included, that have seen the point in a row, [N]; at least
    2."""
    rejected: Mapping[str, int] = field(default_factory=dict)
    """How many candidate points each consistency check turned away on this step, by the check's
    name."""
    difference: FloatArray | None = None
    """How differently each point looks from when it was first seen, in the left and in the right
    image: the mean absolute difference of the windows, [N, 2], grey levels. Where that window does
    not fit: from the frame before, and from the left image. None where somebody else has tracked
    the points."""

    def __len__(self) -> int:
        """Number of points, N."""
        return len(self.ids)

    @staticmethod
    def none() -> Tracks:
        """No tracks at all."""
        return Tracks(
            np.zeros((0, 4)), np.zeros((0, 4)), np.zeros(0, np.int64), age=np.zeros(0, np.int64)
        )

    def kept(self, keep: BoolArray | IntArray) -> Tracks:
        """Only those points: a mask [N], or indices."""
        return replace(
            self,
            prev_px=self.prev_px[keep],
            curr_px=self.curr_px[keep],
            ids=self.ids[keep],
            age=self.age[keep],
            difference=None if self.difference is None else self.difference[keep],
        )

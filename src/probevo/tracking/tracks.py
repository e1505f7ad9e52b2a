"""Tracks: stereo observations of the same points in two frames, as the two-frame solve takes them.

A tracks file has tracks but no images. The solve needs the tracks alone; some predictors need the
images, too.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from probevo.arrays import BoolArray, FloatArray, IntArray
from probevo.camera.rig_calibration import RigCalibration
from probevo.camera.stereo import StereoCamera

NEGATIVE_DISPARITY = "negative disparity"
"""Why a match is rejected that lies farther right in the right image than in the left one."""
NO_MATCH = "no stereo match"
"""Why a feature is rejected whose window looks different in the right image."""
MASKED = "masked"
"""Why a feature is rejected that a mask covers."""
OTHER_ROW = "rows differ"
"""Why a match is rejected whose window looks alike, but lies in another row of the right image."""
NEW_ERROR_PX = 1.0
"""Shift over the image after which the error of a point is independent of the one before."""


@dataclass(frozen=True)
class Tracks:
    """N points, each observed by both cameras in the previous and in the current frame."""

    prev_px: FloatArray
    """(u_l, v_l, u_r, v_r) in the previous frame, [N, 4], px."""
    curr_px: FloatArray
    """The same points in the current frame, [N, 4], px."""
    ids: IntArray
    """Identity of each point, [N]. A point whose window no longer matches its anchor patch gets a
    new one."""
    age: IntArray
    """Number of frames, the current one included, that have seen the point in a row, [N]; at least
    2."""
    rejected: Mapping[str, int] = field(default_factory=dict)
    """How many candidate points each consistency check rejected in this step, by the check's
    name."""
    difference: FloatArray | None = None
    """Mean absolute difference between the aligned image and the anchor patch, in the left and in
    the right image, [N, 2], grey levels. None if another front end has tracked the points."""
    alignment_cov_px2: FloatArray | None = None
    """Covariance of each place in the left and in the right image of the current frame, by how its
    window matches the anchor patch, [N, 2, 2, 2], px²; ∞ where they have nothing in common. None
    if another front end has tracked the points."""
    velocity_error_px: FloatArray | None = None
    """Error that a correction by the velocity of the camera may have left, one standard deviation,
    [N, 4], px; None if nothing was corrected by it."""

    @property
    def are_aligned(self) -> bool:
        """Whether each place was found by aligning a window with the patch of the point's first
        frame, which another front end does not do."""
        return self.difference is not None

    @property
    def median_shift_px(self) -> float:
        """Median shift of the points over the left image; 0 without points."""
        if not len(self):
            return 0.0
        shift_px = np.linalg.norm(self.curr_px[:, :2] - self.prev_px[:, :2], axis=1)
        return float(np.median(shift_px))

    @property
    def novelty(self) -> float:
        """Share of information in the errors of the points that the previous frame did not have, 0
        to 1.

        The error of a point depends on its place between the pixels: it is another one a pixel
        further (``NEW_ERROR_PX``), and the same one where the image has hardly moved. Of a smaller
        shift, which noise mimics, the square counts.
        """
        return min(self.median_shift_px / NEW_ERROR_PX, 1.0) ** 2

    def __len__(self) -> int:
        """Return the number of points, N."""
        return len(self.ids)

    @staticmethod
    def none() -> Tracks:
        """Return no tracks at all."""
        return Tracks(
            prev_px=np.zeros((0, 4)),
            curr_px=np.zeros((0, 4)),
            ids=np.zeros(0, np.int64),
            age=np.zeros(0, np.int64),
        )

    def subset(self, keep: BoolArray | IntArray) -> Tracks:
        """Return only some of the points: a mask [N], or indices."""
        return replace(
            self,
            prev_px=self.prev_px[keep],
            curr_px=self.curr_px[keep],
            ids=self.ids[keep],
            age=self.age[keep],
            difference=None if self.difference is None else self.difference[keep],
            alignment_cov_px2=(
                None if self.alignment_cov_px2 is None else self.alignment_cov_px2[keep]
            ),
            velocity_error_px=(
                None if self.velocity_error_px is None else self.velocity_error_px[keep]
            ),
        )

    def corrected_for_window(self, rig: RigCalibration, camera: StereoCamera) -> Tracks:
        """Return the tracks with both observations corrected for all errors of the rig but the
        disparity errors that the window estimates itself."""
        return replace(
            self,
            prev_px=rig.corrected_for_window(self.prev_px, camera),
            curr_px=rig.corrected_for_window(self.curr_px, camera),
        )

    def corrected(self, rig: RigCalibration, camera: StereoCamera) -> Tracks:
        """Return the tracks with both observations corrected by the rig's calibration."""
        return replace(
            self,
            prev_px=rig.corrected(self.prev_px, camera),
            curr_px=rig.corrected(self.curr_px, camera),
        )

"""The baseline of ``speed.py``: a plain stereo odometry with OpenCV.

FAST corners on a grid, circular Lucas–Kanade with windows of 21×21, PnP in RANSAC.
"""

from __future__ import annotations

import cv2
import numpy as np

from probevo.arrays import BoolArray, FloatArray, Image
from probevo.camera.stereo import StereoCamera

CELL_PX = 40
CORNERS_PER_CELL = 2
"""As many corners as probevo looks for: 600 at KITTI's size."""
WINDOW = {"winSize": (21, 21), "maxLevel": 3}


class OpenCvOdometry:
    """Motion of a stereo camera from frame to frame."""

    def __init__(self, camera: StereoCamera) -> None:
        """Start without a previous frame."""
        self.camera = camera
        self.matrix = np.array(
            [[camera.fu_px, 0, camera.cu_px], [0, camera.fv_px, camera.cv_px], [0, 0, 1.0]]
        )
        self.previous: tuple[Image, Image] | None = None

    def step(self, left: Image, right: Image) -> FloatArray:
        """Return T_curr_prev, [4, 4]; the identity for the first frame."""
        motion = np.eye(4)
        if self.previous is not None:
            points, tracked = self._circle(*self.previous, left, right)
            _, rotation, translation, _ = cv2.solvePnPRansac(
                points,
                tracked,
                self.matrix,
                None,
                iterationsCount=100,
                reprojectionError=1.5,
                confidence=0.999,
            )
            motion[:3, :3] = cv2.Rodrigues(rotation)[0]
            motion[:3, 3] = translation[:, 0]
        self.previous = (left, right)
        return motion

    def _circle(
        self, left0: Image, right0: Image, left1: Image, right1: Image
    ) -> tuple[FloatArray, FloatArray]:
        """Return points in the previous frame, [N, 3], m, and their current left pixels, [N, 2].

        0 is the previous and 1 the current frame.
        """
        # Around the circle: previous left, previous right, current right, current left, and back.
        start = strongest_corners(left0)
        in_right0, ok1 = follow(left0, right0, start)
        in_right1, ok2 = follow(right0, right1, in_right0)
        in_left1, ok3 = follow(right1, left1, in_right1)
        back, ok4 = follow(left1, left0, in_left1)
        # Keep tracks that return to their start, lie in one row, and have a disparity.
        good = ok1 & ok2 & ok3 & ok4 & (np.abs(back - start).max(axis=1) < 1.0)
        good &= (np.abs(start[:, 1] - in_right0[:, 1]) < 2.0) & (
            start[:, 0] - in_right0[:, 0] > 1.0
        )
        pixels = np.hstack([start[good], in_right0[good]]).astype(np.float64)
        return self.camera.triangulate(pixels), in_left1[good].astype(np.float64)


def strongest_corners(image: Image) -> FloatArray:
    """Return the strongest FAST corners of each cell, [N, 2], px."""
    keypoints = cv2.FastFeatureDetector.create(20).detect(image)
    corners = np.array(cv2.KeyPoint.convert(keypoints))
    strength = np.array([keypoint.response for keypoint in keypoints])
    column, row = (corners // CELL_PX).astype(int).T
    cell = row * 1000 + column
    # Sort by cell and falling strength; the rank of a corner is its place in its cell.
    order = np.lexsort((-strength, cell))
    rank = np.arange(len(order)) - np.searchsorted(cell[order], cell[order])
    return corners[order[rank < CORNERS_PER_CELL]]


def follow(a: Image, b: Image, points: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Track points, [N, 2], px, from image a to b; return them and which were found, [N]."""
    found, status, _ = cv2.calcOpticalFlowPyrLK(a, b, points, None, **WINDOW)
    return found, status[:, 0] > 0

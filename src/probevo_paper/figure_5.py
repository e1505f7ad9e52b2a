"""PROBE Fig. 5 (section IV-C.3): errors of stereo features under blur, on a checkerboard."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from probevo.arrays import BoolArray, FloatArray, Image, IntArray
from probevo.config import TrackingConfig
from probevo.predictors.blur import blur
from probevo.sequences.read_ahead import read_ahead
from probevo_paper.figure_5_scene import (
    CORNERS,
    FAST,
    FRAME_STEP_S,
    INSTANT_STEP_S,
    LEFT,
    RIGHT,
    STEREO,
    BoardCamera,
    BoardScene,
)

NUM_CORNERS = CORNERS[0] * CORNERS[1]
REFINE_HALF_PX = 5
"""Half the window of the corner refinement, which is as large as in the tracking."""
_REFINE_UNTIL = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-3)


@dataclass(frozen=True)
class BlurView:
    """The measurements of one instant."""

    time_s: float
    left: Image
    """The window of the left image that was read out."""
    left_px: FloatArray | None
    """Corners found in that window, [32, 2], px; None if the board was not found."""
    blur: FloatArray | None
    """Blur metric of the patch around each corner, [32]; None if the board was not found."""
    right_found: bool
    """Whether the board was found in the right image."""
    fast_found: bool
    """Whether the board was found in the image of the fast camera."""
    previous_found: bool
    """Whether the board was found in the left image 50 ms before."""
    reprojection_px: FloatArray
    """Reprojected − detected in the fast camera, [32, 2]; NaN where one of the three detections
    failed."""
    tracking_px: FloatArray
    """Tracked − detected in the left image, [32, 2]; NaN where a detection or the tracking failed.
    """


@dataclass(frozen=True)
class BlurObservations:
    """Errors and blur of N observations of a corner."""

    time_s: FloatArray
    """Time of the observation, [N]."""
    instant: IntArray
    """Number of the instant, [N]. Errors of one instant are correlated."""
    corner: IntArray
    """Number of the corner, 0 … 31, by rows from the upper left one, [N]."""
    blur: FloatArray
    """Blur metric of the patch in the left image, 0 … 1, [N]."""
    reprojection_px: FloatArray
    """Reprojection error (u, v), [N, 2]; NaN where unknown."""
    tracking_px: FloatArray
    """Tracking error (u, v), [N, 2]; NaN where unknown."""

    def __len__(self) -> int:
        """Return the number of observations, N."""
        return len(self.blur)

    @property
    def threshold(self) -> float:
        """The median of the blur, which separates low from high blur."""
        return float(np.median(self.blur))

    @property
    def is_high(self) -> BoolArray:
        """Whether an observation counts as high blur, [N]."""
        return self.blur > self.threshold

    @staticmethod
    def of(views: list[BlurView]) -> BlurObservations:
        """Collect every corner of every view whose left image shows the board."""
        instants = [k for k, view in enumerate(views) if view.left_px is not None]
        observed = [views[k] for k in instants]
        blurs = [view.blur for view in observed if view.blur is not None]
        no_errors = np.zeros((0, 2))
        return BlurObservations(
            time_s=np.repeat([view.time_s for view in observed], NUM_CORNERS),
            instant=np.repeat(np.array(instants, dtype=np.int64), NUM_CORNERS),
            corner=np.tile(np.arange(NUM_CORNERS), len(observed)),
            blur=np.concatenate([np.zeros(0), *blurs]),
            reprojection_px=np.concatenate(
                [no_errors, *(view.reprojection_px for view in observed)]
            ),
            tracking_px=np.concatenate([no_errors, *(view.tracking_px for view in observed)]),
        )


def blur_views(instants: int, seed: int) -> Iterator[BlurView]:
    """Move the rig before the board, slowly and then fast; measure at synchronised instants.

    The stereo rig takes 20 and the fast camera 125 frames/s; both expose together every 0.2 s,
    which are the instants. Features are tracked from the left image 50 ms earlier. Only the images
    that are used are rendered. The same seed gives the same views.
    """
    scene = BoardScene((instants + 1) * INSTANT_STEP_S, np.random.default_rng([seed, 0]))
    return read_ahead(
        lambda k: _measure(scene, (k + 1) * INSTANT_STEP_S, (seed, 1, k)), range(instants)
    )


class _Detection(NamedTuple):
    """The window of an image around the board, and the corners found in it."""

    image: Image
    window_px: FloatArray
    """Position (u, v) of the window in the image, [2], px."""
    corners_px: FloatArray | None
    """Corners in the window, [32, 2], px; None if the board was not found."""

    @property
    def image_px(self) -> FloatArray | None:
        """Corners in the whole image, [32, 2], px; None if the board was not found."""
        return None if self.corners_px is None else self.corners_px + self.window_px


def _measure(scene: BoardScene, t_s: float, key: tuple[int, ...]) -> BlurView:
    """Measure at one instant; the key seeds the noise of its images."""
    # Both left images are read out in one window, which shows the board in either of them.
    previous_s = t_s - FRAME_STEP_S
    both_s = (previous_s, t_s)
    previous = _detect(scene, LEFT, previous_s, window_s=both_s, key=(*key, 0))
    left = _detect(scene, LEFT, t_s, window_s=both_s, key=(*key, 1))
    right = _detect(scene, RIGHT, t_s, window_s=(t_s,), key=(*key, 2))
    fast = _detect(scene, FAST, t_s, window_s=(t_s,), key=(*key, 3))

    # The reprojection error: triangulated by the stereo rig, compared in the fast camera.
    reprojection_px = np.full((NUM_CORNERS, 2), np.nan)
    if left.image_px is not None and right.image_px is not None and fast.image_px is not None:
        predicted_px = reproject(np.concatenate([left.image_px, right.image_px], axis=1))
        reprojection_px = predicted_px - fast.image_px

    # The tracking error: tracked from the previous left image, compared with a new detection.
    tracking_px = np.full((NUM_CORNERS, 2), np.nan)
    if previous.corners_px is not None and left.corners_px is not None:
        tracked_px = track(previous.image, left.image, previous.corners_px)
        tracking_px = tracked_px - left.corners_px

    return BlurView(
        time_s=t_s,
        left=left.image,
        left_px=left.corners_px,
        blur=None if left.corners_px is None else blur(left.image, left.corners_px),
        right_found=right.corners_px is not None,
        fast_found=fast.corners_px is not None,
        previous_found=previous.corners_px is not None,
        reprojection_px=reprojection_px,
        tracking_px=tracking_px,
    )


def _detect(
    scene: BoardScene,
    camera: BoardCamera,
    t_s: float,
    *,
    window_s: tuple[float, ...],
    key: tuple[int, ...],
) -> _Detection:
    """Expose an image at ``t_s``, in the window that shows the board at all times ``window_s``."""
    window = scene.window(camera, window_s)
    image = scene.expose(camera, t_s, window, np.random.default_rng(key))
    return _Detection(image, window.corner_px, find_corners(image))


def find_corners(image: Image) -> FloatArray | None:
    """Find the interior corners of the board, [32, 2], px; None if the board is not found.

    Corners are ordered by rows from the upper left one. The board is first found as a whole, which
    works under strong blur; then each corner is refined by itself, from the gradients in a window
    as large as that of the tracking. The board must be less than 90° from upright.
    """
    found, corners_px = cv2.findChessboardCornersSB(
        image, CORNERS, flags=cv2.CALIB_CB_NORMALIZE_IMAGE
    )
    if not found:
        return None
    corners_px = corners_px.reshape(-1, 2)
    if corners_px[0, 0] > corners_px[-1, 0]:
        # The board looks the same when turned by 180°, and OpenCV took it so.
        corners_px = corners_px[::-1]
    start_px = np.array(corners_px, dtype=np.float32, order="C").reshape(-1, 1, 2)
    refined_px = cv2.cornerSubPix(
        image,
        start_px,
        winSize=(REFINE_HALF_PX, REFINE_HALF_PX),
        zeroZone=(-1, -1),
        criteria=_REFINE_UNTIL,
    )
    return np.asarray(refined_px, dtype=np.float64).reshape(-1, 2)


def reproject(pixels: FloatArray) -> FloatArray:
    """Take stereo observations, [N, 4], px, to the fast camera, [N, 2], px, by triangulation."""
    return FAST.project(STEREO.triangulate(pixels))


def track(previous: Image, left: Image, previous_px: FloatArray) -> FloatArray:
    """Track points, [N, 2], from the previous image by Lucas–Kanade, [N, 2], px; NaN where lost.

    Window and pyramid are the odometry's; the search starts at the previous points.
    """
    config = TrackingConfig()
    tracked_px, status, _ = cv2.calcOpticalFlowPyrLK(
        previous,
        left,
        previous_px.astype(np.float32),
        previous_px.astype(np.float32),
        winSize=(config.window_px, config.window_px),
        maxLevel=config.pyramid_levels,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    return np.where(status > 0, tracked_px, np.nan).astype(np.float64)

"""What blur does to the errors of stereo features, measured on a checkerboard (PROBE section
IV-C.3, Fig. 5)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count

import cv2
import numpy as np

from probevo.arrays import BoolArray, FloatArray, Image, IntArray
from probevo.config import TrackingConfig
from probevo.predictors.blur import blur
from probevo.sequences.read_ahead import read_ahead
from probevo_paper.blur_scene import (
    CORNERS,
    FAST,
    FRAME_STEP_S,
    INSTANT_STEP_S,
    LEFT,
    RIGHT,
    STEREO,
    BoardScene,
)

NUM_CORNERS = CORNERS[0] * CORNERS[1]
REFINE_HALF_PX = 5
"""Half the window of the corner refinement: as large as that of the tracking."""
_REFINE_UNTIL = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-3)


@dataclass(frozen=True)
class BlurView:
    """What was measured at one instant."""

    time_s: float
    left: Image
    """The window of the left image that was read out."""
    left_px: FloatArray | None
    """Corners found in that window, [32, 2], px; None if the board was not found, as in all that
    follow."""
    blur: FloatArray | None
    """Blur metric of the patch around each, [32]."""
    right_found: bool
    fast_found: bool
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
    """N observations of a corner: the errors, and how blurred it was."""

    time_s: FloatArray
    """[N]."""
    instant: IntArray
    """Number of the instant, [N]. Errors at one instant have causes in common."""
    corner: IntArray
    """0 … 31, by rows from the upper left one, [N]."""
    blur: FloatArray
    """Of the patch in the left image, 0 … 1, [N]."""
    reprojection_px: FloatArray
    """(u, v), [N, 2]; NaN where unknown."""
    tracking_px: FloatArray
    """(u, v), [N, 2]; NaN where unknown."""

    def __len__(self) -> int:
        """Number of observations, N."""
        return len(self.blur)

    @property
    def threshold(self) -> float:
        """The median of the blur, which parts low from high."""
        return float(np.median(self.blur))

    @property
    def is_high(self) -> BoolArray:
        """Whether an observation counts as high blur, [N]."""
        return self.blur > self.threshold

    @staticmethod
    def of(views: list[BlurView]) -> BlurObservations:
        """Every corner of every view whose left image shows the board."""
        seen = [(k, view.left_px, view.blur, view) for k, view in enumerate(views)]
        known = [
            (k, metric, view)
            for k, left_px, metric, view in seen
            if left_px is not None and metric is not None
        ]
        return BlurObservations(
            time_s=np.repeat([view.time_s for _, _, view in known], NUM_CORNERS),
            instant=np.repeat(np.array([k for k, _, _ in known], dtype=np.int64), NUM_CORNERS),
            corner=np.tile(np.arange(NUM_CORNERS), len(known)),
            blur=np.concatenate([np.zeros(0), *(metric for _, metric, _ in known)]),
            reprojection_px=np.concatenate(
                [np.zeros((0, 2)), *(view.reprojection_px for _, _, view in known)]
            ),
            tracking_px=np.concatenate(
                [np.zeros((0, 2)), *(view.tracking_px for _, _, view in known)]
            ),
        )


def blur_views(instants: int, seed: int) -> Iterator[BlurView]:
    """Move the rig before the board, slowly and then fast, and measure at so many synchronised
    instants.

    The stereo rig takes 20 and the fast camera 125 frames/s; both expose together every 0.2 s,
    which are the instants. Tracking comes from the left image before, 50 ms earlier. Of the images
    only what is used gets rendered. The same seed gives the same views.
    """
    scene = BoardScene((instants + 1) * INSTANT_STEP_S, np.random.default_rng([seed, 0]))
    return read_ahead(
        lambda k: _view(scene, (k + 1) * INSTANT_STEP_S, (seed, 1, k)), range(instants)
    )


def _view(scene: BoardScene, t_s: float, key: tuple[int, ...]) -> BlurView:
    before_s = t_s - FRAME_STEP_S
    numbers = count()
    images = []
    found = []
    for camera, when_s, others_s in (
        (LEFT, before_s, (t_s,)),
        (LEFT, t_s, (before_s,)),
        (RIGHT, t_s, ()),
        (FAST, t_s, ()),
    ):
        window = scene.window(camera, (when_s, *others_s))
        images.append(
            scene.expose(camera, when_s, window, np.random.default_rng([*key, next(numbers)]))
        )
        corners_px = find_corners(images[-1])
        found.append((corners_px, window.corner_px))
    (previous_px, _), (left_px, left_corner), (right_px, right_corner), (fast_px, fast_corner) = (
        found
    )
    reprojection_px = tracking_px = np.full((NUM_CORNERS, 2), np.nan)
    if left_px is not None and right_px is not None and fast_px is not None:
        expected_px = reproject(
            np.concatenate([left_px + left_corner, right_px + right_corner], axis=1)
        )
        reprojection_px = expected_px - (fast_px + fast_corner)
    if previous_px is not None and left_px is not None:
        tracking_px = track(images[0], images[1], previous_px) - left_px
    return BlurView(
        time_s=t_s,
        left=images[1],
        left_px=left_px,
        blur=None if left_px is None else blur(images[1], left_px),
        right_found=right_px is not None,
        fast_found=fast_px is not None,
        previous_found=previous_px is not None,
        reprojection_px=reprojection_px,
        tracking_px=tracking_px,
    )


def find_corners(image: Image) -> FloatArray | None:
    """Interior corners of the board, [32, 2], px, by rows from the upper left one; None if it is
    not found.

    The board is found as a whole, for which it may be much blurred, and each corner then refined by
    itself, from the gradients in a window as large as that of the tracking. The board must be less
    than 90° from upright.
    """
    found, corners_px = cv2.findChessboardCornersSB(
        image, CORNERS, flags=cv2.CALIB_CB_NORMALIZE_IMAGE
    )
    if not found:
        return None
    corners_px = corners_px.reshape(-1, 2)
    if corners_px[0, 0] > corners_px[-1, 0]:  # turned by 180°, the board looks the same
        corners_px = corners_px[::-1]
    start_px = np.array(corners_px, dtype=np.float32, order="C").reshape(-1, 1, 2)
    refined_px = cv2.cornerSubPix(
        image, start_px, (REFINE_HALF_PX, REFINE_HALF_PX), (-1, -1), _REFINE_UNTIL
    )
    return np.asarray(refined_px, dtype=np.float64).reshape(-1, 2)


def reproject(pixels: FloatArray) -> FloatArray:
    """Stereo observations [N, 4], px, triangulated and projected into the fast camera, [N, 2], px."""
    return FAST.project(STEREO.triangulate(pixels))


def track(previous: Image, left: Image, previous_px: FloatArray) -> FloatArray:
    """Where Lucas–Kanade finds points [N, 2] of the previous image, [N, 2], px; NaN where it finds
    nothing.

    Window and pyramid are those of the odometry; the search starts where the points were.
    """
    config = TrackingConfig()
    found_px, status, _ = cv2.calcOpticalFlowPyrLK(
        previous,
        left,
        previous_px.astype(np.float32),
        previous_px.astype(np.float32),
        winSize=(config.window_px, config.window_px),
        maxLevel=config.pyramid_levels,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    return np.where(status > 0, found_px, np.nan).astype(np.float64)

"""Whether images that repeat are those of a camera that hangs, or of one at rest."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.camera.transfer import transfer
from probevo.estimation.motion_model import MotionModel, MotionPrediction
from probevo.estimation.recovery import MAX_DURATION_S
from probevo.sequences.frame import Frame
from probevo.tracking import TrackingState
from probevo.tracking.repeated_images import are_repeated, displacements, look_repeated

USUAL_DISTANCE = 6.0
"""Squared Mahalanobis distance of an ordinary motion from its prediction, the mean of χ²(6). Where
images have long been frozen, a rest that is no farther away than that may be what they show."""

MIN_FEATURES = 20
"""Fewest features that tell whether a scene moves."""
MAX_MOVED_SHARE = 0.25
"""Share of the predicted displacement up to which features count as standing. Zero is five standard
deviations of the prediction away from it where the test is made, so that a camera that moves shows
less than this with one in 30,000."""
MIN_SIGMAS = 3.0
"""Standard deviations by which that share has to be kept."""
MOVES_FROM = 23.5
"""Squared Mahalanobis distance from zero from which displacements are a motion: the 99.99 %
quantile of χ²(4), of a shift, a roll and a magnification."""
OVERLAP = 4.0
"""Factor of the variance of what many features show together: the windows of neighbours overlap, so
that they have a part of their errors in common."""

FIT_ITERATIONS = 10
NORMAL_PER_MEDIAN = 1.4826
"""Standard deviation of a Gaussian over the median of its absolute values."""
LEAST_SIGMA_PX = 1e-3
"""Smallest standard deviation of a displacement: in images without noise, none would be left."""


class Repetition(Enum):
    """Whether the images of a frame repeat those of the previous one."""

    NONE = "none"
    AMBIGUOUS = "ambiguous"
    """They repeat, and the camera either rests or moves unseen."""
    FROZEN = "frozen"
    """They do not change although the camera moves."""


@dataclass(frozen=True)
class Shown:
    """The frame that the images may show again: the previous one, or if that was frozen, the last
    one before it."""

    frame: Frame
    features: TrackingState
    """Its features."""
    motion: MotionPrediction
    """The predicted motion from it to the current frame."""
    is_frozen: bool
    """Whether the images of the frames since then were frozen."""


def repetition_of(
    prev_frame: Frame, frame: Frame, model: MotionModel, shown: Shown, camera: StereoCamera
) -> Repetition:
    """Return whether the images of a frame repeat those of the previous one.

    Args:
        prev_frame: the previous frame.
        frame: the current frame.
        model: the motion model before the step.
        shown: the frame that the images may show again.
        camera: the rectified camera.
    """
    if _are_frozen(prev_frame, frame, model, shown, camera):
        return Repetition.FROZEN
    if _may_be_frozen(prev_frame, frame, model, shown):
        return Repetition.AMBIGUOUS
    return Repetition.NONE


def _are_frozen(
    prev_frame: Frame, frame: Frame, model: MotionModel, shown: Shown, camera: StereoCamera
) -> bool:
    """Return whether the images do not change although the camera moves.

    They are the same bytes; or they are the same except for noise, and the camera was too fast to
    have come to rest. Then they count as frozen until they change. A camera that brakes has moved
    on, and shows another image than before; one that rests right where the images froze would have
    to stop from one frame to the next. That counts only once the frame before is too long ago
    to be found again (``recovery``), so that the pose cannot jump back to it, and if the camera may
    well be at rest by what was known of it.
    """
    if not model.is_moving:
        return False
    if are_repeated(prev_frame, frame):
        return True
    at_rest = shown.motion.squared_distance(np.eye(4), np.zeros((6, 6)))
    if shown.is_frozen:
        may_rest = model.since_solve_s > MAX_DURATION_S and at_rest <= USUAL_DISTANCE
    else:
        may_rest = at_rest <= shown.motion.gate
    if may_rest:
        return False
    return look_repeated(prev_frame, frame) and _stand_against(shown, frame, camera)


def _may_be_frozen(prev_frame: Frame, frame: Frame, model: MotionModel, shown: Shown) -> bool:
    """Return whether the images repeat without telling whether the camera rests.

    Equal bytes mean a dropped frame, except from a camera without noise. Images that are equal but
    for noise are ambiguous if the last solved motion followed repeated images, or if a solve was
    rejected, as in a video whose frames come twice.
    """
    if are_repeated(prev_frame, frame):
        return True
    is_ambiguous = model.is_after_repetition or model.rejections > 0
    return is_ambiguous and look_repeated(prev_frame, frame) and _stand(shown, frame)


def _stand_against(shown: Shown, frame: Frame, camera: StereoCamera) -> bool:
    """Return whether features stay where they are, against what is predicted of their motion.

    How far they have moved is fitted by a multiple of how far they should have; it is about 0 if
    images are frozen, and about 1 if the camera moves, however little that may be.
    """
    pixels, moved_px = _displaced(shown, frame)
    predicted_px = (transfer(pixels, shown.motion.T_curr_prev, camera) - pixels)[:, :2]
    is_known = np.isfinite(predicted_px).all(axis=1)
    if is_known.sum() < MIN_FEATURES:
        return False
    moved_px = moved_px[is_known]
    predicted_px = predicted_px[is_known]
    # What lies along the prediction, whose size is the only column of the design.
    sizes_px = np.linalg.norm(predicted_px, axis=1)
    directions = predicted_px / np.maximum(sizes_px, np.finfo(float).tiny)[:, None]
    along_px = (directions * moved_px).sum(axis=1)
    share, variance = _robust_fit(sizes_px[:, None], along_px)
    return bool(abs(share[0]) + MIN_SIGMAS * np.sqrt(variance[0, 0]) < MAX_MOVED_SHARE)


def _stand(shown: Shown, frame: Frame) -> bool:
    """Return whether features stay where they are, as far as their noise tells."""
    pixels, moved_px = _displaced(shown, frame)
    if len(pixels) < MIN_FEATURES:
        return True
    places = pixels[:, :2] - pixels[:, :2].mean(axis=0)
    u, v = (places / max(float(places.std()), 1.0)).T
    one = np.ones(len(pixels))
    none = np.zeros(len(pixels))
    # A shift, a magnification and a roll.
    design = np.vstack(
        [np.column_stack([one, none, u, -v]), np.column_stack([none, one, v, u])],
    )
    motion, covariance = _robust_fit(design, moved_px.T.reshape(-1))
    return bool(motion @ np.linalg.solve(covariance, motion) < MOVES_FROM)


def _displaced(shown: Shown, frame: Frame) -> tuple[FloatArray, FloatArray]:
    """Return the features of the scene that are found again in a frame, (u_l, v_l, u_r, v_r) where
    they were, [N, 4], px, and how far they have moved in the left image, [N, 2], px."""
    if shown.frame.left is None or frame.left is None:
        return np.zeros((0, 4)), np.zeros((0, 2))
    features = shown.features
    pixels = features.pixels[~features.are_fixed(features.ids)]
    moved_px = displacements(shown.frame.left, frame.left, pixels[:, :2])
    is_found = np.isfinite(moved_px).all(axis=1)
    return pixels[is_found], moved_px[is_found]


def _robust_fit(design: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Fit values, [N], by columns of a design, [N, K], robustly (Cauchy's loss).

    Returns:
        The coefficients, [K], and their covariance, [K, K].
    """
    weights = np.ones(len(values))
    for _ in range(FIT_ITERATIONS):
        # Weighted least squares: the normal equations.
        weighted = design * weights[:, None]
        inverse = np.asarray(np.linalg.pinv(weighted.T @ design), dtype=np.float64)
        coefficients = inverse @ (weighted.T @ values)
        residuals = values - design @ coefficients
        # Cauchy's weight 1/(1 + (r/c)²), with c twice the standard deviation by the median of |r|.
        sigma = max(NORMAL_PER_MEDIAN * float(np.median(np.abs(residuals))), LEAST_SIGMA_PX)
        weights = 1.0 / (1.0 + (residuals / (2.0 * sigma)) ** 2)
    return coefficients, OVERLAP * sigma**2 * inverse

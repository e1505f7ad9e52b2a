"""The rotation between two images, from which the tracking of a camera that turned fast starts.

``coarse_rotation`` takes the shift of the whole image. It always finds one, and does not see a turn
about the optical axis.

``matched_rotation`` matches descriptors (ORB: Rublee et al., ICCV 2011). Lucas–Kanade follows a
feature for a few tens of pixels, and a window that turns by about ten degrees. Descriptors find it
anywhere, turned by any angle, but less precisely.
"""

from __future__ import annotations

import cv2
import numpy as np

from probevo.arrays import BoolArray, FloatArray, Image
from probevo.camera.stereo import StereoCamera
from probevo.geometry import so3

COARSE_REDUCTION = 8
"""Factor by which images are reduced for the coarse rotation."""
NUM_FEATURES = 500
"""Features per image."""
USUAL_WIDTH_PX = 640
"""Wider images are reduced to about this width, by a whole factor: half a degree is precise enough
for a start."""
MIN_PX = 64
"""Height and width below which an image has no descriptors: a window of one is 31 px wide."""
NUM_SAMPLES = 200
"""Pairs of matches that are tried: enough to find one of two right ones, with all but certainty, if
a fifth of them are right."""
NEAR_RAD = 0.06
"""Matches that a rotation explains to within this agree with it. They need not lie at infinity: a
point at 3 m moves by so much when the camera moves by 0.2 m."""
MIN_AGREEING = 12
"""Matches that have to agree. Wrong ones lie anywhere, of which a percent are near by chance."""


def coarse_rotation(prev_image: Image, image: Image, camera: StereoCamera) -> FloatArray:
    """Return C_curr_prev, [3, 3], a rough yaw and pitch from the shift of the whole image (phase
    correlation)."""
    # A rotation by several degrees shifts a small image by a few pixels only.
    size = max(image.shape[1] // COARSE_REDUCTION, 2), max(image.shape[0] // COARSE_REDUCTION, 2)
    prev_small, small = (
        cv2.resize(each, size, interpolation=cv2.INTER_AREA).astype(np.float32)
        for each in (prev_image, image)
    )
    # A window function, since phase correlation takes the images as periodic.
    window = np.asarray(cv2.createHanningWindow(size, cv2.CV_32F))
    (du, dv), _ = cv2.phaseCorrelate(prev_small, small, window)
    # A shift down by dv is a rotation about −x, a shift to the right by du one about +y.
    angle = COARSE_REDUCTION * np.array([-dv / camera.fv_px, du / camera.fu_px, 0.0])
    rotation: FloatArray = so3.exp(angle)
    return rotation


def matched_rotation(prev_image: Image, image: Image, camera: StereoCamera) -> FloatArray | None:
    """Return C_curr_prev, [3, 3], by which most matched features have turned; None if few agree.

    Args:
        prev_image: previous left image, [height, width], uint8.
        image: current left image.
        camera: the rectified camera.
    """
    reduction = max(1, round(image.shape[1] / USUAL_WIDTH_PX))
    prev_image = _reduced(prev_image, reduction)
    image = _reduced(image, reduction)
    if min(image.shape) < MIN_PX:
        return None
    orb = cv2.ORB.create(nfeatures=NUM_FEATURES)
    prev_found, prev_descriptors = orb.detectAndCompute(prev_image, None)
    found, descriptors = orb.detectAndCompute(image, None)
    if prev_descriptors is None or descriptors is None:
        return None
    matches = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(prev_descriptors, descriptors)
    if len(matches) < MIN_AGREEING:
        return None
    prev_px = np.array([prev_found[match.queryIdx].pt for match in matches])
    curr_px = np.array([found[match.trainIdx].pt for match in matches])
    # Places refer to the centres of pixels, which are at whole numbers.
    to_middle_px = 0.5 * (reduction - 1)
    prev_rays = camera.unit_rays(reduction * prev_px + to_middle_px)
    curr_rays = camera.unit_rays(reduction * curr_px + to_middle_px)
    agreeing = _best_sample(prev_rays, curr_rays)
    if int(agreeing.sum()) < MIN_AGREEING:
        return None
    return so3.most_aligned(curr_rays[agreeing].T @ prev_rays[agreeing])


def _reduced(image: Image, factor: int) -> Image:
    """Return an image, smaller by a whole factor."""
    if factor == 1:
        return image
    size = image.shape[1] // factor, image.shape[0] // factor
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))


def _best_sample(prev_rays: FloatArray, curr_rays: FloatArray) -> BoolArray:
    """Return which of N matches agree with the rotation of the best pair of them, [N]."""
    rng = np.random.default_rng(0)
    pairs = rng.integers(len(prev_rays), size=(NUM_SAMPLES, 2))
    rotations = so3.most_aligned(curr_rays[pairs].mT @ prev_rays[pairs])
    # c · R p = Σ c_i p_j R_ij for each of S rotations and N pairs of rays (p, c): one product of
    # matrices, [S, 9] by [9, N].
    outer_products = curr_rays[:, :, None] * prev_rays[:, None, :]
    cosines = rotations.reshape(-1, 9) @ outer_products.reshape(-1, 9).T
    near = cosines > np.cos(NEAR_RAD)
    best: BoolArray = near[int(near.sum(axis=1).argmax())]
    return best

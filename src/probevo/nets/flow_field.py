"""The input of networks from two images of one camera: optical flow on a grid of viewing rays.

Images of any pinhole camera are resampled to one small virtual camera, in which dense optical flow
is computed (Kroeger et al. 2016) and averaged over cells. Flow is in normalised coordinates, x =
(u − c_u)/f_u, so that neither focal length nor image size matter, and a network learned with one
camera sees with another, as long as that covers the same field of view.

A rotation moves each ray by an amount that depends on the rotation alone, and on no depth. So a
field of flow can be rotated further, as a camera would have seen it (``rotated``): from one pair of
images come any number of training data with exact targets.
"""

from __future__ import annotations

import threading
from functools import cache
from typing import Any

import cv2
import numpy as np

from probevo.arrays import AnyArray, FloatArray, Image
from probevo.camera.stereo import StereoCamera
from probevo.errors import InputError

Fields = Any
"""Arrays of NumPy, or of JAX."""
FOCAL_PX = 180.0
"""Focal length of the virtual camera: half the rendered scenes', a quarter of KITTI's."""
SIZE_PX = (288, 80)
"""Width and height of its images: x from −0.8 to 0.8, y from −0.22 to 0.22."""
CELL_PX = 4
"""The flow is averaged over cells of this size."""
CELLS = (SIZE_PX[1] // CELL_PX, SIZE_PX[0] // CELL_PX)
"""Rows and columns of cells."""
CHANNELS = 4
"""Flow along x and y, mismatch and contrast."""
MIN_LEVELS = 2.0
"""Added to grey levels before their logarithm is taken: quantisation and noise of a dark image."""


def virtual_view(image: Image, camera: StereoCamera) -> Image:
    """Return what the virtual camera sees of an image, [80, 288], uint8.

    Raises:
        InputError: the camera's field of view is smaller than the virtual camera's.
    """
    check_field_of_view(camera)
    # Affine map from a pixel of the virtual camera to the pixel of the image with the same ray: u =
    # f_u x + c_u with x = (u_virtual − c_virtual)/FOCAL_PX.
    to_source = np.array(
        [
            [camera.fu_px / FOCAL_PX, 0.0, camera.cu_px - camera.fu_px * _center()[0] / FOCAL_PX],
            [0.0, camera.fv_px / FOCAL_PX, camera.cv_px - camera.fv_px * _center()[1] / FOCAL_PX],
        ]
    )
    # A pixel of the virtual camera is roughly the mean of those it covers.
    sigma_px = 0.4 * max(camera.fu_px / FOCAL_PX, 1.0)
    blurred = cv2.GaussianBlur(image, (0, 0), sigma_px)
    view = cv2.warpAffine(
        blurred,
        to_source,
        SIZE_PX,
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )
    return np.asarray(view, np.uint8)


def check_field_of_view(camera: StereoCamera) -> None:
    """Refuse a camera that does not see all rays of the virtual one.

    Raises:
        InputError: it has no images, or says how far it has to see.
    """
    if camera.size_px is None:
        raise InputError("camera", "there are no images.", "Networks need images.")
    x, y = (center / FOCAL_PX for center in _center())
    width_px, height_px = camera.size_px
    # How far the camera sees in each direction, in normalised coordinates
    left = camera.cu_px / camera.fu_px
    right = (width_px - 1 - camera.cu_px) / camera.fu_px
    top = camera.cv_px / camera.fv_px
    bottom = (height_px - 1 - camera.cv_px) / camera.fv_px
    if min(left, right) < x or min(top, bottom) < y:
        what = (
            f"it sees {left:.2f} to the left, {right:.2f} to the right, {top:.2f} up and"
            f" {bottom:.2f} down, in units of the focal length."
        )
        cure = (
            f"Networks need {x:.2f} to either side and {y:.2f} up and down: crop the images less."
        )
        raise InputError("camera", what, cure)


def field_of_images(prev: Image, curr: Image, camera: StereoCamera) -> FloatArray:
    """Return what a network sees of two images of a camera, [4, rows, columns], float32.

    Raises:
        InputError: the camera's field of view is smaller than the virtual camera's.
    """
    return flow_field(virtual_view(prev, camera), virtual_view(curr, camera))


def flow_field(prev: Image, curr: Image) -> FloatArray:
    """Return what a network sees of two images of the virtual camera, [4, rows, columns], float32.

    The channels are the flow along x and y of each cell, from the previous to the current image, in
    normalised coordinates; the logarithm of how far grey levels differ once the flow is taken back
    (mismatch); and the logarithm of how far they vary within the cell (contrast). The last two tell
    where the flow can be trusted.
    """
    start = np.zeros((*prev.shape, 2), np.float32)  # overwritten
    flow_px = np.asarray(_FLOW_ESTIMATOR.dis.calc(prev, curr, start))
    # The current image as sampled along the flow looks like the previous one where the flow is
    # right.
    columns, rows = _pixels()
    moved = cv2.remap(curr, columns + flow_px[..., 0], rows + flow_px[..., 1], cv2.INTER_LINEAR)
    difference = np.abs(moved.astype(np.float32) - prev)
    levels = prev.astype(np.float32)
    mean = cell_means(levels)
    variance = np.maximum(cell_means(levels**2) - mean**2, 0.0)
    field = [
        cell_means(flow_px[..., 0]) / FOCAL_PX,
        cell_means(flow_px[..., 1]) / FOCAL_PX,
        np.log(cell_means(difference) + MIN_LEVELS),
        np.log(np.sqrt(variance) + MIN_LEVELS),
    ]
    return np.stack(field).astype(np.float32)


def rotated(fields: Fields, rotations: Fields) -> Fields:
    """Return fields of flow, [N, 4, rows, columns], as if the camera had then turned further.

    Args:
        fields: as ``flow_field`` gives them, of NumPy or JAX.
        rotations: C by which the current camera is turned, p' = C p, [N, 3, 3].
    """
    xp = fields.__array_namespace__()
    rays = cell_rays()
    x = rays[0] + fields[:, 0]
    y = rays[1] + fields[:, 1]
    # Where each ray of the previous image is seen in the current one, as a ray, [N, 3, rows,
    # columns]. A camera that turns further moves it by C, whatever its depth.
    seen = xp.stack([x, y, xp.ones_like(x)], axis=1)
    turned = xp.einsum("nij,njrc->nirc", rotations, seen)
    moved = [turned[:, 0] / turned[:, 2] - rays[0], turned[:, 1] / turned[:, 2] - rays[1]]
    return xp.concatenate([xp.stack(moved, axis=1), fields[:, 2:]], axis=1)


def mirrored(fields: Fields) -> Fields:
    """Return fields, [N, 4, rows, columns], of the mirrored world: left and right exchanged.

    The rotation (φ_x, φ_y, φ_z) of the camera becomes (φ_x, −φ_y, −φ_z).
    """
    # Columns in reverse order, and the flow along x with the other sign
    signs = np.array([-1.0, 1.0, 1.0, 1.0], fields.dtype)[:, None, None]
    return fields[..., ::-1] * signs


@cache
def cell_rays() -> FloatArray:
    """Return the normalised coordinates x and y of the centre of each cell, [2, rows, columns]."""
    columns, rows = _pixels()
    x = (cell_means(columns) - _center()[0]) / FOCAL_PX
    y = (cell_means(rows) - _center()[1]) / FOCAL_PX
    return np.stack([x, y])


def _center() -> tuple[float, float]:
    """Return the principal point of the virtual camera, px."""
    return 0.5 * (SIZE_PX[0] - 1), 0.5 * (SIZE_PX[1] - 1)


@cache
def _pixels() -> tuple[FloatArray, FloatArray]:
    """Return the columns and the rows of all pixels, [80, 288] each, float32."""
    columns, rows = np.meshgrid(np.arange(SIZE_PX[0]), np.arange(SIZE_PX[1]))
    return columns.astype(np.float32), rows.astype(np.float32)


class _FlowEstimator(threading.local):
    """OpenCV's estimator of dense flow, one for each thread: it keeps its images and buffers."""

    def __init__(self) -> None:
        self.dis = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)


_FLOW_ESTIMATOR = _FlowEstimator()


def cell_means(values: AnyArray) -> FloatArray:
    """Return the mean of each cell, [rows, columns], of values of all pixels."""
    # [rows, 4, columns, 4], of which the mean is taken within each cell
    parts = values.reshape(CELLS[0], CELL_PX, CELLS[1], CELL_PX)
    means: FloatArray = parts.mean(axis=(1, 3))
    return means

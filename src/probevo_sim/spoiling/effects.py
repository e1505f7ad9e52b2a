"""What spoils an image. All functions are pure, and of grey images [height, width], uint8."""

from __future__ import annotations

import cv2
import numpy as np

from probevo.arrays import AnyArray, BoolArray, FloatArray, Image
from probevo.camera.stereo import StereoCamera

BLUR_INSTANTS = 9
"""Instants of an exposure."""
UNDISTORTED_BY = 30
"""Steps of Newton's method that invert a radial distortion; each leaves two thirds of the error at
most."""
MIN_SLOPE = 1e-6
"""Least derivative by which a step divides: with the strongest barrel, it is zero in a corner."""


def shaken(image: Image, way_px: FloatArray) -> Image:
    """Blur along a straight way of the whole image during the exposure, (u, v), [2], px."""
    shares = np.linspace(-0.5, 0.5, max(BLUR_INSTANTS, 1 + 2 * int(np.hypot(*way_px))))
    height, width = image.shape
    total = np.zeros(image.shape, np.float32)
    for share in shares:
        shift = np.array([[1.0, 0.0, share * way_px[0]], [0.0, 1.0, share * way_px[1]]])
        total += cv2.warpAffine(
            image.astype(np.float32), shift, (width, height), borderMode=cv2.BORDER_REPLICATE
        )
    return _grey(total / len(shares))


def optical_flow(image: Image, other: Image) -> FloatArray:
    """Return the flow of each pixel of an image to another one, [height, width, 2], px."""
    method = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_FAST)
    flow: FloatArray = method.calc(image, other, None)  # type: ignore[call-overload]
    return flow


def blurred_along(image: Image, flow_px: FloatArray, share: float) -> Image:
    """Blur each pixel along its own flow, [height, width, 2], px, as a shutter that is open for a
    share of the time between two frames."""
    v, u = np.mgrid[: image.shape[0], : image.shape[1]].astype(np.float32)
    total = np.zeros(image.shape, np.float32)
    for instant in np.linspace(-0.5, 0.5, BLUR_INSTANTS, dtype=np.float32):
        way = np.float32(share) * instant
        total += cv2.remap(
            image.astype(np.float32),
            u + way * flow_px[..., 0].astype(np.float32),
            v + way * flow_px[..., 1].astype(np.float32),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
    return _grey(total / BLUR_INSTANTS)


def exposed(image: Image, gain: float, noise_grey: float, rng: np.random.Generator) -> Image:
    """Change the exposure by a factor, and add white noise of a standard deviation, grey levels."""
    grey = np.float32(gain) * image.astype(np.float32)
    if noise_grey > 0.0:
        grey = grey + np.float32(noise_grey) * rng.standard_normal(image.shape, dtype=np.float32)
    return _grey(grey)


def texture(shape: tuple[int, int], rng: np.random.Generator) -> Image:
    """Draw a texture with detail at all scales, [height, width]."""
    grey = np.zeros(shape, np.float32)
    for scale in (1, 3, 8, 20):
        coarse = rng.standard_normal((shape[0] // scale + 2, shape[1] // scale + 2), np.float32)
        grey += cv2.resize(coarse, shape[::-1], interpolation=cv2.INTER_LINEAR)
    return _grey(110.0 + 35.0 * grey)


def pasted(image: Image, patch: Image, corner_px: tuple[float, float]) -> Image:
    """Paste a patch with its upper left corner at (u, v), px, which may be between pixels or
    outside of the image."""
    height, width = image.shape
    shift = np.array([[1.0, 0.0, corner_px[0]], [0.0, 1.0, corner_px[1]]])
    over = cv2.warpAffine(patch.astype(np.float32), shift, (width, height))
    cover = cv2.warpAffine(np.ones(patch.shape, np.float32), shift, (width, height))
    return _grey(over + (1.0 - cover) * image.astype(np.float32))


def dirt_mask(shape: tuple[int, int], amount: float, rng: np.random.Generator) -> FloatArray:
    """Draw how much of the light dirt on a lens lets through, [height, width], 0 to 1: blots that
    are out of focus."""
    height, width = shape
    mask = np.ones(shape, np.float32)
    for _ in range(3 + round(20 * amount)):
        center = (int(rng.integers(width)), int(rng.integers(height)))
        radius = int(rng.uniform(0.02, 0.02 + 0.08 * amount) * width)
        cv2.circle(mask, center, max(radius, 1), float(rng.uniform(0.05, 0.5)), -1)
    softened: FloatArray = cv2.GaussianBlur(mask, (0, 0), 0.01 * width).astype(np.float64)
    return softened


def soiled(image: Image, mask: FloatArray) -> Image:
    """Look through dirt that lets a share of the light through, [height, width]; the rest is the
    grey of the dirt."""
    share = mask.astype(np.float32)
    return _grey(share * image.astype(np.float32) + (1.0 - share) * 60.0)


def compressed(image: Image, quality: int) -> Image:
    """Compress by JPEG of a quality, 1 to 100."""
    data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    decoded: Image = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)  # type: ignore[assignment]
    return decoded


def _grey(values: AnyArray) -> Image:
    image: Image = np.clip(np.rint(values), 0, 255).astype(np.uint8)
    return image


def strongest_barrel(camera: StereoCamera) -> float:
    """Return the magnitude of a negative k1 beyond which the corners of an image show nothing.

    No radius r is seen farther out than where r (1 + k1 r²) has its maximum: r = 1/√(3 |k1|), seen
    at two thirds of that.
    """
    width, height = camera.size_px or (0, 0)
    u, v = np.meshgrid([0.0, width - 1.0], [0.0, height - 1.0])
    x = (u - camera.cu_px) / camera.fu_px
    y = (v - camera.cv_px) / camera.fv_px
    # 2 / (3 √(3 |k1|)) = r of the farthest corner
    return 4.0 / (27.0 * float(np.max(x**2 + y**2)))


def distortion_map(camera: StereoCamera, k1: float) -> FloatArray:
    """Return where each pixel of a distorted image comes from, [2, height, width], px, float32.

    A point at the normalised coordinates x is seen at x (1 + k1 r²), with r² = x² + y².

    Args:
        camera: of the images without distortion.
        k1: the coefficient, from minus ``strongest_barrel`` on.
    """
    width, height = camera.size_px or (0, 0)
    u, v = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
    seen_x = (u - camera.cu_px) / camera.fu_px
    seen_y = (v - camera.cv_px) / camera.fv_px
    # r of the point from r (1 + k1 r²) of its pixel: from there, no step passes the solution.
    seen_r = np.hypot(seen_x, seen_y)
    r = seen_r
    for _ in range(UNDISTORTED_BY):
        slope = np.maximum(1.0 + 3.0 * k1 * r**2, MIN_SLOPE)
        r = r - (r * (1.0 + k1 * r**2) - seen_r) / slope
    factor = 1.0 + k1 * r**2
    source = [
        camera.cu_px + camera.fu_px * seen_x / factor,
        camera.cv_px + camera.fv_px * seen_y / factor,
    ]
    return np.stack(source).astype(np.float32)


def distorted_mask(mask: Image | BoolArray, source_px: FloatArray) -> Image:
    """Return a mask whose pixels come from these places, [2, height, width], px."""
    grey = np.asarray(mask, np.uint8) * (255 if mask.dtype == np.bool_ else 1)
    remapped = cv2.remap(
        grey, source_px[0], source_px[1], cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(remapped, np.uint8)


def distorted(image: Image, source_px: FloatArray) -> Image:
    """Return an image whose pixels come from these places, [2, height, width], px."""
    remapped = cv2.remap(
        image, source_px[0], source_px[1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(remapped, np.uint8)

"""Random points seen by a stereo camera along a known motion, with known noise.

Other tests use them: ``from worlds import CAMERA, seen_twice``.
"""

from dataclasses import replace

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.image_errors import NUM_ERRORS, ImageErrors
from probevo.camera.rig_calibration import disparity_basis, row_basis
from probevo.camera.rig_rows_numba import RADIAL, ROLL
from probevo.camera.stereo import StereoCamera
from probevo.geometry import se3
from probevo.noise import StereoNoise, StudentT
from probevo.sequences.frame import Frame, StereoFeatures
from probevo.tracking.tracks import Tracks

WIDTH_PX = 1226
HEIGHT_PX = 370
CAMERA = StereoCamera(
    fu_px=707.0,
    fv_px=709.0,
    cu_px=601.0,
    cv_px=183.0,
    baseline_m=0.537,
    size_px=(WIDTH_PX, HEIGHT_PX),
)
FORWARD = se3.exp(np.array([0.02, 0.01, -1.2, 0.003, 0.01, -0.002]))
"""T_curr_prev of a car at 12 m/s and ten frames a second."""
TWO_FRAMES = {"estimator": "two-frame"}
"""Settings of an odometry without a window."""
FRAME_NS = 100_000_000
START_NS = 1_400_000_000_123_456_789


def random_pixels(
    rng: np.random.Generator, count: int, depth_m: tuple[float, float] = (5.0, 60.0)
) -> FloatArray:
    """Return noise-free observations, [N, 4], px, of points spread over the image, uniform in
    inverse depth."""
    rho = rng.uniform(1.0 / depth_m[1], 1.0 / depth_m[0], count)
    u = rng.uniform(0.0, WIDTH_PX, count)
    v = rng.uniform(0.0, HEIGHT_PX, count)
    return np.column_stack([u, v, u - CAMERA.fu_px * CAMERA.baseline_m * rho, v])


def moved(pixels: FloatArray, T_curr_prev: FloatArray) -> FloatArray:
    """Return the same points after a motion, [N, 4], px."""
    return CAMERA.project(se3.transform(T_curr_prev, CAMERA.triangulate(pixels)))


def tracks_of(prev_px: FloatArray, curr_px: FloatArray) -> Tracks:
    count = len(prev_px)
    return Tracks(prev_px, curr_px, np.arange(count), age=np.full(count, 2))


def seen_twice(
    rng: np.random.Generator,
    count: int,
    T_curr_prev: FloatArray = FORWARD,
    *,
    sigma_px: float = 0.0,
    depth_m: tuple[float, float] = (5.0, 60.0),
) -> Tracks:
    """Return points before and after a motion, with white Gaussian noise on all eight numbers."""
    prev_px = random_pixels(rng, count, depth_m)
    curr_px = moved(prev_px, T_curr_prev)
    prev_noise, curr_noise = sigma_px * rng.normal(size=(2, count, 4))
    return tracks_of(prev_px + prev_noise, curr_px + curr_noise)


def at_infinity(rng: np.random.Generator, count: int, T_curr_prev: FloatArray = FORWARD) -> Tracks:
    """Return points without disparity, moved by the rotation alone; their rays stay ahead of the
    camera."""
    prev_px = random_pixels(rng, count)
    prev_px[:, 2] = prev_px[:, 0]
    x = (prev_px[:, 0] - CAMERA.cu_px) / CAMERA.fu_px
    y = (prev_px[:, 1] - CAMERA.cv_px) / CAMERA.fv_px
    ray = np.column_stack([x, y, np.ones(count)]) @ T_curr_prev[:3, :3].T
    u = CAMERA.fu_px * ray[:, 0] / ray[:, 2] + CAMERA.cu_px
    v = CAMERA.fv_px * ray[:, 1] / ray[:, 2] + CAMERA.cv_px
    return tracks_of(prev_px, np.column_stack([u, v, u, v]))


def both(first: Tracks, second: Tracks) -> Tracks:
    """Return the points of the first, then those of the second."""
    return tracks_of(
        np.vstack([first.prev_px, second.prev_px]), np.vstack([first.curr_px, second.curr_px])
    )


RIG_ROWS_PX = np.array([0.6, -0.4, 0.3, 0.5, 4.0, -0.5, 0.8])
"""True a₀ … a₅ of a bad rectification; a₄ is of the size that KITTI shows."""
RIG_DISPARITY_PX = np.array([0.4, -1.2])
"""True b₁, b₂ of it."""


def image_errors(
    disparity_px: FloatArray | None = None, distortion_px: FloatArray | None = None
) -> ImageErrors:
    """Return the estimate of these errors of the images, the others zero."""
    mean = np.zeros(NUM_ERRORS)
    if disparity_px is not None:
        mean[:2] = disparity_px
    if distortion_px is not None:
        mean[2:] = distortion_px
    return replace(ImageErrors.initial(), mean=mean)


def misrectified(
    pixels: FloatArray,
    rows_px: FloatArray = RIG_ROWS_PX,
    disparity_px: FloatArray = RIG_DISPARITY_PX,
    b0_px: float = 0.0,
) -> FloatArray:
    """What a pair with these errors shows of points that a flawless one would show at ``pixels``,
    [N, 4], px."""
    seen = pixels.copy()
    true_minus_measured = disparity_basis(pixels, CAMERA) @ np.r_[b0_px, disparity_px]
    seen[:, 2] += true_minus_measured
    _, y = CAMERA.normalized(pixels[:, 0], pixels[:, 1])
    seen[:, 2] -= rows_px[ROLL] * CAMERA.fu_px / CAMERA.fv_px * y
    # The lens moves u_r by what it shows at the place where the point is seen.
    undistorted_px = seen[:, 2].copy()
    for _ in range(20):
        seen[:, 2] = undistorted_px + rows_px[RADIAL] * radial_basis(seen, CAMERA)
    seen[:, 3] += row_basis(seen, CAMERA) @ rows_px
    return seen


def radial_basis(pixels: FloatArray, camera: StereoCamera) -> FloatArray:
    """Return ∂u_r/∂a₆ of N features, x r² f_u/f_v in the right image, [N]; d decreases by as
    much."""
    # x in the right image, y in the left one, as in ``fill_row_basis``. The factor f_u/f_v is there
    # because a₆ is in px of v.
    x, _ = camera.normalized(pixels[:, 2], pixels[:, 3])
    _, y = camera.normalized(pixels[:, 0], pixels[:, 1])
    basis: FloatArray = camera.fu_px / camera.fv_px * x * (x * x + y * y)
    return basis


def motion_error(T_estimated: FloatArray, T_true: FloatArray = FORWARD) -> FloatArray:
    """Return ξ = Log(T_true T_estimated⁻¹), [6], m and rad."""
    return se3.log(T_true @ se3.inverse(T_estimated))


def drive(
    rng: np.random.Generator,
    frames: int,
    T_curr_prev: FloatArray = FORWARD,
    *,
    points: int = 150,
    sigma_px: float = 0.2,
    depth_m: tuple[float, float] = (5.0, 60.0),
) -> list[Frame]:
    """Return the features of a drive whose every step is the same motion, a circle, or rather a
    screw; or whose motions are given, [frames, 4, 4].

    A point is followed until it leaves the image or comes nearer than 3/5 of the least depth; a
    new one takes its place.
    """
    ids = np.zeros(0, np.int64)
    pixels = np.zeros((0, 4))
    next_id = 0
    sequence = []
    for index in range(frames):
        motion = T_curr_prev if T_curr_prev.ndim == 2 else T_curr_prev[index]
        points_m = se3.transform(motion, CAMERA.triangulate(pixels))
        ahead = points_m[:, 2] > 0.6 * depth_m[0]
        pixels = CAMERA.project(points_m[ahead])
        ids = ids[ahead]
        inside = np.all((pixels[:, :2] >= 0.0) & (pixels[:, :2] < [WIDTH_PX, HEIGHT_PX]), axis=1)
        missing = points - int(inside.sum())
        pixels = np.vstack([pixels[inside], random_pixels(rng, missing, depth_m)])
        ids = np.r_[ids[inside], next_id + np.arange(missing)]
        next_id += missing
        noisy = pixels + sigma_px * rng.normal(size=pixels.shape)
        sequence.append(
            Frame(index, START_NS + index * FRAME_NS, features=StereoFeatures(ids, noisy))
        )
    return sequence


def with_features(frame: Frame, count: int) -> Frame:
    """Return the frame with only its first features."""
    assert frame.features is not None
    first = StereoFeatures(frame.features.ids[:count], frame.features.pixels[:count])
    return replace(frame, features=first)


def blind_frame(index: int) -> Frame:
    """Return a frame of the drive that shows nothing at all."""
    nothing = StereoFeatures(np.zeros(0, np.int64), np.zeros((0, 4)))
    return Frame(index, START_NS + index * FRAME_NS, features=nothing)


class Homesick(StudentT):
    """A static noise that says of every third feature that it is out of its domain."""

    def predict(self, predictors: FloatArray) -> StereoNoise:
        outside = np.arange(len(predictors)) % 3 == 0
        return replace(super().predict(predictors), out_of_domain=outside)


def tracks_between(prev: Frame, curr: Frame) -> Tracks:
    """Return the landmarks that two frames see."""
    assert prev.features is not None
    assert curr.features is not None
    ids, of_prev, of_curr = np.intersect1d(
        prev.features.ids, curr.features.ids, return_indices=True
    )
    return Tracks(
        prev_px=prev.features.pixels[of_prev],
        curr_px=curr.features.pixels[of_curr],
        ids=ids,
        age=np.full(len(ids), 2),
    )

"""Quantities that reveal calibration errors, each with its standard deviation and a cure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation, RotationSpline
from scipy.special import ndtri

from probevo.arrays import BoolArray, FloatArray, IntArray
from probevo.camera.focal_length import FocalLengthError
from probevo.camera.rig_calibration import RigCalibration
from probevo.camera.rolling_shutter import NOTICEABLE_S, ReadoutTime
from probevo.camera.stereo import StereoCamera
from probevo.evaluation.accelerometer_scale import AccelerometerScale
from probevo.evaluation.clustered_regression import two_sided_p
from probevo.evaluation.gyro_check import LAG, MOUNTING, SCALE, check_gyro
from probevo.evaluation.row_check import DELAY, RowSamples, check_rows
from probevo.geometry import se3
from probevo.sequences.imu import ImuStream
from probevo.sequences.imu_calibration import GRAVITY_M_S2, ImuCalibration

FALSE_ALARMS = 0.01
"""Share of flawless recordings of which any quantity is marked."""
GRAVITY_SIGMA_M_S2 = 0.02
"""Gravity is 9.78 m/s² at the equator and 9.83 at the poles."""
NUM_PARTS = 5
MIN_PARTS = 3
"""Parts of a recording whose mean forces are compared."""
MAX_DOF = 1e6
"""Degrees of freedom beyond which Student's t is a Gaussian."""
SELF_CALIBRATED = (
    "Rows and disparity: the odometry corrects these errors by itself, as far as they are smooth"
    " over the image. Calibrate anew where one exceeds a pixel, with the board in the corners, too."
)
MIN_BLOCKS = 5
"""Minimum number of segments of the path for an estimate of the scatter."""


@dataclass(frozen=True)
class Quantity:
    """A quantity that is zero for a flawless calibration."""

    name: str
    value: float
    sigma: float
    unit: str
    p_value: float
    """Probability of a value at least as far from zero, if the truth is zero."""
    cure: str
    """What a non-zero value means, and how to correct the calibration."""

    @property
    def z(self) -> float:
        """Distance from zero in σ. Where σ is from few data, it is the one that would be as
        improbable with a σ that is known, so that z of all quantities can be compared."""
        if self.p_value == 0.0:  # too improbable for a float
            return self.value / self.sigma
        return float(np.copysign(ndtri(0.5 * self.p_value), self.value))

    def texts(self, *, is_marked: bool) -> tuple[str, ...]:
        """Return name, value, σ, unit and z, as text."""
        name = f"! {self.name}" if is_marked else f"  {self.name}"
        return (name, f"{self.value:+.3g}", f"{self.sigma:.2g}", self.unit, f"{self.z:+.1f}")


def is_marked(quantity: Quantity, count: int) -> bool:
    """Return whether a quantity, one of ``count``, is significantly different from zero."""
    return quantity.p_value < FALSE_ALARMS / count


def largest_z(count: int) -> float:
    """Return how far from zero, in σ, chance may take any of ``count`` quantities."""
    return float(-ndtri(0.5 * FALSE_ALARMS / count))


def row_quantities(frames: list[RowSamples], camera: StereoCamera) -> list[Quantity]:
    """Describe v_r − v_l at the edges of the image, and the delay of the right image."""
    # What each coefficient would be as an angle or as a ratio of focal lengths, in the text of its
    # cure: a₀ = f_v · pitch, a₁ = f_v · roll, and a₂ y = (f_r/f_l − 1) f_v y.
    regression = check_rows(frames, camera)
    x_edge, y_edge = _edges(camera, frames)
    pitch = float(np.rad2deg(regression.values[0] / camera.fv_px))
    roll = float(np.rad2deg(regression.values[1] / camera.fv_px))
    focal = 100.0 * float(regression.values[2] / camera.fv_px)
    meanings = (
        ("rows, all", 1.0, f"as if the right camera were pitched by {pitch:+.3f}°"),
        ("rows, at the side", x_edge, f"as if the right camera were rolled by {roll:+.3f}°"),
        (
            "rows, at the bottom",
            y_edge,
            f"as if the focal length were {focal:+.3f} % longer on the right",
        ),
        ("rows, bend across", x_edge**2, "like uncorrected lens distortion"),
        (
            "rows, in the corner",
            x_edge * y_edge,
            "as if the right camera were turned inwards; a lens may look alike",
        ),
        ("rows, bend down", y_edge**2, "like uncorrected lens distortion"),
        (
            "rows, by the radius",
            y_edge * (x_edge**2 + y_edge**2),
            "as if the two lenses distorted differently",
        ),
    )
    # Each as the error in px that it makes at the edge of the image.
    quantities = []
    for k, (name, factor, meaning) in enumerate(meanings):
        value = float(regression.values[k]) * factor
        sigma = float(regression.sigma[k]) * factor
        p_value = regression.p_value(value, sigma)
        quantities.append(Quantity(name, value, sigma, "px", p_value=p_value, cure=f"{meaning}."))
    # The delay of the right image.
    delay_ms = 1e3 * float(regression.values[DELAY])
    late = "later" if delay_ms > 0.0 else "earlier"
    cure = (
        f"right images are exposed {abs(delay_ms):.2f} ms {late} than left ones. Trigger both"
        " cameras together; with exposures of different length, align their middles."
    )
    sigma_ms = 1e3 * float(regression.sigma[DELAY])
    p_value = regression.p_value(delay_ms, sigma_ms)
    return [
        *quantities,
        Quantity("right image is late", delay_ms, sigma_ms, "ms", p_value=p_value, cure=cure),
    ]


def rig_quantities(rig: RigCalibration, camera: StereoCamera) -> list[Quantity]:
    """Describe the errors of disparity, shutter and focal length that the self-calibration has
    estimated.

    A constant offset cannot be distinguished from noise, and is not estimated.
    """
    width_px = (camera.size_px or (round(2.0 * camera.cu_px), 0))[0]
    x_edge = max(camera.cu_px, width_px - camera.cu_px) / camera.fu_px
    sigma = np.sqrt(np.diag(rig.image.disparity_cov))
    quantities = []
    for k, (name, factor) in enumerate(
        (("disparity, at the side", x_edge), ("disparity, bend", x_edge**2))
    ):
        value = float(rig.disparity[k]) * factor
        spread = float(sigma[k]) * factor
        cure = "points at the sides seem too near or too far, as by uncorrected lens distortion."
        p_value = two_sided_p(value / spread, np.inf)
        quantities.append(Quantity(name, value, spread, "px", p_value=p_value, cure=cure))
    return [*quantities, _readout_quantity(rig.image.readout), _focal_quantity(rig.focal.error())]


def _readout_quantity(readout: ReadoutTime) -> Quantity:
    """Describe the time in which the rows of an image are exposed."""
    value_ms = 1e3 * readout.mean_s
    cure = (
        f"the rows of an image are exposed one after the other, within {abs(value_ms):.1f} ms. The"
        f" odometry corrects it beyond {1e3 * NOTICEABLE_S:.0f} ms, as well as the velocity of the"
        " camera is known; a global shutter needs no correction."
    )
    return Quantity(
        "readout of the rows",
        value_ms,
        1e3 * readout.sigma_s,
        "ms",
        p_value=two_sided_p(readout.mean_s / readout.sigma_s, np.inf),
        cure=cure,
    )


def _focal_quantity(error: FocalLengthError) -> Quantity:
    """Compare the focal length by images in which the camera turns with the calibrated one."""
    cure = (
        f"where the camera turns, images show {1.0 + 0.01 * error.percent:.4f} times the calibrated"
        " focal length. It is wrong, or lens distortion remains, which can look like up to"
        " 4 %: the scale of a gyro decides."
    )
    z = error.log_ratio / error.sigma
    return Quantity(
        "focal length",
        error.percent,
        100.0 * error.sigma,
        "%",
        p_value=two_sided_p(z, np.inf),
        cure=cure,
    )


def scale_quantity(T_world_cam: FloatArray, T_world_cam_true: FloatArray) -> Quantity | None:
    """Compare distances with true distances, over segments of √N frames or, where fewer true poses
    are known, as many more as it takes.

    Args:
        T_world_cam: poses, [N, 4, 4], m.
        T_world_cam_true: true ones, [N, 4, 4], m; NaN where unknown.

    Returns:
        The scale; None if the truth gives too few segments, or the camera is at rest.
    """
    # The first frame with truth at or after each multiple of √N
    ends = np.arange(0, len(T_world_cam), max(int(np.sqrt(len(T_world_cam))), 1))
    known = np.flatnonzero(np.isfinite(T_world_cam_true).all(axis=(1, 2)))
    ends = np.unique(known[np.searchsorted(known, ends[ends <= known.max(initial=-1)])])
    if len(ends) <= MIN_BLOCKS:
        return None
    # Without holes in the truth, over which the estimate may drift far
    starts = ends[:-1][np.diff(ends) <= 2.0 * np.median(np.diff(ends))]
    ends = ends[np.searchsorted(ends, starts) + 1]
    # Where the camera is at the end of a segment, in its own frame at the start, [M, 3] each
    moved, moved_true = (
        (se3.inverse(T[starts]) @ T[ends])[:, :3, 3] for T in (T_world_cam, T_world_cam_true)
    )
    estimated = np.linalg.norm(moved, axis=1)
    true = np.linalg.norm(moved_true, axis=1)
    together = float(np.sum(moved * moved_true))
    if len(true) < MIN_BLOCKS or not together > 0.0:
        return None
    # Where both are mostly noise, lengths compare the noise. The regressions of each on the other
    # enclose the scale: they are apart as far as noise decides.
    dilution = 0.5 * float(np.sum(estimated**2) / together - together / np.sum(true**2))
    # Sums instead of a mean of ratios: a segment at rest has no ratio.
    ratio = float(estimated.sum() / true.sum())
    count = len(true)
    # Standard deviation of a ratio of sums, by the scatter of the residuals of the segments.
    scatter = float(np.sum((estimated - ratio * true) ** 2)) * count / (count - 1)
    sigma = float(np.hypot(max(np.sqrt(scatter) / float(true.sum()), 1e-12), dilution))
    cure = (
        f"distances are {ratio:.4f} times the true ones. If the truth is right, divide baseline_m"
        f" by {ratio:.4f}; a focal length that is too long makes distances ahead too long, too."
    )
    return Quantity(
        "scale against the truth",
        100.0 * (ratio - 1.0),
        100.0 * sigma,
        "%",
        p_value=two_sided_p((ratio - 1.0) / sigma, count - 1),
        cure=cure,
    )


def accelerometer_scale_quantity(scale: AccelerometerScale) -> Quantity:
    """Compare the length of the path with the accelerometer."""
    cure = (
        f"the path is {scale.ratio:.4f} times as long as the accelerometer says. If that is in"
        f" m/s², divide baseline_m by {scale.ratio:.4f}; a wrong focal length does the same."
    )
    return Quantity(
        "scale against accelerometer",
        100.0 * (scale.ratio - 1.0),
        100.0 * scale.sigma,
        "%",
        p_value=scale.p_value,
        cure=cure,
    )


def gyro_quantities(
    between_ns: IntArray,
    rotation_rad: FloatArray,
    stream: ImuStream,
    *,
    calibration: ImuCalibration,
) -> tuple[list[Quantity], FloatArray]:
    """Describe mounting, unit and clock of the gyro.

    Args:
        between_ns: stamps of the two frames of K steps, [K, 2].
        rotation_rad: their rotations by the images, [K, 3], camera frame.
        stream: the samples of the IMU.
        calibration: the calibration of the IMU.

    Returns:
        The quantities, none if the samples cover too few steps, and the rotation of the IMU to the
        camera that agrees with the images, [3, 3].
    """
    check = check_gyro(between_ns, rotation_rad, stream, calibration)
    if check is None:
        return [], calibration.C_cam_imu
    # Mounting: three angles.
    regression = check.regression
    quantities = []
    for k, axis in enumerate("xyz"):
        value = float(np.rad2deg(regression.values[MOUNTING][k]))
        sigma = float(np.rad2deg(regression.sigma[MOUNTING][k]))
        cure = (
            f"the IMU is turned by {value:+.2f}° about the camera's {axis} axis, relative to"
            " T_cam_imu. Write the rotation below instead; where it is large, its inverse is the"
            " usual mistake."
        )
        p_value = regression.p_value(value, sigma)
        name = f"gyro, mounting about {axis}"
        quantities.append(Quantity(name, value, sigma, "°", p_value=p_value, cure=cure))
    # Unit: the images' rates are 1 + scale times the gyro's, which are a factor too large.
    scale = float(regression.values[SCALE])
    factor = 1.0 / (1.0 + scale) if abs(1.0 + scale) > 1e-9 else np.inf
    cure = f"its rates are {factor:.4g} times those of the images."
    if 0.7 < factor / np.rad2deg(1.0) < 1.4:
        cure += " They are in degrees per second: convert them to rad/s."
    elif factor < 0.0:
        cure += " Its axes are left-handed, or all signs are inverse: negate the rates."
    else:
        cure += " Is the gyro in rad/s, and the focal length in pixels of these images?"
    sigma = float(np.hypot(regression.sigma[SCALE], check.attenuation * (1.0 + scale)))
    p_value = regression.p_value(scale, sigma)
    unit = Quantity(
        "gyro, scale",
        100.0 * (factor - 1.0),
        100.0 * sigma * factor**2,
        "%",
        p_value=p_value,
        cure=cure,
    )
    # The lag is what has to be added to the stamps, and the offset what was taken off them.
    late_ms = -1e3 * float(regression.values[LAG])
    sigma_ms = 1e3 * float(regression.sigma[LAG])
    offset_s = calibration.time_offset_s + 1e-3 * late_ms
    cure = (
        f"its stamps are {late_ms:+.1f} ms late relative to those of the images. Set time_offset_s"
        f" (Kalibr: timeshift_cam_imu) to {offset_s:.4f}."
    )
    p_value = regression.p_value(late_ms, sigma_ms)
    clock = Quantity("IMU's clock is late", late_ms, sigma_ms, "ms", p_value=p_value, cure=cure)
    return [*quantities, unit, clock], check.C_cam_imu


def gravity_quantity(
    stamps_ns: IntArray,
    T_world_cam: FloatArray,
    is_ok: BoolArray,
    *,
    stream: ImuStream,
    T_cam_imu: FloatArray,
    bias_sigma_m_s2: float,
) -> Quantity | None:
    """Compare the mean specific force, less the mean acceleration by the images, with gravity.

    In the axes of the world, vibrations average out, and the acceleration is the change of the
    velocity. Each fifth of the recording with solved steps only gives a length.

    Args:
        stamps_ns: stamps of N frames, [N].
        T_world_cam: poses by images, [N, 4, 4], m.
        is_ok: whether each step was solved, [N − 1].
        stream: the samples of the IMU, on the clock of the images.
        T_cam_imu: pose of the IMU on the camera, as the images have it, [4, 4], m.
        bias_sigma_m_s2: standard deviation of the accelerometer's bias.

    Returns:
        The quantity; None without an accelerometer, or with fewer than three such parts.
    """
    parts = [
        _mean_force_m_s2(stamps_ns[part], T_world_cam[part] @ T_cam_imu, stream)
        for part in np.array_split(np.arange(len(stamps_ns)), NUM_PARTS)
        if len(part) > 2 and is_ok[part[0] : part[-1]].all()
    ]
    lengths = [np.linalg.norm(force) for force in parts if force is not None]
    if len(lengths) < MIN_PARTS:
        return None
    length = float(np.mean(lengths))
    # Three independent errors: the bias, gravity at this place, and the scatter of the mean.
    scatter = float(np.std(lengths, ddof=1)) / np.sqrt(len(lengths))
    sigma = float(np.hypot(np.hypot(bias_sigma_m_s2, GRAVITY_SIGMA_M_S2), scatter))
    # Only the scatter is estimated; the others are known. The sum has the degrees of freedom of
    # Welch and Satterthwaite, those of the scatter times (σ/scatter)⁴.
    dof = (len(lengths) - 1) * min((sigma / max(scatter, 1e-9)) ** 4, MAX_DOF)
    cure = (
        "the mean specific force, less the mean acceleration by the images, is"
        f" {length:.3g} m/s² long. "
    )
    if length < 2.0:
        cure += "It is in g: multiply by 9.81. Near zero, gravity has been taken off it."
    else:
        cure += "Is it in m/s², and is each axis scaled alike?"
    value = length - GRAVITY_M_S2
    p_value = two_sided_p(value / sigma, dof)
    return Quantity("accelerometer, gravity", value, sigma, "m/s²", p_value=p_value, cure=cure)


def _mean_force_m_s2(
    stamps_ns: IntArray, T_world_imu: FloatArray, stream: ImuStream
) -> FloatArray | None:
    """Return the mean specific force over K frames less the mean acceleration, [3], m/s².

    Args:
        stamps_ns: stamps of the frames, [K], K > 2.
        T_world_imu: poses of the IMU by images, [K, 4, 4], m.
        stream: the samples of the IMU.

    Returns:
        It is in the axes of the world; None if there are hardly any samples.
    """
    time_s = 1e-9 * (stamps_ns - stamps_ns[0])
    sample_s = 1e-9 * (stream.stamps_ns - stamps_ns[0])
    # From the middle of the first step to the middle of the last, where mean velocities equal the
    # momentary ones.
    middle_s = 0.5 * (time_s[1:] + time_s[:-1])
    is_inside = (sample_s >= middle_s[0]) & (sample_s <= middle_s[-1])
    is_inside &= np.isfinite(stream.accel_m_s2).all(axis=1)
    if is_inside.sum() < len(middle_s) - 1:
        return None
    attitude = RotationSpline(time_s, Rotation.from_matrix(T_world_imu[:, :3, :3]))
    force = attitude(sample_s[is_inside]).apply(stream.accel_m_s2[is_inside])
    velocity = np.diff(T_world_imu[:, :3, 3], axis=0) / np.diff(time_s)[:, None]
    acceleration = (velocity[-1] - velocity[0]) / (middle_s[-1] - middle_s[0])
    return np.asarray(force.mean(axis=0) - acceleration)


def _edges(camera: StereoCamera, frames: list[RowSamples]) -> tuple[float, float]:
    """Return x and y of the farthest edges of the image, or of the matches where it has no size."""
    pixels = np.concatenate([frame.pixels for frame in frames])
    width_px, height_px = camera.size_px or (pixels[:, 0].max(), pixels[:, 1].max())
    x_edge = max(camera.cu_px, width_px - camera.cu_px) / camera.fu_px
    y_edge = max(camera.cv_px, height_px - camera.cv_px) / camera.fv_px
    return float(x_edge), float(y_edge)

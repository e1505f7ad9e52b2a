"""A recording in words, for the head of the report and for ``probevo info``."""

from __future__ import annotations

import math

import cv2
import numpy as np

from probevo import __version__
from probevo.arrays import FloatArray, IntArray
from probevo.camera.exposure_delay import is_noticeable
from probevo.camera.focal_length import FocalLengthError
from probevo.camera.stereo import StereoCamera
from probevo.evaluation.ground_height import GroundHeight
from probevo.evaluation.trajectory_errors import path_length
from probevo.measurements.imu_reason import ImuFault
from probevo.output.domain_warning import domain_text
from probevo.output.imu_calibration_text import imu_calibration_text
from probevo.output.run_result import STEPS_WITHOUT_IMU, RunResult
from probevo.output.table import readable
from probevo.run_config import RunConfig
from probevo.sequences import GroundTruth, Sequence
from probevo.sequences.masked import MaskedRecording
from probevo.sequences.without_imu import WithoutImu

NOTICEABLE_RATIO = 0.1
"""Share by which σ has to differ from that of the noise model to be worth a number."""


def run_facts(sequence: Sequence, config: RunConfig, result: RunResult) -> dict[str, str]:
    """Describe a run, by the names of its facts."""
    facts = {
        "Recording": str(sequence.path),
        "Format": sequence.format,
        "Frames": frames_text(result.stamps_ns, len(sequence)),
        "Camera": camera_text(sequence.camera),
        "IMU": imu_use_text(
            sequence, config, left_out=result.imu_left_out, unused_from=result.imu_unused_from
        ),
        "Truth": truth_text(sequence.truth, len(result)),
    }
    recording = sequence.frames if isinstance(sequence, WithoutImu) else sequence
    if isinstance(recording, MaskedRecording):
        facts["Masks"] = mask_text(recording)
    facts["Noise model"] = config.noise
    # What the run has found out about noise, rig, IMU and scale.
    if result.noise_factor is not None and (result.noise_factor != 1.0).any():
        facts["Noise of the features"] = feature_noise_text(result.noise_factor)
    if result.jitter_sigma_rad is not None:
        offset_px = sequence.camera.fu_px * float(result.jitter_sigma_rad[1])
        facts["Rig"] = (
            f"the right camera {jitter_text(result.jitter_sigma_rad)}, which moves all disparities"
            f" of a frame by σ = {readable(offset_px)} px"
        )
    # The right images of other frames seem to be late by less than a frame, which is a fault.
    if is_noticeable(result.right_delay_s) and result.right_late_frames == 0:
        facts["Exposures"] = delay_text(result.right_delay_s)
    if result.readout_s != 0.0:
        facts["Shutter"] = readout_text(result.readout_s)
    if result.focal_length is not None and len(result) > 1:
        facts["Focal length"] = focal_text(result.focal_length)
    if result.imu_noise_factor is not None:
        facts["Noise of the IMU"] = imu_noise_text(result.imu_noise_factor)
    if result.imu_calibration_errors is not None:
        facts["Calibration of the IMU"] = imu_calibration_text(result.imu_calibration_errors)
    if result.out_of_domain is not None:
        facts["Out of its domain"] = domain_text(result.out_of_domain)
    scale = result.accelerometer_scale
    if scale is not None:
        facts["Scale"] = f"{scale.ratio:.3f} ± {scale.sigma:.3f} of that by the accelerometer"
    if result.ground_height is not None:
        facts["Height above the ground"] = height_text(result.ground_height)
    for name, use in result.sensors.items():
        facts[f"Sensor {name}"] = str(use)
    facts["OpenCV threads"] = str(cv2.getNumThreads())
    facts["probevo"] = __version__
    return facts


def height_text(height: GroundHeight) -> str:
    """Describe the height of the camera above the ground."""
    known = "" if height.known_m is None else f"; {height.known_m:g} m by --camera-height-m"
    return f"{height.height_m:.3f} ± {height.sigma_m:.3f} m by the images{known}"


def mask_text(recording: MaskedRecording) -> str:
    """Describe the masks of a recording by the share of the first image that is not masked."""
    texts = []
    for side, masks in (("left", recording.left_masks), ("right", recording.right_masks)):
        if masks is not None:
            share = float(np.mean(masks.of_frame(0) > 0))
            kind = "" if masks.is_fixed else ", another one for each frame"
            texts.append(f"{side}: features in {100.0 * share:.0f} % of the image{kind}")
    return "; ".join(texts)


def frames_text(stamps_ns: IntArray, recorded: int | None = None) -> str:
    """Describe frames by their number, duration and rate.

    Args:
        stamps_ns: their times, [N].
        recorded: number of frames of the recording, of which these are the first N.
    """
    total = "" if recorded in (None, len(stamps_ns)) else f" of {recorded:,}"
    seconds = float(stamps_ns[-1] - stamps_ns[0]) * 1e-9
    if len(stamps_ns) < 2:
        return "1"
    return (
        f"{len(stamps_ns):,}{total} in {seconds:.1f} s"
        f" ({1e9 / float(np.median(np.diff(stamps_ns))):.2f} Hz)"
    )


def camera_text(camera: StereoCamera) -> str:
    """Describe a camera by its resolution, focal length, baseline and field of view, and by what
    its calibration says of the shutter."""
    text = f"f {camera.fu_px:.1f} px, baseline {camera.baseline_m:.4f} m"
    if camera.size_px is not None:
        width, height = camera.size_px
        text = f"{width}×{height} px, {text}, {field_of_view_deg(camera):.0f}° wide"
    if camera.readout_s:
        text += f", rows exposed within {1e3 * camera.readout_s:.1f} ms"
    return text


def field_of_view_deg(camera: StereoCamera) -> float:
    """Compute the horizontal field of view; NaN where the image size is not known."""
    width_px = camera.size_px[0] if camera.size_px else math.nan
    return math.degrees(
        math.atan(camera.cu_px / camera.fu_px) + math.atan((width_px - camera.cu_px) / camera.fu_px)
    )


def unused_imu_text(result: RunResult) -> str:
    """Return in how many steps the window did not use its IMU, and why; empty if it always did."""
    num_unused = result.unusable.get(STEPS_WITHOUT_IMU, 0)
    if not num_unused:
        return ""
    fault_counts = [
        (result.unusable.get(f"{STEPS_WITHOUT_IMU}_{fault.value}", 0), fault) for fault in ImuFault
    ]
    most_first = sorted(fault_counts, key=lambda counted: -counted[0])
    reasons = [f"{count} {fault.value.replace('_', ' ')}" for count, fault in most_first if count]
    return f"not used in {num_unused} of {len(result) - 1} steps ({', '.join(reasons)})"


def jitter_text(sigma_rad: FloatArray) -> str:
    """Describe the jitter of the rig: σ of the right camera's pitch, yaw and roll, [3]."""
    pitch, yaw, roll = (readable(math.degrees(angle)) for angle in sigma_rad)
    return (
        f"jitters relative to the left one by σ = {pitch}° in pitch, {yaw}° in yaw, {roll}° in roll"
        " a frame"
    )


def delay_text(delay_s: float) -> str:
    """Describe the exposure delay of the right camera, s."""
    late = "later" if delay_s > 0.0 else "earlier"
    return (
        f"right images are exposed {1e3 * abs(delay_s):.1f} ms {late} than left ones, which is"
        " corrected"
    )


def readout_text(readout_s: float) -> str:
    """Describe the readout time of a rolling shutter, s."""
    order = "first to the last" if readout_s > 0.0 else "last to the first"
    return (
        f"the shutter rolls: the rows of an image are exposed within {1e3 * abs(readout_s):.0f} ms,"
        f" from the {order}, which is corrected"
    )


def focal_text(error: FocalLengthError) -> str:
    """Describe the error of the focal length, or how well it is determined."""
    sigma = readable(100.0 * error.sigma)
    if not error.is_noticeable:
        return (
            f"as calibrated, within what is noticed: turns of the camera show a difference of"
            f" {error.percent:+.2f} ± {sigma} %"
        )
    longer = "longer" if error.percent > 0.0 else "shorter"
    return (
        f"where the camera turns, images show one that is {readable(abs(error.percent))} %"
        f" {longer} than calibrated (σ = {sigma} %): it is wrong, or lens distortion remains"
    )


def feature_noise_text(noise_factor: FloatArray) -> str:
    """Describe the size of the features' errors against their noise model, by the factors of its
    variances in the N-1 steps."""
    ratio = np.sqrt(np.median(noise_factor))
    if abs(ratio - 1.0) < NOTICEABLE_RATIO:
        return "as the noise model says"
    return (
        f"{ratio:.2f} times as large as the noise model says (σ, median of the steps), which is"
        " taken into account"
    )


def imu_noise_text(noise_factor: float) -> str:
    """Describe the noise of the IMU that the window assumes, by the factor of its variances."""
    ratio = math.sqrt(noise_factor)
    if ratio < 1.1:
        return "as calibrated, as far as the images show it"
    return f"{ratio:.1f} times as large as calibrated (σ), which is taken into account"


def imu_use_text(
    sequence: Sequence,
    config: RunConfig,
    *,
    left_out: str | None = None,
    unused_from: int | None = None,
) -> str:
    """Describe whether there is an IMU, and what it is used for.

    Args:
        sequence: the recording.
        config: settings of a run.
        left_out: why the window did not use it in the end; None if it did, or before a run.
        unused_from: index of the first frame after it last did; None if it never did.
    """
    if not config.imu:
        return "left out"
    if sequence.imu is None:
        return "none"
    uses = ["to start the tracking", "for dead reckoning where the camera is blind"]
    if config.gyro.prefilter_deg:
        uses.append("to reject features")
    if config.ransac.rotation_from == "gyro":
        uses.append("in RANSAC")
    if config.gyro.prior:
        uses.append("in the solve")
    gyro = f"gyro {', '.join(uses)}"
    if config.estimator == "window" and config.window.imu == "auto":
        if left_out:
            start = "" if unused_from is None else f" from frame {unused_from} on"
            return f"not used in the window{start}: it {left_out}; {gyro}"
        return f"in the window, once it agrees with the images; {gyro}"
    return gyro


def truth_text(truth: GroundTruth | None, num_frames: int | None = None) -> str:
    """Count the frames, of the first ``num_frames``, with a true pose; and measure their path."""
    if truth is None:
        return "none"
    known = truth.known[:num_frames]
    return (
        f"{known.sum():,} of {len(known):,} frames,"
        f" {path_length(truth.T_world_cam[:num_frames][known]):.1f} m"
    )

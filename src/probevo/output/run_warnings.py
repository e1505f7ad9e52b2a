"""Warnings about a run, in words."""

from __future__ import annotations

import numpy as np

from probevo.arrays import BoolArray, FloatArray, IntArray
from probevo.camera.focal_length import FocalLengthError
from probevo.estimation.motion_estimate import Status
from probevo.estimation.noise_scale import SCATTER
from probevo.evaluation.accelerometer_scale import AccelerometerScale
from probevo.evaluation.ground_height import GroundHeight
from probevo.geometry import se3
from probevo.measurements.imu_reason import ImuFault
from probevo.output.domain_warning import domain_warning
from probevo.output.imu_calibration_text import imu_calibration_warning
from probevo.output.run_result import RunResult
from probevo.sequences.missing_data import Defect
from probevo.tracking.fixed_features import MIN_SHIFT_PX, STILL_PX, FixedFeatures, StepsAtRest
from probevo.tracking.left_right import MIN_MATCHES
from probevo.tracking.tracks import OTHER_ROW

MAX_REPEATED = 0.1
"""Share of frames with repeated images that brings a warning."""
MIN_OK = 0.5
"""Share of steps that have to be OK for a run to be usable."""
MAX_UNSOLVED = 0.1
"""Share of steps without a solve that brings a warning."""
MAX_SCALE_ERROR = 0.04
"""Largest plausible error of the scale; a calibrated baseline is good to 1 %."""
MAX_ACCELEROMETER_ERROR = 0.03
"""Largest plausible error of the scale by the accelerometer, whose own scale is good to 1 %."""
MAX_HEIGHT_ERROR = 0.03
"""Largest plausible error of the scale by a known height: a load lowers a car by some 2 cm."""
MAX_MOTION_ERROR = 0.25
"""Error of motions, as a share of their length, beyond which the truth may be that of another
recording."""
MIN_MOTION_M = 0.2
"""Length of the motions that are compared with the truth, which may be wrong by some 5 cm, m."""
MAX_AT_REST = 0.5
"""Share of steps at rest above which moving features bring a warning; a vehicle that waits for
crossing traffic moves most of the time."""
MIN_FOR_SCALE = 5
"""Minimum number of steps for the scale."""
SCALE_SIGMAS = 3.0
"""Standard errors of the scale beyond which it is wrong by more than noise explains."""
ROW_SIGMAS = 3.0
"""Errors of the rows, in standard deviations of their prior, that no rectification leaves. Those of
KITTI, the largest of the recordings here, are 2.0 to 2.3."""
NOISE_SIGMAS = 2.0
"""Standard deviations between recordings by which the size of their errors no longer differs by
chance."""
MAX_FIXED = 0.01
"""Share of features at rest, among those that should have moved, that is no longer due to chance.
Without a part of the vehicle in view, it is 0.0001 at most on KITTI, Karlsruhe and EuRoC; before a
camera at rest, 0.0004 of the features move."""
_CAUSES = {
    Status.DEGENERATE: "features that are all far away or few, or a wrong baseline or focal length",
    Status.TOO_FEW_TRACKS: (
        "dark, blurred, featureless or repeated images, a pair that is not rectified, not"
        " simultaneous or not exposed alike, or images of more than two megapixels (scale these"
        " down: --resized)"
    ),
    Status.NOT_CONVERGED: (
        "stamps or an IMU in wrong units, a wrong calibration, or frames out of order"
    ),
    Status.GAP: "missing frames, or wrong stamps",
    Status.RECOVERED: "dark, blurred or frozen images between usable ones",
}


def run_warnings(result: RunResult, truth: FloatArray | None = None) -> dict[str, str]:
    """Return heading and text of each warning; ``truth`` is as in ``scale_warning``."""
    stopped = None
    if result.stopped:
        stopped = f"After {len(result):,} frames: {result.stopped}"
    num_repeated = result.unusable.get(Defect.REPEATED_IMAGES.value, 0)
    warnings = {
        "Stopped before the end": stopped,
        "Few steps are OK": status_warning(result.status),
        "Some steps are not solved": unsolved_warning(result.status),
        "Images repeat": repetition_warning(num_repeated, len(result)),
        "Left and right images of different frames": timing_warning(result.right_late_frames),
        "Interlaced images": interlacing_warning(result.is_interlaced),
        "Rows of left and right images differ": rows_warning(result),
        "A part of the vehicle in view": fixed_warning(result.fixed_features),
        "At rest in a scene that moves": rest_warning(result.steps_at_rest),
        "Focal length": focal_warning(result.focal_length),
        "Noise model": camera_warning(result.other_camera),
        "Size of the noise": noise_warning(result),
        "IMU": imu_warning(
            result.imu_left_out,
            result.imu_fault,
            result.imu_unused_from,
            shutter_rolls=result.readout_s != 0.0,
        ),
        "Calibration of the IMU": imu_calibration_warning(result.imu_calibration_errors),
        "Truth": truth_warning(result.T_curr_prev, result.status == Status.OK, truth),
        "Scale": scale_warning(result, truth),
        "Scale by the accelerometer": accelerometer_warning(result.accelerometer_scale),
        "Scale by the camera's height": height_warning(result.ground_height),
        "Out of domain": domain_warning(result.out_of_domain),
        "A sensor is faulty": sensor_warning(result),
    }
    return {heading: text for heading, text in warnings.items() if text}


def status_warning(status: IntArray) -> str | None:
    """Warn if less than half of the steps, [N-1], are OK, and name the usual cause; else None."""
    num_ok = int(np.sum(status == Status.OK))
    if num_ok >= MIN_OK * len(status):
        return None
    return (
        f"Only {num_ok:,} of {len(status):,} steps are OK, and the path is not reliable."
        f" {_usual_cause(status)}"
    )


def unsolved_warning(status: IntArray) -> str | None:
    """Warn if a tenth of the steps, [N-1], are not solved, but most are OK; else None."""
    is_solved = (status == Status.OK) | (status == Status.RECOVERED)
    num_unsolved = int(np.sum(~is_solved))
    is_usable = np.sum(status == Status.OK) >= MIN_OK * len(status)
    if not is_usable or num_unsolved < max(1, MAX_UNSOLVED * len(status)):
        return None
    return (
        f"{num_unsolved:,} of {len(status):,} steps are dead-reckoned; the covariance says how"
        f" uncertain that makes them, and the path. {_usual_cause(status[~is_solved])}"
    )


def _usual_cause(status: IntArray) -> str:
    """Return which status most steps have that are not OK, and what usually causes it."""
    statuses, counts = np.unique(status[status != Status.OK], return_counts=True)
    prevailing = Status(statuses[counts.argmax()])
    return (
        f"Most that are not OK have the status {prevailing.name}, usually because of"
        f" {_CAUSES[prevailing]}: see `probevo info SEQUENCE`."
    )


def repetition_warning(num_repeated: int, num_frames: int) -> str | None:
    """Warn if the images of so many frames repeat those before that it is no chance; else None."""
    if num_repeated < max(1, MAX_REPEATED * num_frames):
        return None
    return (
        f"The images of {num_repeated:,} of {num_frames:,} frames are those of the frame before, as"
        " of a driver that hangs, or a video of a higher rate than the camera's. While the camera"
        " moves they are bridged; before that, they look like rest. Leave them out: their stamps"
        " are not those of the images."
    )


def timing_warning(right_late_frames: int) -> str | None:
    """Warn of right images that belong to other frames than the left ones (``PairTiming``)."""
    if right_late_frames == 0:
        return None
    late, other = ("right", "left") if right_late_frames > 0 else ("left", "right")
    when = "later" if right_late_frames > 0 else "earlier"
    count = abs(right_late_frames)
    frames = "one frame" if count == 1 else f"{count} frames"
    image = "image" if count == 1 else f"{count} images"
    before = "before" if count == 1 else f"{count} before"
    return (
        f"The {late} images are {frames} late: the rows of a left image agree best with those of"
        f" the right image {frames} {when}. Motions and covariances are wrong. Pair the images by"
        f" their stamps. If these tell nothing of it: leave out the first {image} of the {late}"
        f" camera, give each later one the name or place of the one {before}, and leave out the"
        f" last {image} of the {other} camera, with times and poses."
    )


def interlacing_warning(is_interlaced: bool) -> str | None:
    """Warn of images whose rows are of two times (``Interlacing``)."""
    if not is_interlaced:
        return None
    return (
        "Rows of the images are of two times: where the scene moves, a row resembles the next but"
        " one rather than the next, as in interlaced video. Motions and covariances are wrong. Take"
        " every second row of both images, from the first one on, and halve f_v and c_v."
    )


def rows_warning(result: RunResult) -> str | None:
    """Warn of a pair that is not rectified; None if it is, or if its images are of other frames.

    A large error shows in the coefficients of the rows, which the prior bounds for any rectified
    pair; a larger one than matches are looked for shows in those that look alike elsewhere.
    """
    if result.right_late_frames:
        return None
    symptoms = []
    errors = result.row_errors
    if errors is not None and errors.sigmas > ROW_SIGMAS:
        symptoms.append(
            f"Rows of right images are off by up to {errors.largest_px:.1f} px;"
            f" {errors.sigmas:.1f} standard deviations of what a rectification leaves."
        )
    num_elsewhere = result.rejected.get(OTHER_ROW, 0)
    num_tracks = int(result.num_tracks.sum())
    if num_elsewhere > max(num_tracks, MIN_MATCHES):
        symptoms.append(
            f"{num_elsewhere:,} stereo matches look alike in other rows; {num_tracks:,} were"
            " tracked in the same one."
        )
    if not symptoms:
        return None
    return (
        f"{' '.join(symptoms)} Features are lost, and the path may be off by more than its"
        " covariance says. Are the images rectified, with the calibration of these lenses and"
        " mounts, simultaneous, and exposed alike? `probevo calibrate-check SEQUENCE` shows the"
        " rows; calibrate and rectify anew."
    )


def fixed_warning(fixed: FixedFeatures | None) -> str | None:
    """Warn of features that stay where they are in both images while the camera moves; None if they
    are few."""
    if fixed is None or fixed.num_fixed < MIN_MATCHES or fixed.share < MAX_FIXED:
        return None
    u, v = fixed.center_px
    spread_u, spread_v = fixed.spread_px
    return (
        f"{fixed.num_fixed:,} of {fixed.num_moving:,} features that the motion should have moved by"
        f" {MIN_SHIFT_PX:g} px or more stayed within {STILL_PX:g} px in both images, around"
        f" (u, v) = ({u:.0f} ± {spread_u:.0f}, {v:.0f} ± {spread_v:.0f}) px of left images. A part"
        " of the vehicle seems to be in view, or something that moves along with it. It takes the"
        " place of features of the scene, and may hold the path at rest while that hardly moves."
        " Mask it: --mask-left."
    )


def rest_warning(steps: StepsAtRest | None) -> str | None:
    """Warn of a path that stands still for most of the run while features pass; else None."""
    if steps is None or steps.num_at_rest < MAX_AT_REST * max(steps.num_steps, 1):
        return None
    share = steps.num_passing / max(steps.num_features, 1)
    if steps.num_passing < MIN_MATCHES or share < MAX_FIXED:
        return None
    return (
        f"The path stands still in {steps.num_at_rest:,} of {steps.num_steps:,} steps, in which"
        f" {100.0 * share:.0f} % of the features move by {MIN_SHIFT_PX:g} px or more. If the"
        " camera moves, a part of the vehicle is in view and holds most features: mask it"
        " (--mask-left). If it rests, traffic passes, and the path is right."
    )


def focal_warning(error: FocalLengthError | None) -> str | None:
    """Warn of a focal length that the images contradict by more than a lens could; else None."""
    if error is None or not error.exceeds_lenses:
        return None
    longer = "longer" if error.percent > 0.0 else "shorter"
    return (
        f"Where the camera turns, images show a focal length that is {abs(error.percent):.1f} ±"
        f" {100.0 * error.sigma:.1f} % {longer} than calibrated, more than a lens distortion that"
        " was not removed usually explains. If it is the focal length, distances and turns are"
        " wrong by about as much. Are the intrinsics those of the rectified images, at their"
        " resolution?"
    )


def camera_warning(difference: str | None) -> str | None:
    """Warn of a noise model that was learned with another camera, if it differs in something."""
    if difference is None:
        return None
    return (
        f"Of the noise model: {difference} Its covariances may be too small or too large here:"
        " `probevo compare` it with student-t, and train one with this camera."
    )


def noise_warning(result: RunResult) -> str | None:
    """Warn of a learned noise model if the errors of the features are larger or smaller than in its
    training by more than recordings usually differ; else None."""
    if not result.noise_is_learned or result.noise_factor is None or not len(result.noise_factor):
        return None
    log_factor = float(np.median(np.log(result.noise_factor)))
    if abs(log_factor) < NOISE_SIGMAS * SCATTER:
        return None
    return (
        f"The errors of the features are {np.exp(0.5 * log_factor):.2g} times as large (σ) as where"
        " the noise model was learned. That is taken into account, but how features compare may"
        " differ as well: `probevo compare` it with student-t, and train one on such recordings."
    )


def imu_warning(
    reason: str | None,
    fault: ImuFault | None = None,
    unused_from: int | None = None,
    *,
    shutter_rolls: bool = False,
) -> str | None:
    """Warn if the window left out the IMU at the end of the run, unless nothing was wrong with it,
    as in a run that ends before it is tested; else None.

    Args:
        reason: why, a phrase that continues "the IMU …".
        fault: what kind of reason it is, if that is known.
        unused_from: index of the first frame after it was last used; None if it never was.
        shutter_rolls: whether the readout of a rolling shutter was corrected.
    """
    if not reason or fault is ImuFault.TESTING:
        return None
    start = "The" if unused_from is None else f"From frame {unused_from} on, the"
    text = f"The IMU {reason}. {start} path is by images alone."
    if fault is not None and fault.is_of_samples:
        return text
    if shutter_rolls:
        text += (
            " The IMU may be right: the shutter rolls, and images contradict it until that is"
            " noticed, or where the rig is swung. A readout_s in calib.yaml is corrected from the"
            " start."
        )
    return (
        f"{text} `probevo calibrate-check SEQUENCE` says whether its unit, mounting or clock is"
        " wrong."
    )


def accelerometer_warning(scale: AccelerometerScale | None) -> str | None:
    """Warn if the path is longer or shorter than the accelerometer says; else None."""
    if scale is None:
        return None
    off = abs(scale.ratio - 1.0)
    if off < MAX_ACCELEROMETER_ERROR or off <= SCALE_SIGMAS * scale.sigma:
        return None
    return (
        f"The path is {scale.ratio:.3f} ± {scale.sigma:.3f} times as long as the accelerometer"
        f" says. If that is in m/s², divide baseline_m by {scale.ratio:.3f}; a wrong focal length"
        " does the same."
    )


def height_warning(height: GroundHeight | None) -> str | None:
    """Warn if the camera is higher or lower above the ground than is known; else None."""
    if height is None or height.known_m is None or height.ratio is None:
        return None
    off = abs(height.ratio - 1.0)
    if off < MAX_HEIGHT_ERROR or off * height.known_m <= SCALE_SIGMAS * height.sigma_m:
        return None
    return (
        f"The camera is {height.height_m:.3f} ± {height.sigma_m:.3f} m above the ground by the"
        f" images, {height.known_m:g} m by --camera-height-m. If that is right, divide baseline_m"
        f" by {height.ratio:.3f}: the whole path is wrong by this factor."
    )


def sensor_warning(result: RunResult) -> str | None:
    """Name the sensors that were found to be faulty, and why; None if there are none."""
    texts = [
        f"{name} is excluded from frame {use.excluded_at} on: {use.reason}."
        for name, use in result.sensors.items()
        if use.excluded_at is not None
    ]
    if not texts:
        return None
    return " ".join(texts) + " The path does not use it. Is its mounting correct?"


def truth_warning(
    T_curr_prev: FloatArray, is_ok: BoolArray, truth: FloatArray | None
) -> str | None:
    """Warn if the motions have little to do with the true ones, whatever their scale; else None.

    They are motions between frames whose true poses are known: from one to the next, or over as
    many as it takes to move farther than a coarse truth may be wrong.

    Args:
        T_curr_prev: motions of N-1 steps, [N-1, 4, 4], m.
        is_ok: which of these steps are OK, [N-1]; only those count.
        truth: true poses T_world_cam of the frames, [N, 4, 4], m; NaN where unknown.
    """
    if truth is None:
        return None
    known = _known_frames(truth)
    T_world_cam = se3.chain_motions(T_curr_prev)[known]
    truth = truth[known]
    apart = 1
    while True:
        is_counted = _are_all_ok(is_ok, known, apart)
        if is_counted.sum() < MIN_FOR_SCALE:
            return None
        true_m = _displacements(truth, apart)[is_counted]
        length_m = float(np.median(np.linalg.norm(true_m, axis=1)))
        if length_m >= MIN_MOTION_M:
            break
        apart *= 2
    motions_m = _displacements(T_world_cam, apart)[is_counted]
    off_m = _misfit(motions_m, true_m)
    if off_m <= MAX_MOTION_ERROR * length_m:
        return None
    num_steps = int(np.median((known[apart:] - known[:-apart])[is_counted]))
    which = "The steps are" if num_steps == 1 else f"Motions over {num_steps} steps are"
    text = (
        f"{which} off the true ones by {off_m:.2g} m in the median, whatever their scale, where a"
        f" true one is {length_m:.2g} m long."
    )
    inverse_m = _displacements(se3.inverse(truth), apart)[is_counted]
    length_m = float(np.median(np.linalg.norm(inverse_m, axis=1)))
    if _misfit(motions_m, inverse_m) <= MAX_MOTION_ERROR * length_m:
        return f"{text} They fit the inverse poses: is the truth T_cam_world, not T_world_cam?"
    return f"{text} Is it the truth of this recording, with poses T_world_cam of the camera?"


def _known_frames(truth: FloatArray) -> IntArray:
    """Return the places of the frames, of N, whose true poses, [N, 4, 4], are known, [M]."""
    return np.flatnonzero(np.isfinite(truth).all(axis=(1, 2)))


def _displacements(T_world_cam: FloatArray, apart: int) -> FloatArray:
    """Return the translations of the motions from each of M poses, [M, 4, 4], to the one that many
    places further on, [M - apart, 3], m."""
    T_end_start = se3.inverse(T_world_cam[apart:]) @ T_world_cam[:-apart]
    return T_end_start[:, :3, 3]


def _are_all_ok(is_ok: BoolArray, frames: IntArray, apart: int) -> BoolArray:
    """Return whether all steps, of N-1, are OK from each of M frames to the one that many places
    further on, [M - apart]."""
    num_bad = np.concatenate([[0], np.cumsum(~is_ok)])[frames]
    return np.asarray(num_bad[apart:] == num_bad[:-apart])


def _misfit(motions_m: FloatArray, true_m: FloatArray) -> float:
    """Return by how much motions, [K, 3], are off the true ones, [K, 3], in the median, at the
    scale that fits most of them, m."""
    squared_m2 = np.sum(motions_m * motions_m, axis=1).clip(1e-12)
    # A scale below zero would fit a path that is driven backwards.
    scale = max(float(np.median(np.sum(motions_m * true_m, axis=1) / squared_m2)), 0.0)
    return float(np.median(np.linalg.norm(scale * motions_m - true_m, axis=1)))


def scale_warning(result: RunResult, truth: FloatArray | None) -> str | None:
    """Warn if the steps are longer or shorter than the true ones as a whole; else None.

    A wrong baseline causes that, and the covariances do not contain it. Where some true poses are
    unknown, the motions between the known ones are compared.

    Args:
        result: a run over N frames.
        truth: true poses T_world_cam of the frames, [N, 4, 4], m; NaN where unknown.
    """
    if truth is None or len(result) < 2:
        return None
    return step_length_warning(result.T_curr_prev, result.status == Status.OK, truth)


def step_length_warning(T_curr_prev: FloatArray, is_ok: BoolArray, truth: FloatArray) -> str | None:
    """Warn if N-1 steps, [N-1, 4, 4], of which some are OK, [N-1], are longer or shorter than the
    true ones as a whole; else None."""
    known = _known_frames(truth)
    is_counted = _are_all_ok(is_ok, known, 1)
    if is_counted.sum() < MIN_FOR_SCALE:
        return None
    true_m = _displacements(truth[known], 1)[is_counted]
    steps_m = _displacements(se3.chain_motions(T_curr_prev)[known], 1)[is_counted]
    # Noise in what is projected on makes a projection too short: that of the steps where the truth
    # is noisy, as it is beside a camera at rest, and that of the truth where the steps are. The
    # scale is between the one and the inverse of the other.
    errors = np.array([_ratio(steps_m, true_m), 1.0 / _ratio(true_m, steps_m)]) - 1.0
    if not errors[0] * errors[1] > 0.0:
        return None
    scale = 1.0 + float(errors[np.argmin(np.abs(errors))])
    if abs(scale - 1.0) <= MAX_SCALE_ERROR:
        return None
    return (
        f"The steps are {scale:.3g} times as long as the true ones. Are the baseline and the truth"
        " in metres, and of this camera?"
    )


def _ratio(steps_m: FloatArray, others_m: FloatArray) -> float:
    """Return the median length of steps, [K, 3], projected on the longer half of others, as a share
    of these; NaN if noise may be why it is not 1."""
    squared_m2 = np.sum(others_m * others_m, axis=1)
    is_long = squared_m2 >= np.median(squared_m2)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = np.sum(steps_m * others_m, axis=1)[is_long] / squared_m2[is_long]
    median = float(np.median(ratios))
    # 1.4826 times the median of absolute values is the σ of a Gaussian, 1.2533 times the standard
    # error of a mean that of a median.
    scatter = 1.4826 * float(np.median(np.abs(ratios - median)))
    standard_error = 1.2533 * scatter / len(ratios) ** 0.5
    is_certain = median > 0.0 and abs(median - 1.0) > SCALE_SIGMAS * standard_error
    return median if is_certain else np.nan

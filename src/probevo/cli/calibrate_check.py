"""``probevo calibrate-check``: check a calibration against the images and the IMU of a
recording."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import islice, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import tyro

from probevo.cli.arguments import checked, parse
from probevo.cli.text import table
from probevo.errors import InputError
from probevo.run_config import ReadSettings

if TYPE_CHECKING:
    from probevo.arrays import BoolArray, FloatArray, IntArray
    from probevo.camera.rig_calibration import RigCalibration
    from probevo.camera.stereo import StereoCamera
    from probevo.evaluation.calibration_quantities import Quantity
    from probevo.evaluation.ground_height import GroundHeight
    from probevo.evaluation.row_check import RowSamples
    from probevo.odometry import StereoOdometry
    from probevo.sequences import Sequence

MAX_FRAMES = 300
MIN_FRAMES = 12
NOTICEABLE_PX = 0.05
"""What the lenses' distortion has to leave to be mentioned."""
FALSE_ALARMS = 0.01
"""Share of flawless recordings of which any quantity is marked."""


@dataclass(frozen=True)
class CalibrateCheckArguments:
    """Says what a recording itself tells of its calibration: of rows and disparity of the rectified
    pair, of the delay of its right image, of the scale if the truth is known, and of the IMU.

    Each quantity is zero for a flawless calibration, and comes with its standard deviation σ and
    z, its distance from zero in σ. Lines that start with ! are further from zero than chance would
    have it (once in a hundred flawless recordings); below the table stands how to mend them.
    """

    sequence: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="SEQUENCE")]
    """Folder of the recording, a bag, or a tracks file (.npz)."""
    max_frames: int = MAX_FRAMES
    """Frames that are looked at, from the start."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Picture of the errors to write, .png, .svg or .pdf: rows and lens distortion over the image,
    disparity over its width, and how far each quantity is from zero."""
    settings: Annotated[ReadSettings, tyro.conf.arg(name="")] = field(default_factory=ReadSettings)


def main(words: list[str]) -> None:
    """Parse the arguments, open the recording, and print what it says of its calibration."""
    arguments = parse(CalibrateCheckArguments, words, "calibrate-check")
    settings = checked(arguments.settings)
    if arguments.max_frames < MIN_FRAMES:
        what = f"is {arguments.max_frames}."
        raise InputError("--max-frames", what, f"It must be at least {MIN_FRAMES}.")
    if arguments.out is not None:
        from probevo.output.calibration_picture import check_picture_path

        check_picture_path(arguments.out)
    from probevo.cli.first_use import say_if_compiling
    from probevo.sequences import open_sequence

    sequence = open_sequence(arguments.sequence, settings.format, **settings.format_options())
    say_if_compiling()
    found = check(sequence, arguments.max_frames)
    print("\n".join(found.lines), flush=True)
    if arguments.out is not None:
        from probevo.output.calibration_picture import write_calibration_picture

        write_calibration_picture(
            arguments.out,
            found.rig,
            found.quantities,
            marked=found.marked,
            camera=sequence.camera,
            largest_z=_largest_z(len(found.quantities)),
        )
        print(f"picture: {arguments.out}", flush=True)


@dataclass(frozen=True)
class Check:
    """What a recording tells of its calibration."""

    lines: list[str]
    """The report."""
    quantities: list[Quantity]
    marked: list[Quantity]
    """Those that are further from zero than chance would have it."""
    rig: RigCalibration
    """The self-calibration at the end."""


def check(sequence: Sequence, max_frames: int) -> Check:
    """Check the calibration of a recording.

    Raises:
        InputError: the recording is too short or too poor in features to say anything, or faulty.
    """
    from probevo.camera.distortion_field import root_mean_square_px
    from probevo.evaluation.accelerometer_scale import accelerometer_scale
    from probevo.evaluation.calibration_quantities import (
        SELF_CALIBRATED,
        accelerometer_scale_quantity,
        gravity_quantity,
        gyro_quantities,
        rig_quantities,
        row_quantities,
        scale_quantity,
    )

    seen = _look(sequence, max_frames)
    camera = sequence.camera
    quantities = row_quantities(seen.rows, camera) + rig_quantities(seen.rig, camera)
    num_frames = len(seen.T_world_cam)
    lines = [f"recording: {sequence.path}, {num_frames} frames, {len(seen.rotation_rad)} solved"]
    notes = []
    if sequence.truth is not None:
        known = sequence.truth.T_world_cam[: len(seen.T_world_cam)]
        found = scale_quantity(seen.T_world_cam, known)
        if found is not None:
            quantities.append(found)
    stream = getattr(sequence, "imu_stream", None)
    if sequence.imu is None or stream is None:
        notes.append("IMU: none whose samples are read at their own rate.")
    else:
        gyro, C_cam_imu = gyro_quantities(
            seen.between_ns, seen.rotation_rad, stream, calibration=sequence.imu
        )
        quantities += gyro
        T_cam_imu = sequence.imu.T_cam_imu.copy()
        T_cam_imu[:3, :3] = C_cam_imu
        gravity = gravity_quantity(
            sequence.stamps_ns[:num_frames],
            seen.T_world_cam,
            seen.is_ok,
            stream=stream,
            T_cam_imu=T_cam_imu,
            bias_sigma_m_s2=sequence.imu.accel_bias_sigma_m_s2,
        )
        if gravity is not None:
            quantities.append(gravity)
        scale = accelerometer_scale(
            sequence.stamps_ns[:num_frames],
            seen.T_world_cam,
            seen.is_ok,
            stream=stream,
            calibration=sequence.imu,
        )
        if scale is not None:
            quantities.append(accelerometer_scale_quantity(scale))
        if not gyro:
            notes.append("IMU: its samples cover too few solved steps.")
        elif any(_is_marked(quantity, len(quantities)) for quantity in gyro[:3]):
            matrix = "; ".join(" ".join(f"{value:+.6f}" for value in row) for row in C_cam_imu)
            notes.append(f"The rotation in T_cam_imu that agrees with the images: {matrix}.")
    common_px, disparity_px = root_mean_square_px(seen.rig.image.distortion)
    if max(common_px, disparity_px) > NOTICEABLE_PX:
        notes.append(
            f"Lenses: they move both views of a point by {common_px:.2f} px, and disparities by"
            f" {disparity_px:.2f} px beyond the bend above (rms over the image). This is corrected."
        )
    if not any(quantity.name.startswith("scale") for quantity in quantities):
        notes.append("Scale: neither true poses nor an accelerometer tell it.")
    if seen.height is not None:
        notes.append(
            f"Height: the left camera is {seen.height.height_m:.3f} ± {seen.height.sigma_m:.3f} m"
            " above the ground that it drives over. Measure it: if that is wrong, baseline_m is"
            " wrong by the same factor."
        )
    marked = [quantity for quantity in quantities if _is_marked(quantity, len(quantities))]
    cells = [quantity.texts(is_marked=quantity in marked) for quantity in quantities]
    lines += ["", *table(("quantity", "value", "σ", "unit", "z"), cells).splitlines(), ""]
    lines += [f"! {quantity.name}: {quantity.cure}" for quantity in marked]
    if any(quantity.name.startswith(("rows", "disparity")) for quantity in marked):
        lines.append(SELF_CALIBRATED)
    if not marked:
        lines.append("Nothing is further from zero than chance would have it.")
    return Check(lines + notes, quantities, marked=marked, rig=seen.rig)


def _is_marked(quantity: Quantity, count: int) -> bool:
    """Return whether a quantity is significantly different from zero, given ``count``
    quantities."""
    return quantity.p_value < FALSE_ALARMS / count


def _largest_z(count: int) -> float:
    """Return how far from zero, in σ, chance may take any of ``count`` quantities."""
    from scipy.stats import norm

    return float(norm.isf(0.5 * FALSE_ALARMS / count))


@dataclass(frozen=True)
class _Seen:
    """The results of an odometry without IMU over N frames, K of them solved."""

    rows: list[RowSamples]
    """The stereo matches of each frame with a solved step before and after it."""
    rig: RigCalibration
    """Its self-calibration at the end."""
    T_world_cam: FloatArray
    """Poses, [N, 4, 4], m."""
    is_ok: BoolArray
    """Whether each step was solved, [N − 1]."""
    between_ns: IntArray
    """Stamps of the two frames of each solved step, [K, 2]."""
    rotation_rad: FloatArray
    """Their rotations Log(C_curr_prev), [K, 3], camera frame."""
    height: GroundHeight | None
    """Height of the left camera above the ground, if it is known."""


def _look(sequence: Sequence, max_frames: int) -> _Seen:
    """Run an odometry without the IMU, and collect its results.

    Raises:
        InputError: left and right are swapped, or too few steps are solved.
    """
    import numpy as np

    from probevo.camera.rig_calibration import RigCalibration
    from probevo.estimation.motion_estimate import Status
    from probevo.evaluation.ground_height import GroundHeights
    from probevo.geometry import se3, so3
    from probevo.odometry import StereoOdometry
    from probevo.tracking.left_right import LeftRightCheck

    odometry = StereoOdometry(sequence.camera, config={"estimator": "two-frame"})
    camera = sequence.camera
    heights = GroundHeights(camera)
    motions = []
    solved = []
    left_right = LeftRightCheck(sequence.path, min(max_frames, len(sequence)))
    steps: list[_Step] = []
    prev_ns = 0
    for frame in islice(sequence, max_frames):
        motion = odometry.step(frame)
        motions.append(motion.T_curr_prev)
        solved.append(motion.status is Status.OK)
        tracks = odometry.tracks
        left_right.see(frame, tracks)
        is_used = odometry.used
        heights.add(
            frame.stamp_ns,
            motion.T_curr_prev,
            tracks.ids[is_used],
            tracks.curr_px[is_used],
            is_ok=motion.status is Status.OK,
        )
        if motion.status is Status.OK and odometry.rig is not None:
            used = tracks.curr_px[is_used]
            ids = tracks.ids[is_used]
            raw = _as_matched(odometry, ids)
            rotation_rad = so3.log(motion.T_curr_prev[:3, :3])
            between_ns = (prev_ns, frame.stamp_ns)
            steps.append(_Step(raw, used, ids, rotation_rad=rotation_rad, between_ns=between_ns))
        prev_ns = frame.stamp_ns
    rows = _row_samples(steps, camera)
    if len(motions) < MIN_FRAMES:
        what = f"it has {len(motions)} frames; {MIN_FRAMES} at least are needed."
        raise InputError(sequence.path, what, "Give a longer recording of the same rig.")
    if len(rows) < MIN_FRAMES - 2:
        what = f"only {len(steps)} of its first {len(motions)} frames have a motion that is solved."
        cure = "`probevo info` says whether the images are rectified, sharp and textured."
        raise InputError(sequence.path, what, cure)
    return _Seen(
        rows=rows,
        rig=odometry.rig or RigCalibration.initial(),
        T_world_cam=se3.chain_motions(motions[1:]),
        is_ok=np.array(solved[1:], np.bool_),
        between_ns=np.array([step.between_ns for step in steps], np.int64),
        rotation_rad=np.array([step.rotation_rad for step in steps]),
        height=heights.height(),
    )


def _as_matched(odometry: StereoOdometry, ids: IntArray) -> FloatArray:
    """Return what the last frame showed of some tracks, given their identities, [N], without any
    correction, [N, 4], px."""
    import numpy as np

    from probevo.arrays import rows_of

    if odometry.state is None:
        return np.zeros((0, 4))
    seen = odometry.state.observations.frames[-1]
    pixels: FloatArray = seen.pixels[rows_of(ids, seen.landmarks)]
    return pixels


class _Step(NamedTuple):
    """A step that was solved."""

    raw_px: FloatArray
    """Observations in its current frame as matched, [N, 4], px."""
    corrected_px: FloatArray
    """The same, corrected by the rig's calibration."""
    ids: IntArray
    """Identity of each feature, [N]."""
    rotation_rad: FloatArray
    """Log(C_curr_prev), [3], camera frame."""
    between_ns: tuple[int, int]
    """Stamps of its two frames."""

    @property
    def rate_rad_s(self) -> FloatArray:
        """Rotation per second, [3]."""
        start_ns, end_ns = self.between_ns
        return self.rotation_rad / (1e-9 * (end_ns - start_ns))


def _row_samples(steps: list[_Step], camera: StereoCamera) -> list[RowSamples]:
    """Return the matches of each frame with a solved step before and after it."""
    from probevo.evaluation.row_check import RowSamples

    return [
        RowSamples.of(
            step.raw_px,
            step.corrected_px,
            step.ids,
            rate_rad_s=0.5 * (step.rate_rad_s + after.rate_rad_s),
            camera=camera,
        )
        for step, after in pairwise(steps)
        if step.between_ns[1] == after.between_ns[0]
    ]

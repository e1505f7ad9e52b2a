"""Check of a recording's calibration by its own images, truth and IMU."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import islice, pairwise
from typing import NamedTuple

import numpy as np

from probevo.arrays import BoolArray, FloatArray, IntArray, rows_of
from probevo.camera.rig_calibration import RigCalibration
from probevo.camera.stereo import StereoCamera
from probevo.errors import InputError
from probevo.estimation.motion_estimate import Status
from probevo.evaluation.accelerometer_scale import accelerometer_scale
from probevo.evaluation.calibration_quantities import (
    Quantity,
    accelerometer_scale_quantity,
    gravity_quantity,
    gyro_quantities,
    is_marked,
    rig_quantities,
    row_quantities,
    scale_quantity,
)
from probevo.evaluation.ground_height import GroundHeight, GroundHeights
from probevo.evaluation.row_check import RowSamples
from probevo.geometry import se3, so3
from probevo.odometry import StereoOdometry
from probevo.sequences import Sequence
from probevo.sequences.base import imu_stream_of
from probevo.sequences.imu import ImuStream
from probevo.sequences.imu_calibration import ImuCalibration
from probevo.sequences.validation import usable_stream
from probevo.tracking.left_right import LeftRightCheck

MIN_FRAMES = 12


@dataclass(frozen=True)
class CalibrationCheck:
    """Results of the check of a recording's calibration."""

    num_frames: int
    num_solved: int
    quantities: list[Quantity]
    rig: RigCalibration
    """The self-calibration at the end."""
    height: GroundHeight | None
    """Height of the left camera above the ground, if it is known."""
    has_imu: bool
    """Whether there is an IMU whose samples are read at their own rate."""
    C_cam_imu: FloatArray | None
    """The rotation of the IMU to the camera that agrees with the images, [3, 3]; None if the IMU's
    samples cover too few solved steps, or without an IMU."""

    @property
    def marked(self) -> list[Quantity]:
        """Quantities that are further from zero than chance explains."""
        return [
            quantity for quantity in self.quantities if is_marked(quantity, len(self.quantities))
        ]


def check_calibration(sequence: Sequence, max_frames: int) -> CalibrationCheck:
    """Check the calibration of a recording by its first frames.

    Raises:
        InputError: the recording is too short or too poor in features to say anything, or faulty.
    """
    seen = _look(sequence, max_frames)
    num_frames = len(seen.T_world_cam)
    quantities = row_quantities(seen.rows, sequence.camera)
    quantities += rig_quantities(seen.rig, sequence.camera)
    if sequence.truth is not None:
        scale = scale_quantity(seen.T_world_cam, sequence.truth.T_world_cam[:num_frames])
        if scale is not None:
            quantities.append(scale)
    C_cam_imu = None
    stream = imu_stream_of(sequence)
    has_imu = sequence.imu is not None and stream is not None
    if sequence.imu is not None and stream is not None:
        stamps_ns = sequence.stamps_ns[:num_frames]
        usable = usable_stream(stream, stamps_ns)
        imu_quantities, C_cam_imu = _imu_quantities(seen, stamps_ns, usable, sequence.imu)
        quantities += imu_quantities
    return CalibrationCheck(
        num_frames=num_frames,
        num_solved=len(seen.rotation_rad),
        quantities=quantities,
        rig=seen.rig,
        height=seen.height,
        has_imu=has_imu,
        C_cam_imu=C_cam_imu,
    )


def _imu_quantities(
    seen: _Seen, stamps_ns: IntArray, stream: ImuStream, calibration: ImuCalibration
) -> tuple[list[Quantity], FloatArray | None]:
    """Describe gyro and accelerometer.

    Args:
        seen: the results of the odometry over N frames.
        stamps_ns: stamps of these frames, [N].
        stream: the samples of the IMU that the odometry would use.
        calibration: the calibration of the IMU.

    Returns:
        The quantities, and the rotation of the IMU to the camera that agrees with the images,
        [3, 3]; None if the samples cover too few steps.
    """
    quantities, C_cam_imu = gyro_quantities(
        seen.frame_stamps_ns, seen.rotation_rad, stream, calibration=calibration
    )
    agreeing = C_cam_imu if quantities else None
    T_cam_imu = calibration.T_cam_imu.copy()
    T_cam_imu[:3, :3] = C_cam_imu
    gravity = gravity_quantity(
        stamps_ns,
        seen.T_world_cam,
        seen.is_ok,
        stream=stream,
        T_cam_imu=T_cam_imu,
        bias_sigma_m_s2=calibration.accel_bias_sigma_m_s2,
    )
    if gravity is not None:
        quantities.append(gravity)
    scale = accelerometer_scale(
        stamps_ns,
        seen.T_world_cam,
        seen.is_ok,
        stream=stream,
        calibration=replace(calibration, T_cam_imu=T_cam_imu),
    )
    if scale is not None:
        quantities.append(accelerometer_scale_quantity(scale))
    return quantities, agreeing


@dataclass(frozen=True)
class _Seen:
    """The results of an odometry without IMU over N frames, K of them solved."""

    rows: list[RowSamples]
    """The stereo matches of each frame with a solved step before and after it."""
    rig: RigCalibration
    """Self-calibration of the odometry at the end."""
    T_world_cam: FloatArray
    """Poses, [N, 4, 4], m."""
    is_ok: BoolArray
    """Whether each step was solved, [N − 1]."""
    frame_stamps_ns: IntArray
    """Stamps of the two frames of each solved step, [K, 2]."""
    rotation_rad: FloatArray
    """Rotations Log(C_curr_prev) of the solved steps, [K, 3], camera frame."""
    height: GroundHeight | None
    """Height of the left camera above the ground, if it is known."""


def _look(sequence: Sequence, max_frames: int) -> _Seen:
    """Run an odometry without the IMU, and collect its results.

    Raises:
        InputError: left and right are swapped, or too few steps are solved.
    """
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
            frame_stamps_ns = (prev_ns, frame.stamp_ns)
            steps.append(
                _Step(raw, used, ids, rotation_rad=rotation_rad, frame_stamps_ns=frame_stamps_ns)
            )
        prev_ns = frame.stamp_ns
    rows = _row_samples(steps, camera)
    if len(motions) < MIN_FRAMES:
        what = f"it has {len(motions)} frames; {MIN_FRAMES} at least are needed."
        raise InputError(sequence.path, what, "Give a longer recording of the same rig.")
    if len(rows) < MIN_FRAMES - 2:
        what = f"only {len(steps)} of its first {len(motions)} frames have a motion that is solved."
        cure = "Are the images rectified, sharp and textured, and is baseline_m in metres?"
        raise InputError(sequence.path, what, cure)
    return _Seen(
        rows=rows,
        rig=odometry.rig or RigCalibration.initial(),
        T_world_cam=se3.chain_motions(motions[1:]),
        is_ok=np.array(solved[1:], np.bool_),
        frame_stamps_ns=np.array([step.frame_stamps_ns for step in steps], np.int64),
        rotation_rad=np.array([step.rotation_rad for step in steps]),
        height=heights.height(),
    )


def _as_matched(odometry: StereoOdometry, ids: IntArray) -> FloatArray:
    """Return what the last frame showed of some tracks, given their identities, [N], without any
    correction, [N, 4], px."""
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
    """Observations corrected by the rig's calibration, [N, 4], px."""
    ids: IntArray
    """Identity of each feature, [N]."""
    rotation_rad: FloatArray
    """Log(C_curr_prev), [3], camera frame."""
    frame_stamps_ns: tuple[int, int]
    """Stamps of its two frames."""

    @property
    def rate_rad_s(self) -> FloatArray:
        """Rotation per second, [3]."""
        start_ns, end_ns = self.frame_stamps_ns
        return self.rotation_rad / (1e-9 * (end_ns - start_ns))


def _row_samples(steps: list[_Step], camera: StereoCamera) -> list[RowSamples]:
    """Return the matches of each frame with a solved step before and after it."""
    return [
        RowSamples.of(
            step.raw_px,
            step.corrected_px,
            step.ids,
            rate_rad_s=0.5 * (step.rate_rad_s + next_step.rate_rad_s),
            camera=camera,
        )
        for step, next_step in pairwise(steps)
        if step.frame_stamps_ns[1] == next_step.frame_stamps_ns[0]
    ]

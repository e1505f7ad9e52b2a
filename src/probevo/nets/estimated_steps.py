"""Steps of an odometry on a recording, as a network sees them, with their true corrections."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import islice
from typing import NamedTuple

import numpy as np

from probevo.arrays import FloatArray, Image
from probevo.camera.stereo import StereoCamera
from probevo.config import OdometryConfig
from probevo.errors import InputError
from probevo.geometry import se3
from probevo.measurements.correction import MotionCorrection
from probevo.measurements.sensor import NoMeasurement
from probevo.nets.flow_field import flow_field, virtual_view
from probevo.nets.image_pairs import true_poses
from probevo.odometry import StereoOdometry
from probevo.sequences.base import Sequence
from probevo.sequences.frame import Frame

NUM_STEREO = 2
"""Channels of the flow from the left to the right image: disparity, and how far rows differ."""


@dataclass(frozen=True)
class EstimatedSteps:
    """N steps whose motion was solved for."""

    fields: FloatArray
    """The network's input from the images, [N, 6, rows, columns], float32 (``stereo_field``)."""
    motions: FloatArray
    """Log of the estimated T_curr_prev, [N, 6], m and rad."""
    covariances: FloatArray
    """Covariances of these motions by the odometry, [N, 6, 6]."""
    corrections: FloatArray
    """ξ* = Log(T_true T_est⁻¹), [N, 6]."""

    def __len__(self) -> int:
        """Return N."""
        return len(self.fields)


class _Asked(NamedTuple):
    """The motion of the images in a step that a correction is asked about."""

    T_curr_prev: FloatArray
    """Motion, [4, 4], m."""
    cov: FloatArray
    """Covariance of its left perturbation, [6, 6], m and rad."""


class _Recorder(MotionCorrection):
    """Notes what a correction is asked about, and corrects nothing."""

    name = "recorder"

    def __init__(self) -> None:
        self.asked: _Asked | None = None

    def correct(
        self, prev_frame: Frame, frame: Frame, T_curr_prev: FloatArray, *, cov: FloatArray
    ) -> NoMeasurement:
        """Note the motion."""
        self.asked = _Asked(T_curr_prev, cov)
        return NoMeasurement("recorded")


def stereo_field(prev: Image, left: Image, right: Image) -> FloatArray:
    """Return what a network sees of three images of the virtual camera, [6, rows, columns].

    The first four channels are ``flow_field`` from the previous to the current left image,
    the other two the flow from the left to the right one. Rows differ where the rectification is
    wrong.
    """
    return np.concatenate([flow_field(prev, left), flow_field(left, right)[:NUM_STEREO]])


def view_pair(left: Image, right: Image, camera: StereoCamera) -> tuple[Image, Image]:
    """Return what the virtual camera sees of both images, [80, 288] each.

    Raises:
        InputError: the camera's field of view is smaller than the virtual camera's.
    """
    return virtual_view(left, camera), virtual_view(right, camera)


def read_steps(
    sequence: Sequence,
    num_frames: int,
    on_frame: Callable[[int], None] | None = None,
    *,
    config: OdometryConfig,
) -> EstimatedSteps:
    """Run the odometry over a recording; return the steps that were solved, and whose truth is
    known.

    Args:
        sequence: the recording.
        num_frames: frames to read.
        on_frame: called with the number of frames done.
        config: of the odometry; its noise model is the default.

    Raises:
        InputError: it has no images or no truth, a camera that sees too little, a faulty frame, or
            no step that was solved.
    """
    T_world_cam = true_poses(sequence)
    # A correction is called after the solve, with the motion and its covariance: the recorder notes
    # both, and leaves the motion as it is.
    recorder = _Recorder()
    odometry = StereoOdometry(sequence.camera, imu=sequence.imu, config=config, sensors=[recorder])
    rows: dict[str, list[FloatArray]] = {name: [] for name in EstimatedSteps.__dataclass_fields__}
    prev_view = None
    for frame in islice(sequence, num_frames):
        if frame.left is None or frame.right is None:
            raise InputError(sequence.path, "there are no images.", "Networks need images.")
        recorder.asked = None
        odometry.step(frame)
        asked = recorder.asked
        left, right = view_pair(frame.left, frame.right, sequence.camera)
        k = frame.index
        is_known = k > 0 and np.isfinite(T_world_cam[k - 1 : k + 1]).all()
        if prev_view is not None and is_known and asked is not None:
            # T_curr_prev of the truth, and T_corr = T_true T_est⁻¹
            T_true = se3.inverse(T_world_cam[k]) @ T_world_cam[k - 1]
            rows["fields"].append(stereo_field(prev_view, left, right))
            rows["motions"].append(se3.log(asked.T_curr_prev))
            rows["covariances"].append(asked.cov)
            rows["corrections"].append(se3.log(T_true @ se3.inverse(asked.T_curr_prev)))
        prev_view = left
        if on_frame is not None:
            on_frame(k + 1)
    if not rows["fields"]:
        what = "no step was solved for whose true motion is known."
        raise InputError(sequence.path, what, "Give a recording with ground truth.")
    return EstimatedSteps(**{name: np.array(values) for name, values in rows.items()})

"""The type of a predictor, and the step of the odometry that it is computed from."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Flag, auto

import numpy as np

from probevo.arrays import FloatArray, Image
from probevo.camera.stereo import StereoCamera
from probevo.sequences.frame import Frame, ImuSamples
from probevo.tracking.last_residuals import LastResiduals
from probevo.tracking.tracks import Tracks


class Needs(Flag):
    """What a predictor needs beside the tracks, their previous residuals, and the prediction.

    The prediction is the motion by gyro and motion model, before any image is used.
    """

    TRACKS = 0
    """Nothing else."""
    LEFT = auto()
    """The current left image."""
    PREVIOUS_LEFT = auto()
    """The left image of the previous frame."""
    ACCELEROMETER = auto()
    """The specific force that the IMU measures."""
    RIGHT = auto()
    """The current right image."""
    PREVIOUS_RIGHT = auto()
    """The right image of the previous frame."""
    ALIGNMENT = auto()
    """How each window was aligned with its anchor patch; features of another front end were not."""
    IMAGES = LEFT | PREVIOUS_LEFT | RIGHT | PREVIOUS_RIGHT
    """Any image: ``predictor.needs & Needs.IMAGES`` is true if the predictor needs at least one."""


@dataclass(frozen=True)
class Step:
    """The input of predictors: all that is known about a step before its motion is estimated."""

    tracks: Tracks
    """The N features that are seen in both frames."""
    camera: StereoCamera
    """The rectified camera."""
    predicted_T_curr_prev: FloatArray
    """T_curr_prev as gyro and motion model predict it, [4, 4]."""
    prev_frame: Frame
    """The previous frame."""
    curr_frame: Frame
    """The current frame, with the IMU samples of the interval."""
    previous_residuals: LastResiduals = field(default_factory=LastResiduals.none)
    """Residuals of the previous step's features at its estimated motion, if that was solved."""

    @property
    def duration_s(self) -> float:
        """Time between the two frames."""
        return 1e-9 * (self.curr_frame.stamp_ns - self.prev_frame.stamp_ns)

    @property
    def imu(self) -> ImuSamples:
        """IMU samples of the interval; empty if they do not cover all of it."""
        if self.curr_frame.imu is not None:
            return self.curr_frame.imu
        return ImuSamples(
            stamps_ns=np.zeros(0, np.int64),
            gyro_rad_s=np.zeros((0, 3)),
            accel_m_s2=np.zeros((0, 3)),
        )

    @property
    def left(self) -> Image:
        """Left image of the current frame, [height, width]; [0, 0] without images."""
        return _image_or_empty(self.curr_frame.left)

    @property
    def right(self) -> Image:
        """Right image of the current frame, [height, width]; [0, 0] without images."""
        return _image_or_empty(self.curr_frame.right)

    @property
    def previous_left(self) -> Image:
        """Left image of the previous frame, [height, width]; [0, 0] without images."""
        return _image_or_empty(self.prev_frame.left)

    @property
    def previous_right(self) -> Image:
        """Right image of the previous frame, [height, width]; [0, 0] without images."""
        return _image_or_empty(self.prev_frame.right)

    @property
    def uv(self) -> FloatArray:
        """Features (u, v) in the current left image, [N, 2], px."""
        return self.tracks.curr_px[:, :2]

    @property
    def previous_uv(self) -> FloatArray:
        """Features (u, v) in the left image of the previous frame, [N, 2], px."""
        return self.tracks.prev_px[:, :2]

    @property
    def previous_residual_px(self) -> FloatArray:
        """Size of each feature's residual in the previous step, [N], px; NaN where unknown."""
        return self.previous_residuals.size_px_of(self.tracks.ids)

    def for_all_features(self, values: FloatArray) -> FloatArray:
        """Repeat values that belong to the step as a whole for each feature, [C] → [N, C]."""
        # A view: the rows share their memory.
        return np.broadcast_to(values, (len(self.tracks), len(values)))


def _image_or_empty(image: Image | None) -> Image:
    return np.zeros((0, 0), np.uint8) if image is None else image


@dataclass(frozen=True)
class Predictor:
    """One cue for the noise of a feature, as one or more columns of the prediction space.

    ``compute`` maps a step with N features to [N], or to [N, C] with C columns. NaN means that a
    value is undefined; it is refused unless ``undefined`` says where this can happen.
    """

    name: str
    """Name of the predictor, as in ``probevo train --predictors``."""
    columns: Mapping[str, str]
    """Name and unit of each column; a predictor with one column gives it its own name."""
    source: str
    """Where it comes from: paper and section."""
    needs: Needs
    """The data it needs; a recording without them is refused."""
    compute: Callable[[Step], FloatArray]
    """Compute its values for a step, [N] or [N, C]."""
    undefined: str = ""
    """Where it has no value, such as "where the patch leaves the image"; empty if it always has."""
    depends_on_previous_motion: bool = False
    """Whether the values depend on motions that earlier steps have estimated.

    Such a predictor can confirm a wrong motion by its own consequences, which the estimator has
    to guard against."""

"""Everything that the odometry remembers from frame to frame, as one value."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from probevo.arrays import BoolArray, FloatArray
from probevo.camera.rig_calibration import RigCalibration
from probevo.camera.rig_jitter import RigJitter
from probevo.config import OdometryConfig
from probevo.estimation.disparity_filter import DisparityFilter
from probevo.estimation.inertial import (
    Inertial,
    may_bridge,
    trusts_gyro,
    uses_imu,
    with_samples,
)
from probevo.estimation.motion_estimate import MotionEstimate, Status
from probevo.estimation.motion_model import MotionModel, MotionPrediction
from probevo.estimation.pose_filter import PoseFilter
from probevo.estimation.recovery import (
    MOST_DURATION_S,
    DeadReckonedPath,
    Recovery,
    noise_factor,
)
from probevo.estimation.reprojection import ReprojectionSolution
from probevo.estimation.sensor_fusion import SensorFusion
from probevo.estimation.window import Window
from probevo.measurements.base import pose_of
from probevo.measurements.gyro import GyroBias, GyroRotation, covers, integrate_gyro
from probevo.measurements.relative_pose import RelativePose
from probevo.measurements.relative_rotation import RelativeRotation
from probevo.sequences.frame import Frame
from probevo.sequences.imu_calibration import ImuCalibration
from probevo.tracking import TrackingState, Tracks
from probevo.tracking.last_residuals import LastResiduals
from probevo.tracking.observations import ObservationStore


@dataclass(frozen=True)
class StepFeatures:
    """The N tracks of the last step, and what became of them."""

    tracks: Tracks
    """Corrected by the rig's calibration."""
    phi: FloatArray
    """Their places in the prediction space, [N, M]."""
    used: BoolArray
    """Which of them the solve used, [N]."""
    weights: FloatArray
    """How far each was trusted, [N], 0 to 1."""
    T_curr_prev: FloatArray
    """The motion that they show by themselves, without the window, or else the dead-reckoned one,
    [4, 4], m."""

    @staticmethod
    def none(num_columns: int) -> StepFeatures:
        """Return no features, in a prediction space of M columns."""
        return StepFeatures(
            tracks=Tracks.none(),
            phi=np.zeros((0, num_columns)),
            used=np.zeros(0, np.bool_),
            weights=np.zeros(0),
            T_curr_prev=np.eye(4),
        )


@dataclass(frozen=True)
class Prediction:
    """Prior knowledge of the step to a frame, before its images are looked at."""

    state: OdometryState
    """After the frame that the motion leads from."""
    frame: Frame
    """The frame that it leads to."""
    duration_s: float
    motion: MotionPrediction
    gyro: GyroRotation | None
    """Integrated over the interval; None where its samples do not cover it."""
    rotation: RelativeRotation | None
    """The same as a measurement, with the covariance of its noise and its bias."""
    gyro_bias: GyroBias | None
    """Estimate of the gyro's bias at the current frame."""
    window: Window | None
    """The window with what its IMU has measured since its last frame; None without a window."""

    def gyro_bias_after(
        self, solution: ReprojectionSolution, *, enters_solve: bool
    ) -> GyroBias | None:
        """Return the estimate of the gyro's bias after an accepted solve; None without an IMU.

        Args:
            solution: the motion.
            enters_solve: whether the gyro's rotation was one of its measurements.
        """
        if self.gyro is None or self.gyro_bias is None:
            return self.gyro_bias
        learn = self.gyro_bias.updated if enters_solve else self.gyro_bias.compared
        return learn(self.gyro, solution.T_curr_prev[:3, :3], solution.cov[3:, 3:])

    def from_last_usable(self) -> tuple[Prediction, Recovery] | None:
        """Predict the motion from the last usable frame instead, whose features may be found again
        (``estimation.recovery``).

        Returns:
            The prediction, and how its motion becomes one from the previous frame. None if that
            frame was a usable one, or the last one has been given up. A window with an IMU is left
            to itself.
        """
        usable = self.state.last_usable
        if usable is None or not _may_enter(self.state.window, usable.state.frame):
            return None
        duration_s = usable.path.duration_s + self.duration_s
        if duration_s > MOST_DURATION_S:
            return None
        model = self.state.motion_model
        prediction = replace(
            self,
            state=usable.state,
            duration_s=duration_s,
            motion=usable.path.predicted(self.motion, model.path_sensitivity),
            gyro=None,
            rotation=None,
        )
        return prediction, Recovery(usable.path, noise_factor(model.frames_of(duration_s)))


@dataclass(frozen=True)
class LastUsable:
    """The last frame with a motion from images, while those after it are dead-reckoned."""

    state: OdometryState
    """After that frame."""
    path: DeadReckonedPath
    """From it to the last frame."""


@dataclass(frozen=True)
class OdometryState:
    """The whole memory of a ``StereoOdometry``: a step computes a new one and assigns it last.

    Nothing else remembers anything, so that a step that raises has never happened.
    """

    frame: Frame
    """The last frame."""
    tracking: TrackingState
    """Features alive in it."""
    observations: ObservationStore
    """Raw observations of the last frames, by landmark."""
    rig: RigCalibration | None
    """What is left of the rectification's errors; None without self-calibration."""
    gyro_bias: GyroBias | None
    """Estimate of the gyro's bias; None without an IMU."""
    motion_model: MotionModel
    disparities: DisparityFilter
    residuals: LastResiduals
    """Residuals of the last step's features, by landmark."""
    fusion: SensorFusion
    """Pose of the camera in the world, which is the first camera, and what is remembered of each
    sensor that corrects it."""
    step: StepFeatures
    """The features of the last step."""
    is_frozen: bool
    """Whether the images have stood still in the last step though the camera moved."""
    window: Window | None
    """The last frames and their landmarks; None for the two-frame estimator."""
    last_usable: LastUsable | None = None
    """Where the path has been dead-reckoned from; None if the last frame has a motion from
    images."""

    @staticmethod
    def at_first_frame(
        frame: Frame,
        tracking: TrackingState,
        imu: ImuCalibration | None,
        *,
        config: OdometryConfig,
        num_columns: int,
        sensor_names: Sequence[str] = (),
        jitter: RigJitter | None = None,
    ) -> OdometryState:
        """Return the state after the first frame.

        Args:
            frame: the first frame.
            tracking: its features.
            imu: calibration of the IMU, if there is one.
            config: all settings.
            num_columns: M of the prediction space.
            sensor_names: of the sensors beside the camera.
            jitter: the prior of the rig's jitter; by default that of an unknown rig.
        """
        return OdometryState(
            frame=frame,
            tracking=tracking,
            observations=ObservationStore().with_frame(tracking.observations(frame)),
            rig=RigCalibration.initial(jitter) if config.self_calibration else None,
            gyro_bias=GyroBias.initial(imu) if imu else None,
            motion_model=MotionModel.at_start(config.motion_model),
            disparities=DisparityFilter.none(),
            residuals=LastResiduals.none(),
            fusion=SensorFusion.at_origin(sensor_names),
            step=StepFeatures.none(num_columns),
            is_frozen=False,
            window=_first_window(frame, imu, config) if config.estimator == "window" else None,
        )

    @property
    def pose(self) -> PoseFilter:
        """Pose of the camera in the world."""
        return self.fusion.pose

    def last_usable_after(self, duration_s: float, motion: MotionEstimate) -> LastUsable | None:
        """Return the last frame with a motion from images, if the next one does not have one."""
        if motion.status in (Status.OK, Status.RECOVERED):
            return None
        usable = self.last_usable or LastUsable(self, DeadReckonedPath.none())
        return replace(usable, path=usable.path.advanced(duration_s, motion))

    def predict(self, frame: Frame, imu: ImuCalibration | None) -> Prediction:
        """Predict the motion to the next frame, from gyro and last velocity (PROBE eqs. 3-4).

        A gyro that is yet to be tested against the window, or contradicts it, predicts nothing. One
        that the window uses refuses no motion that images show and the last velocity allows: which
        of the two is wrong, the window says.

        Args:
            frame: the next frame.
            imu: calibration of the IMU, if there is one.
        """
        duration_s = 1e-9 * (frame.stamp_ns - self.frame.stamp_ns)
        window = self.window
        if window is not None:
            window = with_samples(window, self.frame, frame)
        gyro = None
        bias = None
        rotation = None
        if imu is not None and self.gyro_bias is not None:
            bias = self.gyro_bias.predicted(duration_s, imu)
            start_ns = self.frame.stamp_ns
            if frame.imu is not None and covers(frame.imu, start_ns, frame.stamp_ns):
                gyro = integrate_gyro(
                    frame.imu, start_ns, frame.stamp_ns, calibration=imu, bias_rad_s=bias.mean
                )
                rotation = RelativeRotation(
                    gyro.C_curr_prev,
                    bias.prior(gyro),
                    curr=pose_of(frame.index),
                    prev=pose_of(self.frame.index),
                )
        without_gyro = self.motion_model.predict(duration_s, None)
        motion = without_gyro
        if rotation is not None and trusts_gyro(window):
            motion = self.motion_model.predict(duration_s, rotation)
            if uses_imu(window):
                motion = replace(motion, without_gyro=without_gyro)
        return Prediction(
            state=self,
            frame=frame,
            duration_s=duration_s,
            motion=motion,
            gyro=gyro,
            rotation=rotation,
            gyro_bias=bias,
            window=window,
        )


def _first_window(frame: Frame, imu: ImuCalibration | None, config: OdometryConfig) -> Window:
    """Return the window of the first frame, with the IMU if there is one that may be used."""
    window = Window.at_first_frame(frame.index)
    if imu is None or config.window.imu == "off":
        return window
    return replace(window, inertial=Inertial(imu))


def motion_for_window(
    window: Window, prediction: Prediction, motion: MotionEstimate
) -> RelativePose:
    """Return the motion of a step as a window takes it.

    Errors of dead reckoning are those of one velocity, and no step's is independent of the one's
    before. So a dead-reckoned motion is one from the last usable frame, as long as that is in the
    window.

    Args:
        window: before the step.
        prediction: of the step.
        motion: that was solved or dead-reckoned from the frame that the prediction leads from.
    """
    curr = pose_of(prediction.frame.index)
    usable = prediction.state.last_usable_after(prediction.duration_s, motion)
    if usable is not None and _may_enter(window, usable.state.frame):
        path = usable.path
        return RelativePose(
            path.T_prev_usable, path.cov, curr=curr, prev=pose_of(usable.state.frame.index)
        )
    return RelativePose(
        motion.T_curr_prev, motion.cov, curr=curr, prev=pose_of(prediction.state.frame.index)
    )


def _may_enter(window: Window | None, frame: Frame) -> bool:
    """Return whether a motion from a frame to the next one can enter a window, if there is one."""
    return window is None or (not may_bridge(window) and frame.index in window.frames)

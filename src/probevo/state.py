"""Everything the odometry remembers from frame to frame, as one frozen value."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from probevo.arrays import BoolArray, FloatArray
from probevo.camera.rig_calibration import RigCalibration
from probevo.config import OdometryConfig
from probevo.estimation.disparity_filter import DisparityFilter
from probevo.estimation.motion_estimate import MotionEstimate, Status
from probevo.estimation.motion_model import MotionModel
from probevo.estimation.noise_scale import NoiseScale
from probevo.estimation.pose_filter import PoseFilter
from probevo.estimation.recovery import MAX_DURATION_S, DeadReckonedPath, OutageVelocity
from probevo.estimation.sensor_fusion import SensorFusion
from probevo.estimation.window.inertial import Inertial
from probevo.estimation.window.window import Window
from probevo.measurements.gyro import GyroBias
from probevo.sequences.frame import Frame
from probevo.sequences.frame_checks import check_memory, share_memory
from probevo.sequences.imu_calibration import ImuCalibration
from probevo.tracking import TrackingState, Tracks
from probevo.tracking.last_residuals import LastResiduals
from probevo.tracking.observations import ObservationStore


@dataclass(frozen=True)
class StepFeatures:
    """The N tracks of the last step, with their predictors and weights."""

    tracks: Tracks
    """Corrected by the rig's calibration."""
    phi: FloatArray
    """Predictors of the tracks, [N, M]."""
    used: BoolArray
    """Which tracks the solve used, [N]."""
    weights: FloatArray
    """Robust weight of each track, [N], from 0 (outlier) to 1."""
    T_curr_prev: FloatArray
    """The motion of the two-frame solve, or else the dead-reckoned one, [4, 4], m."""
    tracks_of_vehicle: Tracks = field(default_factory=Tracks.none)
    """Raw tracks of features that are fixed to the vehicle."""

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
class Outage:
    """Dead-reckoned steps, whose motion is better known once the features of the last usable frame
    before them are found again (``estimation.recovery``)."""

    before: OdometryState
    """The state after the last usable frame."""
    path: DeadReckonedPath
    """The motion from that frame to the last one."""
    velocity: OutageVelocity | None = None
    """The mean velocity meanwhile, once a later step is solved; None while the outage lasts."""

    @property
    def lasts(self) -> bool:
        """Whether the last step was dead-reckoned, too."""
        return self.velocity is None


@dataclass(frozen=True)
class OdometryState:
    """The whole memory of a ``StereoOdometry``: a step computes a new one and assigns it last.

    Since nothing else has state, a step that raises leaves no trace.
    """

    frame: Frame
    """The last frame."""
    tracking: TrackingState
    """Features tracked into the last frame."""
    observations: ObservationStore
    """Raw observations of the last frames, by landmark."""
    rig: RigCalibration | None
    """Estimated errors of the rectification; None without self-calibration."""
    gyro_bias: GyroBias | None
    """Estimate of the gyro's bias; None without an IMU."""
    motion_model: MotionModel
    disparities: DisparityFilter
    residuals: LastResiduals
    """Residuals of the last step's features, by landmark."""
    noise_scale: NoiseScale
    """How large the errors of the features are against their noise model."""
    fusion: SensorFusion
    """Pose of the camera in the world (the first camera), and the tests of each sensor that
    corrects it."""
    features: StepFeatures
    """The features of the last step."""
    is_frozen: bool
    """Whether the images of the last frame did not change although the camera moved."""
    window: Window | None
    """The last frames and their landmarks; None for the two-frame estimator."""
    gyro_period_ns: float | None = None
    """Usual time between samples of the gyro, ns; None before the first."""
    outage: Outage | None = None
    """Dead-reckoned steps up to the last frame, or with a window also earlier ones, until features
    connect the frame before them with one after them; None if there are none."""

    @staticmethod
    def at_first_frame(
        frame: Frame,
        tracking: TrackingState,
        imu: ImuCalibration | None,
        *,
        config: OdometryConfig,
        num_columns: int,
        sensor_names: Sequence[str] = (),
        rig: RigCalibration | None = None,
    ) -> OdometryState:
        """Return the state after the first frame.

        Args:
            frame: the first frame.
            tracking: its features.
            imu: calibration of the IMU, if there is one.
            config: all settings.
            num_columns: M of the prediction space.
            sensor_names: of the sensors beside the camera.
            rig: the prior of the rig's errors; None without self-calibration.
        """
        return OdometryState(
            frame=frame,
            tracking=tracking,
            observations=ObservationStore().with_frame(tracking.observations(frame)),
            rig=rig,
            gyro_bias=GyroBias.initial(imu) if imu else None,
            motion_model=MotionModel.at_start(config.motion_model),
            disparities=DisparityFilter.none(),
            noise_scale=NoiseScale(),
            residuals=LastResiduals.none(),
            fusion=SensorFusion.at_origin(sensor_names),
            features=StepFeatures.none(num_columns),
            is_frozen=False,
            window=_first_window(frame, imu, config) if config.estimator == "window" else None,
        )

    @property
    def pose(self) -> PoseFilter:
        """Pose of the camera in the world."""
        return self.fusion.pose

    @property
    def is_dead_reckoned(self) -> bool:
        """Whether the motion to the last frame was not solved from images."""
        return self.outage is not None and self.outage.lasts

    def dead_reckoned_after(self, duration_s: float, motion: MotionEstimate) -> Outage | None:
        """Return the outage that lasts after the next motion; None if that was solved."""
        if motion.status in (Status.OK, Status.RECOVERED):
            return None
        outage = self.outage
        if outage is None or not outage.lasts:
            # It begins with this step.
            outage = Outage(replace(self, outage=None), DeadReckonedPath.none())
        return replace(outage, path=outage.path.advanced(duration_s, motion))

    def outage_after(
        self, duration_s: float, motion: MotionEstimate, *, is_connected: bool
    ) -> Outage | None:
        """Return the outage after the next motion; None if it does not last, and there is nothing
        to connect.

        Args:
            duration_s: time of that motion.
            motion: the motion.
            is_connected: whether the window has features of the last usable frame in it.
        """
        if motion.status is not Status.OK:
            return self.dead_reckoned_after(duration_s, motion)
        velocity = self.outage_velocity(duration_s, motion)
        if self.outage is None or velocity is None or is_connected:
            return None
        path = self.outage.path.advanced(duration_s, motion)
        if path.duration_s > MAX_DURATION_S:
            return None
        return replace(self.outage, path=path, velocity=velocity)

    def outage_velocity(self, duration_s: float, motion: MotionEstimate) -> OutageVelocity | None:
        """Return the mean velocity during the outage, given a solved step after it.

        Args:
            duration_s: time of that step.
            motion: the step.

        Returns:
            None without an outage, and without a window.
        """
        outage = self.outage
        if self.window is None or outage is None:
            return None
        if outage.velocity is not None:
            return outage.velocity.advanced(motion.T_curr_prev)
        return OutageVelocity.between(outage.path, outage.before.motion_model, motion, duration_s)

    def without_overwritten_images(self, frame: Frame) -> OdometryState:
        """Return the state without an outage whose last usable frame has its images in the memory
        of the next frame's, as where a driver uses a few buffers in turn.

        Raises:
            InputError: the outage lasts, so that its last usable frame is needed.
        """
        if self.outage is None:
            return self
        usable = self.outage.before.frame
        if self.outage.lasts:
            check_memory(usable, frame)
        elif share_memory(usable, frame):
            return replace(self, outage=None)
        return self


def _first_window(frame: Frame, imu: ImuCalibration | None, config: OdometryConfig) -> Window:
    """Return the window of the first frame, with the IMU if there is one that may be used."""
    window = Window.at_first_frame(frame.index)
    if imu is None or config.window.imu == "off":
        return window
    return replace(window, inertial=Inertial(imu))

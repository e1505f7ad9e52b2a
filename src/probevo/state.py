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
from probevo.estimation.recovery import MAX_DURATION_S, DeadReckonedPath, Gap
from probevo.estimation.sensor_fusion import SensorFusion
from probevo.estimation.window.inertial import Inertial
from probevo.estimation.window.window import Window
from probevo.measurements.gyro import GyroBias
from probevo.sequences.frame import Frame
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
class LastUsable:
    """The last frame whose motion was solved from images; those after it are dead-reckoned."""

    state: OdometryState
    """The state after that frame."""
    path: DeadReckonedPath
    """The motion from that frame to the last one."""


@dataclass(frozen=True)
class Unconnected:
    """A usable frame before dead-reckoned steps that no feature connects with the frames after them
    yet."""

    usable: LastUsable
    gap: Gap


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
    last_usable: LastUsable | None = None
    """The frame from which the path is dead-reckoned; None if the motion to the last frame was
    solved from images."""
    gyro_period_ns: float | None = None
    """Usual time between samples of the gyro, ns; None before the first."""
    unconnected: Unconnected | None = None
    """The last usable frame before steps that were dead-reckoned, though the last one was solved,
    until features connect it with a frame after them; None without a window."""

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

    def last_usable_after(self, duration_s: float, motion: MotionEstimate) -> LastUsable | None:
        """Return where dead reckoning starts after the next motion; None if that was solved."""
        if motion.status in (Status.OK, Status.RECOVERED):
            return None
        usable = self.last_usable or LastUsable(
            replace(self, unconnected=None), DeadReckonedPath.none()
        )
        return replace(usable, path=usable.path.advanced(duration_s, motion))

    def gap_before(self, duration_s: float, motion: MotionEstimate) -> Gap | None:
        """Return the gap between the usable frame that is not connected yet and a solved step.

        Args:
            duration_s: time of that step.
            motion: the step.

        Returns:
            None if all frames are connected, and without a window.
        """
        if self.window is None:
            return None
        if self.last_usable is not None:
            before = self.last_usable.state.motion_model
            return Gap.between(self.last_usable.path, before, motion, duration_s)
        if self.unconnected is not None:
            return self.unconnected.gap.advanced(motion.T_curr_prev)
        return None

    def unconnected_after(
        self, duration_s: float, motion: MotionEstimate, *, is_connected: bool
    ) -> Unconnected | None:
        """Return the usable frame that is still to be connected after the next motion.

        Args:
            duration_s: time of that motion.
            motion: the motion.
            is_connected: whether it has found features of that frame.
        """
        if motion.status is not Status.OK or is_connected:
            return None
        usable = self.to_reconnect
        gap = self.gap_before(duration_s, motion)
        if usable is None or gap is None:
            return None
        path = usable.path.advanced(duration_s, motion)
        if path.duration_s > MAX_DURATION_S:
            return None
        return Unconnected(replace(usable, path=path), gap)

    @property
    def to_reconnect(self) -> LastUsable | None:
        """The frame whose features are to be found again; None if all frames are connected."""
        if self.last_usable is None and self.unconnected is not None:
            return self.unconnected.usable
        return self.last_usable


def _first_window(frame: Frame, imu: ImuCalibration | None, config: OdometryConfig) -> Window:
    """Return the window of the first frame, with the IMU if there is one that may be used."""
    window = Window.at_first_frame(frame.index)
    if imu is None or config.window.imu == "off":
        return window
    return replace(window, inertial=Inertial(imu))

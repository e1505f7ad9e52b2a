"""Everything the odometry remembers from frame to frame, as one frozen value."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from probevo.arrays import BoolArray, FloatArray
from probevo.camera.rig_calibration import RigCalibration
from probevo.camera.rig_jitter import RigJitter
from probevo.config import OdometryConfig
from probevo.estimation.disparity_filter import DisparityFilter
from probevo.estimation.motion_estimate import MotionEstimate, Status
from probevo.estimation.motion_model import MotionModel, MotionPrediction
from probevo.estimation.noise_scale import NoiseScale
from probevo.estimation.pose_filter import PoseFilter
from probevo.estimation.recovery import (
    MOST_DURATION_S,
    DeadReckonedPath,
    Recovery,
    noise_factor,
)
from probevo.estimation.reprojection import ReprojectionSolution
from probevo.estimation.sensor_fusion import SensorFusion
from probevo.estimation.window.inertial import Inertial
from probevo.estimation.window.inertial_steps import with_samples
from probevo.estimation.window.window import Window
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
    """The motion to a frame and everything else that is known before its images are used."""

    state: OdometryState
    """The state after the frame at the start of the motion."""
    frame: Frame
    """The frame at its end."""
    duration_s: float
    motion: MotionPrediction
    gyro: GyroRotation | None
    """The gyro integrated over the interval; None if its samples do not cover it."""
    rotation: RelativeRotation | None
    """The same rotation as a measurement, whose covariance includes the bias's."""
    gyro_bias: GyroBias | None
    """Estimate of the gyro's bias at the current frame."""
    window: Window | None
    """The window, with the IMU samples since its last frame; None without a window."""

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
        # If the gyro has entered the solve, the motion is not independent of it.
        learn = (
            self.gyro_bias.updated_by_joint_solve
            if enters_solve
            else self.gyro_bias.updated_by_independent_solve
        )
        return learn(self.gyro, solution.T_curr_prev[:3, :3], solution.cov[3:, 3:])

    def from_last_usable(self) -> tuple[Prediction, Recovery] | None:
        """Predict the motion from the last usable frame, where features may be found again
        (``estimation.recovery``).

        Returns:
            The prediction, and the recovery that turns its motion into one from the previous frame.
            None if the previous frame is usable itself, if the last usable one is too long ago, or
            if a window with an IMU bridges the frames between.
        """
        usable = self.state.last_usable
        window = self.state.window
        if usable is None or Inertial.of(window).may_bridge:
            return None
        if window is not None and usable.state.frame.index not in window.frames:
            return None
        duration_s = usable.path.duration_s + self.duration_s
        if duration_s > MOST_DURATION_S:
            return None
        # The features are those of the usable frame; the motion is the path since then and the step
        # predicted. The gyro was integrated over that step only, and does not apply.
        model = self.state.motion_model
        # Identities that the frames between have given to new features are not given again.
        tracking = replace(usable.state.tracking, next_id=self.state.tracking.next_id)
        prediction = replace(
            self,
            state=replace(usable.state, tracking=tracking),
            duration_s=duration_s,
            motion=usable.path.predicted(self.motion, model.path_sensitivity),
            gyro=None,
            rotation=None,
        )
        return prediction, Recovery(usable.path, noise_factor(model.frames_of(duration_s)))


@dataclass(frozen=True)
class LastUsable:
    """The last frame whose motion was solved from images; those after it are dead-reckoned."""

    state: OdometryState
    """The state after that frame."""
    path: DeadReckonedPath
    """The motion from that frame to the last one."""


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
        usable = self.last_usable or LastUsable(self, DeadReckonedPath.none())
        return replace(usable, path=usable.path.advanced(duration_s, motion))

    def predict(self, frame: Frame, imu: ImuCalibration | None) -> Prediction:
        """Predict the motion to the next frame, from gyro and last velocity (PROBE eqs. 3-4).

        With a window, the gyro predicts nothing once it has failed a test. Until then, and until it
        has passed one, it is only an alternative to the last velocity. Once the window uses it, the
        last velocity is the alternative to the gyro: the window has more data to find out which of
        the two is wrong. A solve that agrees with either is accepted.

        Args:
            frame: the next frame.
            imu: calibration of the IMU, if there is one.
        """
        # The window preintegrates the IMU by itself; below, its gyro predicts the rotation.
        duration_s = 1e-9 * (frame.stamp_ns - self.frame.stamp_ns)
        window = self.window
        if window is not None:
            window = with_samples(window, self.frame, frame)
        # Integrate the gyro, if its samples cover the interval.
        gyro = None
        bias = None
        rotation = None
        bias_sensitivity = None
        if imu is not None and self.gyro_bias is not None:
            bias = self.gyro_bias.predicted(duration_s, imu)
            start_ns = self.frame.stamp_ns
            if frame.imu is not None and covers(frame.imu, start_ns, frame.stamp_ns):
                gyro = integrate_gyro(
                    frame.imu, start_ns, frame.stamp_ns, calibration=imu, bias_rad_s=bias.mean
                )
                rotation = RelativeRotation(
                    gyro.C_curr_prev,
                    bias.rotation_cov(gyro),
                    curr=pose_of(frame.index),
                    prev=pose_of(self.frame.index),
                )
                bias_sensitivity = bias.sensitivity(gyro)
        motion = self.motion_model.predict(duration_s, None)
        if rotation is not None:
            # The rotation is the gyro's, the translation that of the last velocity.
            of_gyro = self.motion_model.predict(duration_s, rotation, bias_sensitivity)
            motion = self._with_alternative(of_velocity=motion, of_gyro=of_gyro, window=window)
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

    def _with_alternative(
        self, *, of_velocity: MotionPrediction, of_gyro: MotionPrediction, window: Window | None
    ) -> MotionPrediction:
        """Return the prediction of a step that has a gyro; the gate accepts what agrees with it, or
        with its alternative.

        Args:
            of_velocity: by the last velocity alone.
            of_gyro: with the rotation of the gyro.
            window: the window, which may have tested the gyro.
        """
        inertial = Inertial.of(window)
        if inertial.is_used:
            # It has passed its tests, and would see a sudden turn.
            return replace(of_gyro, alternative=replace(of_velocity, sudden_turn_rad=0.0))
        if inertial.trusts_gyro:
            # Nothing can test it. Where the velocity has been given up, since it contradicted solve
            # after solve, it may have been the gyro that was wrong.
            gives_up = self.motion_model.speed_is_unknown
            return replace(of_gyro, alternative=of_velocity if gives_up else None)
        if inertial.may_bridge:
            # It has not been tested yet.
            return replace(of_velocity, alternative=of_gyro)
        # It has failed a test.
        return of_velocity


def _first_window(frame: Frame, imu: ImuCalibration | None, config: OdometryConfig) -> Window:
    """Return the window of the first frame, with the IMU if there is one that may be used."""
    window = Window.at_first_frame(frame.index)
    if imu is None or config.window.imu == "off":
        return window
    return replace(window, inertial=Inertial(imu))


def motion_for_window(
    window: Window, prediction: Prediction, motion: MotionEstimate
) -> RelativePose:
    """Return the motion of a step as a measurement of the window.

    Dead-reckoned steps all have the error of the same velocity, so they are not independent. Their
    motion is therefore measured from the last usable frame, as long as the window has it, and not
    from the previous frame; unless the IMU knows the motion from there.

    Args:
        window: the window before the step.
        prediction: the prediction of the step.
        motion: the solved or dead-reckoned motion from ``prediction.state.frame`` to
            ``prediction.frame``.
    """
    curr = pose_of(prediction.frame.index)
    # None if the motion was solved: a solved one is measured from where it starts.
    usable = prediction.state.last_usable_after(prediction.duration_s, motion)
    has_usable = usable is not None and usable.state.frame.index in window.frames
    if usable is not None and has_usable and not window.inertial.predicts_next:
        path = usable.path
        return RelativePose(
            path.T_prev_usable, path.cov, curr=curr, prev=pose_of(usable.state.frame.index)
        )
    return RelativePose(
        motion.T_curr_prev, motion.cov, curr=curr, prev=pose_of(prediction.state.frame.index)
    )

"""The prediction of a motion before the images of its frame are used: last velocity, gyro, IMU."""

from __future__ import annotations

from dataclasses import dataclass, replace

from probevo.arrays import FloatArray
from probevo.estimation.frozen_images import Shown
from probevo.estimation.motion_estimate import MotionEstimate
from probevo.estimation.motion_model import MotionModel, MotionPrediction
from probevo.estimation.recovery import MAX_DURATION_S, Recovery, span_factor
from probevo.estimation.reprojection import ReprojectionSolution
from probevo.estimation.window.inertial import Inertial
from probevo.estimation.window.inertial_steps import preintegrate_samples
from probevo.estimation.window.window import Window
from probevo.measurements.constant_velocity import ConstantVelocity
from probevo.measurements.gyro import GyroBias, GyroRotation, covers, integrate_gyro, period_after
from probevo.measurements.relative_pose import RelativePose
from probevo.measurements.relative_rotation import RelativeRotation
from probevo.measurements.variables import pose_of
from probevo.sequences.frame import Frame
from probevo.sequences.imu_calibration import ImuCalibration
from probevo.state import OdometryState


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
    gyro_period_ns: float | None
    """Usual time between samples of the gyro, ns; None before the first."""
    window: Window | None
    """The window, with the IMU samples since its last frame; None without a window."""

    def gyro_bias_after(
        self, solution: ReprojectionSolution, cov: FloatArray, *, enters_solve: bool
    ) -> GyroBias | None:
        """Return the estimate of the gyro's bias after an accepted solve; None without an IMU.

        Args:
            solution: the motion.
            cov: its covariance, with the errors of the rig, [6, 6].
            enters_solve: whether the gyro's rotation was one of its measurements.
        """
        if self.gyro is None or self.gyro_bias is None:
            return self.gyro_bias
        C_curr_prev = solution.T_curr_prev[:3, :3]
        if enters_solve:
            # The motion is not independent of the gyro, whose part is taken off the solve's own
            # covariance.
            return self.gyro_bias.updated_by_joint_solve(
                self.gyro, C_curr_prev, solution.cov[3:, 3:]
            )
        return self.gyro_bias.updated_by_independent_solve(self.gyro, C_curr_prev, cov[3:, 3:])

    @property
    def shown(self) -> Shown:
        """The frame that the images may show again: the previous one, or, if its images were
        frozen, the last usable one."""
        state = self.state
        outage = state.outage
        if not state.is_frozen or outage is None or not outage.lasts:
            return Shown(state.frame, state.tracking, self.motion, is_frozen=state.is_frozen)
        sensitivity = state.motion_model.path_sensitivity
        return Shown(
            outage.before.frame,
            outage.before.tracking,
            outage.path.predicted(self.motion, sensitivity),
            is_frozen=True,
        )

    def from_last_usable(self) -> tuple[Prediction, Recovery] | None:
        """Predict the motion from the last usable frame, where features may be found again
        (``estimation.recovery``).

        Returns:
            The prediction, and the recovery that turns its motion into one from the previous frame.
            None if the previous frame is usable itself, if the last usable one is too long ago, or
            if a window with an IMU bridges the frames between.
        """
        outage = self.state.outage
        window = self.state.window
        if outage is None or Inertial.of(window).may_bridge:
            return None
        if window is not None and outage.before.frame.index not in window.frames:
            return None
        duration_s = outage.path.duration_s + self.duration_s
        if duration_s > MAX_DURATION_S:
            return None
        # The features are those of the usable frame; the motion is the path since then and the step
        # predicted. The gyro was integrated over that step only, and does not apply.
        model = self.state.motion_model
        # Identities that the frames between have given to new features are not given again.
        tracking = replace(outage.before.tracking, next_id=self.state.tracking.next_id)
        prediction = replace(
            self,
            state=replace(outage.before, tracking=tracking),
            duration_s=duration_s,
            motion=outage.path.predicted(self.motion, model.path_sensitivity),
            gyro=None,
            rotation=None,
        )
        return prediction, Recovery(outage.path, span_factor(model.frames_of(duration_s)))


def predict(state: OdometryState, frame: Frame, imu: ImuCalibration | None) -> Prediction:
    """Predict the motion to the next frame, from gyro and last velocity (PROBE eqs. 3-4).

    With a window, the gyro predicts nothing once it has failed a test. Until then, and until it
    has passed one, it is only an alternative to the last velocity. Once the window uses it, the
    last velocity is the alternative to the gyro: the window has more data to find out which of
    the two is wrong. A solve that agrees with either is accepted.

    Args:
        state: after the last frame.
        frame: the next frame.
        imu: calibration of the IMU, if there is one.
    """
    duration_s = 1e-9 * (frame.stamp_ns - state.frame.stamp_ns)
    # The window preintegrates the IMU itself; the gyro below predicts only the rotation.
    window = state.window
    if window is not None:
        window = preintegrate_samples(window, state.frame, frame)
    # Integrate the gyro, if its samples cover the interval.
    gyro = None
    bias = None
    rotation = None
    bias_sensitivity = None
    if imu is not None and state.gyro_bias is not None:
        bias = state.gyro_bias.predicted(duration_s, imu)
        start_ns = state.frame.stamp_ns
        usual_period_ns = state.gyro_period_ns
        if frame.imu is not None and covers(frame.imu, start_ns, frame.stamp_ns, usual_period_ns):
            gyro = integrate_gyro(
                frame.imu, start_ns, frame.stamp_ns, calibration=imu, bias_rad_s=bias.mean
            )
            rotation = RelativeRotation(
                gyro.C_curr_prev,
                bias.rotation_cov(gyro),
                curr=pose_of(frame.index),
                prev=pose_of(state.frame.index),
            )
            bias_sensitivity = bias.sensitivity(gyro)
    motion = state.motion_model.predict(duration_s, None)
    if rotation is not None:
        # The rotation is the gyro's, the translation that of the last velocity.
        gyro_prediction = state.motion_model.predict(duration_s, rotation, bias_sensitivity)
        motion = _with_alternative(
            state.motion_model,
            velocity_prediction=motion,
            gyro_prediction=gyro_prediction,
            window=window,
        )
    return Prediction(
        state=state,
        frame=frame,
        duration_s=duration_s,
        motion=motion,
        gyro=gyro,
        rotation=rotation,
        gyro_bias=bias,
        gyro_period_ns=period_after(frame.imu, state.gyro_period_ns),
        window=window,
    )


def _with_alternative(
    model: MotionModel,
    *,
    velocity_prediction: MotionPrediction,
    gyro_prediction: MotionPrediction,
    window: Window | None,
) -> MotionPrediction:
    """Return the prediction of a step that has a gyro; the gate accepts what agrees with it, or
    with its alternative.

    Args:
        model: the motion model before the step.
        velocity_prediction: by the last velocity alone.
        gyro_prediction: with the rotation of the gyro.
        window: the window, which may have tested the gyro.
    """
    inertial = Inertial.of(window)
    if inertial.is_used:
        # It has passed its tests, and would see a sudden turn.
        return replace(
            gyro_prediction, alternative=replace(velocity_prediction, sudden_turn_rad=0.0)
        )
    if inertial.trusts_gyro:
        # Nothing can test it. Where the velocity has been given up, since it contradicted solve
        # after solve, it may have been the gyro that was wrong.
        gives_up = model.speed_is_unknown
        return replace(gyro_prediction, alternative=velocity_prediction if gives_up else None)
    if inertial.may_bridge:
        # It has not been tested yet.
        return replace(velocity_prediction, alternative=gyro_prediction)
    # It has failed a test.
    return velocity_prediction


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
    outage = prediction.state.dead_reckoned_after(prediction.duration_s, motion)
    if outage is not None and not window.inertial.predicts_next:
        usable = outage.before.frame.index
        if usable in window.frames:
            path = outage.path
            return RelativePose(path.T_prev_usable, path.cov, curr=curr, prev=pose_of(usable))
    return RelativePose(
        motion.T_curr_prev, motion.cov, curr=curr, prev=pose_of(prediction.state.frame.index)
    )


def velocity_for_window(window: Window, prediction: Prediction) -> ConstantVelocity | None:
    """Return the constant-velocity measurement of a step, which ties its motion to that of the step
    before; None if the window does not have that step.

    Args:
        window: the window before the step.
        prediction: the prediction of the step.
    """
    frames = prediction.state.observations.frames
    if len(frames) < 2 or frames[-2].frame not in window.frames:
        return None
    before, prev = frames[-2:]
    return ConstantVelocity(
        pose_of(before.frame),
        pose_of(prev.frame),
        pose_of(prediction.frame.index),
        duration_ratio=prediction.duration_s / (1e-9 * (prev.stamp_ns - before.stamp_ns)),
        covariance=prediction.state.motion_model.change_cov(prediction.duration_s),
    )

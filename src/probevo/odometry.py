"""The whole flow for one frame: read this first."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from probevo.arrays import BoolArray, FloatArray
from probevo.camera.exposure_delay import is_noticeable, without_delay
from probevo.camera.rig_calibration import RigCalibration
from probevo.camera.rig_jitter import LEARNED_FRAMES, RigJitter
from probevo.camera.stereo import StereoCamera
from probevo.config import OdometryConfig
from probevo.errors import InputError
from probevo.estimation import inertial
from probevo.estimation.disparity_filter import DisparityFilter
from probevo.estimation.motion_correction import corrected, shares_of
from probevo.estimation.motion_estimate import MotionEstimate, SensorOutcome, Status
from probevo.estimation.motion_model import MotionModel
from probevo.estimation.recovery import (
    INLIERS_FACTOR,
    MOST_DURATION_S,
    noise_factor,
    recovered,
)
from probevo.estimation.rig_update import update_rig
from probevo.estimation.search_starts import rotated_starts, track_from_best_start
from probevo.estimation.sensor_fusion import SensorFusion, motion_innovations_squared
from probevo.estimation.visual_motion import MotionPriors, VisualEstimator, VisualMotion
from probevo.estimation.window import Window
from probevo.estimation.window_estimator import WindowEstimator
from probevo.estimation.window_motion import live_advance, live_motion
from probevo.geometry import se3
from probevo.landmarks import Landmarks, triangulated
from probevo.measurements.base import Measurement, VectorMeasurement, pose_of
from probevo.measurements.correction import MotionCorrection, read_correction
from probevo.measurements.gyro import GyroBias
from probevo.measurements.relative_pose import RelativePose
from probevo.measurements.sensor import Reading, Sensor, read_sensor, sensor_names
from probevo.noise import NoiseModel
from probevo.noise.jitter_array import learned_jitter_cov
from probevo.predictors import PredictionSpace, Step, space_for
from probevo.python_arguments import as_camera, as_config, as_noise
from probevo.sequences.frame import Frame, is_repeated, looks_repeated
from probevo.sequences.imu_calibration import ImuCalibration
from probevo.sequences.validation import validated
from probevo.stage_clock import StageClock
from probevo.state import LastUsable, OdometryState, Prediction, StepFeatures
from probevo.tracking import Tracked, TrackingState, Tracks, tracker_for
from probevo.tracking.last_residuals import LastResiduals
from probevo.tracking.observations import FrameObservations
from probevo.tracking.preparation import with_prepared_images

LOST = (Status.TOO_FEW_TRACKS, Status.DEGENERATE)
"""What a step is whose features were lost. One that was refused has features, which contradict the
prediction or one another, and would do so from any other frame."""
MOST_REPEATED_SOLVES = 3
"""How often a step is solved again, at most, because its tracks show more jitter of the rig."""


class StereoOdometry:
    """Relative motion of a stereo camera, one frame at a time (PROBE Fig. 1; thesis Fig. 4.1).

    Args:
        camera: the rectified camera, as a sequence gives it.
        noise: noise model of the features, or its name or file; the static Student-t by default.
            One of another camera is an InputError unless ``config.any_camera`` accepts it.
        imu: calibration of the IMU whose samples come with the frames, if they do.
        config: all settings, or a dictionary of those that differ from the defaults.
        predictors: the prediction space; by default that of the noise model, and any other is an
            InputError.
        sensors: further sensors, each a ``Sensor``, and at most one ``MotionCorrection``.
    """

    def __init__(
        self,
        camera: StereoCamera,
        noise: NoiseModel | str | Path | None = None,
        imu: ImuCalibration | None = None,
        config: OdometryConfig | Mapping[str, Any] | None = None,
        predictors: PredictionSpace | None = None,
        *,
        sensors: Sequence[Sensor | MotionCorrection] = (),
    ) -> None:
        self.camera = as_camera(camera)
        self.noise = as_noise(noise)
        self.imu = imu
        self.config = as_config(config)
        if not self.config.any_camera:
            self.noise.check_camera(camera)
        self.predictors = space_for(self.noise.columns, predictors)
        self.sensors = tuple(sensors)
        self._sensor_names = sensor_names(self.sensors)
        self._check_corrections()
        self._visual = VisualEstimator(
            camera,
            self.noise,
            self.config,
            predicts_from_motion=(
                bool(self.noise.columns) and self.predictors.depends_on_previous_motion
            ),
        )
        self._tracking = self.config.tracker
        self._window = WindowEstimator(camera, self.config)
        self._state: OdometryState | None = None

    def step(self, frame: Frame) -> MotionEstimate:
        """Estimate the motion from the previous frame to this one: T_curr_prev with its 6×6
        covariance and a status.

        The first frame yields the identity with zero covariance and status FIRST. Where the images
        fix no motion, it is dead-reckoned. If anything raises, the odometry is as it was before the
        call, as if the frame had never been there.

        Raises:
            InputError: the frame is not later than the previous one, or not what its camera sees.
        """
        state = self._state
        frame, missing = validated(frame, self.camera, prev_frame=state.frame if state else None)
        if state is None:
            self._state = self._first_state(frame)
            return MotionEstimate.first(missing)
        clock = StageClock(decode=frame.decode_ms)
        prediction = state.predict(frame, self.imu)  # from gyro and last velocity
        observed = self._observe(state, frame, prediction, clock=clock)  # pixels → tracks → φ
        measured = self._measure(state, frame, prediction)  # gyro, and sensors plugged in
        solved = self._solve(  # consensus, noise of each track, motion
            state, frame, prediction, observed=observed, measured=measured, clock=clock
        )
        solved = self._recovered(state, frame, prediction, solved=solved, clock=clock)
        estimate, after = self._conclude(  # learn from it, advance the pose
            state, frame, prediction, solved=solved, measured=measured, clock=clock
        )
        estimate = replace(estimate, missing=missing)
        self._state = after
        return estimate

    @property
    def tracks(self) -> Tracks:
        """The N tracks of the last step, corrected by the rig's calibration."""
        return self._features.tracks

    @property
    def phi(self) -> FloatArray:
        """Their places in the prediction space, [N, M]."""
        return self._features.phi

    @property
    def used(self) -> BoolArray:
        """Which of them the solve used, [N]."""
        return self._features.used

    @property
    def weights(self) -> FloatArray:
        """How far each was trusted, [N], 0 to 1."""
        return self._features.weights

    @property
    def landmarks(self) -> Landmarks:
        """The points that the last solve used, in the current camera's frame, with covariances."""
        noise = self._state.observations.frames[-1].noise if self._state else None
        if noise is None:
            return Landmarks.none()
        seen = self.tracks.kept(self.used)
        return triangulated(seen.ids, seen.curr_px, noise, self.camera)

    @property
    def state(self) -> OdometryState | None:
        """Everything that it remembers; None before the first frame."""
        return self._state

    @property
    def rig(self) -> RigCalibration | None:
        """What it has learned of the rectification's errors; None without self-calibration."""
        if self._state is None:
            if not self.config.self_calibration:
                return None
            return RigCalibration.initial(self._initial_jitter())
        return self._state.rig

    @property
    def gyro_bias(self) -> GyroBias | None:
        """What it has learned of the gyro's bias; None without an IMU."""
        if self._state is None:
            return GyroBias.initial(self.imu) if self.imu else None
        return self._state.gyro_bias

    @property
    def window(self) -> Window | None:
        """The last frames, adjusted together; None for the two-frame estimator."""
        return None if self._state is None else self._state.window

    def relative(self, frame: int, other: int) -> tuple[FloatArray, FloatArray]:
        """Return the motion T_frame_other between two frames of the window, and its covariance.

        Args:
            frame: index of the frame to which it leads.
            other: index of the frame that it starts from.

        Returns:
            T_frame_other, [4, 4], m, and the covariance of its left perturbation, [6, 6], from the
            joint covariance of all poses of the window.

        Raises:
            InputError: a frame is not in the window, or there is none.
        """
        if self.window is None:
            raise InputError(
                "relative", "there is no window.", "Set estimator to window, and hand in a frame."
            )
        return self.window.relative(self.window.slot(frame), self.window.slot(other))

    @property
    def _features(self) -> StepFeatures:
        if self._state is None:
            return StepFeatures.none(len(self.predictors.columns))
        return self._state.step

    def _first_state(self, frame: Frame) -> OdometryState:
        tracker = tracker_for(frame, self.camera, self._tracking)
        tracked = tracker.track(TrackingState.none(), frame, np.eye(4))
        return OdometryState.at_first_frame(
            frame,
            tracked.state,
            self.imu,
            config=self.config,
            num_columns=len(self.predictors.columns),
            sensor_names=self._sensor_names,
            jitter=self._initial_jitter(),
        )

    def _initial_jitter(self) -> RigJitter:
        """Return what the noise model has learned of the rig's jitter, or else the wide prior."""
        learned = learned_jitter_cov(self.noise)
        if learned is None:
            return RigJitter.initial()
        return RigJitter.initial(learned, LEARNED_FRAMES)

    def _observe(
        self, state: OdometryState, frame: Frame, prediction: Prediction, *, clock: StageClock
    ) -> _Observed:
        """Find the features again, correct them, and compute their predictors."""
        starts = state.motion_model.starts(prediction.duration_s, prediction.motion)
        starts += rotated_starts(prediction.motion, state.frame, frame, self.camera)
        is_frozen = _is_frozen(state, frame, prediction)
        if is_frozen:  # the features have moved on unseen
            tracked = Tracked.nothing(state.tracking)
        else:
            tracked = track_from_best_start(
                tracker_for(frame, self.camera, self._tracking),
                state.tracking,
                with_prepared_images(frame, self._tracking),
                starts=starts,
                camera=self.camera,
                config=self.config,
            )
        clock.lap("track")
        twist_s = None if state.motion_model.speed_is_unknown else state.motion_model.twist_s
        corrected = self._corrected(tracked.tracks, state.rig, twist_s, twist_s)
        if state.rig is not None:
            clock.lap("calibrate")
        tracks = corrected.tracks
        phi = self.predictors(
            Step(
                tracks,
                self.camera,
                prediction.motion.T_curr_prev,
                prev_frame=state.frame,
                curr_frame=frame,
                previous_residuals=state.residuals,
            )
        )
        clock.lap("predict")
        return _Observed(tracked, corrected, phi, is_frozen)

    def _corrected(
        self,
        tracks: Tracks,
        rig: RigCalibration | None,
        prev_twist_s: FloatArray | None,
        curr_twist_s: FloatArray | None,
    ) -> _Corrected:
        """Correct raw tracks by the rig's calibration, and learn of its rows from them.

        Args:
            tracks: as tracked.
            rig: the calibration before this frame.
            prev_twist_s: twist a second at the previous frame, [6]; None if it is not known.
            curr_twist_s: that at this frame.
        """
        if rig is None:
            return _Corrected(simultaneous=tracks, tracks=tracks, rig=None, delay_s=0.0)
        delay_s = 0.0
        simultaneous = tracks
        if prev_twist_s is not None and curr_twist_s is not None:
            delay_s = rig.delay.delay_s
            simultaneous = replace(
                tracks,
                prev_px=without_delay(tracks.prev_px, delay_s, prev_twist_s, self.camera),
                curr_px=without_delay(tracks.curr_px, delay_s, curr_twist_s, self.camera),
            )
        rig = rig.with_rows(simultaneous.curr_px, self.camera)
        corrected = simultaneous.corrected(rig, self.camera)
        return _Corrected(simultaneous, corrected, rig, delay_s)

    def _measure(self, state: OdometryState, frame: Frame, prediction: Prediction) -> _Measured:
        """Ask gyro and sensors.

        The gyro's rotation enters the solve only where the settings say so, and a sensor that has
        been excluded is not asked. Measurements of the motion have a bounded loss there, so that a
        wrong one has no pull.
        """
        prev_frame = state.frame
        if state.is_frozen:  # its images were taken with those of an earlier frame
            prev_frame = replace(prev_frame, left=None, right=None, prepared=None)
        of_motion: list[Measurement] = []
        if prediction.rotation is not None and self.config.gyro.prior:
            of_motion.append(prediction.rotation)
        readings = []
        for name, sensor in zip(self._sensor_names, self.sensors, strict=True):
            if state.fusion.is_excluded(name) or isinstance(sensor, MotionCorrection):
                readings.append(Reading(name))  # a correction is asked once there is a motion
                continue
            reading = read_sensor(name, sensor, prev_frame, frame)
            readings.append(reading)
            for measurement in reading.of_motion(pose_of(frame.index)):
                if isinstance(measurement, VectorMeasurement):
                    measurement = measurement.bounded()
                of_motion.append(measurement)
        return _Measured(of_motion=of_motion, readings=readings)

    def _solve(
        self,
        state: OdometryState,
        frame: Frame,
        prediction: Prediction,
        *,
        observed: _Observed,
        measured: _Measured,
        clock: StageClock,
    ) -> _Solved:
        """Estimate the motion from the tracks and what else was measured of it.

        Where right images are exposed at another time, where they would have been seen depends on
        the motion itself: the tracks are corrected by the motion that was found, and solved again.
        """
        priors = MotionPriors(
            prediction=prediction.motion,
            gyro=prediction.rotation,
            disparities=state.disparities,
            measurements=measured.of_motion,
            curr=pose_of(frame.index),
        )
        solved = self._solve_with_jitter(frame, observed, priors, clock)
        if solved.visual.status is not Status.OK or not is_noticeable(observed.delay_s):
            return solved
        last_twist_s = state.motion_model.twist_s
        twist_s = se3.log(solved.visual.accepted_solution.T_curr_prev) / prediction.duration_s
        # The twist is the mean of a step; at its ends there is half of the change.
        corrected = self._corrected(
            observed.tracked.tracks,
            state.rig,
            0.5 * (last_twist_s + twist_s),
            1.5 * twist_s - 0.5 * last_twist_s,
        )
        observed = replace(observed, corrected=corrected)
        return self._solve_with_jitter(frame, observed, priors, clock)

    def _solve_with_jitter(
        self, frame: Frame, observed: _Observed, priors: MotionPriors, clock: StageClock
    ) -> _Solved:
        """Estimate the motion from the tracks.

        Where the tracks show more jitter of the rig than was expected, they are solved again with
        what they show, as they are in the first frames of a rig that is looser than the prior.
        """
        rig = observed.rig
        jitter_cov = None if rig is None else rig.jitter.cov
        for _ in range(1 + MOST_REPEATED_SOLVES):
            visual = self._visual.estimate(
                observed.tracks,
                observed.phi,
                replace(priors, jitter_cov=jitter_cov),
                rng=np.random.default_rng([self.config.seed, frame.index]),
                clock=clock,
            )
            if rig is None or visual.two_frames_only is None:
                return _Solved(observed, visual, rig=rig, common_mode=np.zeros((6, 3)))
            used = observed.tracks.kept(visual.used)
            updated, common_mode = update_rig(rig, used, visual.two_frames_only, self.camera)
            if not updated.jitter.exceeds(jitter_cov):
                break
            jitter_cov = updated.jitter.cov
        return _Solved(observed, visual, rig=updated, common_mode=common_mode)

    def _recovered(
        self,
        state: OdometryState,
        frame: Frame,
        prediction: Prediction,
        *,
        solved: _Solved,
        clock: StageClock,
    ) -> _Solved:
        """Where a step after a dead-reckoned one has no motion, look for the features of the last
        frame that had one (``estimation.recovery``).

        Returns:
            The motion from that frame, or the step as it was solved. A window with an IMU is left
            to itself.
        """
        usable = state.last_usable
        if (
            usable is None
            or not _reaches(state.window, usable.state.frame)
            or solved.visual.status not in LOST
            or solved.observed.is_frozen
            or usable.path.duration_s + prediction.duration_s > MOST_DURATION_S
        ):
            return solved
        motion = usable.path.predicted(prediction.motion, state.motion_model.path_sensitivity)
        from_usable = replace(
            prediction,
            duration_s=usable.path.duration_s + prediction.duration_s,
            motion=motion,
            gyro=None,
            rotation=None,
        )
        found = self._solve(
            usable.state,
            frame,
            from_usable,
            observed=self._observe(usable.state, frame, from_usable, clock=clock),
            measured=_Measured(of_motion=[], readings=[]),
            clock=clock,
        )
        fewest = INLIERS_FACTOR * self.config.solver.min_tracks
        if found.visual.status is not Status.OK or found.visual.num_inliers < fewest:
            return solved
        frames = state.motion_model.frames_of(from_usable.duration_s)
        return replace(found, recovery=_Recovery(usable, from_usable, noise_factor(frames)))

    def _conclude(
        self,
        state: OdometryState,
        frame: Frame,
        prediction: Prediction,
        *,
        solved: _Solved,
        measured: _Measured,
        clock: StageClock,
    ) -> tuple[MotionEstimate, OdometryState]:
        """Learn from the step, and propagate the pose to this frame.

        Returns:
            The estimate, and the state after the step.
        """
        observed = solved.observed
        visual = solved.visual
        learned = self._learn(state, prediction, solved)
        clock.lap("learn")
        window = None
        fusion = state.fusion
        readings = _readings_used(measured, frame, solved, prediction.window)
        motion, readings = self._correct(state, frame, learned.motion, readings=readings)
        if prediction.window is not None:  # the two-frame motion is where its adjustment starts
            window = self._adjust(
                prediction.window,
                frame,
                motion,
                of_images=learned.motion,
                solved=solved,
                measurements=measured.of_motion,
            )
            motion = live_motion(motion, prediction.window, window)
            fusion = fusion.advanced(live_advance(motion, window))
            clock.lap("window")
        else:
            if solved.recovery is not None:
                motion = solved.recovery.usable.path.closed(motion)
            fusion = fusion.after(motion)
        fusion, outcomes = self._fuse(fusion, frame, solved, readings=readings)
        pose = fusion.pose
        estimate = replace(
            motion,
            T_world_cam=pose.T_world_cam,
            pose_cov=pose.cov,
            sensors=outcomes,
            imu_left_out=inertial.reason_left_out(window),
            stage_ms=clock.times_ms,
        )
        after = OdometryState(
            frame=frame,
            tracking=learned.tracking,
            observations=state.observations.with_frame(observed.for_store(frame, visual)),
            rig=learned.rig,
            gyro_bias=learned.gyro_bias,
            motion_model=learned.motion_model,
            disparities=learned.disparities,
            residuals=learned.residuals,
            fusion=fusion,
            step=StepFeatures(observed.tracks, observed.phi, visual.used, visual.weights),
            is_frozen=observed.is_frozen,
            window=window,
            last_usable=_last_usable(state, prediction, learned.motion),
        )
        return estimate, after

    def _learn(
        self,
        state: OdometryState,
        prediction: Prediction,
        solved: _Solved,
    ) -> _Learned:
        """Take the motion that was solved, or else the predicted one, and learn from it.

        That of a recovery leads from the last usable frame.
        """
        recovery = solved.recovery
        if recovery is not None:
            learned = self._accept(recovery.usable.state, recovery.prediction, solved)
            path_s = recovery.prediction.duration_s
            motion = recovered(learned.motion, recovery.noise_factor)
            return replace(
                learned,
                motion=motion,
                motion_model=state.motion_model.after_recovery(
                    prediction.duration_s, path_s, motion.T_curr_prev, cov=motion.cov
                ),
                residuals=LastResiduals.none(),  # those over several frames are no usual ones
            )
        if solved.visual.status is Status.OK:
            return self._accept(state, prediction, solved)
        return self._dead_reckon(state, prediction, solved.observed, solved.visual)

    def _accept(self, state: OdometryState, prediction: Prediction, solved: _Solved) -> _Learned:
        """Take the solve as the motion, and update gyro bias, rig and motion model by it."""
        observed = solved.observed
        visual = solved.visual
        solution = visual.accepted_solution
        T_curr_prev = solution.T_curr_prev
        gyro_bias = prediction.gyro_bias
        if prediction.gyro is not None and gyro_bias is not None:
            learn = gyro_bias.updated if self.config.gyro.prior else gyro_bias.compared
            gyro_bias = learn(prediction.gyro, T_curr_prev[:3, :3], solution.cov[3:, 3:])
        rig = solved.rig
        if rig is not None and visual.two_frames_only is not None:
            rig = rig.with_delay(
                observed.tracked.tracks.curr_px[visual.used],
                se3.log(T_curr_prev) / prediction.duration_s,
                self.camera,
            )
            if state.rig is not None and rig.delay.differs_from(observed.delay_s):
                # The tracks were those of another delay, and teach nothing but the delay.
                rig = replace(state.rig, delay=rig.delay)
        cov = solution.cov + solved.common_mode @ solved.common_mode.T
        residuals = LastResiduals.none()
        if self.predictors.depends_on_previous_motion:
            residuals = LastResiduals.left_by(observed.tracks, visual.T_reference, self.camera)
        motion = MotionEstimate(
            T_curr_prev=T_curr_prev,
            cov=cov,
            status=visual.status,
            num_tracks=len(observed.tracks),
            num_inliers=visual.num_inliers,
            iterations=visual.num_iterations,
            common_mode=solved.common_mode,
            path_cross_cov=visual.disparities.path_cross_cov,
            num_used=visual.num_used,
            num_out_of_domain=visual.num_out_of_domain,
        )
        return _Learned(
            motion=motion,
            tracking=observed.tracked.state.without(observed.tracks.ids[visual.outliers]),
            rig=rig,
            gyro_bias=gyro_bias,
            motion_model=state.motion_model.after_solve(prediction.duration_s, T_curr_prev, cov),
            disparities=visual.disparities,
            residuals=residuals,
        )

    def _dead_reckon(
        self,
        state: OdometryState,
        prediction: Prediction,
        observed: _Observed,
        visual: VisualMotion,
    ) -> _Learned:
        """Take the predicted motion, with its covariance, where the images fix none."""
        refused = visual.status is Status.NOT_CONVERGED
        is_gap = state.motion_model.is_gap(prediction.duration_s)
        reckoned = state.motion_model.dead_reckoned(
            prediction.motion, visual.solution, refused=refused
        )
        motion = MotionEstimate(
            T_curr_prev=reckoned.T_curr_prev,
            cov=reckoned.cov,
            status=Status.GAP if is_gap else visual.status,
            num_tracks=len(observed.tracks),
            num_inliers=visual.num_inliers,
            iterations=visual.num_iterations,
            path_cross_cov=reckoned.path_cross_cov,
            num_used=visual.num_used,
            num_out_of_domain=visual.num_out_of_domain,
        )
        return _Learned(
            motion=motion,
            tracking=observed.tracked.state,
            rig=observed.rig,
            gyro_bias=prediction.gyro_bias,
            motion_model=state.motion_model.after_dead_reckoning(
                prediction.duration_s, prediction.motion, refused=refused
            ),
            disparities=DisparityFilter.none(),
            residuals=LastResiduals.none(),
        )

    def _correct(
        self,
        state: OdometryState,
        frame: Frame,
        motion: MotionEstimate,
        *,
        readings: list[Reading],
    ) -> tuple[MotionEstimate, list[Reading]]:
        """Return the motion as a correction has it, and what sensors returned with what it did.

        Tracking and motion model go on from the motion of the images: their next step is alike.
        """
        readings = list(readings)
        for at, sensor in enumerate(self.sensors):
            if not isinstance(sensor, MotionCorrection):
                continue
            name = self._sensor_names[at]
            if motion.status is not Status.OK:
                readings[at] = Reading(name, reason="dead-reckoned step")
                continue
            readings[at] = read_correction(
                sensor, (state.frame, frame), motion.T_curr_prev, name=name, cov=motion.cov
            )
            for measurement in readings[at].measurements:
                motion = corrected(motion, measurement)
        return motion, readings

    def _check_corrections(self) -> None:
        """Refuse what a correction cannot be used with.

        Raises:
            InputError: there are several.
        """
        count = sum(isinstance(sensor, MotionCorrection) for sensor in self.sensors)
        if count > 1:
            what = f"{count} of them correct the motion."
            raise InputError("sensors", what, "Take one: it was learned from what it corrects.")

    def _fuse(
        self,
        fusion: SensorFusion,
        frame: Frame,
        solved: _Solved,
        *,
        readings: Sequence[Reading],
    ) -> tuple[SensorFusion, tuple[SensorOutcome, ...]]:
        """Correct the pose by what the sensors measured of it, and test them.

        Without a solve, measurements of the motion have no innovation to test.
        """
        if not self.sensors:
            return fusion, ()
        pose = pose_of(frame.index)
        motion_squared: dict[str, list[float | None]] = {}
        for sensor, reading in zip(self.sensors, readings, strict=True):
            of_motion = reading.of_motion(pose)
            motion_squared[reading.name] = [None] * len(of_motion)
            # A correction has taken the place of the solve, and cannot be tested against it.
            if solved.shows_step and not isinstance(sensor, MotionCorrection):
                solution = solved.visual.accepted_solution
                motion_squared[reading.name] = motion_innovations_squared(
                    of_motion, solution.T_curr_prev, pose, cov=solution.cov
                )
        return fusion.updated(readings, pose, self.config.north, motion_squared=motion_squared)

    def _adjust(
        self,
        window: Window,
        frame: Frame,
        motion: MotionEstimate,
        *,
        of_images: MotionEstimate,
        solved: _Solved,
        measurements: Sequence[Measurement],
    ) -> Window:
        """Adjust the last frames together, starting from the motion that two of them have shown.

        Without a solve, the dead-reckoned motion counts as a measurement, unless there is an IMU
        that knows it better. A corrected one counts beside the features, with which it shares the
        information of the images.

        Args:
            window: the window before the step.
            frame: the new frame.
            motion: the motion that was solved, corrected if there is a correction.
            of_images: the same without the correction.
            solved: what the images show of it.
            measurements: further ones of the motion.
        """
        observed = solved.observed
        visual = solved.visual
        recovery = solved.recovery
        prev = int(window.frames[-1]) if recovery is None else recovery.usable.state.frame.index
        by_itself = RelativePose(
            motion.T_curr_prev,
            motion.cov,
            curr=pose_of(frame.index),
            prev=pose_of(prev),
        )
        if visual.status is not Status.OK or visual.noise is None:
            return self._window.without_features(window, frame.index, by_itself, measurements)
        noise = visual.noise
        if recovery is not None:
            noise = noise.scaled(np.full(len(noise.scale), recovery.noise_factor))
        if motion is not of_images:
            shares = shares_of(of_images, motion, self.config.window.frames)
            noise = noise.scaled(shares.of_features(visual.weights[visual.used]))
            by_itself = by_itself.scaled(shares.motion)
            measurements = [*measurements, by_itself]
        tracks = observed.corrected.simultaneous.kept(visual.used)
        if observed.rig is not None:
            tracks = tracks.with_rows_corrected(observed.rig, self.camera)
        return self._window.with_features(
            inertial.gated(window, by_itself),
            frame.index,
            tracks,
            noise,
            two_frames=by_itself,
            jitter_cov=None if observed.rig is None else observed.rig.jitter.cov,
            measurements=measurements,
        )


def _is_frozen(state: OdometryState, frame: Frame, prediction: Prediction) -> bool:
    """Return whether the images stand still though the camera moves.

    They are the same bytes, or the same but for noise, and the camera was too fast to have come to
    rest within the step. From then on they are frozen until they change.
    """
    if not state.motion_model.is_moving:
        return False
    if is_repeated(state.frame, frame):
        return True
    cannot_rest = prediction.motion.fails_gate(np.eye(4), np.zeros((6, 6)))
    return (state.is_frozen or cannot_rest) and looks_repeated(state.frame, frame)


@dataclass(frozen=True)
class _Corrected:
    """The tracks of a frame, corrected by the rig's calibration."""

    simultaneous: Tracks
    """With right observations as of the time of the left ones, but otherwise raw."""
    tracks: Tracks
    """Corrected by all of the calibration."""
    rig: RigCalibration | None
    """With the rows of this frame's stereo matches."""
    delay_s: float
    """The delay of the right images that was taken off; 0 while the speed is not known."""


@dataclass(frozen=True)
class _Observed:
    """What the images of a frame show, before a motion is estimated."""

    tracked: Tracked
    """Raw."""
    corrected: _Corrected
    phi: FloatArray
    """Places of the tracks in the prediction space, [N, M]."""
    is_frozen: bool
    """Whether the images stand still though the camera moves, so that there are no tracks."""

    @property
    def tracks(self) -> Tracks:
        """The tracks, corrected by the rig's calibration."""
        return self.corrected.tracks

    @property
    def rig(self) -> RigCalibration | None:
        """The calibration, with the rows of this frame's stereo matches."""
        return self.corrected.rig

    @property
    def delay_s(self) -> float:
        """The delay of the right images that was taken off."""
        return self.corrected.delay_s

    def for_store(self, frame: Frame, visual: VisualMotion) -> FrameObservations:
        """Return the raw observations, with the noise that was predicted for those used."""
        return replace(
            self.tracked.state.observations(frame),
            noise=visual.noise,
            noise_landmarks=self.tracks.ids[visual.used],
        )


@dataclass(frozen=True)
class _Solved:
    """The motion of a step, and what its tracks say of the rig."""

    observed: _Observed
    """The tracks as they were solved."""
    visual: VisualMotion
    rig: RigCalibration | None
    """The calibration after the step, but for the delay of the right images."""
    common_mode: FloatArray
    """Columns along which errors of the calibration before the step move the motion, [6, 3]."""
    recovery: _Recovery | None = None
    """If the motion leads from the last usable frame instead of the previous one."""

    @property
    def shows_step(self) -> bool:
        """Whether the images show the motion from the previous frame to this one."""
        return self.visual.status is Status.OK and self.recovery is None


@dataclass(frozen=True)
class _Recovery:
    """Where the motion of a recovered step leads from."""

    usable: LastUsable
    """The last frame with a motion from images."""
    prediction: Prediction
    """From there to the current frame."""
    noise_factor: float
    """Factor of the variance of matches between these two."""


def _reaches(window: Window | None, frame: Frame) -> bool:
    """Return whether a motion from a frame to the next one can enter a window, if there is one."""
    return window is None or (window.inertial is None and frame.index in window.frames)


@dataclass(frozen=True)
class _Measured:
    """What the sensors beside the camera measured."""

    of_motion: list[Measurement]
    """What enters the solve: the gyro's rotation, and what sensors measured of the motion."""
    readings: list[Reading]
    """What each sensor returned."""


def _last_usable(
    state: OdometryState, prediction: Prediction, motion: MotionEstimate
) -> LastUsable | None:
    """Return what later frames may be held against, given the motion that a step ended with."""
    if motion.status in (Status.OK, Status.RECOVERED):
        return None
    usable = state.usable
    return replace(usable, path=usable.path.advanced(prediction.duration_s, motion))


def _readings_used(
    measured: _Measured, frame: Frame, solved: _Solved, window: Window | None
) -> list[Reading]:
    """Return what of the readings was used: of the motion, nothing if it was dead-reckoned.

    The window uses measurements of the motion also where the images fix none.
    """
    if solved.shows_step or window is not None:
        return measured.readings
    pose = pose_of(frame.index)
    used = []
    for reading in measured.readings:
        of_pose = reading.of_pose(pose)
        reason = reading.reason
        if reading.measurements and not of_pose:
            reason = "dead-reckoned step"
        used.append(Reading(reading.name, of_pose, reason))
    return used


@dataclass(frozen=True)
class _Learned:
    """The motion of a step, and the parts of the state that it changes."""

    motion: MotionEstimate
    tracking: TrackingState
    rig: RigCalibration | None
    gyro_bias: GyroBias | None
    motion_model: MotionModel
    disparities: DisparityFilter
    residuals: LastResiduals

"""Stereo odometry, one frame at a time: the whole pipeline in the order of its stages. Read this
first."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from probevo.arrays import BoolArray, FloatArray
from probevo.camera.rig_calibration import RigCalibration
from probevo.camera.rig_jitter import LEARNED_FRAMES, RigJitter
from probevo.camera.rolling_shutter import Twists
from probevo.camera.stereo import StereoCamera
from probevo.config import OdometryConfig
from probevo.errors import InputError
from probevo.estimation.disparity_filter import DisparityFilter
from probevo.estimation.frozen_images import Repetition, repetition_of
from probevo.estimation.landmarks import Landmarks, triangulated
from probevo.estimation.motion_correction import (
    CovarianceIntersection,
    covariance_intersection,
    with_correction,
)
from probevo.estimation.motion_estimate import MotionEstimate, SensorOutcome, Status
from probevo.estimation.search_starts import rotated_starts, track_from_best_start
from probevo.estimation.self_calibration import SelfCalibratingEstimator
from probevo.estimation.sensor_fusion import SensorFusion, solve_innovations
from probevo.estimation.vehicle_parts import fixed_to_vehicle, many_stay
from probevo.estimation.visual_estimator import VisualEstimator
from probevo.estimation.visual_motion import MotionPriors
from probevo.estimation.window.estimator import WindowEstimator
from probevo.estimation.window.inertial import Inertial
from probevo.estimation.window.live_motion import live_motion, live_pose
from probevo.estimation.window.window import Window
from probevo.measurements.base import Measurement
from probevo.measurements.correction import MotionCorrection
from probevo.measurements.gyro import GyroBias
from probevo.measurements.sensor import Reading, Sensor
from probevo.measurements.sensor_suite import SensorSuite
from probevo.measurements.variables import pose_of
from probevo.noise import NoiseModel
from probevo.noise.jitter_array import learned_jitter_cov
from probevo.prediction import Prediction, motion_for_window, predict, velocity_for_window
from probevo.predictors import PredictionSpace, Step, space_for
from probevo.python_arguments import (
    as_camera,
    as_config,
    as_imu,
    as_noise,
    as_predictors,
    as_sensors,
)
from probevo.sequences.frame import Frame
from probevo.sequences.imu_calibration import ImuCalibration
from probevo.sequences.validation import validated
from probevo.stage_clock import StageClock
from probevo.stages import Measured, Observed, Solved
from probevo.state import OdometryState, StepFeatures
from probevo.tracking import Tracked, TrackingState, Tracks, tracker_for
from probevo.tracking.corrected_tracks import CorrectedTracks
from probevo.tracking.last_residuals import LastResiduals
from probevo.tracking.preparation import with_prepared_images


class StereoOdometry:
    """Relative motion of a stereo camera, one frame at a time (PROBE Fig. 1; thesis Fig. 4.1).

    Args:
        camera: the rectified camera, as a sequence gives it.
        noise: noise model of the features, or its name or file; the static Student-t by default.
            One of another camera is an InputError unless ``config.any_camera`` accepts it.
        imu: calibration of the IMU, if frames come with IMU samples.
        config: all settings, or a dictionary of those that differ from the defaults.
        predictors: the prediction space; by default that of the noise model, and any other is an
            InputError.
        sensors: further sensors, each a ``Sensor``, and at most one ``MotionCorrection``.

    Another thread may read its properties while one steps it: each of them is of one step. Several
    that belong together are in ``state``, which no step changes.
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
        self.imu = as_imu(imu)
        self.config = as_config(config)
        if not self.config.any_camera:
            self.noise.check_camera(camera)
        self.predictors = space_for(self.noise.columns, as_predictors(predictors))
        self.sensors: tuple[Sensor | MotionCorrection, ...] = as_sensors(sensors)
        self._suite = SensorSuite(self.sensors)
        predicts_from_motion = (
            bool(self.noise.columns) and self.predictors.depends_on_previous_motion
        )
        self._motion_estimator = SelfCalibratingEstimator(
            camera,
            VisualEstimator(
                camera, self.noise, self.config, predicts_from_motion=predicts_from_motion
            ),
        )
        self._tracker_config = self.config.tracking_of_estimator
        self._window_estimator = WindowEstimator(camera, self.config)
        self._state: OdometryState | None = None

    def step(self, frame: Frame) -> MotionEstimate:
        """Estimate the motion from the previous frame to this one: T_curr_prev with its 6×6
        covariance and a status.

        The first frame yields the identity with zero covariance and status FIRST. If the images do
        not determine the motion, it is dead-reckoned. If anything raises, the odometry is as it was
        before the call.

        Raises:
            InputError: the frame is not later than the previous one, or does not match the camera.
        """
        state = self._state
        frame, missing = validated(frame, self.camera, prev_frame=state.frame if state else None)
        # The first camera is the world; there is no motion yet.
        if state is None:
            self._state = self._first_state(frame)
            return MotionEstimate.first(missing)
        state = state.without_overwritten_images(frame)
        clock = StageClock(decode=frame.decode_ms)
        prediction = predict(state, frame, self.imu)  # from last velocity and gyro
        observed = self._observe(prediction, clock)  # tracking/, predictors/: pixels → tracks → φ
        measured = self._measure(prediction, observed, clock)  # measurements/: gyro, other sensors
        # noise/, estimation/: φ → R → motion
        solved = self._solve_or_recover(observed, measured, clock)
        estimate, after = self._advance(prediction, solved, measured, clock)  # motion → pose
        estimate = replace(estimate, missing=missing + observed.missing)
        # The state changes last, so that a step that raises leaves no trace.
        self._state = after
        return estimate

    @property
    def tracks(self) -> Tracks:
        """The N tracks of the last step, corrected by the rig's calibration."""
        return self._features.tracks

    @property
    def phi(self) -> FloatArray:
        """The predictors φ of these tracks, [N, M]: their places in the prediction space."""
        return self._features.phi

    @property
    def used(self) -> BoolArray:
        """Which of the tracks the solve used, [N]; RANSAC rejected the others."""
        return self._features.used

    @property
    def weights(self) -> FloatArray:
        """Robust weight of each track, [N], from 0 (outlier) to 1."""
        return self._features.weights

    @property
    def tracks_of_vehicle(self) -> Tracks:
        """The tracks of the last step that are fixed to the vehicle, and no part of ``tracks``."""
        return self._features.tracks_of_vehicle

    @property
    def T_curr_prev_before_window(self) -> FloatArray:
        """The motion of the two-frame solve, [4, 4], m: before the window adjusts it, and before
        corrections; the dead-reckoned one if there is no accepted solve.

        Measurements of the motion by sensors, and the gyro with ``gyro.prior``, are part of it.
        """
        return self._features.T_curr_prev

    @property
    def landmarks(self) -> Landmarks:
        """The points that the last solve used, in the current camera's frame, with covariances."""
        state = self._state
        noise = state.observations.frames[-1].noise if state else None
        if state is None or noise is None:
            return Landmarks.none()
        seen = state.features.tracks.subset(state.features.used)
        return triangulated(seen.ids, seen.curr_px, noise, self.camera)

    @property
    def state(self) -> OdometryState | None:
        """Everything the odometry remembers; None before the first frame."""
        return self._state

    @property
    def rig(self) -> RigCalibration | None:
        """The estimated errors of the rectification; None without self-calibration."""
        state = self._state
        return self._initial_rig() if state is None else state.rig

    @property
    def gyro_bias(self) -> GyroBias | None:
        """The estimated bias of the gyro; None without an IMU."""
        state = self._state
        if state is None:
            return GyroBias.initial(self.imu) if self.imu else None
        return state.gyro_bias

    @property
    def window(self) -> Window | None:
        """The last frames, adjusted together; None for the two-frame estimator."""
        state = self._state
        return None if state is None else state.window

    def relative(self, frame: int, other: int) -> tuple[FloatArray, FloatArray]:
        """Return the motion T_frame_other between two frames of the window, and its covariance.

        Args:
            frame: index of the frame at the end of the motion.
            other: index of the frame at its start.

        Returns:
            T_frame_other, [4, 4], m, and the covariance of its left perturbation, [6, 6], from the
            joint covariance of all poses of the window.

        Raises:
            InputError: a frame is not in the window, or there is none.
        """
        window = self.window
        if window is None:
            raise InputError(
                "relative", "there is no window.", "Set estimator to window, and step a frame."
            )
        return window.relative(window.slot(frame), window.slot(other))

    @property
    def _features(self) -> StepFeatures:
        state = self._state
        if state is None:
            return StepFeatures.none(len(self.predictors.columns))
        return state.features

    def _first_state(self, frame: Frame) -> OdometryState:
        tracker = tracker_for(frame, self.camera, self._tracker_config)
        tracked = tracker.track(TrackingState.none(), frame, np.eye(4))
        return OdometryState.at_first_frame(
            frame,
            tracked.state,
            self.imu,
            config=self.config,
            num_columns=len(self.predictors.columns),
            sensor_names=self._suite.names,
            rig=self._initial_rig(),
        )

    def _initial_rig(self) -> RigCalibration | None:
        """Return the prior of the rig's errors, with the jitter learned with the noise model, or
        else a wide one; None without self-calibration."""
        if not self.config.self_calibration:
            return None
        jitter = RigJitter.initial()
        learned = learned_jitter_cov(self.noise)
        if learned is not None:
            jitter = RigJitter.initial(learned, LEARNED_FRAMES)
        return RigCalibration.initial(jitter, self.camera.readout_s)

    def _observe(self, prediction: Prediction, clock: StageClock) -> Observed:
        """Track the features into the frame, correct them for the rig, and compute predictors."""
        state = prediction.state
        frame = prediction.frame
        model = state.motion_model
        repetition = repetition_of(state.frame, frame, model, prediction.shown, self.camera)
        if repetition is Repetition.FROZEN:
            # The camera moves but its images do not change. Tracking them would measure a motion of
            # zero with great confidence, so there are no tracks.
            tracked = Tracked.all_lost(state.tracking)
        else:
            # Usually one start, the prediction. While speed or rotation are unknown there are more.
            starts = model.starts(prediction.duration_s, prediction.motion)
            if frame.features is None:
                frame = with_prepared_images(frame, self._tracker_config)
                starts += rotated_starts(prediction.motion, state.frame, frame, self.camera)
            tracked = track_from_best_start(
                tracker_for(frame, self.camera, self._tracker_config),
                state.tracking,
                (state.frame, frame),
                starts=starts,
                speed_is_unknown=model.speed_is_unknown,
                camera=self.camera,
                config=self.config,
            )
        clock.lap("track")
        # A second search in the same images, from the last usable frame, finds them prepared.
        prediction = replace(prediction, frame=frame)
        return self._describe(prediction, tracked, clock, repetition)

    def _describe(
        self,
        prediction: Prediction,
        tracked: Tracked,
        clock: StageClock,
        repetition: Repetition,
    ) -> Observed:
        """Correct the tracks of the scene for the rig, and compute their predictors."""
        state = prediction.state
        model = state.motion_model
        # Before the solve, the last velocity stands for that at either frame.
        twists = None if model.speed_is_unknown else Twists(model.twist, model.twist)
        # Raw observations stay in the state; only those of this step are corrected, since the
        # calibration improves while a track lives.
        corrected = CorrectedTracks.of(tracked.tracks_of_scene, state.rig, self.camera, twists)
        if state.rig is not None:
            clock.lap("calibrate")
        phi = self.predictors(
            Step(
                corrected.tracks,
                self.camera,
                prediction.motion.T_curr_prev,
                prev_frame=state.frame,
                curr_frame=prediction.frame,
                previous_residuals=state.residuals,
            )
        )
        clock.lap("predict")
        return Observed(prediction, tracked, corrected, phi, repetition)

    def _without_vehicle(self, observed: Observed, solved: Solved, clock: StageClock) -> Observed:
        """Return what is observed without features that are fixed to the vehicle, if a solve may
        have taken these for the scene."""
        tracks = observed.tracked.tracks_of_scene
        if not many_stay(tracks.subset(solved.visual.used)):
            return observed
        prediction = observed.prediction
        fixed_ids = fixed_to_vehicle(
            tracks,
            prediction.state.observations,
            self.camera,
            config=self.config,
            rng=np.random.default_rng((self.config.seed, prediction.frame.index)),
        )
        clock.lap("consensus")
        if not len(fixed_ids):
            return observed
        scene = observed.tracked.with_fixed(fixed_ids)
        return self._describe(prediction, scene, clock, observed.repetition)

    def _measure(self, prediction: Prediction, observed: Observed, clock: StageClock) -> Measured:
        """Collect the measurements of the gyro and of all sensors that are not excluded.

        By default the gyro only predicts; with ``gyro.prior`` its rotation is a measurement, too.
        """
        state = prediction.state
        frame = prediction.frame
        prev_frame = state.frame
        # Images of a frozen frame are copies of an earlier frame's. A sensor that compares images
        # must not take them for those of its stamp.
        if state.is_frozen:
            prev_frame = replace(prev_frame, left=None, right=None, prepared=None)
        if observed.is_frozen:
            frame = replace(frame, left=None, right=None, prepared=None)
        readings = self._suite.read(prev_frame, frame, is_excluded=state.fusion.is_excluded)
        gyro_measurements: list[Measurement] = []
        if prediction.rotation is not None and self.config.gyro.prior:
            gyro_measurements.append(prediction.rotation)
        motion_measurements: list[Measurement] = []
        for reading in readings:
            motion_measurements += reading.motion_measurements(pose_of(frame.index))
        if self.sensors:
            clock.lap("sensors")
        return Measured(gyro_measurements, motion_measurements, readings)

    def _solve_or_recover(
        self, observed: Observed, measured: Measured, clock: StageClock
    ) -> Solved:
        """Estimate the motion from the tracks and from other measurements of it.

        If the tracks are lost right after dead-reckoned steps, search for the features of the last
        usable frame instead (``estimation.recovery``); for a window, also where they are not.
        """
        others = [*measured.gyro_measurements, *measured.motion_measurements]
        solved = self._solve(observed, others, clock)
        # Without features of the vehicle, if they make the camera seem to be at rest
        without_vehicle = self._without_vehicle(observed, solved, clock)
        if without_vehicle is not observed:
            observed = without_vehicle
            solved = self._solve(observed, others, clock)
        # Recovery, where the features are lost. A window connects the last usable frame also with
        # one that is solved from the previous frame.
        state = observed.prediction.state
        is_solved = solved.visual.status is Status.OK
        is_lost = solved.is_lost and state.is_dead_reckoned
        if not (is_lost or (is_solved and state.window is not None)):
            return solved
        recovered = self._solve_from_last_usable(observed.prediction, clock)
        if recovered is None:
            return solved
        if not is_solved:
            return recovered
        # Both velocities are known now, before the outage and after it.
        velocity = state.outage_velocity(
            observed.prediction.duration_s, solved.calibrated.accepted()
        )
        across = recovered.visual.accepted_solution
        if velocity is None or velocity.contradicts(across.T_curr_prev, across.cov):
            return solved
        return replace(solved, reacquired=recovered.tracks_for_window)

    def _solve_from_last_usable(self, prediction: Prediction, clock: StageClock) -> Solved | None:
        """Estimate the motion from the last usable frame to this one; None if too few of its
        features are found again."""
        retry = prediction.from_last_usable()
        if retry is None:
            return None
        since_usable, recovery = retry
        # Sensors measure from the previous frame, not from the last usable one: leave them out.
        found = self._solve(self._observe(since_usable, clock), (), clock)
        fewest = self.config.solver.min_tracks_beyond_chance
        if found.visual.status is not Status.OK or found.visual.num_inliers < fewest:
            return None
        return replace(found, recovery=recovery)

    def _solve(
        self, observed: Observed, others: Sequence[Measurement], clock: StageClock
    ) -> Solved:
        """Reject outliers, predict the noise of each inlier, and solve for the motion."""
        prediction = observed.prediction
        state = prediction.state
        index = prediction.frame.index
        priors = MotionPriors(
            prediction=prediction.motion,
            gyro=prediction.rotation,
            disparities=state.disparities,
            measurements=others,
            curr=pose_of(index),
            noise_factor=state.noise_scale.factor,
        )
        calibrated = self._motion_estimator.estimate(
            observed.corrected_tracks,
            observed.phi,
            priors,
            motion_model=state.motion_model,
            duration_s=prediction.duration_s,
            seed=(self.config.seed, index),
            clock=clock,
        )
        return Solved(observed, calibrated)

    def _advance(
        self, prediction: Prediction, solved: Solved, measured: Measured, clock: StageClock
    ) -> tuple[MotionEstimate, OdometryState]:
        """Update the estimates that a step improves, and propagate the pose to its frame.

        Returns:
            The estimate, and the state after the step.
        """
        state = prediction.state
        # The motion of the two-frame solve, or else dead-reckoned; gyro bias, rig, motion model,
        # disparities.
        step_motion, updated = self._accept_or_dead_reckon(prediction, solved)
        clock.lap("learn")
        corrected, readings = self._correct(prediction, solved, step_motion, measured)
        if self.sensors:
            clock.lap("sensors")
        # The pose: from the window, or by compounding the motion.
        window = None
        if prediction.window is None:
            motion = solved.from_previous_frame(corrected)
            fusion = state.fusion.after(motion)
        else:
            # A corrected motion and the features are from the same images. Inflate both, so that
            # the window does not count the images twice.
            intersection = None
            if any(reading.corrects and reading.measurements for reading in readings):
                intersection = covariance_intersection(
                    step_motion, corrected, self.config.window.frames
                )
            window = self._adjust(
                prediction.window, solved, corrected, intersection=intersection, measured=measured
            )
            motion = live_motion(corrected, prediction.window, window)
            if solved.visual.is_partly_determined and not window.is_blind[-1]:
                # What features leave open, the window knows by the velocity before.
                model = state.motion_model.after_solve(
                    prediction.duration_s, motion.T_curr_prev, motion.cov
                )
                updated = replace(updated, motion_model=model)
            fusion = state.fusion.after(motion, live_pose(window))
            clock.lap("window")
        outcomes: tuple[SensorOutcome, ...] = ()
        if readings:
            fusion, outcomes = self._fuse(fusion, readings, solved, step_motion)
            clock.lap("sensors")
        estimate = replace(
            motion,
            # Copies: the caller may write to them.
            T_world_cam=fusion.pose.T_world_cam.copy(),
            cov_cam_world=fusion.pose.cov.copy(),
            noise_factor=state.noise_scale.factor,
            sensors=outcomes,
            imu_reason=Inertial.of(window).reason,
            stage_ms=clock.times_ms,
        )
        after = replace(
            updated,
            frame=prediction.frame,
            observations=state.observations.with_frame(solved.observations),
            fusion=fusion,
            # The features keep the motion of the two-frame solve.
            features=solved.features(solved.from_previous_frame(step_motion).T_curr_prev),
            is_frozen=solved.observed.is_frozen,
            gyro_period_ns=prediction.gyro_period_ns,
            window=window,
            outage=state.outage_after(
                prediction.duration_s,
                step_motion,
                is_connected=self._is_connected(solved, window),
            ),
        )
        return estimate, after

    def _correct(
        self,
        prediction: Prediction,
        solved: Solved,
        step_motion: MotionEstimate,
        measured: Measured,
    ) -> tuple[MotionEstimate, list[Reading]]:
        """Apply the sensor that corrects the motion, if there is one.

        Returns:
            The motion, corrected if it was; and the readings that apply to the step.
        """
        readings = measured.readings
        # The two-frame estimator has no solve in a dead-reckoned step that the sensors'
        # measurements of the motion could enter; a window always has one.
        if not solved.is_step_solved and prediction.window is None:
            pose = pose_of(prediction.frame.index)
            readings = [reading.without_motion(pose) for reading in readings]
        return with_correction(
            step_motion,
            readings,
            self._suite,
            prev_frame=prediction.state.frame,
            frame=prediction.frame,
        )

    def _fuse(
        self,
        fusion: SensorFusion,
        readings: Sequence[Reading],
        solved: Solved,
        step_motion: MotionEstimate,
    ) -> tuple[SensorFusion, tuple[SensorOutcome, ...]]:
        """Correct the pose by the sensors' measurements of it, and test each sensor."""
        pose = pose_of(solved.prediction.frame.index)
        innovations = solve_innovations(
            readings,
            pose,
            solved.visual.accepted_solution if solved.is_step_solved else None,
            common_mode=solved.calibrated.image_common_mode.columns,
            # A recovered motion is not that of the step, and was solved without the sensors.
            reckoned=step_motion if solved.recovery is None else None,
        )
        return fusion.updated(readings, pose, self.config.north, motion_innovations=innovations)

    def _is_connected(self, solved: Solved, window: Window | None) -> bool:
        """Return whether the window has taken the features of the last usable frame that were found
        again: an adjustment that fails goes on without any."""
        if solved.reacquired is None or window is None:
            return False
        newest = solved.prediction.frame.index
        in_common = window.num_common_landmarks(solved.reacquired.prev, newest)
        return in_common >= self.config.solver.min_tracks_beyond_chance

    def _accept_or_dead_reckon(
        self, prediction: Prediction, solved: Solved
    ) -> tuple[MotionEstimate, OdometryState]:
        """Accept the solved motion and update what depends on it, or else dead-reckon.

        Returns:
            The motion; after a recovery, it is that from the last usable frame. The state with
            tracking, rig, gyro bias, motion model, disparities, residuals and noise scale updated,
            and all else as before the step.
        """
        state = prediction.state
        visual = solved.visual
        tracking = solved.observed.tracked.state
        duration_s = prediction.duration_s
        if visual.status is not Status.OK:
            # Dead reckoning. Disparity filter and residuals start afresh, since both need the
            # motion of every step.
            motion = solved.calibrated.dead_reckoned(
                state.motion_model, prediction.motion, duration_s
            )
            model = state.motion_model.after_dead_reckoning(
                duration_s, prediction.motion, motion.T_curr_prev, is_rejected=visual.is_rejected
            )
            return motion, replace(
                state,
                tracking=tracking,
                rig=solved.calibrated.rig,
                gyro_bias=prediction.gyro_bias,
                motion_model=model,
                disparities=DisparityFilter.none(),
                residuals=LastResiduals.none(),
                noise_scale=state.noise_scale.after(visual.estimated_noise_factor),
            )
        # An accepted solve
        motion = solved.calibrated.accepted()
        gyro_bias = solved.prediction.gyro_bias_after(
            visual.accepted_solution, motion.cov, enters_solve=self.config.gyro.prior
        )
        residuals = LastResiduals.none()
        if solved.recovery is not None:
            # It is several steps long: it gives the mean velocity only, leaves the predictors no
            # residuals of a single step, and has the noise of longer ways over the image.
            motion = solved.recovery.accepted(motion)
            noise_scale = state.noise_scale
            model = state.motion_model.after_recovery(
                duration_s,
                solved.prediction.duration_s,
                motion.T_curr_prev,
                cov=motion.cov,
            )
        else:
            noise_scale = state.noise_scale.after(visual.estimated_noise_factor)
            if solved.observed.repetition is Repetition.AMBIGUOUS:
                model = state.motion_model.after_repetition(duration_s)
            else:
                model = state.motion_model.after_solve(duration_s, motion.T_curr_prev, motion.cov)
            if self.predictors.depends_on_previous_motion:
                residuals = LastResiduals.after_step(solved.tracks, visual.T_reference, self.camera)
        return motion, replace(
            state,
            tracking=tracking.without(solved.tracks.ids[visual.outliers]),
            rig=solved.calibrated.rig,
            gyro_bias=gyro_bias,
            motion_model=model,
            disparities=visual.disparities,
            residuals=residuals,
            noise_scale=noise_scale,
        )

    def _adjust(
        self,
        window: Window,
        solved: Solved,
        step_motion: MotionEstimate,
        *,
        intersection: CovarianceIntersection | None,
        measured: Measured,
    ) -> Window:
        """Adjust the last frames together, starting from the motion of the two-frame solve.

        Args:
            window: the window before the step.
            solved: the two-frame solve.
            step_motion: the motion of that solve, or else dead-reckoned; corrected, if there is a
                correction.
            intersection: how features and corrected motion share the information of their images;
                None without a correction.
            measured: what the sensors measured.
        """
        prediction = solved.prediction
        measurements = list(measured.motion_measurements)
        # The gyro counts once: not beside an IMU of the window, which has its samples, nor beside a
        # dead-reckoned motion, whose rotation is the gyro's.
        if not window.inertial.has_measured and solved.is_step_solved:
            measurements += measured.gyro_measurements
        # What tracks do not show of a step, the velocity before may.
        velocity = None
        if solved.visual.status is not Status.OK:
            velocity = velocity_for_window(window, prediction)
        return self._window_estimator.step(
            window,
            solved.tracks_for_window,
            motion_for_window(window, prediction, step_motion),
            velocity=velocity,
            intersection=intersection,
            measurements=measurements,
            reacquired=solved.reacquired,
        )

"""The whole flow for one frame: read this first."""

from __future__ import annotations

import numpy as np

from probevo.camera.stereo import StereoCamera, check_camera
from probevo.config import OdometryConfig
from probevo.estimation.disparity_filter import DisparityMemory
from probevo.estimation.motion_estimate import MotionEstimate, Status
from probevo.estimation.motion_model import MotionModel
from probevo.estimation.reprojection import RotationPrior
from probevo.estimation.rig_calibration import SelfCalibration
from probevo.estimation.search_starts import track_from_best, turned_starts
from probevo.estimation.two_frame import estimate_motion
from probevo.measurements.gyro import GyroBias, GyroRotation, covers, integrate_gyro
from probevo.noise import NoiseModel, StudentT
from probevo.predictors import PredictionSpace, Step, space_for
from probevo.sequences.frame import Frame, check_frame, check_order, is_repeated
from probevo.sequences.imu_calibration import ImuCalibration
from probevo.stage_clock import StageClock
from probevo.tracking import Tracker, Tracks, tracker_for
from probevo.tracking.last_residuals import LastResiduals


class StereoOdometry:
    """Relative motion of a stereo camera, one frame at a time (PROBE Fig. 1; thesis Fig. 4.1).

    After a step, ``tracks`` holds its N tracks, corrected, ``phi`` their places in the prediction
    space, [N, M], ``used`` which of them were solved with, and ``weights`` how far each was
    trusted, from 0 to 1.

    Args:
        camera: the rectified camera, as a sequence gives it.
        noise: noise model of the features, the static Student-t by default; one of another camera
            is an InputError.
        imu: calibration of the IMU whose samples come with the frames, if they do.
        config: all settings.
        predictors: the prediction space; by default that of the noise model, and any other is an
            InputError.
    """

    def __init__(
        self,
        camera: StereoCamera,
        noise: NoiseModel | None = None,
        imu: ImuCalibration | None = None,
        config: OdometryConfig | None = None,
        predictors: PredictionSpace | None = None,
    ) -> None:
        self.camera = camera
        self.noise = noise or StudentT()
        self.imu = imu
        self.config = config or OdometryConfig()
        check_camera(camera, "camera")
        self.noise.check_camera(camera)
        self.calibration = SelfCalibration.initial() if self.config.self_calibration else None
        self.gyro_bias = GyroBias.initial(imu) if imu else None
        self.predictors = space_for(self.noise.columns, predictors)
        self.tracks = Tracks.none()
        self.phi = np.zeros((0, len(self.predictors.columns)))
        self.used = np.zeros(0, np.bool_)
        self.weights = np.zeros(0)
        self._memory = DisparityMemory.none()
        self._model = MotionModel.at_start(self.config.motion_model)
        self._residuals = LastResiduals.none()
        self._tracker: Tracker | None = None
        self._before: Frame | None = None

    def step(self, frame: Frame) -> MotionEstimate:
        """Motion from the previous frame to this one: T_curr_prev with its 6×6 covariance and a
        status.

        Where it cannot be solved, it is carried on from gyro and last velocity, as unsure as such a
        guess is.

        Raises:
            InputError: the frame is not later than the one before, or not what its camera sees.
        """
        check_frame(frame, self.camera)
        clock = StageClock(decode=frame.decode_ms)
        before = self._before
        if before is None or self._tracker is None:
            self._before = frame
            self._tracker = tracker_for(frame, self.camera, self.config.tracking)
            self._tracker.track(frame, np.eye(4))
            return MotionEstimate(np.eye(4), np.zeros((6, 6)), Status.FIRST, num_tracks=0)
        duration_s = check_order(before, frame)
        gyro = self._integrate_gyro(before.stamp_ns, frame)  # PROBE eqs. (3)-(4)
        rotation = (
            RotationPrior(gyro.C_curr_prev, self.gyro_bias.prior(gyro))
            if gyro and self.gyro_bias
            else None
        )
        expected = self._model.expected(duration_s, rotation)
        starts = self._model.starts(duration_s, expected) + turned_starts(
            expected, before, frame, camera=self.camera
        )
        if self._model.is_moving and is_repeated(
            before, frame
        ):  # frozen: what was followed has gone on unseen
            tracks = Tracks.none()
            self._tracker = tracker_for(frame, self.camera, self.config.tracking)
        else:
            tracks = track_from_best(
                self._tracker, frame, starts, camera=self.camera, config=self.config
            )  # pixels → Tracks
        clock.lap("track")
        if self.calibration:
            self.calibration = self.calibration.with_rows(tracks.curr_px, self.camera)
            tracks = self.calibration.corrected_tracks(tracks, self.camera)
            clock.lap("calibrate")
        phi = self.predictors(
            Step(
                tracks,
                self.camera,
                expected.T_curr_prev,
                before=before,
                now=frame,
                last_residuals=self._residuals,
            )
        )  # [N, M]
        clock.lap("predict")
        known = (expected, rotation, self._memory)
        rng = np.random.default_rng([self.config.seed, frame.index])
        visual = estimate_motion(
            tracks, phi, self.noise, self.camera, *known, self.config, rng, clock
        )
        self.tracks = tracks
        self.phi = phi
        self.used = visual.used
        self.weights = visual.weights
        self._before = frame
        status, shared, refused = (
            visual.status,
            np.zeros((6, 3)),
            visual.status is Status.NOT_CONVERGED,
        )
        if status is Status.OK and visual.solution and visual.alone:
            if gyro and self.gyro_bias:
                learn = (
                    self.gyro_bias.updated if self.config.gyro.prior else self.gyro_bias.compared
                )
                self.gyro_bias = learn(
                    gyro, visual.solution.T_curr_prev[:3, :3], visual.solution.cov[3:, 3:]
                )
            if self.calibration:
                used = tracks.kept(visual.used)
                self.calibration, shared = self.calibration.with_motion(
                    used, visual.alone, self.camera
                )
            T_curr_prev = visual.solution.T_curr_prev
            cov = visual.solution.cov + shared @ shared.T
            self._tracker.drop(tracks.ids[visual.astray])
            tied = visual.memory.path_cross_cov
            self._model = self._model.after_solve(duration_s, T_curr_prev, cov)
        else:
            status = Status.GAP if self._model.is_gap(duration_s) else status
            T_curr_prev, cov, tied = self._model.carried_on(
                expected, visual.solution, refused=refused
            )
            self._model = self._model.after_blind(duration_s, expected, refused=refused)
        self._residuals = LastResiduals.left_by(
            tracks, visual.T_judging if status is Status.OK else None, self.camera
        )
        self._memory = visual.memory
        clock.lap("learn")
        facts = len(tracks), visual.num_trusted, visual.num_iterations, shared, tied, clock.times_ms
        return MotionEstimate(
            T_curr_prev, cov, status, *facts, visual.num_used, visual.num_out_of_domain
        )

    def _integrate_gyro(self, since_ns: int, frame: Frame) -> GyroRotation | None:
        """The gyro's rotation since the last frame, less the bias believed in; None if it does not
        cover that time."""
        if self.imu is None or self.gyro_bias is None:
            return None
        self.gyro_bias = self.gyro_bias.predicted(1e-9 * (frame.stamp_ns - since_ns), self.imu)
        if frame.imu is None or not covers(frame.imu, since_ns, frame.stamp_ns):
            return None
        return integrate_gyro(
            frame.imu,
            since_ns,
            frame.stamp_ns,
            calibration=self.imu,
            bias_rad_s=self.gyro_bias.mean,
        )

"""The whole flow for one frame: read this first."""

from __future__ import annotations

import numpy as np

from probevo.camera.stereo import StereoCamera
from probevo.config import OdometryConfig
from probevo.motion.estimate import MotionEstimate, Status
from probevo.motion.gyro import GyroBias, GyroRotation, integrate_gyro
from probevo.motion.motion_model import MotionModel
from probevo.motion.reprojection import RotationPrior
from probevo.motion.self_calibration import SelfCalibration
from probevo.motion.visual import VisualMotion, estimate_motion
from probevo.noise import NoiseModel, StudentT
from probevo.sequences.frame import Frame, ImuCalibration
from probevo.stage_clock import StageClock
from probevo.tracking import Tracker, Tracks, tracker_for

DROP_BELOW = 0.1
"""Robust weight below which a track is no longer followed."""


class StereoOdometry:
    """Relative motion of a stereo camera, one frame at a time (PROBE Fig. 1; thesis Fig. 4.1).

    Args:
        camera: the rectified camera, as a sequence gives it.
        noise: noise model of the features; the static Student-t by default.
        imu: calibration of the IMU whose samples come with the frames, if they do.
        config: all settings.
    """

    def __init__(
        self,
        camera: StereoCamera,
        noise: NoiseModel | None = None,
        imu: ImuCalibration | None = None,
        config: OdometryConfig | None = None,
    ) -> None:
        self.camera = camera
        self.noise = noise or StudentT()
        self.imu = imu
        self.config = config or OdometryConfig()
        self.calibration = SelfCalibration.initial()
        self.gyro_bias = GyroBias.initial(imu) if imu else None
        self.tracks = Tracks.none()
        """Tracks of the last step, corrected by the self-calibration."""
        self.weights = np.zeros(0)
        """How far each of them was trusted, [N]: 0 for an outlier, at most 1."""
        self._model = MotionModel.at_start(self.config.motion_model)
        self._tracker: Tracker | None = None
        self._stamp_ns = 0

    def step(self, frame: Frame) -> MotionEstimate:
        """Motion from the previous frame to this one: T_curr_prev with its 6×6 covariance and a status.

        The first frame yields the identity with zero covariance and status FIRST. Where the motion cannot be solved, it
        is carried on from the gyro and the last velocity, with the covariance that such a guess deserves.
        """
        clock = StageClock(decode=frame.decode_ms)
        since_ns, self._stamp_ns = self._stamp_ns, frame.stamp_ns
        if self._tracker is None:
            self._tracker = tracker_for(frame, self.camera, self.config.tracking)
            self._tracker.track(frame, np.eye(4))
            return MotionEstimate(np.eye(4), np.zeros((6, 6)), Status.FIRST, 0)

        duration_s = 1e-9 * (frame.stamp_ns - since_ns)
        gyro, rotation = self._integrate_gyro(frame, since_ns)  # PROBE eqs. (3)-(4)
        expected = self._model.expected(duration_s, rotation)
        tracks = self._tracker.track(frame, expected.T_curr_prev)  # pixels → Tracks, the waist of the design
        clock.lap("track")
        self.tracks = self._correct(tracks)
        clock.lap("calibrate")
        predictors = np.zeros((len(self.tracks), 0))  # the prediction space has no columns yet
        rng = np.random.default_rng([self.config.seed, frame.index])
        visual = estimate_motion(
            self.tracks, predictors, self.noise, self.camera, expected, rotation, self.config, rng, clock
        )
        self.weights = visual.weights
        if visual.status is Status.OK and visual.solution is not None:
            T_curr_prev, cov, status = visual.solution.T_curr_prev, visual.solution.cov, Status.OK
            if self.config.self_calibration:
                cov = cov + self.calibration.motion_covariance(visual.solved, visual.solution, self.camera)
            self._model = self._model.after(duration_s, (T_curr_prev, cov))
            self._learn(visual, gyro)
        else:
            T_curr_prev, cov = expected.T_curr_prev, expected.cov
            status = Status.GAP if self._model.is_gap(duration_s) else visual.status
            self._model = self._model.after(duration_s, None)
        clock.lap("learn")
        return MotionEstimate(
            T_curr_prev=T_curr_prev,
            cov=cov,
            status=status,
            num_tracks=len(tracks),
            num_inliers=int((visual.weights >= 0.5).sum()),
            iterations=visual.solution.iterations if visual.solution else 0,
            stage_ms=clock.times_ms,
        )

    def _integrate_gyro(self, frame: Frame, since_ns: int) -> tuple[GyroRotation | None, RotationPrior | None]:
        """The gyro's rotation, and what it is worth with its bias unknown."""
        if frame.imu is None or self.imu is None or self.gyro_bias is None:
            return None, None
        self.gyro_bias = self.gyro_bias.predicted(1e-9 * (frame.stamp_ns - since_ns), self.imu)
        gyro = integrate_gyro(frame.imu, since_ns, frame.stamp_ns, self.imu, self.gyro_bias.mean)
        return gyro, RotationPrior(gyro.C_curr_prev, self.gyro_bias.prior(gyro))

    def _correct(self, tracks: Tracks) -> Tracks:
        if not self.config.self_calibration:
            return tracks
        self.calibration = self.calibration.with_rows(tracks.curr_px, self.camera)
        return self.calibration.corrected_tracks(tracks, self.camera)

    def _learn(self, visual: VisualMotion, gyro: GyroRotation | None) -> None:
        """What a step that worked teaches: which tracks to drop, the calibration, the gyro's bias."""
        if visual.solution is None or self._tracker is None:
            return
        self._tracker.drop(self.tracks.ids[visual.weights < DROP_BELOW])
        if self.config.self_calibration:
            self.calibration = self.calibration.with_motion(visual.solved, visual.solution, self.camera)
        if gyro is not None and self.gyro_bias is not None and self.config.gyro.prior:
            T_curr_prev, cov = visual.solution.T_curr_prev, visual.solution.cov
            self.gyro_bias = self.gyro_bias.updated(gyro, T_curr_prev[:3, :3], cov[3:, 3:])

"""What the last motion lets one predict of the next: where to search, what to dead-reckon with, and
which solves to refuse."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from probevo.arrays import FloatArray
from probevo.config import MotionModelConfig
from probevo.estimation.reprojection import ReprojectionSolution
from probevo.geometry import se3, so3
from probevo.geometry.se3_numba import perturb
from probevo.measurements.relative_rotation import RelativeRotation

INNOVATION_GATE = 60.0
"""Squared Mahalanobis distance of a motion's innovation (six dimensions) beyond which the solve is
refused: about 7σ."""

FASTEST_START = 1.5
"""Fastest forward speed that is tried at the start, in standard deviations of the speed there."""

MAX_REFUSALS = 3
"""Solves that the gate may refuse, with none accepted in between, before the motion model itself is
given up."""

GYRO_MISALIGNMENT_RAD = 0.02
"""Standard deviation of the gyro's axes, and of its scale; its noise is not all there is."""
GYRO_DELAY_S = 0.006
"""Standard deviation of the gyro's clock."""

MOVING_TWIST = np.repeat([0.1, 0.05], 3)
"""Twist, m/s and rad/s, beyond which no two images are alike."""


@dataclass(frozen=True)
class MotionPrediction:
    """Motion over the coming step, before its images are looked at."""

    T_curr_prev: FloatArray
    """[4, 4]."""
    cov: FloatArray
    """Covariance of its left perturbation, [6, 6]. It is more than a gyro's own noise: no solve
    must be refused for the gyro's scale, its clock or how it is mounted."""
    velocity_sensitivity: FloatArray
    """How the velocity's error, [6], in standard deviations, moves it, [6, 6]; a gyro's rotation
    does not depend on it."""
    without_gyro: MotionPrediction | None = None
    """The same from the last velocity alone, where the gyro's rotation is not to refuse a solve."""

    def innovation(self, T_curr_prev: FloatArray) -> FloatArray:
        """Return how far a motion [4, 4] is from the predicted one, as a left perturbation, [6]."""
        return se3.log(T_curr_prev @ se3.inverse(self.T_curr_prev))

    def fails_gate(self, T_curr_prev: FloatArray, cov: FloatArray) -> bool:
        """Return whether a solved motion with its covariance cannot come from this prediction."""
        # A gyro may be the one that is wrong: a solve is refused only if the images contradict the
        # last velocity, too.
        if self.without_gyro is not None and not self.without_gyro.fails_gate(T_curr_prev, cov):
            return False
        innovation = self.innovation(T_curr_prev)
        # Prediction and solve are independent, so that the innovation has the sum of both.
        squared = innovation @ np.linalg.solve(self.cov + cov, innovation)
        return bool(squared > INNOVATION_GATE)


@dataclass(frozen=True)
class DeadReckoning:
    """A motion that the images did not give."""

    T_curr_prev: FloatArray
    """[4, 4]."""
    cov: FloatArray
    """Covariance of its left perturbation, [6, 6]."""
    path_cross_cov: FloatArray
    """As of ``MotionEstimate``, [6, 6]."""


@dataclass(frozen=True)
class MotionModel:
    """Constant velocity in the camera's own frame, disturbed by an acceleration.

    The acceleration may go on as long as there is no solve. Its error is one for all the steps that
    are dead-reckoned, so that their errors are correlated.
    """

    config: MotionModelConfig
    twist_s: FloatArray
    """Log(T_curr_prev) a second, [6], of the last motion that was solved."""
    twist_sigma_s: FloatArray
    """Its standard deviation, [6], m/s and rad/s."""
    usual_step_s: float = 0.0
    """Running mean of the time between frames; 0 before the second."""
    refusals: int = 0
    """Solves that failed the gate, since the last one that passed."""
    path_sensitivity: FloatArray = field(default_factory=lambda: np.zeros((6, 6)))
    """How the error of the velocity has moved the path since the last solve, along the current
    axes, [6, 6]."""

    @staticmethod
    def at_start(config: MotionModelConfig) -> MotionModel:
        """Return the model that knows nothing: any speed that the configuration holds possible."""
        sigma = np.repeat([config.start_speed_m_s, config.start_turn_rate_rad_s], 3)
        return MotionModel(config, twist_s=np.zeros(6), twist_sigma_s=sigma)

    def predict(self, duration_s: float, gyro: RelativeRotation | None) -> MotionPrediction:
        """Predict the motion of the coming step; the rotation is the gyro's where there is one."""
        T_curr_prev = np.empty((4, 4))
        perturb(self.twist_s * duration_s, np.eye(4), T_curr_prev)  # Exp(ξ), compiled
        velocity_sensitivity = np.diag(self._drifted_sigma(duration_s) * duration_s)
        # The stamps of both ends are off, and a longer interval is a longer way.
        stamp_variance = 2.0 * self.config.stamp_sigma_s**2
        cov = velocity_sensitivity**2 + stamp_variance * np.outer(self.twist_s, self.twist_s)
        if gyro is not None:
            # The gyro takes the place of the predicted rotation. A turn of the axes, a wrong scale
            # and a late clock err with the rotation, and with how fast it changes.
            T_curr_prev[:3, :3] = gyro.C_curr_prev
            angle = so3.log(gyro.C_curr_prev)
            change_rad_s = angle / duration_s - self.twist_s[3:]
            unmodelled_rad = GYRO_MISALIGNMENT_RAD * np.linalg.norm(angle) + (
                GYRO_DELAY_S * np.linalg.norm(change_rad_s)
            )
            # Rotation and translation no longer share the errors of the stamps.
            cov[3:] = 0.0
            cov[:, 3:] = 0.0
            cov[3:, 3:] = gyro.cov + unmodelled_rad**2 * np.eye(3)
            velocity_sensitivity[3:] = 0.0
        return MotionPrediction(T_curr_prev, cov, velocity_sensitivity)

    def starts(self, duration_s: float, prediction: MotionPrediction) -> list[FloatArray]:
        """Return the motions, [4, 4] each, from which tracking may have to start.

        While the speed is unknown these are several forward speeds.
        """
        if not self.speed_is_unknown:
            return [prediction.T_curr_prev]
        # Lucas–Kanade finds a feature only from nearby: those of a fast vehicle are lost if their
        # search starts from standstill.
        C_curr_prev = prediction.T_curr_prev[:3, :3]
        speeds_m_s = self.config.start_speed_m_s * np.array([0.0, 0.5, 1.0, FASTEST_START])
        return [
            se3.from_parts(C_curr_prev, np.array([0.0, 0.0, -speed_m_s * duration_s]))
            for speed_m_s in speeds_m_s
        ]

    @property
    def speed_is_unknown(self) -> bool:
        """Whether there is no velocity: at the start, or after the model was given up."""
        return bool(self.twist_sigma_s[2] > 0.5 * self.config.start_speed_m_s)

    @property
    def is_moving(self) -> bool:
        """Whether the last motion that was solved was none of a camera at rest."""
        return bool((np.abs(self.twist_s) > MOVING_TWIST).any())

    def dead_reckoned(
        self,
        prediction: MotionPrediction,
        solution: ReprojectionSolution | None,
        *,
        refused: bool,
    ) -> DeadReckoning:
        """Return what to go on with where a step has no accepted solve: the prediction.

        While the speed is unknown, the prediction would be no motion at all; a solve that is
        determined, but not accepted, is then still the better guess. Where a solve was refused, one
        of the two is wrong, and the covariance covers both.
        """
        T_curr_prev = prediction.T_curr_prev
        cov = prediction.cov
        if solution is not None and refused:
            innovation = prediction.innovation(solution.T_curr_prev)
            cov = cov + np.outer(innovation, innovation)
        if solution is not None and self.speed_is_unknown:
            T_curr_prev = solution.T_curr_prev
        # One unknown velocity moves this step and those before it: their errors are correlated, and
        # a covariance of the path that added up the steps' own would be too small.
        path_before = se3.adjoint(T_curr_prev) @ self.path_sensitivity
        path_cross_cov = path_before @ prediction.velocity_sensitivity.T
        return DeadReckoning(T_curr_prev, cov, path_cross_cov)

    def is_gap(self, duration_s: float) -> bool:
        """Return whether frames are missing in a step that long."""
        return self.usual_step_s > 0.0 and duration_s > self.config.gap_factor * self.usual_step_s

    def frames_of(self, duration_s: float) -> float:
        """Return how many of the usual steps a time has."""
        return duration_s / self.usual_step_s if self.usual_step_s > 0.0 else 1.0

    def after_solve(
        self, duration_s: float, T_curr_prev: FloatArray, cov: FloatArray
    ) -> MotionModel:
        """Return the model after a step that was solved, with T_curr_prev [4, 4] and cov [6, 6]."""
        # A new velocity, independent of what was dead-reckoned before: ``refusals`` and
        # ``path_sensitivity`` start anew.
        return MotionModel(
            self.config,
            twist_s=se3.log(T_curr_prev) / duration_s,
            twist_sigma_s=np.sqrt(np.diagonal(cov)) / duration_s,
            usual_step_s=self._usual_step_after(duration_s),
        )

    def after_recovery(
        self, duration_s: float, path_s: float, T_curr_usable: FloatArray, cov: FloatArray
    ) -> MotionModel:
        """Return the model after a motion over several frames: it shows the mean velocity, and half
        of the change since is unknown.

        Args:
            duration_s: time between the last two frames.
            path_s: time of the whole motion.
            T_curr_usable: the motion, [4, 4].
            cov: its covariance, [6, 6].
        """
        mean = self.after_solve(path_s, T_curr_usable, cov)
        return replace(
            mean,
            twist_sigma_s=mean._drifted_sigma(0.5 * path_s),
            usual_step_s=self._usual_step_after(duration_s),
        )

    def after_dead_reckoning(
        self, duration_s: float, prediction: MotionPrediction, *, refused: bool = False
    ) -> MotionModel:
        """Return the model after a dead-reckoned step: its velocity is one step older.

        ``refused`` says that there was a solve, but that it failed the gate. After several of these
        it is the model that is wrong: it becomes as uncertain as at the start.
        """
        refusals = self.refusals + int(refused)
        path_before = se3.adjoint(prediction.T_curr_prev) @ self.path_sensitivity
        path_sensitivity = path_before + prediction.velocity_sensitivity
        usual_step_s = self._usual_step_after(duration_s)
        # A camera that was picked up, or a wrong first solve: what the images say again and again
        # is right. The twist stays as a guess, but refuses nothing any more.
        if refusals >= MAX_REFUSALS:
            return replace(
                MotionModel.at_start(self.config),
                twist_s=self.twist_s,
                usual_step_s=usual_step_s,
                path_sensitivity=path_sensitivity,
            )
        return MotionModel(
            self.config,
            twist_s=self.twist_s,
            twist_sigma_s=self._drifted_sigma(duration_s),
            usual_step_s=usual_step_s,
            refusals=refusals,
            path_sensitivity=path_sensitivity,
        )

    def _usual_step_after(self, duration_s: float) -> float:
        if self.is_gap(duration_s):  # one long step says nothing of the next ones
            return self.usual_step_s
        if self.usual_step_s == 0.0:
            return duration_s
        return 0.9 * self.usual_step_s + 0.1 * duration_s

    def _drifted_sigma(self, duration_s: float) -> FloatArray:
        """Return the standard deviation of the twist after so much more time, [6]."""
        # An acceleration that goes on moves the velocity in proportion to the time, not to its
        # root: a vehicle that brakes keeps braking.
        acceleration = np.repeat(
            [self.config.acceleration_m_s2, self.config.angular_acceleration_rad_s2], 3
        )
        return self.twist_sigma_s + acceleration * duration_s

"""Constant-velocity motion model: it predicts the next motion for the search of features, for dead
reckoning, and for the gate that rejects wrong solves."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from probevo.arrays import FloatArray
from probevo.config import MotionModelConfig
from probevo.estimation.acceleration_scale import AccelerationScale
from probevo.estimation.reprojection import ReprojectionSolution
from probevo.geometry import se3, so3
from probevo.geometry.se3_numba import perturb
from probevo.geometry.uncertainty import squared_mahalanobis
from probevo.measurements.relative_rotation import RelativeRotation

INNOVATION_GATE = 27.86
"""Squared Mahalanobis distance of a motion's innovation beyond which the solve is rejected: the
99.99 % quantile of χ²(6)."""
GYRO_GATE = 60.0
"""The same where the rotation is a gyro's, about 7σ. A rectification that is off turns all motions
of the images alike, which neither covariance includes, and a gyro is precise enough to show."""

MAX_STAMP_SHARE = 0.05
"""Upper bound of the standard deviation of a stamp, as a share of the time between frames. It
admits motions that are half too long or too short; 5 ms at 30 Hz would also admit a standstill."""

MIN_PREDICTED_SIGMA = 1e-5
"""Smallest standard deviation of a prediction, m and rad. Over a microsecond, that of the motion
would be so small that rounding loses the information of the features."""

UNKNOWN_FROM = 0.5
"""Standard deviation of the forward speed, over that of its prior at the start, above which it
counts as unknown."""

FASTEST_START = 1.5
"""Fastest forward speed that is tried at the start, in standard deviations of its prior."""

SUDDEN_TURN_RAD_S2 = 20.0
"""Standard deviation of the angular acceleration that the gate allows for at any time. A hand-held
camera may turn like that from rest, while a moving object, such as a lorry, looks like a
translation of the camera, hardly like a rotation."""

STEP_SMOOTHING = 0.1
"""Weight of a new step in the running mean of their durations."""
MAX_GAPS = 10
"""Steps in a row that may be gaps, before their duration is taken for that of another frame
rate."""

MAX_REJECTIONS = 3
"""Number of solves that may be rejected, without an accepted one between them, before the motion
model itself is reset: one or two wrong solves in a row are usual behind a passing lorry, and with
more the prediction is the likelier one to be wrong."""

GYRO_MISALIGNMENT_RAD = 0.02
"""Standard deviation of the gyro's mounting and of its scale, which its noise density omits."""
GYRO_DELAY_S = 0.006
"""Standard deviation of the delay between the clocks of gyro and camera."""

MOVING_TWIST = np.repeat([0.1, 0.05], 3)
"""Twist, m/s and rad/s, beyond which successive images must differ."""


@dataclass(frozen=True)
class MotionPrediction:
    """Predicted motion of the next step, before its images are used."""

    T_curr_prev: FloatArray
    """[4, 4]."""
    cov: FloatArray
    """Covariance of its left perturbation, [6, 6]. It includes errors of the gyro's scale, clock
    and mounting beside its noise, so that these do not cause rejections."""
    velocity_sensitivity: FloatArray
    """∂ξ/∂(error of the velocity in standard deviations), [6, 6]. If the rotation is a gyro's, the
    error of its rate is that of the gyro's bias."""
    is_of_gyro: bool = False
    """Whether the rotation is a gyro's."""
    sudden_turn_rad: float = 0.0
    """Standard deviation that a sudden turn adds to the rotation about each axis; 0 if a gyro would
    see it."""
    alternative: MotionPrediction | None = None
    """Another prediction: from the last velocity alone where this one is a gyro's, which may be
    wrong; that of a gyro where it has not been tested. If set, a solve must contradict both
    predictions to be rejected."""

    def innovation(self, T_curr_prev: FloatArray) -> FloatArray:
        """Return the difference of a motion [4, 4] and the prediction, a left perturbation, [6]."""
        return se3.log(T_curr_prev @ se3.inverse(self.T_curr_prev))

    @property
    def gate(self) -> float:
        """Squared Mahalanobis distance beyond which a motion contradicts the prediction."""
        return GYRO_GATE if self.is_of_gyro else INNOVATION_GATE

    def fails_gate(
        self, T_curr_prev: FloatArray, cov: FloatArray, gate: float | None = None
    ) -> bool:
        """Return whether a solved motion differs too much from the prediction, given both
        covariances.

        Args:
            T_curr_prev: the motion, [4, 4].
            cov: its covariance, [6, 6].
            gate: another gate than its own.
        """
        # Either prediction may be the one that is wrong.
        if self.alternative is not None and not self.alternative.fails_gate(T_curr_prev, cov, gate):
            return False
        squared = self.squared_distance(T_curr_prev, self._with_sudden_turn(cov))
        return squared > (self.gate if gate is None else gate)

    def _with_sudden_turn(self, cov: FloatArray) -> FloatArray:
        """Return the covariance of a motion, [6, 6], plus that of a turn that begins suddenly."""
        enlarged = cov.copy()
        enlarged[3:, 3:] += self.sudden_turn_rad**2 * np.eye(3)
        return enlarged

    def agrees(self, T_curr_prev: FloatArray, information: FloatArray) -> bool:
        """Return whether a solved motion passes the gate in the directions that it determines.

        Args:
            T_curr_prev: the motion, [4, 4].
            information: about its left perturbation, [6, 6], which may be singular.
        """
        if self.alternative is not None and self.alternative.agrees(T_curr_prev, information):
            return True
        cov = self._with_sudden_turn(self.cov)
        # In units u of the prediction's standard deviations, with information M of the solve,
        # (1 + M⁻¹)⁻¹ = M (1 + M)⁻¹, which needs no inverse of M.
        root = np.linalg.cholesky(cov)
        u = np.linalg.solve(root, self.innovation(T_curr_prev))
        values, directions = np.linalg.eigh(root.T @ information @ root)
        share = np.maximum(values, 0.0) / (1.0 + np.maximum(values, 0.0))
        return bool(share @ (directions.T @ u) ** 2 <= self.gate)

    def squared_distance(self, T_curr_prev: FloatArray, cov: FloatArray) -> float:
        """Return the squared Mahalanobis distance of the prediction from a motion [4, 4] with
        covariance [6, 6], whose error is independent."""
        innovation = self.innovation(T_curr_prev)
        return float(squared_mahalanobis(innovation, self.cov + cov))


@dataclass(frozen=True)
class DeadReckoning:
    """A predicted motion that stands in for a solve."""

    T_curr_prev: FloatArray
    """[4, 4]."""
    cov: FloatArray
    """Covariance of its left perturbation, [6, 6]."""
    path_cross_cov: FloatArray
    """Cross-covariance of the path's error with that of the step, [6, 6] (``MotionEstimate``)."""


@dataclass(frozen=True)
class MotionModel:
    """Constant velocity in the camera's frame, disturbed by an unknown acceleration.

    Without a solve, the acceleration may last. All dead-reckoned steps depend on the same error of
    the velocity, and of the gyro's bias, so their errors are correlated (``path_sensitivity``).
    """

    config: MotionModelConfig
    twist: FloatArray
    """Log(T_curr_prev) per second of the last solved motion, [6], m/s and rad/s."""
    twist_sigma: FloatArray
    """Its standard deviation in that step, [6], m/s and rad/s."""
    usual_step_s: float = 0.0
    """Running mean of the time between frames; 0 before the second."""
    gaps: int = 0
    """Steps in a row that were gaps: many of them are another frame rate."""
    rejections: int = 0
    """Solves that were rejected since the last accepted one."""
    path_sensitivity: FloatArray = field(default_factory=lambda: np.zeros((6, 6)))
    """∂(path error)/∂(error of the velocity) since the last solve, along the axes of the current
    camera, [6, 6]."""
    unseen_s: float = 0.0
    """Time of the last steps if their images repeated, so that the camera may have moved."""
    is_after_repetition: bool = False
    """Whether the last solved motion followed such steps, so that its duration is not known."""
    since_solve_s: float = 0.0
    """Time of the dead-reckoned steps since the last solve."""
    acceleration_scale: AccelerationScale = field(default_factory=AccelerationScale)
    """How large the accelerations of this rig are, against those of the settings."""

    @staticmethod
    def at_start(config: MotionModelConfig) -> MotionModel:
        """Return the model before the first motion: at rest, with the wide prior of the
        settings."""
        sigma = np.repeat([config.start_speed_m_s, config.start_turn_rate_rad_s], 3)
        return MotionModel(config, twist=np.zeros(6), twist_sigma=sigma)

    def predict(
        self,
        duration_s: float,
        gyro: RelativeRotation | None,
        bias_sensitivity: FloatArray | None = None,
    ) -> MotionPrediction:
        """Predict the motion of the next step; with a gyro, the rotation is the gyro's.

        Args:
            duration_s: time between the two frames.
            gyro: the gyro's rotation, whose covariance includes that of its bias.
            bias_sensitivity: ∂(left perturbation of that rotation)/∂(error of the gyro's bias in
                standard deviations), [3, 3]; None if the bias is known.
        """
        T_curr_prev = np.empty((4, 4))
        perturb(self.twist * duration_s, np.eye(4), T_curr_prev)  # Exp(ξ), compiled
        velocity_sensitivity = np.diag(self._drifted_sigma(duration_s) * duration_s)
        cov = velocity_sensitivity**2 + self._cov_by_stamps(duration_s)
        if gyro is not None:
            # The gyro replaces the predicted rotation. Errors of its mounting and its scale grow
            # with the rotation, those of its clock with the change of the rate.
            T_curr_prev[:3, :3] = gyro.C_curr_prev
            angle = so3.log(gyro.C_curr_prev)
            change_rad_s = angle / duration_s - self.twist[3:]
            unmodelled_rad = GYRO_MISALIGNMENT_RAD * np.linalg.norm(angle) + (
                GYRO_DELAY_S * np.linalg.norm(change_rad_s)
            )
            # The rotation no longer depends on the stamps: drop its cross-covariance.
            cov[3:] = 0.0
            cov[:, 3:] = 0.0
            cov[3:, 3:] = gyro.covariance + unmodelled_rad**2 * np.eye(3)
            # No step without a solve improves the bias: its error is the same in all of them.
            velocity_sensitivity[3:] = 0.0
            if bias_sensitivity is not None:
                velocity_sensitivity[3:, 3:] = bias_sensitivity
        return MotionPrediction(
            T_curr_prev,
            cov + MIN_PREDICTED_SIGMA**2 * np.eye(6),
            velocity_sensitivity,
            is_of_gyro=gyro is not None,
            sudden_turn_rad=0.0 if gyro is not None else SUDDEN_TURN_RAD_S2 * duration_s**2,
        )

    def change_cov(self, duration_s: float) -> FloatArray:
        """Return the covariance of the next motion, given that of the step before: of the
        acceleration between them, [6, 6].

        Args:
            duration_s: time between the two frames.
        """
        change = (self._drifted_sigma(duration_s) - self.twist_sigma) * duration_s
        return np.diag(change**2 + MIN_PREDICTED_SIGMA**2) + self._cov_by_stamps(duration_s)

    def twist_change_cov(self, duration_s: float) -> FloatArray:
        """Return the covariance of how the velocity changes within the next step, given how the
        mean velocity changes from the last step to that one, [6, 6], (m/s)² and (rad/s)².

        Such changes differ from step to step by about as much as they usually amount to, and both
        means have their noise.

        Args:
            duration_s: time between the two frames.
        """
        usual = self.acceleration_scale.usual_factors * self._configured_accelerations * duration_s
        noise = np.hypot(self.twist_sigma, MIN_PREDICTED_SIGMA / duration_s)
        return np.diag(usual**2 + 2.0 * noise**2)

    def _cov_by_stamps(self, duration_s: float) -> FloatArray:
        """Return the covariance that errors of the stamps give a predicted motion, [6, 6]."""
        # Errors of both stamps change the length of the interval, and so the distance. An error
        # δt of it has the variance 2 σ², and moves the motion by δt times the twist.
        stamp_sigma_s = min(self.config.stamp_sigma_s, MAX_STAMP_SHARE * duration_s)
        cov: FloatArray = 2.0 * stamp_sigma_s**2 * np.outer(self.twist, self.twist)
        return cov

    def starts(self, duration_s: float, prediction: MotionPrediction) -> list[FloatArray]:
        """Return the motions, [4, 4] each, to start tracking from.

        Usually this is the prediction. While the speed is unknown, it is several forward speeds.
        """
        if not self.speed_is_unknown:
            return [prediction.T_curr_prev]
        # Lucas–Kanade converges only from nearby. From a start at rest, it loses the features of a
        # fast vehicle.
        C_curr_prev = prediction.T_curr_prev[:3, :3]
        speeds_m_s = self.config.start_speed_m_s * np.array([0.0, 0.5, 1.0, FASTEST_START])
        return [
            se3.from_parts(C_curr_prev, np.array([0.0, 0.0, -speed_m_s * duration_s]))
            for speed_m_s in speeds_m_s
        ]

    @property
    def speed_is_unknown(self) -> bool:
        """Whether there is hardly an estimate of the velocity: at the start, after a reset, or
        after seconds of dead reckoning."""
        return bool(self._drifted_sigma(0.0)[2] > UNKNOWN_FROM * self.config.start_speed_m_s)

    @property
    def is_moving(self) -> bool:
        """Whether the camera moved in the last solved step."""
        return bool((np.abs(self.twist) > MOVING_TWIST).any())

    def dead_reckoned(
        self,
        prediction: MotionPrediction,
        solution: ReprojectionSolution | None,
        *,
        is_rejected: bool,
    ) -> DeadReckoning:
        """Return the motion of a step without an accepted solve: the prediction.

        While the speed is unknown, the prediction tells little, and even a rejected solve is a
        better guess. If a solve was rejected, either may be wrong, so the covariance covers both.
        """
        T_curr_prev = prediction.T_curr_prev
        cov = prediction.cov
        if solution is not None and is_rejected:
            # ν νᵀ: one standard deviation reaches from the prediction to the solve.
            innovation = prediction.innovation(solution.T_curr_prev)
            cov = cov + np.outer(innovation, innovation)
        if solution is not None and self.speed_is_unknown:
            T_curr_prev = solution.T_curr_prev
        # The same error of the velocity, or of the gyro's bias, is in this step and in the
        # dead-reckoned ones before. Without this cross-covariance, the covariance of the path would
        # be too small.
        path_before = se3.adjoint(T_curr_prev) @ self.path_sensitivity
        path_cross_cov = path_before @ prediction.velocity_sensitivity.T
        return DeadReckoning(T_curr_prev, cov, path_cross_cov)

    def is_gap(self, duration_s: float) -> bool:
        """Return whether a step is so long that frames must be missing."""
        return self.usual_step_s > 0.0 and duration_s > self.config.gap_factor * self.usual_step_s

    def frames_of(self, duration_s: float) -> float:
        """Return a time in units of the usual step."""
        return duration_s / self.usual_step_s if self.usual_step_s > 0.0 else 1.0

    def after_solve(
        self, duration_s: float, T_curr_prev: FloatArray, cov: FloatArray
    ) -> MotionModel:
        """Return the model after a step that was solved, with T_curr_prev [4, 4] and cov [6, 6].

        A step gives its mean velocity. Over missing frames, the velocity at its end differs by half
        of the change over that time, which is unknown.
        """
        after = self._after_mean_velocity(duration_s, T_curr_prev, cov)
        if not self.is_gap(duration_s):
            return after
        return replace(after, twist_sigma=after._drifted_sigma(0.5 * duration_s))

    def _after_mean_velocity(
        self, duration_s: float, T_curr_prev: FloatArray, cov: FloatArray
    ) -> MotionModel:
        """Return the model after a solved motion, with its mean velocity."""
        # The new velocity is independent of earlier dead reckoning, so ``rejections`` and
        # ``path_sensitivity`` are reset.
        twist = se3.log(T_curr_prev) / duration_s
        twist_sigma = np.sqrt(np.diagonal(cov)) / duration_s
        if self.unseen_s > 0.0:
            # The motion happened in this step, or since the images began to repeat: take the mean
            # of both velocities.
            slower = se3.log(T_curr_prev) / (duration_s + self.unseen_s)
            twist_sigma = np.hypot(twist_sigma, 0.5 * (twist - slower))
            twist = 0.5 * (twist + slower)
        # A motion within a microsecond tells less of the velocity than the prior does.
        prior = MotionModel.at_start(self.config)
        is_known = twist_sigma < prior.twist_sigma
        twist = np.where(is_known, twist, prior.twist)
        twist_sigma = np.where(is_known, twist_sigma, prior.twist_sigma)
        scale = self.acceleration_scale
        if not self.speed_is_unknown:
            scale = scale.after(
                twist - self.twist,
                twist_sigma**2 + self.twist_sigma**2,
                accelerations=self._configured_accelerations,
                duration_s=duration_s + self.since_solve_s,
            )
        rate = self._with_step(duration_s)
        return MotionModel(
            self.config,
            twist=twist,
            twist_sigma=twist_sigma,
            usual_step_s=rate.usual_step_s,
            gaps=rate.gaps,
            is_after_repetition=self.unseen_s > 0.0,
            acceleration_scale=scale,
        )

    def without_velocity(self) -> MotionModel:
        """Return the model with a velocity that is as unknown as at the start."""
        return replace(
            MotionModel.at_start(self.config),
            usual_step_s=self.usual_step_s,
            gaps=self.gaps,
            acceleration_scale=self.acceleration_scale,
        )

    def after_repetition(self, duration_s: float) -> MotionModel:
        """Return the model after a step whose images repeat those before: the camera rests, or has
        moved on unseen."""
        unknown = self._with_step(duration_s).without_velocity()
        return replace(unknown, unseen_s=self.unseen_s + duration_s)

    def after_recovery(
        self, duration_s: float, path_s: float, T_curr_usable: FloatArray, cov: FloatArray
    ) -> MotionModel:
        """Return the model after a solved motion over several frames, which gives a mean velocity;
        see ``after_solve``.

        Args:
            duration_s: time between the last two frames.
            path_s: time of the whole motion.
            T_curr_usable: the motion, [4, 4].
            cov: its covariance, [6, 6].
        """
        # A mean velocity tells little of the accelerations, so that their scale stays.
        mean = replace(
            self._after_mean_velocity(path_s, T_curr_usable, cov),
            acceleration_scale=self.acceleration_scale,
        )
        rate = self._with_step(duration_s)
        return replace(
            mean,
            twist_sigma=mean._drifted_sigma(0.5 * path_s),
            usual_step_s=rate.usual_step_s,
            gaps=rate.gaps,
        )

    def after_dead_reckoning(
        self,
        duration_s: float,
        prediction: MotionPrediction,
        T_curr_prev: FloatArray,
        *,
        is_rejected: bool = False,
    ) -> MotionModel:
        """Return the model after a dead-reckoned step: same velocity, larger uncertainty.

        Args:
            duration_s: time between the two frames.
            prediction: what was predicted of its motion.
            T_curr_prev: its motion, [4, 4]: the prediction, or a rejected solve.
            is_rejected: whether a solve was rejected. After MAX_REJECTIONS without an
                accepted one between them, the model itself is taken to be wrong, and becomes as
                uncertain as at the start.
        """
        rejections = self.rejections + int(is_rejected)
        path_before = se3.adjoint(T_curr_prev) @ self.path_sensitivity
        path_sensitivity = path_before + prediction.velocity_sensitivity
        rate = self._with_step(duration_s)
        # The camera was picked up, say, or the first solve was wrong. Solves that contradict the
        # model again and again are right. Keep the twist as a guess, but let it reject nothing.
        if rejections >= MAX_REJECTIONS:
            return replace(
                rate.without_velocity(), twist=self.twist, path_sensitivity=path_sensitivity
            )
        return replace(
            rate,
            rejections=rejections,
            path_sensitivity=path_sensitivity,
            since_solve_s=self.since_solve_s + duration_s,
        )

    def _with_step(self, duration_s: float) -> MotionModel:
        """Return the model with the usual step and the gaps after a step of this duration."""
        if self.is_gap(duration_s) and self.gaps < MAX_GAPS:
            # Missing frames do not change the frame rate.
            return replace(self, gaps=self.gaps + 1)
        usual_step_s = (1.0 - STEP_SMOOTHING) * self.usual_step_s + STEP_SMOOTHING * duration_s
        if self.usual_step_s == 0.0 or self.is_gap(duration_s):
            usual_step_s = duration_s
        return replace(self, usual_step_s=usual_step_s, gaps=0)

    def _drifted_sigma(self, duration_s: float) -> FloatArray:
        """Return the standard deviation of the twist after a further time, [6]."""
        # The velocity drifts in proportion to time, not to its square root as in a random walk: a
        # vehicle that brakes keeps braking.
        return self.twist_sigma + self.accelerations * (self.since_solve_s + duration_s)

    @property
    def accelerations(self) -> FloatArray:
        """Standard deviations of this rig's accelerations, [6], m/s² and rad/s²."""
        accelerations: FloatArray = self.acceleration_scale.factors * self._configured_accelerations
        return accelerations

    @property
    def _configured_accelerations(self) -> FloatArray:
        """Standard deviations of the accelerations by the settings, [6], m/s² and rad/s²."""
        return np.repeat(
            [self.config.acceleration_m_s2, self.config.angular_acceleration_rad_s2], 3
        )

"""What the last motion lets one expect of the next: where to look, what to carry on with, what not
to believe."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from probevo.arrays import FloatArray
from probevo.config import MotionModelConfig
from probevo.estimation.reprojection import ReprojectionSolution, RotationPrior
from probevo.geometry import se3, so3

ABSURD = 60.0
"""Squared Mahalanobis length of a motion's surprise (six dimensions) beyond which it is not
believed: about 7σ."""

FASTEST_START = 1.5
"""Fastest forward speed that a start is tried with, in standard deviations of the speed at start.
"""

MAX_REFUSALS = 3
"""Solves that the belief may refuse, with none believed in between, before it is given up itself.
"""

ASKEW_RAD = 0.02
LATE_S = 0.006
"""Standard deviations of how far a gyro's axes, or its scale, are off, and its clock; its noise is
not all there is."""

MOVING = np.repeat([0.1, 0.05], 3)
"""Twist, m/s and rad/s, beyond which no two images are alike."""


@dataclass(frozen=True)
class ExpectedMotion:
    """Motion over the coming step, before its images are looked at."""

    T_curr_prev: FloatArray
    """[4, 4]."""
    cov: FloatArray
    """Covariance of its left perturbation, [6, 6]. It is more than a gyro's own noise: no solve
    must be refused for the gyro's scale, its clock or how it is mounted."""
    of_velocity: FloatArray
    """How the velocity's error, [6], in standard deviations, moves it, [6, 6]; a gyro's rotation it
    does not turn."""

    def surprise(self, T_curr_prev: FloatArray) -> FloatArray:
        """How far a motion [4, 4] is from it, as a left perturbation, [6]."""
        return se3.log(T_curr_prev @ se3.inverse(self.T_curr_prev))

    def is_absurd(self, T_curr_prev: FloatArray, cov: FloatArray) -> bool:
        """Whether a solved motion and its covariance cannot come from what was expected."""
        surprise = self.surprise(T_curr_prev)
        return bool(surprise @ np.linalg.solve(self.cov + cov, surprise) > ABSURD)


@dataclass(frozen=True)
class MotionModel:
    """Constant velocity in the camera's own frame, disturbed by an acceleration that may go on as
    long as we are blind.

    Its error is then one for all the steps that are carried on, so that they stray together.
    """

    config: MotionModelConfig
    twist_s: FloatArray
    """Log(T_curr_prev) a second, [6], of the last motion that was solved."""
    twist_sigma_s: FloatArray
    """Its standard deviation, [6], m/s and rad/s."""
    usual_step_s: float = 0.0
    """Running mean of the time between frames; 0 before the second."""
    refusals: int = 0
    """Solves that were not believed, since the last one that was."""
    strayed: FloatArray = field(default_factory=lambda: np.zeros((6, 6)))
    """How the error of the velocity has moved the path since the last solve, along the current
    axes, [6, 6]."""

    @staticmethod
    def at_start(config: MotionModelConfig) -> MotionModel:
        """Nothing is known: any speed that the configuration holds possible."""
        sigma = np.repeat([config.start_speed_m_s, config.start_turn_rate_rad_s], 3)
        return MotionModel(config, np.zeros(6), sigma)

    def expected(self, duration_s: float, gyro: RotationPrior | None) -> ExpectedMotion:
        """Motion over the coming step; the rotation is the gyro's where there is one."""
        T_curr_prev = se3.exp(self.twist_s * duration_s)
        of_velocity = np.diag(self._drifted_sigma(duration_s) * duration_s)
        cov = of_velocity**2 + 2.0 * self.config.stamp_sigma_s**2 * np.outer(
            self.twist_s, self.twist_s
        )
        if gyro is not None:
            T_curr_prev[:3, :3] = gyro.C_curr_prev
            felt = so3.log(gyro.C_curr_prev)
            change_rad_s = felt / duration_s - self.twist_s[3:]
            untold_rad = ASKEW_RAD * np.linalg.norm(felt) + LATE_S * np.linalg.norm(change_rad_s)
            cov[3:] = 0.0
            cov[:, 3:] = 0.0
            of_velocity[3:] = 0.0
            cov[3:, 3:] = gyro.cov + untold_rad**2 * np.eye(3)
        return ExpectedMotion(T_curr_prev, cov, of_velocity)

    def starts(self, duration_s: float, expected: ExpectedMotion) -> list[FloatArray]:
        """Motions, [4, 4] each, from which tracking may have to start: several forward speeds while
        none is known."""
        if not self.speed_is_unknown:
            return [expected.T_curr_prev]
        speeds_m_s = self.config.start_speed_m_s * np.array([0.0, 0.5, 1.0, FASTEST_START])
        return [
            se3.from_parts(expected.T_curr_prev[:3, :3], np.array([0.0, 0.0, -v * duration_s]))
            for v in speeds_m_s
        ]

    @property
    def speed_is_unknown(self) -> bool:
        """Whether there is no velocity to go by: at the start, or after a belief was given up."""
        return bool(self.twist_sigma_s[2] > 0.5 * self.config.start_speed_m_s)

    @property
    def is_moving(self) -> bool:
        """Whether the last motion that was solved was none of a camera at rest."""
        return bool((np.abs(self.twist_s) > MOVING).any())

    def carried_on(
        self, expected: ExpectedMotion, solution: ReprojectionSolution | None, *, refused: bool
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """What to go on with if a step is not believed: T_curr_prev, its covariance, and
        ``MotionEstimate.path_cross_cov``.

        It is the motion expected. While no speed is known, that would be none at all; a solve that
        is determined, but not believed, is then still the better guess. Where a solve was refused,
        one of the two is wrong, and the covariance holds both.
        """
        T_curr_prev = expected.T_curr_prev
        cov = expected.cov
        if solution is not None and refused:
            surprise = expected.surprise(solution.T_curr_prev)
            cov = cov + np.outer(surprise, surprise)
        if solution is not None and self.speed_is_unknown:
            T_curr_prev = solution.T_curr_prev
        return T_curr_prev, cov, se3.adjoint(T_curr_prev) @ self.strayed @ expected.of_velocity.T

    def is_gap(self, duration_s: float) -> bool:
        """Whether frames are missing in a step that long."""
        return self.usual_step_s > 0.0 and duration_s > self.config.gap_factor * self.usual_step_s

    def after_solve(
        self, duration_s: float, T_curr_prev: FloatArray, cov: FloatArray
    ) -> MotionModel:
        """The belief after a step that was solved, with T_curr_prev [4, 4] and cov [6, 6]."""
        sigma = np.sqrt(np.diagonal(cov)) / duration_s
        return MotionModel(
            self.config,
            se3.log(T_curr_prev) / duration_s,
            sigma,
            usual_step_s=self._usual_after(duration_s),
        )

    def after_blind(
        self, duration_s: float, expected: ExpectedMotion, *, refused: bool = False
    ) -> MotionModel:
        """The belief after a step that was carried on: one step older.

        ``refused`` says that there was a solve, but not a believable one. After several of these it
        is the belief that is wrong: it becomes as unsure as at the start.
        """
        usual = self._usual_after(duration_s)
        refusals = self.refusals + int(refused)
        strayed = se3.adjoint(expected.T_curr_prev) @ self.strayed + expected.of_velocity
        if refusals >= MAX_REFUSALS:
            start = MotionModel.at_start(self.config)
            return replace(start, twist_s=self.twist_s, usual_step_s=usual, strayed=strayed)
        return MotionModel(
            self.config,
            self.twist_s,
            self._drifted_sigma(duration_s),
            usual_step_s=usual,
            refusals=refusals,
            strayed=strayed,
        )

    def _usual_after(self, duration_s: float) -> float:
        if self.is_gap(duration_s):
            return self.usual_step_s
        return (
            duration_s if self.usual_step_s == 0.0 else 0.9 * self.usual_step_s + 0.1 * duration_s
        )

    def _drifted_sigma(self, duration_s: float) -> FloatArray:
        """Standard deviation of the twist after so much more time, [6]."""
        acceleration = np.repeat(
            [self.config.acceleration_m_s2, self.config.angular_acceleration_rad_s2], 3
        )
        return self.twist_sigma_s + acceleration * duration_s

"""What the last motion lets one expect of the next: where to look, what to carry on with, what not to believe."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from probevo.arrays import FloatArray
from probevo.config import MotionModelConfig
from probevo.geometry import se3
from probevo.motion.reprojection import ReprojectionSolution, RotationPrior

ABSURD = 60.0
"""Squared Mahalanobis length of a motion's surprise (six dimensions) beyond which it is not believed: about 7σ."""

FASTEST_START = 1.5
"""Fastest forward speed that a start is tried with, in standard deviations of the speed at start."""

MAX_REFUSALS = 3
"""Solves in a row that the belief may refuse before it is given up itself."""


@dataclass(frozen=True)
class ExpectedMotion:
    """Motion over the coming step, before its images are looked at."""

    T_curr_prev: FloatArray
    """[4, 4]."""
    cov: FloatArray
    """Covariance of its left perturbation, [6, 6]."""

    def is_absurd(self, T_curr_prev: FloatArray, cov: FloatArray) -> bool:
        """Whether a solved motion and its covariance cannot come from what was expected."""
        surprise = se3.log(T_curr_prev @ se3.inverse(self.T_curr_prev))
        return bool(surprise @ np.linalg.solve(self.cov + cov, surprise) > ABSURD)


@dataclass(frozen=True)
class MotionModel:
    """Constant velocity in the camera's own frame, disturbed by white acceleration."""

    config: MotionModelConfig
    twist_s: FloatArray
    """Log(T_curr_prev) a second, [6], of the last motion that was solved."""
    twist_sigma_s: FloatArray
    """Its standard deviation, [6], m/s and rad/s."""
    usual_step_s: float = 0.0
    """Running mean of the time between frames; 0 before the second."""
    refusals: int = 0
    """Solves in a row that were not believed."""

    @staticmethod
    def at_start(config: MotionModelConfig) -> MotionModel:
        """Nothing is known: any speed that the configuration holds possible."""
        sigma = np.repeat([config.start_speed_m_s, config.start_turn_rate_rad_s], 3)
        return MotionModel(config, np.zeros(6), sigma)

    def expected(self, duration_s: float, gyro: RotationPrior | None) -> ExpectedMotion:
        """Motion over the coming step; the rotation is the gyro's where there is one."""
        T_curr_prev = se3.exp(self.twist_s * duration_s)
        cov = np.diag((self._drifted_sigma(duration_s) * duration_s) ** 2)
        if gyro is not None:
            T_curr_prev[:3, :3] = gyro.C_curr_prev
            cov[3:, 3:] = gyro.cov
        return ExpectedMotion(T_curr_prev, cov)

    def starts(self, duration_s: float, expected: ExpectedMotion) -> list[FloatArray]:
        """Motions, [4, 4] each, from which tracking may have to start: several forward speeds while none is known."""
        if not self.speed_is_unknown:
            return [expected.T_curr_prev]
        speeds_m_s = self.config.start_speed_m_s * np.array([0.0, 0.5, 1.0, FASTEST_START])
        return [se3.from_parts(expected.T_curr_prev[:3, :3], np.array([0.0, 0.0, -v * duration_s])) for v in speeds_m_s]

    @property
    def speed_is_unknown(self) -> bool:
        """Whether there is no velocity to go by: at the start, or after a belief was given up."""
        return bool(self.twist_sigma_s[2] > 0.5 * self.config.start_speed_m_s)

    def carried_on(self, expected: ExpectedMotion, solution: ReprojectionSolution | None) -> FloatArray:
        """T_curr_prev, [4, 4], to go on with if a step is not believed: the expected one.

        While no speed is known, that would be none at all; a solve that is determined, but not believed, is then still
        the better guess.
        """
        if solution is None or not self.speed_is_unknown:
            return expected.T_curr_prev
        return solution.T_curr_prev

    def is_gap(self, duration_s: float) -> bool:
        """Whether frames are missing in a step that long."""
        return self.usual_step_s > 0.0 and duration_s > self.config.gap_factor * self.usual_step_s

    def after(
        self, duration_s: float, solved: tuple[FloatArray, FloatArray] | None, *, refused: bool = False
    ) -> MotionModel:
        """The belief after a step: that of the solved T_curr_prev [4, 4] and cov [6, 6], or one step older for None.

        ``refused`` says that there was a solve, but not a believable one. After several of these in a row it is the
        belief that is wrong: it becomes as unsure as at the start.
        """
        usual = self.usual_step_s
        if not self.is_gap(duration_s):
            usual = duration_s if usual == 0.0 else 0.9 * usual + 0.1 * duration_s
        if solved is not None:
            T_curr_prev, cov = solved
            sigma = np.sqrt(np.diagonal(cov)) / duration_s
            return MotionModel(self.config, se3.log(T_curr_prev) / duration_s, sigma, usual)
        refusals = self.refusals + int(refused)
        if refusals >= MAX_REFUSALS:
            return replace(MotionModel.at_start(self.config), twist_s=self.twist_s, usual_step_s=usual)
        return MotionModel(self.config, self.twist_s, self._drifted_sigma(duration_s), usual, refusals)

    def _drifted_sigma(self, duration_s: float) -> FloatArray:
        """Standard deviation of the twist after so much more time, [6]."""
        acceleration = np.repeat([self.config.acceleration_m_s2, self.config.angular_acceleration_rad_s2], 3)
        drifted: FloatArray = np.hypot(self.twist_sigma_s, acceleration * duration_s)
        return drifted

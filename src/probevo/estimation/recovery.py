"""Recovery: from the last frame with a motion to the first that shows its features again.

Black, frozen or blurred frames are dead-reckoned, and the features are lost in them. What was seen
in the last usable frame u may be found again in the current frame k, though. In a window, whose
landmarks are found again so, these observations connect k with u. Two frames give T_k_u with a
covariance S, and with the dead-reckoned T_{k−1}_u the step

    T_k_{k−1} = T_k_u T_{k−1}_u⁻¹,    ξ = ξ_k_u − Ad(T_k_{k−1}) ξ_{k−1}_u.

The step itself is no better known than where the previous frame was, but the path is: the errors of
the dead reckoning go out again, which their cross-covariance with the step says.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from probevo.arrays import FloatArray
from probevo.estimation.motion_estimate import MotionEstimate, Status
from probevo.estimation.motion_model import MotionPrediction
from probevo.geometry import se3

INLIERS_FACTOR = 2
"""How many times the inliers of another step a recovery needs: of the few that survive, those that
agree by chance have chosen the motion. With fewer, one in six was far outside of its covariance."""
FRAMES_OF_NOISE = 2.0
"""Frames over which matches are as good as the noise model says. Over more, their variance is taken
to grow with the number of frames: on spoiled recordings, the NEES of a recovery did."""
MOST_DURATION_S = 3.0
"""Time after which the last usable frame is given up: a car has then left what it showed."""
LOST = (Status.TOO_FEW_TRACKS, Status.DEGENERATE)
"""What a step is whose features were lost. One that was refused has features, which contradict the
prediction or one another, and would do so from any other frame."""


@dataclass(frozen=True)
class DeadReckonedPath:
    """The dead-reckoned motion from the last usable frame to the last frame."""

    duration_s: float
    T_prev_usable: FloatArray
    """[4, 4]."""
    cov: FloatArray
    """Covariance of its left perturbation, [6, 6]."""

    @staticmethod
    def none() -> DeadReckonedPath:
        """Return the path at the last usable frame itself."""
        return DeadReckonedPath(0.0, np.eye(4), np.zeros((6, 6)))

    def advanced(self, duration_s: float, motion: MotionEstimate) -> DeadReckonedPath:
        """Return the path after one more step that was dead-reckoned."""
        return DeadReckonedPath(
            duration_s=self.duration_s + duration_s,
            T_prev_usable=motion.T_curr_prev @ self.T_prev_usable,
            cov=self._grown(motion.T_curr_prev, motion.cov, motion.path_cross_cov),
        )

    def predicted(
        self, prediction: MotionPrediction, path_sensitivity: FloatArray
    ) -> MotionPrediction:
        """Predict the motion from the last usable frame to the current one.

        Args:
            prediction: of the step from the previous frame to the current one.
            path_sensitivity: how the error of the velocity has moved the path so far, [6, 6], as
                of the motion model.
        """
        # One unknown velocity has moved the path before and moves this step: both sensitivities,
        # along the current axes, add up, and the two errors are correlated.
        T_curr_prev = prediction.T_curr_prev
        velocity = prediction.velocity_sensitivity
        before = se3.adjoint(T_curr_prev) @ path_sensitivity
        return MotionPrediction(
            T_curr_prev=T_curr_prev @ self.T_prev_usable,
            cov=self._grown(T_curr_prev, prediction.cov, before @ velocity.T),
            velocity_sensitivity=before + velocity,
        )

    def closed(self, motion: MotionEstimate) -> MotionEstimate:
        """Return the step from the previous frame, given the motion from the last usable one."""
        # The error of the dead reckoning is part of the step with the opposite sign: variances add
        # up in the step, and its negative cross-covariance takes them out of the path.
        T_curr_prev = motion.T_curr_prev @ se3.inverse(self.T_prev_usable)
        adjoint = se3.adjoint(T_curr_prev)
        reckoned = adjoint @ self.cov @ adjoint.T
        return replace(
            motion,
            T_curr_prev=T_curr_prev,
            cov=motion.cov + reckoned,
            path_cross_cov=motion.path_cross_cov - reckoned,
        )

    def _grown(
        self, T_curr_prev: FloatArray, cov: FloatArray, path_cross_cov: FloatArray
    ) -> FloatArray:
        adjoint = se3.adjoint(T_curr_prev)
        grown: FloatArray = adjoint @ self.cov @ adjoint.T + cov + path_cross_cov + path_cross_cov.T
        return grown


@dataclass(frozen=True)
class Recovery:
    """A motion that leads from the last usable frame instead of the previous one."""

    path: DeadReckonedPath
    """From the last usable frame to the previous one."""
    noise_factor: float
    """Factor of the variance of matches between the last usable frame and the current one."""

    def accepted(self, motion: MotionEstimate) -> MotionEstimate:
        """Return the motion from the last usable frame under the variance of such matches."""
        # Errors of the calibration are the same however far apart the frames are.
        own = motion.cov - motion.common_mode @ motion.common_mode.T
        cov = motion.cov + (self.noise_factor - 1.0) * own
        return replace(motion, cov=cov, status=Status.RECOVERED)


def noise_factor(frames: float) -> float:
    """Return the factor of the variance of matches over a number of frames
    (``FRAMES_OF_NOISE``)."""
    return max(1.0, frames / FRAMES_OF_NOISE)

"""Recovery: the motion from the last usable frame to the first frame that sees its features again.

Black, frozen or blurred frames are dead-reckoned, and tracks end in them. The features of the last
usable frame u may be found again in the current frame k, though. In a window, these observations
connect k with u. With two frames, they give T_k_u with covariance S; together with the
dead-reckoned T_{k−1}_u, the step is

    T_k_{k−1} = T_k_u T_{k−1}_u⁻¹,    ξ = ξ_k_u − Ad(T_k_{k−1}) ξ_{k−1}_u.

The step is as uncertain as the dead-reckoned pose of the previous frame. The path is not: the error
of the dead reckoning is in the step with the opposite sign, and cancels. The cross-covariance of
path and step expresses that.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from probevo.arrays import FloatArray
from probevo.estimation.motion_estimate import MotionEstimate, Status
from probevo.estimation.motion_model import MotionModel, MotionPrediction
from probevo.geometry import se3
from probevo.geometry.uncertainty import MOTIONS_DIFFER_FROM, advance_cov

FRAMES_OF_NOISE = 2.0
"""Number of frames over which the noise model holds for matches. Over more, their variance grows in
proportion to the number of frames, as the NEES of recoveries did on degraded recordings."""
MAX_DURATION_S = 3.0
"""Time after which the last usable frame is given up: a car has then passed what it showed."""
STATUSES_WITHOUT_FEATURES = (Status.TOO_FEW_TRACKS, Status.DEGENERATE)
"""Status of a step whose features were lost. A rejected solve is not among them: its features
contradict the prediction or each other, and would do so from any other frame."""


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
        """Return the path after one more dead-reckoned step."""
        return DeadReckonedPath(
            duration_s=self.duration_s + duration_s,
            T_prev_usable=motion.T_curr_prev @ self.T_prev_usable,
            cov=advance_cov(self.cov, motion.T_curr_prev, motion.cov, motion.path_cross_cov),
        )

    def predicted(
        self, prediction: MotionPrediction, path_sensitivity: FloatArray
    ) -> MotionPrediction:
        """Predict the motion from the last usable frame to the current one.

        Args:
            prediction: of the step from the previous frame to the current one.
            path_sensitivity: ∂(path)/∂(error of the velocity) so far, [6, 6], of the motion model.
        """
        # The same error of the velocity is in the path before and in this step. Along the current
        # axes, both sensitivities add up, and the two errors are correlated.
        T_curr_prev = prediction.T_curr_prev
        velocity = prediction.velocity_sensitivity
        before = se3.adjoint(T_curr_prev) @ path_sensitivity
        return MotionPrediction(
            T_curr_prev=T_curr_prev @ self.T_prev_usable,
            cov=advance_cov(self.cov, T_curr_prev, prediction.cov, before @ velocity.T),
            velocity_sensitivity=before + velocity,
        )

    def closed(self, motion: MotionEstimate) -> MotionEstimate:
        """Return the step from the previous frame, given the motion from the last usable one."""
        # The error of the dead reckoning is in the step with the opposite sign. It adds to the
        # covariance of the step; the negative cross-covariance removes it from that of the path.
        T_curr_prev = motion.T_curr_prev @ se3.inverse(self.T_prev_usable)
        adjoint = se3.adjoint(T_curr_prev)
        reckoned = adjoint @ self.cov @ adjoint.T
        return replace(
            motion,
            T_curr_prev=T_curr_prev,
            cov=motion.cov + reckoned,
            path_cross_cov=motion.path_cross_cov - reckoned,
        )


@dataclass(frozen=True)
class OutageVelocity:
    """Mean velocity during dead-reckoned steps between two solved ones, whose velocities are known.

    It is the mean of both, up to the accelerations of the vehicle. A motion across the outage that
    contradicts it is not the camera's: a lorry that covers the view may be seen before and after
    the outage, too.
    """

    duration_s: float
    """Duration of the dead-reckoned steps."""
    mean_twist: FloatArray
    """Mean of the velocities before and after them, [6], m/s and rad/s."""
    sigma: FloatArray
    """Standard deviation of the mean velocity in between, [6]."""
    T_curr_end: FloatArray
    """Motion from the last dead-reckoned frame to the current one, solved, [4, 4]."""

    @staticmethod
    def between(
        path: DeadReckonedPath, before: MotionModel, motion: MotionEstimate, duration_s: float
    ) -> OutageVelocity:
        """Return the mean velocity before a solved step.

        Args:
            path: the dead-reckoned one.
            before: the motion model at its start.
            motion: the step after it.
            duration_s: time of that step.
        """
        twist = se3.log(motion.T_curr_prev) / duration_s
        sigma = np.sqrt(np.diagonal(motion.cov)) / duration_s
        unknown = before.accelerations * (path.duration_s + duration_s)
        if before.speed_is_unknown:
            return OutageVelocity(path.duration_s, twist, sigma + unknown, motion.T_curr_prev)
        # With a constant acceleration, the mean of both is right. One that is new in the middle,
        # and ends with the same velocity, moves it by half of what it might alone.
        return OutageVelocity(
            path.duration_s,
            mean_twist=0.5 * (before.twist + twist),
            sigma=0.5 * (before.twist_sigma + sigma + unknown),
            T_curr_end=motion.T_curr_prev,
        )

    def advanced(self, T_curr_prev: FloatArray) -> OutageVelocity:
        """Return the same after one more solved step, [4, 4]."""
        return replace(self, T_curr_end=T_curr_prev @ self.T_curr_end)

    def contradicts(self, T_curr_usable: FloatArray, cov: FloatArray) -> bool:
        """Return whether a motion from the last usable frame to the current one cannot be that of
        the camera.

        Args:
            T_curr_usable: the motion, [4, 4].
            cov: its covariance, [6, 6].
        """
        # Both at the end of the outage: E (Exp(ξ) T) = Exp(Ad(E) ξ) E T.
        T_end_curr = se3.inverse(self.T_curr_end)
        across = se3.log(T_end_curr @ T_curr_usable)
        adjoint = se3.adjoint(T_end_curr)
        cov_across = adjoint @ cov @ adjoint.T
        difference = across / self.duration_s - self.mean_twist
        variance = self.sigma**2 + np.diagonal(cov_across) / self.duration_s**2
        return bool((difference**2 / variance).sum() > MOTIONS_DIFFER_FROM)


@dataclass(frozen=True)
class Recovery:
    """A motion that leads from the last usable frame instead of the previous one."""

    path: DeadReckonedPath
    """From the last usable frame to the previous one."""
    span_factor: float
    """Factor by which the variance of matches over so many frames exceeds the noise model."""

    def accepted(self, motion: MotionEstimate) -> MotionEstimate:
        """Return the motion from the last usable frame, with the covariance that such matches
        have."""
        # Errors of the calibration are the same however far apart the frames are.
        cov = motion.cov + (self.span_factor - 1.0) * motion.own_cov
        return replace(motion, cov=cov, status=Status.RECOVERED)


def span_factor(frames: float) -> float:
    """Return the factor of the variance of matches over a number of frames
    (``FRAMES_OF_NOISE``)."""
    return max(1.0, frames / FRAMES_OF_NOISE)

"""The change of the camera's velocity in a step, as a rolling shutter shows it.

Where the velocity at a frame moves what is seen (``camera.rolling_shutter``), its change c between
the two frames is one more unknown of the step: rows near the top and the bottom of the images agree
with those in the middle for the right one only. Its prior is that of the motion model, c ~ N(c₀,
Q): the change from the last step to this one, c₀, is off by what such changes differ from step to
step.

One Gauss–Newton step of the joint normal equations of motion and change (``JointEquations``) gives
c and its covariance Σ_c. The motion is solved for a given change; what is left unknown of that
moves it by H⁻¹ C, so that its covariance gets the term (H⁻¹ C) Σ_c (H⁻¹ C)ᵀ. Where the calibration
of the rig is updated (``estimation.rig_update``), the change is eliminated like the motion.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from probevo.arrays import FloatArray
from probevo.estimation.joint_equations import JointEquations
from probevo.estimation.reprojection import ReprojectionSolution


class ChangeUnknown(NamedTuple):
    """The change of the velocity as an unknown of a step with N tracks."""

    value: FloatArray
    """c by which the tracks were corrected, [6], m/s and rad/s."""
    sensitivity: FloatArray
    """D = ∂e/∂c, [N, 4, 6], px/(m/s) and px/(rad/s)."""
    prior_mean: FloatArray
    """c₀, [6]."""
    prior_cov: FloatArray
    """Q, [6, 6]."""

    @property
    def prior_information(self) -> FloatArray:
        """Q⁻¹, [6, 6]."""
        return np.linalg.inv(self.prior_cov).astype(float)

    @property
    def prior_gradient(self) -> FloatArray:
        """Gradient of the logarithm of the prior, [6]."""
        gradient: FloatArray = self.prior_information @ (self.prior_mean - self.value)
        return gradient


class VelocityChange(NamedTuple):
    """The estimated change of the velocity in a step."""

    mean: FloatArray
    """c, [6], m/s and rad/s."""
    cov: FloatArray
    """Σ_c, [6, 6]."""
    motion_cov: FloatArray
    """What is unknown of it adds this to the covariance of the motion, [6, 6]."""


def estimate_change(unknown: ChangeUnknown, solution: ReprojectionSolution) -> VelocityChange:
    """Estimate the change of the velocity by one Gauss–Newton step.

    Args:
        unknown: the change by which the tracks were corrected, and its prior.
        solution: the motion from these two frames alone.
    """
    eliminated = JointEquations.of(unknown.sensitivity, solution).solved()
    cov = np.linalg.inv(eliminated.information + unknown.prior_information).astype(float)
    motion_gain = eliminated.gain[:6]
    return VelocityChange(
        mean=unknown.value + cov @ (eliminated.gradient + unknown.prior_gradient),
        cov=cov,
        motion_cov=np.asarray(motion_gain @ cov @ motion_gain.T, np.float64),
    )

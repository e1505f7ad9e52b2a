"""EM of the rig's jitter over the steps of a drive.

In each frame the right camera is rotated by ω ~ N(0, S) (``camera.rig_jitter``). The E-step solves
for the jitter η of both frames of a step at its motion, whose uncertainty is propagated to η. Two
frames determine only the change ω' − ω° well; its covariance is 2 S, so the M-step is

    S = ½ · mean of E[(ω' − ω°)(ω' − ω°)ᵀ]

over all steps. A step without information about the jitter has the expectation 2 S, and keeps S.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.rig_jitter import MIN_SIGMA_RAD, RigJitter
from probevo.estimation.reprojection import SolvedJitter
from probevo.estimation.two_frame import TwoFrameEstimate

MOTION_DIM = 6


class CommonUnknowns(NamedTuple):
    """The unknowns that are common to all features of a step: the motion, the rig's jitter, and the
    latent errors of the disparities."""

    jacobian: FloatArray
    """Derivative of the prediction by (ξ, η, c), [N, 4, K]; K is 6 for ξ, and 6 more for each of η
    and c, if the noise has a jitter and a time-correlated error."""
    mean: FloatArray
    """Mean of (ξ, η, c) beside the solution, [K]: 0 but for c, and what it changes of η."""
    cov: FloatArray
    """Covariance of (ξ, η, c), [K, K]."""

    @staticmethod
    def of(estimate: TwoFrameEstimate, motion_cov: FloatArray) -> CommonUnknowns:
        """Build them from an estimate at a given motion, and the motion's covariance, [6, 6]."""
        if estimate.common is not None:
            return CommonUnknowns(*estimate.common)
        solution = estimate.solution
        if solution.jitter is None:
            return CommonUnknowns(solution.features.jacobian, np.zeros(MOTION_DIM), motion_cov)
        # η = gain ξ + an independent rest. With G the gain, C the covariance of ξ and V the rest's,
        # the joint covariance is [[C, C Gᵀ], [G C, V + G C Gᵀ]].
        gain, rest = _given_motion(solution.jitter)
        cross = gain @ motion_cov
        cov = np.block([[motion_cov, cross.T], [cross, rest + cross @ gain.T]])
        return CommonUnknowns(solution.full_jacobian, np.zeros(len(cov)), cov)

    def second_moment(self, jitter: SolvedJitter) -> FloatArray:
        """Return E[(ω' − ω°)(ω' − ω°)ᵀ] of the jitter's change, [3, 3], rad²."""
        unknown = jitter.unknown
        # ω' − ω° = L' η' − (m + L° η°): E[Δ Δᵀ] is its mean squared plus its covariance.
        change = np.hstack([unknown.curr_root, -unknown.prev.root])
        jitter_block = slice(MOTION_DIM, MOTION_DIM + len(jitter.eta))
        mean = change @ (jitter.eta + self.mean[jitter_block]) - unknown.prev.mean
        moment: FloatArray = np.outer(mean, mean)
        return moment + change @ self.cov[jitter_block, jitter_block] @ change.T


def learned_covariance(second_moments: FloatArray) -> FloatArray:
    """Return S, [3, 3], rad², from the second moments of at least one change, [K, 3, 3]: M-step."""
    cov: FloatArray = 0.5 * second_moments.mean(axis=0)
    cov = 0.5 * (cov + cov.T)
    return cov + MIN_SIGMA_RAD**2 * np.eye(3)


def initial_covariance() -> FloatArray:
    """Return the initial S, [3, 3], rad²: the prior for unknown rigs."""
    return RigJitter.initial().cov


def _given_motion(jitter: SolvedJitter) -> tuple[FloatArray, FloatArray]:
    """Return dη/dξ, [6, 6], and the covariance of η at a known motion, [6, 6].

    If the features do not determine the motion, η keeps its prior N(0, I), whatever the motion.
    """
    cov = jitter.cov
    if not np.isfinite(cov).all():
        return np.zeros((6, MOTION_DIM)), np.eye(6)
    # Condition the joint Gaussian on ξ: the gain is Σ_ηξ Σ_ξξ⁻¹, and what remains of the covariance
    # is Σ_ηη − Σ_ηξ Σ_ξξ⁻¹ Σ_ξη.
    motion_cov = cov[:MOTION_DIM, :MOTION_DIM]
    cross = cov[:MOTION_DIM, MOTION_DIM:]
    gain: FloatArray = np.linalg.solve(motion_cov, cross).astype(float).T
    return gain, cov[MOTION_DIM:, MOTION_DIM:] - gain @ cross

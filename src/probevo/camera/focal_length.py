"""Estimate of the focal length's error, from images in which the camera turns.

On a straight path, a wrong focal length only scales the motion, which is unobservable. A yaw ψ
moves a point at x = (u − c_u)/f_u by f (1 + x²) ψ: the part that is the same for all x gives f ψ,
the other one gives ψ. With f_true = f e^ε, the residuals of a step are off by 2 ε f x² ψ.

In a curve, disparity errors have a similar effect, so ε is estimated jointly with them: each
accepted step adds its information on θ = (b₁, b₂, ε), with b of ``rig_calibration``. Motion and
jitter of the rig are eliminated by a Schur complement (``estimation.rig_update``). The focal length
is not corrected; this estimate is only reported. It is that of tracks without the distortion field
(``camera.distortion_field``), which would take up most of the error. What the covariance of a
motion contains of ε is that beside such a field (``camera.image_errors``).

Remaining lens distortion looks like a wrong focal length, too, and images cannot distinguish the
two (docs/degradation.md).

Errors of features are correlated, within a frame and over frames. The covariance of θ is therefore
also estimated from the scatter of blocks of frames (a sandwich estimator); the larger σ counts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from probevo.arrays import FloatArray

PRIOR_SIGMA = np.array([1.0, 1.0, 0.1])
"""Prior standard deviation of (b₁, b₂, ε): px, px, and a ratio."""
DIM = 3
FOCAL = 2
"""Index of ε."""
CORRELATED_RESIDUALS = 20.0
"""Number of features whose residuals count as one, as many as ``CORRELATED_FEATURES`` in
``camera.rig_calibration``."""
NOTICEABLE = 0.01
"""Smallest |ε| that is reported: path length and rotations are off by about this ratio."""
MAX_BY_LENSES = 0.04
"""|ε| that remaining lens distortion can cause: up to 0.035 on KITTI, whose focal length is right
within a percent according to the true rotations."""
MIN_EXCESS = 2.0
"""Smallest excess over ``MAX_BY_LENSES`` in units of σ that is warned of."""
MIN_RATIO = 3.0
"""Smallest |ε| in units of σ that is reported."""
FIRST_BLOCK_FRAMES = 5
"""Frames of the first blocks."""
MAX_BLOCKS = 32
"""Largest number of blocks. Then pairs of blocks are merged, and further blocks have twice as many
frames, so that memory stays constant."""


@dataclass(frozen=True)
class FocalLengthEstimate:
    """A Gaussian estimate of ε, jointly with the disparity errors that resemble it."""

    information: FloatArray
    """Λ_b of each block of frames, [B, 3, 3]."""
    moment: FloatArray
    """η_b of each block, [B, 3]: the sum of gradient + Λ θ₀, where the tracks were corrected by
    θ₀."""
    block_frames: int = FIRST_BLOCK_FRAMES
    """Frames of a block."""
    last_frames: int = FIRST_BLOCK_FRAMES
    """Frames in the last block."""

    @staticmethod
    def initial() -> FocalLengthEstimate:
        """Return the estimate without any frame."""
        return FocalLengthEstimate(np.zeros((0, DIM, DIM)), np.zeros((0, DIM)))

    def with_step(
        self, information: FloatArray, gradient: FloatArray, corrected_by: FloatArray
    ) -> FocalLengthEstimate:
        """Update the estimate with the normal equations of a step.

        Args:
            information: on θ, [3, 3], with the motion eliminated.
            gradient: of the log-likelihood by θ, [3], at the values that the tracks have.
            corrected_by: θ by which the tracks were corrected, [3].
        """
        # The θ₀ of tracks changes from step to step. Moments about zero can be added up: the step
        # is likeliest at θ₀ + Λ⁻¹ gradient, so that its η = Λ θ₀ + gradient.
        moment = gradient + information @ corrected_by
        # Add it to the last block, until that is full.
        if self.last_frames < self.block_frames:
            informations = self.information.copy()
            moments = self.moment.copy()
            informations[-1] += information
            moments[-1] += moment
            return replace(
                self, information=informations, moment=moments, last_frames=self.last_frames + 1
            )
        # Begin a block; if there is no room for it, merge the others in pairs first.
        full = self._with_half_as_many_blocks() if len(self.moment) == MAX_BLOCKS else self
        return FocalLengthEstimate(
            information=np.concatenate([full.information, information[None]]),
            moment=np.concatenate([full.moment, moment[None]]),
            block_frames=full.block_frames,
            last_frames=1,
        )

    def _with_half_as_many_blocks(self) -> FocalLengthEstimate:
        return FocalLengthEstimate(
            information=self.information.reshape(-1, 2, DIM, DIM).sum(axis=1),
            moment=self.moment.reshape(-1, 2, DIM).sum(axis=1),
            block_frames=2 * self.block_frames,
            last_frames=2 * self.block_frames,
        )

    def error(self) -> FocalLengthError:
        """Return ε and its standard deviation."""
        # Posterior mean and model covariance of θ, with the information of correlated features.
        prior = np.diag(PRIOR_SIGMA**-2.0)
        information = self.information / CORRELATED_RESIDUALS
        moment = self.moment / CORRELATED_RESIDUALS
        cov = np.linalg.inv(information.sum(axis=0) + prior)
        theta = cov @ moment.sum(axis=0)
        # Sandwich: the influence of each block on ε is its gradient at the estimate, times the row
        # of ε in the covariance. The sum of their squares is the variance of ε by the scatter of
        # the blocks; the prior, which is no sample, adds its own share.
        influence = (moment - information @ theta) @ cov[FOCAL]
        shares = np.einsum("i,bij,j->b", cov[FOCAL], information, cov[FOCAL])
        prior_share = float(cov[FOCAL] @ prior @ cov[FOCAL])
        scatter = prior_share + float(np.sum(influence**2)) * _small_sample_factor(shares)
        variance = max(float(cov[FOCAL, FOCAL]), scatter)
        return FocalLengthError(float(theta[FOCAL]), float(np.sqrt(variance)))


def _small_sample_factor(shares: FloatArray) -> float:
    """Return n/(n − 1) for the effective number n of blocks, given what each contributes, [B].

    If nearly all information is in one block, the scatter is meaningless, and the factor is 1.
    """
    squared = float(np.sum(shares**2))
    if not squared > 0.0:
        return 1.0
    count = float(np.sum(shares)) ** 2 / squared
    return count / (count - 1.0) if count >= 2.0 else 1.0


@dataclass(frozen=True)
class FocalLengthError:
    """The error of the calibrated focal length, as estimated from images."""

    log_ratio: float
    """ε: the true focal length is e^ε times the calibrated one."""
    sigma: float
    """Its standard deviation."""

    @property
    def percent(self) -> float:
        """How much longer the true focal length is than the calibrated one, %."""
        return 100.0 * float(np.expm1(self.log_ratio))

    @property
    def is_noticeable(self) -> bool:
        """Whether the images contradict the calibrated focal length significantly."""
        return abs(self.log_ratio) > max(NOTICEABLE, MIN_RATIO * self.sigma)

    @property
    def exceeds_lenses(self) -> bool:
        """Whether the contradiction is larger than remaining lens distortion can cause, beyond
        chance."""
        excess = abs(self.log_ratio) - MAX_BY_LENSES
        return self.is_noticeable and excess > MIN_EXCESS * self.sigma

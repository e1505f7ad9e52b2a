"""The error of the focal length, as images show it where the camera turns.

Without a turn, a wrong focal length scales the motion, and no image shows it. A yaw ψ moves a point
at x = (u − c_u)/f_u by f (1 + x²) ψ: the part that is the same for all x says how large f ψ is, the
other one how large ψ. With f_true = f e^ε, the residuals of a step are off by 2 ε f x² ψ.

On a curve, errors of the disparity look much alike. Therefore ε is estimated together with them:
each accepted step adds its information on θ = (b₁, b₂, ε), b that of ``rig_calibration``. Motion
and jitter of the rig are eliminated by a Schur complement (``estimation.rig_update``). The focal
length is not corrected: the estimate is for the reader of a run.

What a calibration has left of the lens's distortion looks like a wrong focal length, too, and no
image tells them apart (docs/degradation.md).

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
CORRELATED = 20.0
"""How many features count as one, as in the rig's calibration."""
NOTICEABLE = 0.01
"""Least |ε| that is worth a word: the path is as much too long, and turns are by about as much."""
LENSES_FEIGN = 0.035
"""|ε| that what is left of a lens may feign: up to 0.029 on KITTI, where true rotations say that
the focal length is right within a percent."""
LEAST_RATIO = 3.0
"""How many σ an error has to be away from zero to be one."""
FIRST_BLOCK_FRAMES = 5
MOST_BLOCKS = 32
"""With so many blocks, every two are joined, and from then on twice as many frames make one."""


@dataclass(frozen=True)
class FocalLengthEstimate:
    """A Gaussian estimate of ε, with what else of the calibration looks like it."""

    information: FloatArray
    """Λ_b of each block of frames, [B, 3, 3]."""
    moment: FloatArray
    """η_b of each, [B, 3]: the sum of gradient + Λ θ₀, θ₀ being what the tracks were corrected
    by."""
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
        """Update it with the normal equations of a step.

        Args:
            information: on θ, [3, 3], the motion being eliminated.
            gradient: of the same, [3], where the residuals are.
            corrected_by: θ by which the tracks were corrected, [3].
        """
        moment = gradient + information @ corrected_by
        if self.last_frames < self.block_frames:
            informations = self.information.copy()
            moments = self.moment.copy()
            informations[-1] += information
            moments[-1] += moment
            return replace(
                self, information=informations, moment=moments, last_frames=self.last_frames + 1
            )
        full = self._with_half_as_many_blocks() if len(self.moment) == MOST_BLOCKS else self
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
        prior = np.diag(PRIOR_SIGMA**-2.0)
        information = self.information / CORRELATED
        moment = self.moment / CORRELATED
        cov = np.linalg.inv(information.sum(axis=0) + prior)
        theta = cov @ moment.sum(axis=0)
        # Each block's gradient at the estimate, through the row of ε: its influence on it.
        influence = (moment - information @ theta) @ cov[FOCAL]
        shares = np.einsum("i,bij,j->b", cov[FOCAL], information, cov[FOCAL])
        of_prior = float(cov[FOCAL] @ prior @ cov[FOCAL])
        scatter = of_prior + float(np.sum(influence**2)) * _small_sample_factor(shares)
        variance = max(float(cov[FOCAL, FOCAL]), scatter)
        return FocalLengthError(float(theta[FOCAL]), float(np.sqrt(variance)))


def _small_sample_factor(shares: FloatArray) -> float:
    """Return n/(n − 1) for the effective number n of blocks, given what each contributes, [B].

    If all comes of one block, its scatter says nothing, and the factor is 1.
    """
    squared = float(np.sum(shares**2))
    if not squared > 0.0:
        return 1.0
    count = float(np.sum(shares)) ** 2 / squared
    return count / (count - 1.0) if count >= 2.0 else 1.0


@dataclass(frozen=True)
class FocalLengthError:
    """How far the focal length of the calibration is off, by the images."""

    log_ratio: float
    """ε: the true focal length is e^ε times that of the calibration."""
    sigma: float
    """Its standard deviation."""

    @property
    def percent(self) -> float:
        """How much longer the true focal length is than that of the calibration, %."""
        return 100.0 * float(np.expm1(self.log_ratio))

    @property
    def is_noticeable(self) -> bool:
        """Whether the images contradict the calibration by more than chance."""
        return abs(self.log_ratio) > max(NOTICEABLE, LEAST_RATIO * self.sigma)

    @property
    def is_beyond_lenses(self) -> bool:
        """Whether they do by more than what is left of a lens's distortion feigns."""
        return self.is_noticeable and abs(self.log_ratio) > LENSES_FEIGN

"""A solve of one step, the tracks and the noise that it used, and what residuals show of that
noise."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from probevo.arrays import BoolArray, FloatArray
from probevo.estimation.feature_weights import GAUSSIAN_FROM, scale_of_residuals
from probevo.estimation.reprojection import ReprojectionSolution
from probevo.estimation.two_frame import TwoFrameEstimate
from probevo.geometry.uncertainty import MOTIONS_DIFFER_FROM, normalized_error_squared
from probevo.noise.base import StereoNoise
from probevo.tracking.tracks import Tracks

MOTION_DIM = 6
"""Degrees of freedom of a motion."""


@dataclass(frozen=True)
class VisualSolve:
    """A solve, and the tracks and noise that it used."""

    T_guess: FloatArray
    """The motion that its tracks agreed on before, [4, 4]."""
    used: BoolArray
    """Which of the N tracks of the step it used, [N]."""
    tracks: Tracks
    """The tracks used."""
    noise: StereoNoise
    """Their noise."""
    estimate: TwoFrameEstimate
    noise_factor: float
    """Factor of the noise model's variances in ``noise``."""
    enlargement: float = 1.0
    """Factor by which the covariance of the motion by its tracks was enlarged."""
    need_larger_noise: bool = False
    """Whether the tracks agree only under a larger noise than was predicted."""

    def estimated_noise_factor(self, solution: ReprojectionSolution) -> float | None:
        """Return the factor by which the variances of the noise model would fit the residuals.

        None where they do not show it: Gaussian noise has no room for outliers, so that its scale
        is no measure of theirs, and the other features alone count; and a feature that has hardly
        moved has the same error in both frames (``Tracks.novelty``).

        Args:
            solution: these tracks, under their noise and without any earlier frame.
        """
        has_moved = solution.exceeds_noise and self.tracks.novelty == 1.0
        has_tails = np.isfinite(self.noise.dof)
        if not (has_moved and has_tails.any()):
            return None
        return self.noise_factor * scale_of_residuals(
            solution.features.mahalanobis_sq[has_tails],
            self.noise.dof[has_tails],
            num_fitted=MOTION_DIM * float(has_tails.mean()),
        )

    def differs_from(self, T_curr_prev: FloatArray) -> bool:
        """Return whether its motion differs significantly from another one, [4, 4], given how much
        noise its residuals show."""
        solution = self.estimate.solution
        if not np.isfinite(solution.cov).all():
            return True
        cov = residual_scale(solution.features.mahalanobis_sq, self.noise) * solution.cov
        squared = normalized_error_squared(T_curr_prev, solution.T_curr_prev, cov)
        return bool(squared > MOTIONS_DIFFER_FROM)

    def noise_of_current_frame(self) -> StereoNoise:
        """Return the noise under which a window learns from the current frame as much as this
        solve does.

        Where the covariance of the motion was enlarged, it is the current frame that is noisier
        than predicted; the window knows the places of the landmarks by earlier ones.
        """
        if self.enlargement == 1.0:
            return self.noise
        # Of the two observations of a residual, the current one alone has the excess:
        # κ (R + R) = R + (2κ − 1) R.
        excess_factor = 2.0 * self.enlargement - 1.0
        # The larger noise would also give weight again to the outliers of this solve, as if their
        # scatter were independent. So the variances grow by the gain in weight, too.
        squared = self.estimate.solution.features.mahalanobis_sq
        dof = np.minimum(self.noise.dof, GAUSSIAN_FROM)
        weight = dof / (dof + squared)
        weight_after = dof / (dof + squared / self.enlargement)
        weight_gain = float(weight_after.sum() / weight.sum())
        scaled = self.noise.scaled(excess_factor * weight_gain)
        if self.noise.refers_to == "residual":
            return scaled
        # The frame before, where new landmarks are anchored, is as noisy as predicted.
        return replace(scaled, prev_scale=self.noise.scale_of_prev)


def residual_scale(squared: FloatArray, noise: StereoNoise) -> float:
    """Return the factor by which the variance of N residuals of a solve exceeds their noise, 1 at
    least.

    Args:
        squared: eᵀ Σ⁻¹ e of each, [N].
        noise: their noise.
    """
    return max(1.0, scale_of_residuals(squared, noise.dof, num_fitted=MOTION_DIM))

"""Errors of features at a given motion, in the terms that a noise model is fitted to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.estimation.reprojection import ReprojectionSolution
from probevo.noise.base import StereoNoise, log_density
from probevo.training.gk.feature_errors_numba import ErrorArrays, ResidualArrays, rescale_errors
from probevo.training.gk.jitter import CommonUnknowns


@dataclass(frozen=True)
class FeatureErrors:
    """The errors of m features of a drive at its motions."""

    steps: IntArray
    """Step of each feature, [m]."""
    features: IntArray
    """Index of each among all features of the drive, [m]."""
    phi: FloatArray
    """Place of each in the prediction space, [m, M]."""
    errors: FloatArray
    """What the noise model describes: residuals, or errors of single observations, [m, 4], px."""
    error_cov: FloatArray
    """Covariance of each error that the uncertainty of the motion causes, [m, 4, 4], px²."""
    log_likelihood: FloatArray
    """Log density of each residual under the noise that the motions were solved with, [m], nats."""
    profile: FloatArray
    """Likelihood of each residual as a function of the time correlation, [m, 4], the ``rows`` of a
    ``TimeCorrelationProfile``."""
    jitter_moments: FloatArray
    """Second moment of the change of the rig's jitter in each step that was solved for it, [K, 3,
    3], rad²."""

    @staticmethod
    def none(columns: int) -> FeatureErrors:
        """Return the errors of no features, in a prediction space of so many columns."""
        return FeatureErrors(
            steps=np.zeros(0, np.int64),
            features=np.zeros(0, np.int64),
            phi=np.zeros((0, columns)),
            errors=np.zeros((0, 4)),
            error_cov=np.zeros((0, 4, 4)),
            log_likelihood=np.zeros(0),
            profile=np.zeros((0, 4)),
            jitter_moments=np.zeros((0, 3, 3)),
        )


def errors_of(
    solution: ReprojectionSolution, noise: StereoNoise, common: CommonUnknowns, chosen: IntArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Compute the errors of m features as the noise describes them, and their likelihoods.

    If the noise describes single observations, with scale R, a residual e of scale Σ is rescaled to
    the size of one observation's error: R^½ Σ^-½ e has the scale R. The bias, which the solution
    has removed, is added again.

    Args:
        solution: the motion, given or solved for.
        noise: the noise of its N features.
        common: the motion and what else all features have in common, whose mean is subtracted from
            the errors, but not from the residuals that the likelihoods are of.
        chosen: which features are wanted, [m].

    Returns:
        errors [m, 4], px; their covariance by the one of ``common``, [m, 4, 4], px²; log density of
        the residuals, [m], nats.
    """
    count = len(chosen)
    features = ResidualArrays(
        information=solution.features.information[chosen],
        residuals=solution.features.residuals[chosen],
        jacobian=common.jacobian[chosen],
        scale=noise.scale[chosen],
    )
    out = ErrorArrays(
        errors=np.empty((count, 4)),
        error_cov=np.empty((count, 4, 4)),
        squared=np.empty(count),
        log_det=np.empty(count),
    )
    # Whitened by Σ, and coloured by R if the noise refers to single observations. EM is then an
    # iteration to a fixed point: where R is right, R^½ Σ^-½ e has the scale R.
    rescale_errors(features, common.mean, common.cov, noise.refers_to == "observation", out)
    # The likelihood is the residual's, not the rescaled error's.
    log_likelihood = log_density(out.squared, out.log_det, noise.dof[chosen])
    return out.errors + noise.bias[chosen], out.error_cov, log_likelihood

"""What features show of a motion if they are so far away that their disparities are mostly noise.

The columns of the Jacobian for the translation are proportional to the disparity d. An error of
variance σ² adds to their square, E[d̂²] = d² + σ², so that features at infinity seem to show that
the camera does not move. Two frames subtract σ² (``measurements.stereo_observations``). The window,
which estimates all disparities, does not: where little but σ² is left, its features count by the
rotation of two frames instead.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg

from probevo.arrays import FloatArray
from probevo.estimation.motion_estimate import MAX_UNKNOWN
from probevo.estimation.reprojection import (
    ReprojectionSolution,
    evaluated_at,
    solve_reprojection,
)
from probevo.geometry import se3
from probevo.measurements.constant_velocity import ConstantVelocity
from probevo.measurements.relative_pose import RelativePose
from probevo.measurements.stereo_observations import StereoObservations
from probevo.measurements.variables import Variable

MIN_SIGNAL = 0.5
"""Share of the information on the translation that has to be signal for a window to use it. At one
half, the window's standard deviation of the translation is too small by a factor of √2."""
INFINITY_DISPARITY_PX = 1e-9
"""Disparity below which a feature counts as one at infinity."""


def translation_signal(
    solution: ReprojectionSolution,
    disparity: FloatArray,
    variance: FloatArray,
    *,
    known: FloatArray,
) -> float:
    """Return which share of the information on a translation is not due to errors of disparities,
    in the direction where it is least.

    Args:
        solution: the motion of two frames, by N features.
        disparity: estimates of their disparities, [N], px.
        variance: of the errors of these, [N], px².
        known: covariance of the translation by others, [3, 3], m²; where they know it better than
            the features, errors of the disparities do no harm.

    Raises:
        numpy.linalg.LinAlgError: the features do not determine the rotation.
    """
    # Σ a Jᵀ Σ⁻¹ J of each feature, [N, 6, 6], for a disparity of one pixel; without any, the
    # columns of its translation are zero.
    features = solution.features
    refined = features.refined[:, 2]
    is_finite = np.abs(refined) > INFINITY_DISPARITY_PX
    jacobian = features.jacobian.copy()
    jacobian[:, :, :3] /= np.where(is_finite, refined, np.inf)[:, None, None]
    weighted = features.curvature[:, None, None] * (features.information @ jacobian)
    information = jacobian.mT @ weighted
    # For the disparities as they are; the rotation is eliminated, A_tt − A_tr A_rr⁻¹ A_rt.
    translation_information = np.einsum("n,nij->ij", disparity**2, information[:, :3, :3])
    mixed = np.einsum("n,nij->ij", disparity, information[:, 3:, :3])
    rotation_information = information[:, 3:, 3:].sum(axis=0)
    noise = np.einsum("n,nij->ij", variance, information[:, :3, :3])
    translation_given_rotation = translation_information - mixed.T @ np.linalg.solve(
        rotation_information, mixed
    )
    noise_shares = scipy.linalg.eigvalsh(noise, translation_given_rotation + np.linalg.inv(known))
    return 1.0 - float(noise_shares[-1])


def rotation_of_far_features(
    observations: StereoObservations,
    known: RelativePose | ConstantVelocity,
    guess: FloatArray,
    *,
    expected: FloatArray,
    prev: Variable,
) -> RelativePose:
    """Return the motion that features show which say nothing of its translation: the rotation, for
    each translation that the camera may have made.

    Args:
        observations: the features, of two frames.
        known: measures the motion without them.
        guess: rotation to start from, [3, 3].
        expected: the motion that it measures, [4, 4].
        prev: pose of the previous frame.

    Raises:
        numpy.linalg.LinAlgError: the features do not determine the rotation.
    """
    # They are linearised at the translation that is expected: by themselves, they may show one of
    # hundreds of metres.
    variances = np.concatenate([np.diagonal(known.covariance)[:3], MAX_UNKNOWN[3:] ** 2])
    translation = RelativePose(expected, np.diag(variances), curr=observations.poses.curr)
    solution = solve_reprojection(
        observations,
        guess=se3.from_parts(guess, expected[:3, 3]),
        others=[translation],
    )
    A = evaluated_at(solution, observations).motion_information
    translation_cov = np.diag(MAX_UNKNOWN[:3] ** 2)
    # A translation that is wrong by ρ turns the estimate by −A_rr⁻¹ A_rt ρ.
    gain = np.linalg.solve(A[3:, 3:], A[3:, :3])
    cross = -gain @ translation_cov
    rotation_cov = np.linalg.inv(A[3:, 3:]) - cross @ gain.T
    cov = np.block([[translation_cov, cross.T], [cross, rotation_cov]])
    return RelativePose(solution.T_curr_prev, 0.5 * (cov + cov.T), curr=known.curr, prev=prev)

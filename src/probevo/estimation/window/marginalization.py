"""What a window keeps of the poses that leave it: the prior, as the Schur complement of theirs."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from probevo.arrays import BoolArray, FloatArray
from probevo.estimation.window.equations import POSE, RIG
from probevo.estimation.window.further_measurements import with_dead_reckoning_in_prior
from probevo.estimation.window.window import MarginalPrior, Window, is_of_poses

MIN_SHARE = 1e-14
"""Smallest information about the position of a window, over that about the motions within it: less
is a matter of rounding, and would spoil the covariances of the motions. In a street, it is that of
kilometres; among points at a distance of a metre, that of a hundred metres."""
POSITION_IS_UNKNOWN = 1e-8
"""Share of the information below which the position of a window is as good as unknown: it changes
the variances of the motions within the window by no more than that."""
MIN_SHARE_OF_MOTIONS = 1e-12
"""The same for the least known state of a window whose oldest pose is held."""
MIN_POSITION_INFORMATION = 1e-6
"""Smallest information about the position of a window that is left where rounding has lost it, m⁻²:
that of a kilometre."""
LENGTH_M = 10.0
"""Lever arm: an attitude error of 1 rad counts as an error of the position by this length, where
the information about both is compared."""


class PoseCovariance(NamedTuple):
    """The joint covariance of the poses of a window."""

    world_cov: FloatArray
    """Covariance of their left perturbations, [6K, 6K], m and rad."""
    motion_cov: FloatArray
    """The same, as if the oldest pose was known where it is not: covariances of motions between
    poses follow from it without the rounding of the large variances that they have in common,
    [6K, 6K]."""


def pose_covariance(hessian: FloatArray) -> PoseCovariance:
    """Invert the Hessian of the poses, [6K, 6K].

    The motions within the window are known far better than its position in the world, and after
    hours with blackouts so much better that both are lost in one inversion. So the oldest pose is
    first held by additional information B, the diagonal of its own block. With C the inverse then,
    and C₀ its columns of the oldest pose, the inverse without B is C + C₀ (B⁻¹ − C₀₀)⁻¹ C₀ᵀ
    (Woodbury). The position is at least as well known as ``MIN_SHARE`` says.

    Raises:
        numpy.linalg.LinAlgError: the motions are not known.
    """
    diagonal = np.diagonal(hessian)[:POSE]
    if not (diagonal > 0.0).all():
        raise np.linalg.LinAlgError("the oldest pose is not known at all")
    root = np.sqrt(diagonal)
    # B = D² with D = diag(root): what is added doubles the diagonal of the oldest pose's block.
    held = hessian.copy()
    held[:POSE, :POSE] += np.diag(root**2)
    inverse = _definite_inverse(held)
    # With B = D², (B⁻¹ − C₀₀)⁻¹ = D (1 − D C₀₀ D)⁻¹ D. The eigenvalues of the bracket are the
    # shares of the information about the oldest pose that are not due to holding it.
    share, directions = np.linalg.eigh(np.eye(POSE) - root[:, None] * inverse[:POSE, :POSE] * root)
    moved = inverse[:, :POSE] * root @ directions
    position_gain = moved / np.maximum(share, MIN_SHARE)
    is_known = share > POSITION_IS_UNKNOWN
    world_cov = inverse + position_gain @ moved.T
    if is_known.all():
        return PoseCovariance(world_cov, world_cov)
    return PoseCovariance(
        world_cov, motion_cov=inverse + position_gain[:, is_known] @ moved[:, is_known].T
    )


def _definite_inverse(information: FloatArray) -> FloatArray:
    """Invert an information matrix, so that no rounding makes a variance negative.

    A long pause within the window leaves the motion across it known by next to nothing, beside
    motions that are known to a hundredth of a millimetre. What is lost by rounding is as well known
    as ``MIN_SHARE_OF_MOTIONS`` says.

    Raises:
        numpy.linalg.LinAlgError: some state is not known at all.
    """
    diagonal = np.diagonal(information)
    if not (diagonal > 0.0).all():
        raise np.linalg.LinAlgError("a pose is not known at all")
    # On a scale of its own for each state. A⁻¹ = RᵀR is not negative, whatever the root R.
    sigma = diagonal**-0.5
    unit = sigma[:, None] * information * sigma
    try:
        root = np.linalg.inv(np.linalg.cholesky(unit))
    except np.linalg.LinAlgError:
        values, directions = np.linalg.eigh(unit)
        root = np.maximum(values, MIN_SHARE_OF_MOTIONS)[:, None] ** -0.5 * directions.T
    root = root * sigma
    return np.asarray(root.T @ root)


def with_pose(prior: MarginalPrior) -> MarginalPrior:
    """Return the prior with one more pose, of which it says nothing."""
    size = len(prior.vector)
    # The rig stays last, behind the new pose.
    kept = np.concatenate([np.arange(size - RIG), np.arange(size - RIG, size) + POSE])
    information = np.zeros((size + POSE, size + POSE))
    information[np.ix_(kept, kept)] = prior.information
    vector = np.zeros(size + POSE)
    vector[kept] = prior.vector
    return MarginalPrior(information, vector)


def kept_positive(prior: MarginalPrior) -> MarginalPrior:
    """Return the prior with an information about its poses that is positive.

    Rounding may lose what the prior says of the position of the window, beside the motions within
    it, and leave negative eigenvalues. These are raised to ``MIN_POSITION_INFORMATION``.
    """
    # A pose of which the prior says nothing has only zeros, and is no matter of rounding.
    poses = np.flatnonzero(np.diagonal(prior.information)[:-RIG])
    block = np.ix_(poses, poses)
    pose_information = prior.information[block]
    # With a unit diagonal, Cholesky fails by what rounding has lost, whatever the scale of a pose.
    unit = np.sqrt(np.maximum(np.diagonal(pose_information), MIN_POSITION_INFORMATION))
    try:
        np.linalg.cholesky(pose_information / unit[:, None] / unit)
    except np.linalg.LinAlgError:
        # Eigenvalues of metres and radians can be compared only on one scale.
        metres = np.where(poses % POSE < POSE // 2, 1.0, LENGTH_M)
        values, directions = np.linalg.eigh(pose_information / metres[:, None] / metres)
        directions = metres[:, None] * directions
        information = prior.information.copy()
        information[block] = (
            directions * np.maximum(values, MIN_POSITION_INFORMATION) @ directions.T
        )
        return replace(prior, information=information)
    return prior


def without_poses(prior: MarginalPrior, leaving: BoolArray) -> MarginalPrior:
    """Marginalise the poses of some frames, [K]: the Schur complement of their block."""
    gone = is_of_poses(leaving)
    # With r what remains and g what goes: Λ' = Λ_rr − Λ_rg Λ_gg⁻¹ Λ_gr, η' = η_r − Λ_rg Λ_gg⁻¹ η_g.
    information = prior.information
    gain = np.linalg.solve(information[np.ix_(gone, gone)], information[np.ix_(gone, ~gone)])
    rest = information[np.ix_(~gone, ~gone)] - information[np.ix_(~gone, gone)] @ gain
    return MarginalPrior(
        information=0.5 * (rest + rest.T), vector=prior.vector[~gone] - gain.T @ prior.vector[gone]
    )


def without_blind(window: Window, leaving: BoolArray) -> Window:
    """Marginalise blind frames, [K], which only prior and dead reckoning connect with others."""
    if not leaving.any():
        return window
    window = with_dead_reckoning_in_prior(window, leaving)
    # No observation is of a blind frame, so that only the prior has to be marginalised. The places
    # of later frames move up.
    num_before = np.cumsum(leaving)
    observations = window.observations
    return replace(
        window.without_frames(leaving),
        prior=kept_positive(without_poses(window.prior, leaving)),
        observations=observations._replace(slot=observations.slot - num_before[observations.slot]),
    )

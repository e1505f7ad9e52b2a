"""Update of the rig's calibration by the residuals of a solve, and the effect of its uncertainty on
the motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.focal_length_numba import focal_sensitivity
from probevo.camera.rig_calibration import RigCalibration
from probevo.camera.rig_jitter import RigJitter
from probevo.camera.stereo import StereoCamera
from probevo.camera.transfer_numba import Intrinsics
from probevo.estimation.reprojection import ReprojectionSolution, SolvedJitter, sum_products
from probevo.estimation.rig_update_numba import disparity_sensitivities, weigh_columns
from probevo.tracking.tracks import Tracks

_RADIAL = 3
"""Index of a₆ among (b₀, b₁, b₂, a₆, ε)."""
_FOCAL = [1, 2, 4]
"""Indices of b₁, b₂ and ε among these."""
_DISPARITY = slice(1, 3)
"""Those of b₁ and b₂: two frames do not estimate b₀."""


def update_rig(
    rig: RigCalibration, tracks: Tracks, solution: ReprojectionSolution, camera: StereoCamera
) -> tuple[RigCalibration, FloatArray]:
    """Update disparity errors b, jitter and focal-length error ε of the rig, and return how the
    uncertainty of b moves the motion.

    With D = ∂e/∂(b, a₆, ε) and J = −∂e/∂ξ (and −∂e/∂η, if the noise has a jitter), b and ε are
    estimated from the joint normal equations, from which motion and jitter are eliminated (Schur
    complement). a₆ is estimated from the rows, and b is conditional on it. The solution need not be
    at the optimum, but it must use these two frames alone: the disparity filter was fed with
    observations that were corrected by earlier calibrations, and would confirm these.

    Args:
        rig: the estimate before this step.
        tracks: the N tracks of the solution, corrected by ``rig``.
        solution: the motion from these two frames alone.
        camera: the rectified camera.

    Returns:
        The estimate after the step, and the root of Schmidt's consider term, [6, 3]: ∂ξ/∂(errors
        of the calibration before the step, whitened). Such an error is the same for all features,
        so it does not average out, and in all steps, so it adds up along the path. If the features
        do not determine the motion, nothing is updated.
    """
    if not np.isfinite(solution.cov).all():
        return rig, np.zeros((6, 3))
    # Sensitivities of the residuals to the calibration, and weighted products of both
    D = calibration_sensitivity(tracks, solution, camera)
    jacobian = solution.full_jacobian
    # w Σ⁻¹ (D, e): both at once.
    columns = np.concatenate([D, solution.residuals[:, :, None]], axis=2)
    weighted = np.empty_like(columns)
    weigh_columns(solution.information, solution.irls_weight, columns, weighted)
    # Normal equations of (ξ, η) and (b, a₆, ε): [[H, −C], [−Cᵀ, B]], with the gradients of both. C
    # has a minus since J is the derivative of the prediction, and D that of the residual.
    of_motion = sum_products(jacobian, weighted)
    C = of_motion[:, :-1]
    motion_gradient = of_motion[:, -1]
    of_rig = sum_products(D, weighted)
    B = of_rig[:, :-1]
    rig_gradient = -of_rig[:, -1]
    if solution.jitter is not None:
        motion_gradient[6:] -= solution.jitter.eta  # of the prior η ~ N(0, I)
    # The Schur complement on b, a₆ and ε, and the step (ξ, η) with these held.
    solved = np.linalg.solve(solution.full_hessian, np.column_stack([C, motion_gradient]))
    # Gain H⁻¹ C: B − Cᵀ H⁻¹ C, and its gradient g_rig + Cᵀ H⁻¹ g_motion.
    gain = solved[:, :-1]
    step = solved[:, -1].astype(float)
    gradient = gain.T @ motion_gradient + rig_gradient
    information = B - C.T @ gain
    updated = rig.with_disparity(
        information[_DISPARITY, _DISPARITY],
        gradient[_DISPARITY],
        with_radial=information[_DISPARITY, _RADIAL],
    )
    # Near the optimum, IRLS steps are too short, since the curvature of the loss is less than its
    # weights: scale the information of the focal length to the curvature.
    curvature = float(solution.curvature.sum() / solution.irls_weight.sum())
    focal = rig.focal.with_step(
        curvature * information[np.ix_(_FOCAL, _FOCAL)],
        gradient[_FOCAL],
        np.append(rig.disparity, 0.0),
    )
    updated = replace(updated, focal=focal)
    if solution.jitter is not None:
        updated = replace(updated, jitter=_updated_jitter(rig.jitter, solution.jitter, step[6:]))
    # The consider term: jitter is new in every frame and cannot absorb a constant error, so it is
    # held here.
    motion_gain = np.linalg.solve(solution.hessian, C[:6, :3])
    return updated, motion_gain @ np.linalg.cholesky(rig.disparity_cov)


def _updated_jitter(jitter: RigJitter, solved: SolvedJitter, step: FloatArray) -> RigJitter:
    """Update S with the change of the jitter between the frames, after a Gauss–Newton step, [6].

    E[(ω' − ω°)(ω' − ω°)ᵀ] is the outer product of the mean plus the covariance, as in EM: a step
    without information about the jitter leaves S unchanged.
    """
    unknown = solved.unknown
    change = np.hstack([unknown.curr_root, -unknown.prev.root])
    # ω' − ω° = L' η' − L° η° − m.
    mean = change @ (solved.eta + step) - unknown.prev.mean
    return jitter.with_change(np.outer(mean, mean) + change @ solved.cov[6:, 6:] @ change.T)


def calibration_sensitivity(
    tracks: Tracks, solution: ReprojectionSolution, camera: StereoCamera
) -> FloatArray:
    """Return ∂e/∂(b₀, b₁, b₂, a₆, ε), [N, 4, 5]; ε is the error of log f
    (``camera.focal_length``)."""
    sensitivity = np.empty((len(tracks), 4, 5))
    intrinsics = Intrinsics.of(camera)
    disparity_sensitivities(
        solution.disparity_jacobian,
        np.array(tracks.prev_px, order="C"),
        np.array(tracks.curr_px, order="C"),
        camera=intrinsics,
        sensitivity=sensitivity,
    )
    focal_sensitivity(solution.T_curr_prev, intrinsics, solution.refined, sensitivity[:, :, 4])
    return sensitivity

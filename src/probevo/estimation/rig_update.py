"""What the residuals of a motion say of the rig's calibration, and the calibration's uncertainty of
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


def update_rig(
    rig: RigCalibration, tracks: Tracks, solution: ReprojectionSolution, camera: StereoCamera
) -> tuple[RigCalibration, FloatArray]:
    """Update the rig's disparity errors, its jitter and the error of its focal length, and say how
    the uncertainty of the first moves the motion.

    With D = ∂e/∂(b, a₆, ε) and J = −∂e/∂ξ (and −∂e/∂η, where the noise has a jitter), the estimate
    takes in the part of the residuals that a change of b and ε explains, motion and jitter being
    eliminated from the joint normal equations (Schur complement). What a₆ is, the rows tell; b is
    that which belongs to it. The solution need not be at the
    optimum, but must use only what these two frames show: the disparity filter was fed with the
    calibration of its time, and would confirm it.

    Args:
        rig: the estimate before this step.
        tracks: the N tracks of the solution, corrected by ``rig``.
        solution: the motion from these two frames alone.
        camera: the rectified camera.

    Returns:
        The estimate after the step, and the root of Schmidt's consider term, [6, 3]: columns along
        which errors of the calibration before the step move the motion, for errors of unit
        variance. Such an error is common to all features, so that no number of them averages it
        out, and to all steps, so that it adds up along the path. Features that do not fix the
        motion teach nothing.
    """
    if not np.isfinite(solution.cov).all():
        return rig, np.zeros((6, 3))
    D = calibration_sensitivity(tracks, solution, camera)
    jacobian = solution.full_jacobian
    # w Σ⁻¹ (D, e): both at once.
    columns = np.concatenate([D, solution.residuals[:, :, None]], axis=2)
    weighted = np.empty_like(columns)
    weigh_columns(solution.information, solution.irls_weight, columns, weighted)
    # Normal equations of (ξ, η, b, a₆, ε): [[H, C], [Cᵀ, B]], with the gradients of both.
    of_motion = sum_products(jacobian, weighted)
    C = of_motion[:, :-1]
    motion_gradient = of_motion[:, -1]
    of_rig = sum_products(D, weighted)
    B = of_rig[:, :-1]
    rig_gradient = -of_rig[:, -1]
    if solution.jitter is not None:
        motion_gradient[6:] -= solution.jitter.eta
    # The Schur complement on b, a₆ and ε; b₀ is not estimated.
    solved = np.linalg.solve(solution.full_hessian, np.column_stack([C, motion_gradient]))
    gain = solved[:, :-1]
    step = solved[:, -1].astype(float)
    gradient = gain.T @ motion_gradient + rig_gradient
    information = B - C.T @ gain
    updated = rig.with_disparity(
        information[1:3, 1:3], gradient[1:3], with_radial=information[1:3, _RADIAL]
    )
    # One step with the IRLS weights is too short: the curvature of the loss is less than they.
    curvature = float(solution.curvature.sum() / solution.irls_weight.sum())
    focal = rig.focal.with_step(
        curvature * information[np.ix_(_FOCAL, _FOCAL)],
        gradient[_FOCAL],
        np.append(rig.disparity, 0.0),
    )
    updated = replace(updated, focal=focal)
    if solution.jitter is not None:
        updated = replace(updated, jitter=_updated_jitter(rig.jitter, solution.jitter, step[6:]))
    # A constant error is none that is new in every frame: the jitter must not be expected to take
    # it up, and is held.
    motion_gain = np.linalg.solve(solution.hessian, C[:6, :3])
    return updated, motion_gain @ np.linalg.cholesky(rig.disparity_cov)


def _updated_jitter(jitter: RigJitter, solved: SolvedJitter, step: FloatArray) -> RigJitter:
    """Update S with the jitter's change, which is one more Gauss–Newton step [6] away.

    E[(ω' − ω°)(ω' − ω°)ᵀ] is the square of its mean plus its covariance: a step that shows nothing
    of the jitter leaves S as it is.
    """
    unknown = solved.unknown
    change = np.hstack([unknown.curr_root, -unknown.prev.root])
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

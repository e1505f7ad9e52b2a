"""Update of the rig's calibration by the residuals of a solve, and the effect of its uncertainty on
the motion."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.distortion_field import (
    DISPARITY_MODES,
    DISPLACEMENT_MODES,
    NUM_COEFFICIENTS,
    modes_at,
)
from probevo.camera.distortion_field_numba import FieldModes, field_sensitivities, predict_pixels
from probevo.camera.focal_length_numba import focal_sensitivity
from probevo.camera.image_errors import ImageEquations, ScalarEquations
from probevo.camera.rig_calibration import RigCalibration
from probevo.camera.rig_jitter import RigJitter
from probevo.camera.rolling_shutter import Twists, readout_sensitivity
from probevo.camera.stereo import StereoCamera
from probevo.camera.transfer_numba import Intrinsics
from probevo.estimation.joint_equations import JointEquations
from probevo.estimation.motion_estimate import COMMON_MODE_COLUMNS
from probevo.estimation.reprojection import ReprojectionSolution, SolvedJitter
from probevo.estimation.rig_update_numba import disparity_sensitivities
from probevo.estimation.velocity_change import ChangeUnknown
from probevo.measurements.jitter_numba import JITTER_PAIR_DIM
from probevo.tracking.tracks import Tracks

_FIELD = slice(3, 3 + NUM_COEFFICIENTS)
"""Indices of the distortion field's coefficients among (b₀, b₁, b₂, field, a₆, ε, τ)."""
_IMAGE = slice(1, _FIELD.stop)
"""Indices of c = (b₁, b₂, field) among them: two frames do not estimate b₀."""
_RADIAL = _FIELD.stop
"""Index of a₆."""
_EPSILON = _FIELD.stop + 1
"""Index of ε."""
_READOUT = _FIELD.stop + 2
"""Index of the readout time τ."""
_FOCAL = [1, 2, _EPSILON]
"""Indices of b₁, b₂ and ε."""


class CommonMode(NamedTuple):
    """How errors of the calibration before a step move its motion."""

    columns: FloatArray
    """Root of Schmidt's consider term, [6, COMMON_MODE_COLUMNS]: ∂ξ/∂(errors, whitened). Three are
    for b₀, b₁ and b₂, six for what of the distortion field is independent of these, and one for
    the focal length."""
    distortion_gain: FloatArray
    """∂ξ/∂(coefficients of the distortion field), [6, NUM_COEFFICIENTS], m/px and rad/px."""
    focal_gain: FloatArray
    """∂ξ/∂ε, f b being held, [6], m and rad."""
    readout_gain: FloatArray
    """∂ξ/∂τ of the readout time, [6], m/s and rad/s."""

    def times(self, matrix: FloatArray) -> CommonMode:
        """Return the common mode of a motion whose error is a matrix, [6, 6], times this one's."""
        return CommonMode._make(matrix @ part for part in self)

    @staticmethod
    def none() -> CommonMode:
        """Return the common mode of a motion on which no calibration has an influence."""
        return CommonMode(
            np.zeros((6, COMMON_MODE_COLUMNS)),
            distortion_gain=np.zeros((6, NUM_COEFFICIENTS)),
            focal_gain=np.zeros(6),
            readout_gain=np.zeros(6),
        )


def update_rig(
    rig: RigCalibration,
    tracks: Tracks,
    solution: ReprojectionSolution,
    camera: StereoCamera,
    twists: Twists,
    *,
    change: ChangeUnknown | None = None,
) -> tuple[RigCalibration, CommonMode]:
    """Update the errors of the images (b₁, b₂ and the distortion field), the readout time τ of
    their shutter, the jitter and the focal-length error ε, and return how errors of these move the
    motion.

    With D = ∂e/∂(b₀, c, a₆, ε, τ), where c are b₁, b₂ and the distortion field, and J = −∂e/∂ξ (and
    −∂e/∂η, if the noise has a jitter), c, ε and τ are estimated from the joint normal equations,
    from which motion, jitter and the change of the velocity are eliminated (Schur complement). a₆
    is estimated from the rows, and c is conditional on it. The solution need not be at the optimum,
    but it must use these two frames alone: the disparity filter was fed with observations that were
    corrected by earlier calibrations, and would confirm these.

    Args:
        rig: the estimate before this step.
        tracks: the N tracks of the solution, corrected by ``rig``.
        solution: the motion from these two frames alone.
        camera: the rectified camera.
        twists: the velocities at the two frames.
        change: their change in the step, if it is another unknown.

    Returns:
        The estimate after the step, and how errors of the one before it move the motion. Such an
        error is the same for all features, so it does not average out, and in all steps, so it adds
        up along the path. If the features do not determine the motion, nothing is updated.
    """
    if not solution.is_determined:
        return rig, CommonMode.none()
    D = calibration_sensitivity(tracks, solution, camera, twists, readout_s=rig.image.readout_s)
    if change is None:
        equations = JointEquations.of(D, solution)
    else:
        D_both = np.concatenate([change.sensitivity, D], axis=2)
        equations = JointEquations.of(D_both, solution).eliminating(
            len(change.value), change.prior_information, change.prior_gradient
        )
    updated = _updated_rig(rig, solution, equations, novelty=tracks.novelty)
    return updated, _common_mode(rig, solution, equations)


def _updated_rig(
    rig: RigCalibration,
    solution: ReprojectionSolution,
    equations: JointEquations,
    *,
    novelty: float,
) -> RigCalibration:
    """Update the errors of the images, the focal length's and the jitter with a step.

    Args:
        rig: the estimate before the step.
        solution: the motion.
        equations: those of the step.
        novelty: of the step, see ``Tracks``.
    """
    # Without (ξ, η) and the change; their step is that with the calibration held.
    eliminated = equations.solved()
    information = eliminated.information
    gradient = eliminated.gradient
    updated = rig
    if solution.exceeds_noise:
        updated = rig.with_image_errors(
            ImageEquations(
                information=information[_IMAGE, _IMAGE],
                gradient=gradient[_IMAGE],
                with_radial=information[_IMAGE, _RADIAL],
                focal=ScalarEquations(
                    coupling=information[_IMAGE, _EPSILON],
                    information=information[_EPSILON, _EPSILON],
                    gradient=gradient[_EPSILON],
                ),
                readout=ScalarEquations(
                    coupling=information[_IMAGE, _READOUT],
                    information=information[_READOUT, _READOUT],
                    gradient=gradient[_READOUT],
                ),
            )
        )
    # Near the optimum, IRLS steps are too short, since the curvature of the loss is less than its
    # weights: scale the information of the focal length to the curvature.
    features = solution.features
    curvature = float(features.curvature.sum() / features.irls_weight.sum())
    with_focal = curvature * information[_FOCAL]
    # The field, by which the tracks were corrected, takes up most of a wrong focal length. So take
    # the gradient at a field of zero.
    focal = rig.focal.with_step(
        with_focal[:, _FOCAL],
        gradient[_FOCAL] + with_focal[:, _FIELD] @ rig.image.distortion,
        np.append(rig.disparity, 0.0),
    )
    updated = replace(updated, focal=focal)
    if solution.jitter is not None and solution.exceeds_noise:
        jitter = _updated_jitter(
            rig.jitter, solution.jitter, eliminated.step[6 : 6 + JITTER_PAIR_DIM], novelty=novelty
        )
        updated = replace(updated, jitter=jitter)
    return updated


def _common_mode(
    rig: RigCalibration, solution: ReprojectionSolution, equations: JointEquations
) -> CommonMode:
    """Return how errors of the calibration move the motion of a step: Schmidt's consider term.

    Args:
        rig: the estimate by which the tracks of the step were corrected.
        solution: the motion.
        equations: those of the step.
    """
    # ∂ξ/∂(b₀, c, a₆, ε, τ) = H⁻¹ C. The jitter is new in every frame and cannot absorb a constant
    # error, so it is held here.
    motion_gain = np.linalg.solve(solution.hessian, equations.cross[:6]).astype(float)
    # One root of the joint covariance, which is lower triangular: b moves the motion by itself and
    # by what it tells of the field; of the field, only what is independent of b is left to add.
    root = np.linalg.cholesky(rig.disparity_and_field_cov)
    disparity_effect = motion_gain[:, : _FIELD.stop] @ root[:, :3]
    distortion_gain = motion_gain[:, _FIELD]
    field_effect = distortion_gain @ root[_FIELD, _FIELD]
    # So does what is unknown of a readout time that is corrected.
    if rig.image.readout_sigma_s:
        readout_effect = (
            motion_gain[:, _READOUT] + motion_gain[:, _IMAGE] @ rig.image.shift_by_readout
        )
        field_effect = np.column_stack([field_effect, rig.image.readout_sigma_s * readout_effect])
    # A wrong focal length moves the motion, and what was estimated of the image errors, too. It is
    # f b that a stereo calibration fixes by the size of its board, and a longer baseline makes the
    # motion longer.
    focal_gain = motion_gain[:, _EPSILON].copy()
    focal_gain[:3] -= solution.T_curr_prev[:3, 3]
    focal_effect = focal_gain + motion_gain[:, _IMAGE] @ rig.image.shift_by_focal
    return CommonMode(
        columns=np.column_stack(
            [disparity_effect, _square_root(field_effect), rig.image.focal_rms * focal_effect]
        ),
        distortion_gain=distortion_gain,
        focal_gain=focal_gain,
        readout_gain=motion_gain[:, _READOUT],
    )


def _square_root(columns: FloatArray) -> FloatArray:
    """Return the lower triangular root of columns columnsᵀ, [6, 6], with a diagonal ≥ 0.

    As the root of a covariance it is unique. So successive steps, which are alike, have roots that
    are alike, and an error that is the same in all of them can be added up by these.
    """
    upper = np.asarray(np.linalg.qr(columns.T, mode="r"), np.float64)
    signs = np.where(np.diagonal(upper) < 0.0, -1.0, 1.0)
    lower: FloatArray = upper.T * signs
    return lower


def _updated_jitter(
    jitter: RigJitter, solved: SolvedJitter, step: FloatArray, *, novelty: float
) -> RigJitter:
    """Update S with the change of the jitter between the frames, after a Gauss–Newton step, [6].

    E[(ω' − ω°)(ω' − ω°)ᵀ] is the outer product of the mean plus the covariance, as in EM: a step
    without information about the jitter leaves S unchanged.
    """
    unknown = solved.unknown
    change = np.hstack([unknown.curr_root, -unknown.prev.root])
    # ω' − ω° = L' η' − L° η° − m.
    mean = change @ (solved.eta + step) - unknown.prev.mean
    second_moment = np.outer(mean, mean) + change @ solved.cov[6:, 6:] @ change.T
    return jitter.with_change(second_moment, novelty=novelty)


def calibration_sensitivity(
    tracks: Tracks,
    solution: ReprojectionSolution,
    camera: StereoCamera,
    twists: Twists,
    *,
    readout_s: float = 0.0,
) -> FloatArray:
    """Return ∂e/∂(b₀, b₁, b₂, field, a₆, ε, τ), [N, 4, 6 + NUM_COEFFICIENTS], where the field has
    its coefficients, ε is the error of log f (``camera.focal_length``), and τ the readout time.

    Args:
        tracks: the N tracks of the solution, corrected by the calibration.
        solution: the motion from these two frames alone.
        camera: the rectified camera.
        twists: the velocities at the two frames.
        readout_s: the readout time by which the tracks were corrected.
    """
    features = solution.features
    sensitivity = np.empty((len(tracks), 4, 6 + NUM_COEFFICIENTS))
    intrinsics = Intrinsics.of(camera)
    disparity_effect = np.empty((len(tracks), 4, 4))
    disparity_sensitivities(
        features.disparity_jacobian,
        np.array(tracks.prev_px, order="C"),
        np.array(tracks.curr_px, order="C"),
        camera=intrinsics,
        sensitivity=disparity_effect,
    )
    sensitivity[:, :, :3] = disparity_effect[:, :, :3]
    sensitivity[:, :, _RADIAL] = disparity_effect[:, :, 3]
    # The modes are those at the most likely pixels given both observations. At the observed ones,
    # the noise of a pixel would be in its modes and in its residual, and bias the field: a field
    # that pulls the pixels together makes all residuals smaller.
    predicted_px = np.empty((len(tracks), 2))
    predict_pixels(solution.T_curr_prev, intrinsics, features.refined, predicted_px)
    field_sensitivities(
        solution.T_curr_prev,
        intrinsics,
        features.refined,
        features.disparity_jacobian,
        FieldModes(
            prev=modes_at(features.refined, camera),
            curr=modes_at(predicted_px, camera),
            displacement_modes=DISPLACEMENT_MODES,
            disparity_modes=DISPARITY_MODES,
        ),
        sensitivity[:, :, _FIELD],
    )
    focal_sensitivity(
        solution.T_curr_prev, intrinsics, features.refined, sensitivity[:, :, _EPSILON]
    )
    readout_sensitivity(
        solution.T_curr_prev,
        twists,
        camera,
        features.refined,
        readout_s=readout_s,
        sensitivity=sensitivity[:, :, _READOUT],
    )
    return sensitivity

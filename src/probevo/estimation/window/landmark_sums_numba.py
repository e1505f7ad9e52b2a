"""A landmark's part in the normal equations of a window, and its elimination.

Poses T_cam_world are perturbed on the left. Since T_ka = T_k T_a⁻¹, its perturbation is
ξ_ka = ξ_k − Ad(T_ka) ξ_a. Where ξ_ka moves a prediction by J, the poses of frame
and anchor move it by J and −J Ad(T_ka). The adjoint is that of fixed linearisation points, which
are also those of the marginalised information ("first-estimates Jacobians", Huang et al. 2010):
then a shift and turn of the whole window moves no residual, to rounding, and the window does not
gain information about where in the world it is.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from probevo.arrays import FloatArray
from probevo.compiled import compiled, compiled_into_callers
from probevo.estimation.window.equations import (
    FRAME,
    LANDMARK,
    PIXELS,
    POSE,
    RIG,
    LandmarkElimination,
    WindowEquations,
)
from probevo.estimation.window.landmark_track_numba import (
    COMMON_COLUMNS,
    LinearizedTrack,
    WindowProblem,
    share_of_own,
)
from probevo.estimation.window.landmark_weights_numba import RobustWeight

# The sums for each state of ζ_k: its information with ζ_k, with ζ of the frame before and with the
# rig, and its gradient.
_WITH_PREV = FRAME
"""The first of these sums that is information with ζ of the frame before."""
_WITH_RIG = _WITH_PREV + FRAME
"""The first of these sums that is information with the rig."""
_GRADIENT = _WITH_RIG + RIG
"""Which of these sums is the gradient."""
SUMS_PER_STATE = 24
"""Number of sums for each state of ζ_k, rounded up to whole vectors of the processor."""


class Workspace(NamedTuple):
    """Arrays for the elimination of one landmark."""

    root: FloatArray
    """Cholesky factor R of its information, [4, 4]."""
    wide: FloatArray
    """R⁻¹ times its coupling to frames, rig and gradient, [4, 9K + 5]."""
    unit: FloatArray
    """[4]."""


@compiled_into_callers
def add_common(
    row: int,
    problem: WindowProblem,
    track: LinearizedTrack,
    robust: RobustWeight,
    elimination: LandmarkElimination,
    equations: WindowEquations,
) -> None:
    """Fill the gradient of a landmark and its information with the rig; add to those of the rig."""
    first = problem.observations.start[row]
    count = problem.observations.start[row + 1] - first
    # Innovations z are white, so that products with Σ⁻¹ are sums of z zᵀ.
    common = track.common
    common[:] = 0.0
    for k in range(count):
        z = track.innovation[k]
        for i in range(COMMON_COLUMNS):
            z0 = z[0, i]
            z1 = z[1, i]
            z2 = z[2, i]
            z3 = z[3, i]
            for j in range(COMMON_COLUMNS):
                common[i, j] += z0 * z[0, j] + z1 * z[1, j] + z2 * z[2, j] + z3 * z[3, j]
    error = COMMON_COLUMNS - 1
    # The prior of the time-correlated error, δ ~ N(0, τ²).
    prior = problem.landmarks.error_information[row]
    common[3, 3] += prior
    common[3, error] -= prior * problem.landmarks.state[row, 3]
    for i in range(LANDMARK):
        elimination.gradient[row, i] = robust.weight * common[i, error]
        for j in range(RIG):
            elimination.rig_coupling[row, i, j] = robust.curvature * common[i, LANDMARK + j]
    # Gradients have the IRLS weight, Hessians the curvature; of the latter, only the lower
    # triangle.
    rig0 = len(equations.gradient) - RIG
    for i in range(RIG):
        equations.gradient[rig0 + i] += robust.weight * common[LANDMARK + i, error]
        for j in range(i + 1):
            equations.hessian[rig0 + i, rig0 + j] += (
                robust.curvature * common[LANDMARK + i, LANDMARK + j]
            )


@compiled_into_callers
def add_motions(
    row: int,
    problem: WindowProblem,
    track: LinearizedTrack,
    robust: RobustWeight,
    factors: FloatArray,
    sums: FloatArray,
    equations: WindowEquations,
) -> None:
    """Add the observations of a landmark to the equations of the motions from its anchor frame,
    and of the jitters.

    The inverse covariance of the observations is block tridiagonal along the track. The block with
    the previous observation is part of ``sums`` if that was made in the preceding frame. If frames
    in between did not see the landmark, ``sums`` has no column for it, and it is added to
    ``equations`` directly.

    Args:
        row: the landmark.
        problem: all of them.
        track: its observations.
        robust: its robust weight.
        factors: work space, [4, 24].
        sums: receives the sums over frame and anchor, [K, K, 9, 24] (``add_pairs``).
        equations: receives what is not in the sums.
    """
    first = problem.observations.start[row]
    count = problem.observations.start[row + 1] - first
    anchor = problem.observations.slot[first]
    correlation = problem.noise.correlation
    # Blocks of Σ⁻¹ (``landmark_track_numba``): s_k² + ρ²/(1 + ρ) on the diagonal, the last one
    # without the second term, and −ρ/(1 + ρ) beside it.
    from_next = correlation * correlation / (1.0 + correlation)
    off_diagonal = -correlation / (1.0 + correlation)
    for k in range(count):
        # What the columns of ζ_k are multiplied with below: themselves times their block of Σ⁻¹,
        # and those of the rig and of the error times their row of it.
        white = track.white[k]
        diagonal = share_of_own(k, correlation) ** 2
        if k + 1 < count:
            diagonal += from_next
        for n in range(PIXELS):
            for j in range(FRAME):
                factors[n, j] = robust.curvature * diagonal * white[n, j]
            for j in range(RIG):
                factors[n, _WITH_RIG + j] = robust.curvature * track.weighted[k, n, LANDMARK + j]
            factors[n, _GRADIENT] = robust.weight * track.weighted[k, n, COMMON_COLUMNS - 1]
        # With the observation before, −ρ/(1 + ρ) times the white columns of both: in the sums, if
        # that is of the frame before.
        slot = problem.observations.slot[first + k]
        prev_slot = problem.observations.slot[first + k - 1] if k > 0 else slot - 1
        is_next = prev_slot == slot - 1
        for n in range(PIXELS):
            for j in range(FRAME):
                prev = track.white[k - 1, n, j] if k > 0 and is_next else 0.0
                factors[n, _WITH_PREV + j] = robust.curvature * off_diagonal * prev
        if not is_next:
            cross = np.zeros((FRAME, FRAME))
            for n in range(PIXELS):
                for i in range(FRAME):
                    for j in range(FRAME):
                        product = white[n, i] * track.white[k - 1, n, j]
                        cross[i, j] += robust.curvature * off_diagonal * product
            adjoints = problem.adjoints
            _add_neighbours(
                slot, prev_slot, anchor, cross=cross, adjoints=adjoints, equations=equations
            )
        target = sums[slot, anchor]
        # All sums at once: white columns of ζ_k, transposed, times the factors, [9, 4] by [4, 24].
        # In its anchor frame, no motion moves the landmark, only the jitter.
        for i in range(POSE if k == 0 else 0, FRAME):
            w0 = white[0, i]
            w1 = white[1, i]
            w2 = white[2, i]
            w3 = white[3, i]
            for j in range(SUMS_PER_STATE):
                target[i, j] += (
                    w0 * factors[0, j]
                    + w1 * factors[1, j]
                    + w2 * factors[2, j]
                    + w3 * factors[3, j]
                )


@compiled_into_callers
def couple(
    row: int, problem: WindowProblem, track: LinearizedTrack, curvature: float, coupling: FloatArray
) -> None:
    """Fill the information between a landmark and the frames of its observations, [M, 4, 9]."""
    first = problem.observations.start[row]
    count = problem.observations.start[row + 1] - first
    anchor = problem.observations.slot[first]
    anchor_block = coupling[first]
    for k in range(count):
        # Rows (u, v, d, δ), columns ζ_k: those of the landmark in Σ⁻¹ times the white columns of
        # this observation.
        own = coupling[first + k]
        white = track.white[k]
        for i in range(LANDMARK):
            w0 = curvature * track.weighted[k, 0, i]
            w1 = curvature * track.weighted[k, 1, i]
            w2 = curvature * track.weighted[k, 2, i]
            w3 = curvature * track.weighted[k, 3, i]
            for j in range(FRAME):
                own[i, j] = (
                    w0 * white[0, j] + w1 * white[1, j] + w2 * white[2, j] + w3 * white[3, j]
                )
        if k == 0:
            continue  # its pose does not matter there
        # The anchor's pose moves the prediction by −J Ad(T_ka).
        adjoint = problem.adjoints[problem.observations.slot[first + k], anchor]
        for i in range(LANDMARK):
            for j in range(POSE):
                anchor_block[i, j] -= (
                    own[i, 0] * adjoint[0, j]
                    + own[i, 1] * adjoint[1, j]
                    + own[i, 2] * adjoint[2, j]
                    + own[i, 3] * adjoint[3, j]
                    + own[i, 4] * adjoint[4, j]
                    + own[i, 5] * adjoint[5, j]
                )


@compiled_into_callers
def factor_information(
    curvature: float, information: FloatArray, work: Workspace, inverse: FloatArray
) -> None:
    """Fill the Cholesky factor of a landmark's information, [4, 4], and its inverse.

    Args:
        curvature: factor of the information.
        information: its lower triangle.
        work: receives the factor.
        inverse: receives the inverse, [4, 4].
    """
    # The anchor frame always sees the landmark, and δ has a prior: the information is positive
    # definite but for rounding, against which a diagonal entry is bounded.
    root = work.root
    for i in range(LANDMARK):
        for j in range(i + 1):
            total = curvature * information[i, j]
            for n in range(j):
                total -= root[i, n] * root[j, n]
            root[i, j] = math.sqrt(max(total, 1e-12)) if i == j else total / root[j, j]
    # Column by column of R Rᵀ A⁻¹ = I: forwards with R, then backwards with Rᵀ.
    solved = work.unit
    for column in range(LANDMARK):
        for i in range(LANDMARK):
            total = 1.0 if i == column else 0.0
            for n in range(i):
                total -= root[i, n] * solved[n]
            solved[i] = total / root[i, i]
        for i in range(LANDMARK - 1, -1, -1):
            total = solved[i]
            for n in range(i + 1, LANDMARK):
                total -= root[n, i] * inverse[n, column]
            inverse[i, column] = total / root[i, i]


@compiled_into_callers
def _substitute(root: FloatArray, columns: FloatArray, count: int, solved: FloatArray) -> None:
    """Set the first columns of ``solved``, [4, ≥ count], to R⁻¹ times as many given ones."""
    r10 = root[1, 0]
    r20 = root[2, 0]
    r21 = root[2, 1]
    r30 = root[3, 0]
    r31 = root[3, 1]
    r32 = root[3, 2]
    scale0 = 1.0 / root[0, 0]
    scale1 = 1.0 / root[1, 1]
    scale2 = 1.0 / root[2, 2]
    scale3 = 1.0 / root[3, 3]
    for j in range(count):
        y0 = columns[0, j] * scale0
        y1 = (columns[1, j] - r10 * y0) * scale1
        y2 = (columns[2, j] - r20 * y0 - r21 * y1) * scale2
        y3 = (columns[3, j] - r30 * y0 - r31 * y1 - r32 * y2) * scale3
        solved[0, j] = y0
        solved[1, j] = y1
        solved[2, j] = y2
        solved[3, j] = y3


@compiled_into_callers
def eliminate(
    row: int,
    problem: WindowProblem,
    work: Workspace,
    elimination: LandmarkElimination,
    equations: WindowEquations,
) -> None:
    """Eliminate one landmark: subtract Bᵀ A⁻¹ B of its information A, [4, 4], and its coupling B.

    With A = R Rᵀ and Y = R⁻¹ B that is Yᵀ Y; only blocks of frames that saw it, and of the rig, are
    touched.
    """
    first = problem.observations.start[row]
    end = problem.observations.start[row + 1]
    root = work.root
    wide = work.wide
    # The columns of Y are those of all frames from the first to the last that saw it.
    slot = problem.observations.slot
    span = slot[end - 1] - slot[first] + 1
    frames_width = FRAME * span
    width = frames_width + RIG
    if span > end - first:  # frames in between did not see it
        for i in range(LANDMARK):
            wide[i, :frames_width] = 0.0
    # Y = R⁻¹ B: the frames from the anchor on, then the rig; behind them, R⁻¹ times the gradient.
    for m in range(first, end):
        at = FRAME * (slot[m] - slot[first])
        _substitute(root, elimination.coupling[m], FRAME, wide[:, at:])
    _substitute(root, elimination.rig_coupling[row], RIG, wide[:, frames_width:])
    gradient = elimination.gradient[row].reshape(LANDMARK, 1)
    _substitute(root, gradient, 1, wide[:, width:])
    # H −= Yᵀ Y, g −= Yᵀ R⁻¹ g_landmark. Frames come in their order, the rig last: this fills the
    # lower triangle.
    frame0 = FRAME * slot[first]
    rig0 = len(equations.gradient) - RIG
    for p in range(width):
        y0 = wide[0, p]
        y1 = wide[1, p]
        y2 = wide[2, p]
        y3 = wide[3, p]
        at = frame0 + p if p < frames_width else rig0 + p - frames_width
        equations.gradient[at] -= (
            y0 * wide[0, width] + y1 * wide[1, width] + y2 * wide[2, width] + y3 * wide[3, width]
        )
        target = equations.hessian[at, frame0:]
        for q in range(min(p + 1, frames_width)):
            target[q] -= y0 * wide[0, q] + y1 * wide[1, q] + y2 * wide[2, q] + y3 * wide[3, q]
        for q in range(frames_width, p + 1):
            equations.hessian[at, rig0 + q - frames_width] -= (
                y0 * wide[0, q] + y1 * wide[1, q] + y2 * wide[2, q] + y3 * wide[3, q]
            )


@compiled
def add_pairs(sums: FloatArray, adjoints: FloatArray, equations: WindowEquations) -> None:
    """Add the equations of motions to those of frames: ξ_ka = ξ_k − Ad(T_ka) ξ_a.

    In its anchor frame, a landmark is where it is, whatever the pose: only the jitter counts.

    Args:
        sums: equations of ζ = (ξ_ka, ω_k) for frame k and anchor a, [K, K, 9, 24]: its information
            by itself, with ζ of the frame before, and with the rig, and its gradient.
        adjoints: Ad(T_ka), [K, K, 6, 6].
        equations: receives the sums.
    """
    hessian = equations.hessian
    rig0 = len(equations.gradient) - RIG
    mixed_block = np.empty((FRAME, POSE))
    anchor_block = np.empty((POSE, POSE))
    num_frames = len(adjoints)
    for k in range(num_frames):
        for a in range(k + 1):
            # The roll of the jitter moves every observation: its information is zero only where
            # there was none.
            motion_sums = sums[k, a]
            if motion_sums[FRAME - 1, FRAME - 1] == 0.0:
                continue  # no landmark of this anchor was seen there
            adjoint = adjoints[k, a]
            _times_adjoint(motion_sums, adjoint, mixed_block)
            _adjoint_transposed_times(adjoint, mixed_block, anchor_block)
            # mixed_block = H Ad, [9, 6], and anchor_block = Adᵀ H Ad, [6, 6]. The jitter's rows of
            # H have no part in the latter, as the anchor's pose moves ξ_ka alone. Information of
            # (ζ_k, ξ_a) by ζ = (ξ_k − Ad ξ_a, ω_k): [I, −Ad]ᵀ H [I, −Ad].
            frame_k = FRAME * k
            frame_a = FRAME * a
            for i in range(FRAME):
                equations.gradient[frame_k + i] += motion_sums[i, _GRADIENT]
                for j in range(FRAME):
                    hessian[frame_k + i, frame_k + j] += motion_sums[i, j]
                for j in range(POSE):
                    hessian[frame_k + i, frame_a + j] -= mixed_block[i, j]
                for j in range(RIG):
                    hessian[rig0 + j, frame_k + i] += motion_sums[i, _WITH_RIG + j]
            for i in range(POSE):
                for j in range(POSE):
                    hessian[frame_a + i, frame_a + j] += anchor_block[i, j]
                for n in range(POSE):
                    equations.gradient[frame_a + i] -= adjoint[n, i] * motion_sums[n, _GRADIENT]
                    for j in range(RIG):
                        hessian[rig0 + j, frame_a + i] -= (
                            adjoint[n, i] * motion_sums[n, _WITH_RIG + j]
                        )
            if a < k:
                cross = motion_sums[:, _WITH_PREV:_WITH_RIG]
                _add_neighbours(k, k - 1, a, cross=cross, adjoints=adjoints, equations=equations)


@compiled
def _add_neighbours(
    k: int, p: int, a: int, cross: FloatArray, adjoints: FloatArray, equations: WindowEquations
) -> None:
    """Add the information between the motions from frame a to frame k and to frame p before it.

    Args:
        k: slot of the later frame.
        p: slot of the earlier one.
        a: slot of the anchor frame.
        cross: information between ζ_k and ζ_p, [9, 9]. Its transpose counts as well: of the blocks
            off the diagonal only the lower triangle is filled, in the anchor's own block both sum
            up.
        adjoints: Ad(T_ka), [K, K, 6, 6].
        equations: receives the sums.
    """
    # ζ_kᵀ X ζ_p with ξ_ka = ξ_k − Ad_k ξ_a and ξ_pa = ξ_p − Ad_p ξ_a: X couples k and p, −X Ad_p
    # couples k and a, −Xᵀ Ad_k couples p and a, and Ad_kᵀ X Ad_p is the anchor's own. Where the
    # earlier frame is the anchor itself, X has no columns of ξ_pa, only those of the jitter.
    hessian = equations.hessian
    prev_block = np.empty((FRAME, POSE))
    curr_block = np.empty((FRAME, POSE))
    anchor_block = np.empty((POSE, POSE))
    _times_adjoint(cross, adjoints[p, a], prev_block)
    _times_adjoint(cross.T, adjoints[k, a], curr_block)
    _adjoint_transposed_times(adjoints[k, a], prev_block, anchor_block)
    for i in range(FRAME):
        for j in range(FRAME):
            hessian[FRAME * k + i, FRAME * p + j] += cross[i, j]
        for j in range(POSE):
            hessian[FRAME * k + i, FRAME * a + j] -= prev_block[i, j]
            hessian[FRAME * p + i, FRAME * a + j] -= curr_block[i, j]
    for i in range(POSE):
        for j in range(POSE):
            hessian[FRAME * a + i, FRAME * a + j] += anchor_block[i, j] + anchor_block[j, i]


@compiled_into_callers
def _times_adjoint(matrix: FloatArray, adjoint: FloatArray, product: FloatArray) -> None:
    """Set product, [9, 6], to the columns of ξ of a matrix, [9, ≥ 6], times an adjoint, [6, 6].

    A call of BLAS would take longer than these few products.
    """
    for i in range(FRAME):
        m0 = matrix[i, 0]
        m1 = matrix[i, 1]
        m2 = matrix[i, 2]
        m3 = matrix[i, 3]
        m4 = matrix[i, 4]
        m5 = matrix[i, 5]
        for j in range(POSE):
            product[i, j] = (
                m0 * adjoint[0, j]
                + m1 * adjoint[1, j]
                + m2 * adjoint[2, j]
                + m3 * adjoint[3, j]
                + m4 * adjoint[4, j]
                + m5 * adjoint[5, j]
            )


@compiled_into_callers
def _adjoint_transposed_times(adjoint: FloatArray, matrix: FloatArray, product: FloatArray) -> None:
    """Set product, [6, 6], to the transpose of an adjoint times the rows of ξ of a matrix,
    [≥ 6, 6]."""
    for i in range(POSE):
        a0 = adjoint[0, i]
        a1 = adjoint[1, i]
        a2 = adjoint[2, i]
        a3 = adjoint[3, i]
        a4 = adjoint[4, i]
        a5 = adjoint[5, i]
        for j in range(POSE):
            product[i, j] = (
                a0 * matrix[0, j]
                + a1 * matrix[1, j]
                + a2 * matrix[2, j]
                + a3 * matrix[3, j]
                + a4 * matrix[4, j]
                + a5 * matrix[5, j]
            )

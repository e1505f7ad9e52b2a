"""What a track's past says of its disparity: a filter of two states for each track, and of six that all share.

A disparity that was wrong in one frame is wrong by nearly as much in the next (``StereoNoise.lasting``): a residual
hardly shows it, but the parallax of many frames does. So each track carries x = (d, δ), its true disparity and the
error of the measured one. The first sight gives d = measured and δ = 0, with [[S_dd + τ², −τ²], [−τ², τ²]]; every
further one is a Kalman update with the residual of the motion's solve.

The motion that the parallax is measured with is itself uncertain, and wrong for all tracks alike: taken for known, it
would make 300 tracks that are all 1 % too near sure of that to 0.1 %. So an error of x is ε + U c, with ε of the
track's own, and six numbers c ~ N(0, I) in common. Motion and c are estimated together, ξ and c from e = J ξ + H U c
+ …, and of the twelve directions of their posterior, the six that the tracks feel most stay in common; the others go
to ε.

Where the track is in the image is not remembered. A tracker follows a patch from frame to frame, and if it slips, it
follows another one from there on, so that a track *is* where it was last seen. On KITTI the likelihood of the next
residuals says so, too: against remembering nothing it gains 0.3 to 0.9 nats a feature in this way, and loses as much
if the track is taken for one point of the world, seen with noise that is new in each frame.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from probevo.arrays import BoolArray, FloatArray, IntArray
from probevo.camera.stereo import StereoCamera
from probevo.geometry import se3
from probevo.motion.reprojection import ReprojectionSolution, sum_products
from probevo.motion.reprojection_kernels import NEAREST
from probevo.motion.seen_points import KnownDisparities
from probevo.noise.base import StereoNoise
from probevo.tracking.tracks import Tracks

WANDERING = 0.02
"""How much of τ² a lasting error wanders from frame to frame. By likelihood on KITTI: half as much costs 0.03 nats a
feature, three times as much 0.04, and to pull the errors towards zero as well 0.01."""
ROUNDING = 1e-9
"""Of a variance, is left by whatever a residual says."""
SHARED = 6
"""Errors in common. With three, the motions in a simulation are as good; with twelve no better."""


@dataclass(frozen=True)
class DisparityMemory:
    """The disparities of M tracks, as all frames so far tell them."""

    ids: IntArray
    """Identities of the tracks, ascending, [M]."""
    known: KnownDisparities
    """Of each of them, in terms of the last frame."""
    common: FloatArray
    """U: what the errors in common do to (d, δ), [M, 2, 6], px."""
    path: FloatArray
    """Covariance of the path's error, along the axes of the last frame, with the errors in common, [6, 6]."""
    tied: FloatArray
    """Covariance of the path's error before the last step, along the same axes, with that of the step, [6, 6]."""

    @staticmethod
    def none() -> DisparityMemory:
        """Before the first step, and after one that failed."""
        nothing = np.zeros((6, SHARED))
        return DisparityMemory(
            np.zeros(0, np.int64), KnownDisparities.none(), np.zeros((0, 2, SHARED)), nothing, np.zeros((6, 6))
        )

    def of(self, ids: IntArray) -> DisparityMemory:
        """What is known of tracks with these identities, [N]; ``known.rows`` says of which of them."""
        place = np.minimum(np.searchsorted(self.ids, ids), max(len(self.ids) - 1, 0))
        rows = np.flatnonzero(self.ids[place] == ids) if len(self.ids) else place[:0]
        place, known = place[rows], self.known
        found = KnownDisparities(rows, known.disparity[place], known.error[place], known.cov[place])
        return DisparityMemory(ids[rows], found, self.common[place], self.path, self.tied)


@dataclass(frozen=True)
class Together:
    """Motion and errors in common, (ξ, c), after a step."""

    mean: FloatArray
    """[12]."""
    root: FloatArray
    """Of their covariance, [12, 12]."""
    moved: FloatArray
    """How they move the predicted observations, (J, H U), [N, 4, 12]."""
    common: FloatArray
    """U of the tracks that were known, at the disparities that the solve has refined, [M, 2, 6]."""

    @staticmethod
    def of(solution: ReprojectionSolution, before: DisparityMemory) -> Together:
        """From the solve, which took the errors for the tracks' own, by one more Gauss–Newton step.

        The robust weights are those of the solve; its covariance, in which the loss has a part, stays what it is for a
        motion without errors in common.
        """
        rows, common = before.known.rows, before.common.copy()
        # A scale that is wrong for all would seem observable if it were taken of other disparities at every step.
        common[:, 0] *= (solution.refined[rows, 2] / solution.points.seen[rows, 2])[:, None]
        moved = np.zeros((len(solution.squared), 4, SHARED))
        moved[rows] = solution.disparity_jacobian[rows, :, None] * common[:, None, 0]
        moved[rows, 2] -= common[:, 1]
        white, residuals = solution.whitened(moved), solution.whitened(solution.residuals[:, :, None])
        cross, own = sum_products(solution.jacobian, white), sum_products(moved, white)
        both = np.concatenate([solution.jacobian, moved], axis=2)
        normal = np.block([[solution.hessian, cross], [cross.T, own + np.eye(SHARED)]])
        mean = np.linalg.solve(normal, sum_products(both, residuals)[:, 0])
        told, weighted = np.linalg.cholesky(np.linalg.inv(solution.cov)), np.linalg.cholesky(solution.hessian)
        change = told @ np.linalg.inv(weighted)  # takes the Hessian to the information
        factor = float(np.prod(np.diagonal(change))) ** (1.0 / 6.0)
        information = np.block(
            [
                [told @ told.T, factor * change @ cross],
                [factor * cross.T @ change.T, factor**2 * own + np.eye(SHARED)],
            ]
        )
        return Together(mean.astype(float), np.linalg.cholesky(np.linalg.inv(information)).astype(float), both, common)


def remember(
    tracks: Tracks,
    noise: StereoNoise,
    solution: ReprojectionSolution,
    camera: StereoCamera,
    trusted: BoolArray,
    before: DisparityMemory,
) -> tuple[ReprojectionSolution, DisparityMemory]:
    """The solution with the errors in common taken into account, and the memory in terms of the current frame.

    Args:
        tracks: the N tracks that were solved with.
        noise: the noise of each; where no error lasts, nothing is worth remembering.
        solution: the solve, with ``before.known``.
        camera: the rectified camera.
        trusted: which of the tracks to remember, [N]; the others start anew.
        before: what was known of the tracks.
    """
    if noise.lasting is None or not (np.isfinite(solution.cov).all() and np.linalg.eigvalsh(solution.hessian)[0] > 0.0):
        return solution, DisparityMemory.none()
    together = Together.of(solution, before)
    T_curr_prev: FloatArray = se3.exp(together.mean[:6]) @ solution.T_curr_prev
    cov: FloatArray = together.root[:6] @ together.root[:6].T
    better = replace(solution, T_curr_prev=T_curr_prev, cov=cov)
    return better, carried_on(tracks, noise, better, camera, trusted, before, together)


def carried_on(
    tracks: Tracks,
    noise: StereoNoise,
    solution: ReprojectionSolution,
    camera: StereoCamera,
    trusted: BoolArray,
    before: DisparityMemory,
    together: Together | None = None,
) -> DisparityMemory:
    """The memory after a step whose motion is known, or uncertain ``together`` with the errors in common."""
    if noise.lasting is None:
        return DisparityMemory.none()
    order = np.argsort(tracks.ids)
    chosen = order[(trusted & (solution.information[:, 0, 0] > 0.0))[order]]
    points, shared, residuals = solution.points, solution.shared[chosen], solution.residuals[chosen]
    gain = np.swapaxes(shared, 1, 2) @ solution.information[chosen]
    x = np.column_stack([points.seen[chosen, 2], points.error[chosen]])
    common = np.zeros((len(chosen), 2, 2 * SHARED))
    if together is not None:
        U, moved = np.zeros((len(tracks), 2, SHARED)), together.moved[chosen]
        U[before.known.rows] = together.common
        x += U[chosen] @ together.mean[6:]
        residuals = residuals - moved @ together.mean
        common = -gain @ moved
        common[:, :, 6:] += U[chosen]
    x += np.matmul(gain, residuals[:, :, None])[:, :, 0]
    cov = points.cov[chosen, 2:, 2:] - gain @ shared
    cov[:, (0, 1), (0, 1)] += ROUNDING * points.cov[chosen][:, (2, 3), (2, 3)]
    T, px, jacobian = solution.T_curr_prev, tracks.prev_px[chosen], solution.disparity_jacobian[chosen]
    right, down = (px[:, 0] - camera.cu_px) / camera.fu_px, (px[:, 1] - camera.cv_px) / camera.fv_px
    depth = T[2, 0] * right + T[2, 1] * down + T[2, 2] + T[2, 3] * x[:, 0] / (camera.fu_px * camera.baseline_m)
    forward = np.column_stack([jacobian[:, 0] - jacobian[:, 2], np.ones(len(chosen))])
    cov = cov * forward[:, :, None] * forward[:, None, :]
    cov[:, 1, 1] += WANDERING * noise.lasting[chosen]
    common = common * forward[:, :, None]
    path, tied = np.zeros((6, SHARED)), np.zeros((6, 6))
    if together is not None:
        common[:, 0, :6] += solution.jacobian[chosen, 0] - solution.jacobian[chosen, 2]
        common, cov, kept = _most_felt(common @ together.root, cov)
        step, passed_on, before_it = together.root[:6], together.root[6:], se3.adjoint(T) @ before.path
        path, tied = (before_it @ passed_on + step) @ kept, before_it @ passed_on @ step.T
    ahead = depth > NEAREST
    known = KnownDisparities(np.arange(int(ahead.sum())), x[ahead, 0] / depth[ahead], x[ahead, 1], cov[ahead])
    return DisparityMemory(tracks.ids[chosen[ahead]], known, common[ahead, :, :SHARED], path, tied)


def _most_felt(common: FloatArray, cov: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Of twelve errors in common, [M, 2, 12], the six directions that matter most against the tracks' own covariances
    [M, 2, 2], [M, 2, 6]; the latter with the others added; and these directions, [12, 6]."""
    white = np.linalg.solve(np.linalg.cholesky(cov), common)
    _, directions = np.linalg.eigh(sum_products(white, white))
    kept, dropped = directions[:, SHARED:], directions[:, :SHARED]
    rest = common @ dropped
    return common @ kept, cov + rest @ np.swapaxes(rest, 1, 2), kept

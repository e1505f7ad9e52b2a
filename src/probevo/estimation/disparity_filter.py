"""What a track's past says of its disparity: a filter of two states for each track, and of six that
all share.

A disparity that was wrong in one frame is wrong by nearly as much in the next
(``StereoNoise.time_correlated``): a residual hardly shows it, but the parallax of many frames does. So each
track carries x = (d, δ), its true disparity and the error of the measured one. The first sight
gives d = measured and δ = 0, with [[S_dd + τ², −τ²], [−τ², τ²]]; every further one is a Kalman
update with the residual of the motion's solve.

The motion that the parallax is measured with is itself uncertain, and wrong for all tracks alike:
    taken for known, it
would make 300 tracks that are all 1 % too near sure of that to 0.1 %. So an error of x is ε + U c,
with ε of the track's own, and six numbers c ~ N(0, I) in common. Motion and c are estimated
together, ξ and c from e = J ξ + H U c + …, and of the twelve directions of their posterior, the six
that the tracks feel most stay in common; the others go to ε.

Where the track is in the image is not remembered. A tracker follows a patch from frame to frame,
and if it slips, it follows another one from there on, so that a track *is* where it was last seen.
On KITTI the likelihood of the next residuals says so, too: against remembering nothing it gains 0.3
to 0.9 nats a feature in this way, and loses as much if the track is taken for one point of the
world, seen with noise that is new in each frame.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from probevo.arrays import BoolArray, FloatArray, IntArray
from probevo.camera.stereo import StereoCamera
from probevo.compiled import perturb
from probevo.estimation.disparity_filter_numba import normal_parts, renew
from probevo.estimation.reprojection import ReprojectionSolution, sum_products
from probevo.geometry import se3
from probevo.measurements.point_priors import KnownDisparities
from probevo.measurements.stereo_numba import NEAREST
from probevo.noise.base import StereoNoise
from probevo.tracking.tracks import Tracks

WANDERING = 0.02
"""How much of τ² a lasting error wanders from frame to frame. By likelihood on KITTI: half as much
costs 0.03 nats a feature, three times as much 0.04, and to pull the errors towards zero as well
0.01."""
LEAST_DISPARITY_PX = 0.1
"""Below it, a disparity is no measure of another."""
SHARED = 6
"""Errors in common. With three, the motions in a simulation are as good; with twelve no better."""


@dataclass(frozen=True)
class DisparityMemory:
    """The disparities of M tracks, as all frames so far tell them."""

    ids: IntArray
    """Identities of the tracks, ascending, [M]."""
    known: KnownDisparities
    """Of each of them, in terms of the last frame."""
    measured: FloatArray
    """The disparity measured in the last frame, [M], px."""
    common: FloatArray
    """U: what the errors in common do to (d, δ), [M, 2, 6], px."""
    path: FloatArray
    """Covariance of the path's error, along the axes of the last frame, with the errors in common,
    [6, 6]."""
    path_cross_cov: FloatArray
    """Covariance of the path's error before the last step, along the same axes, with that of the
    step, [6, 6]."""

    @staticmethod
    def none() -> DisparityMemory:
        """Before the first step, and after one that failed."""
        nothing = np.zeros((6, SHARED))
        nobody = np.zeros(0, np.int64)
        no_one = KnownDisparities.none()
        return DisparityMemory(
            nobody,
            no_one,
            np.zeros(0),
            common=np.zeros((0, 2, SHARED)),
            path=nothing,
            path_cross_cov=np.zeros((6, 6)),
        )

    def of(self, tracks: Tracks) -> DisparityMemory:
        """What is known of N tracks in their previous frame; ``known.rows`` says of which of them.

        The self-calibration may have learned since then, so that the same measurement is corrected
        to another one.
        """
        ids = tracks.ids
        place = np.minimum(np.searchsorted(self.ids, ids), max(len(self.ids) - 1, 0))
        rows = np.flatnonzero(self.ids[place] == ids) if len(self.ids) else place[:0]
        place = place[rows]
        known = self.known
        measured = tracks.prev_px[rows, 0] - tracks.prev_px[rows, 2]
        error = known.error[place] + measured - self.measured[place]
        found = KnownDisparities(rows, known.disparity[place], error, cov=known.cov[place])
        return DisparityMemory(
            ids[rows],
            found,
            measured,
            common=self.common[place],
            path=self.path,
            path_cross_cov=self.path_cross_cov,
        )


@dataclass(frozen=True)
class JointPosterior:
    """Motion and errors in common, (ξ, c), after a step."""

    mean: FloatArray
    """[12]."""
    root: FloatArray
    """Of their covariance, [12, 12]."""
    common: FloatArray
    """U of the tracks that were known, at the disparities that the solve has refined, [M, 2, 6]."""

    @staticmethod
    def of(solution: ReprojectionSolution, before: DisparityMemory) -> JointPosterior:
        """From the solve, which took the errors for the tracks' own, by one more Gauss–Newton step.

        The robust weights are those of the solve; its covariance, in which the loss has a part,
        stays what it is for a motion without errors in common.
        """
        rows = before.known.rows
        common = before.common.copy()
        # A scale that is wrong for all would seem observable if it were taken of other disparities
        # at every step.
        seen = solution.points.seen[rows, 2]
        refined = solution.refined[rows, 2]
        grown = np.where(
            seen > LEAST_DISPARITY_PX, refined / np.maximum(seen, LEAST_DISPARITY_PX), 1.0
        )
        common[:, 0] *= grown[:, None]
        cross = np.empty((6, SHARED))
        own = np.empty((SHARED, SHARED))
        pull = np.empty(SHARED)
        solved = (
            solution.jacobian,
            solution.disparity_jacobian,
            solution.information,
            solution.irls_weight,
        )
        normal_parts(rows, *solved, solution.residuals, common, cross, own, pull)
        normal = _joint(solution.hessian, cross, own + np.eye(SHARED))
        # The motion is at its optimum, so that only the errors in common are pulled at.
        mean = np.linalg.solve(normal, np.concatenate([np.zeros(6), pull]))
        told = np.linalg.cholesky(np.linalg.inv(solution.cov))
        weighted = np.linalg.cholesky(solution.hessian)
        change = told @ np.linalg.inv(weighted)  # takes the Hessian to the information
        factor = float(np.prod(np.diagonal(change))) ** (1.0 / 6.0)
        information = _joint(
            told @ told.T, factor * change @ cross, factor**2 * own + np.eye(SHARED)
        )
        root = np.linalg.cholesky(np.linalg.inv(information))
        return JointPosterior(mean.astype(float), root.astype(float), common)


def _joint(motion: FloatArray, cross: FloatArray, common: FloatArray) -> FloatArray:
    """The symmetric matrix of these blocks, [12, 12]."""
    joint = np.empty((12, 12))
    joint[:6, :6] = motion
    joint[:6, 6:] = cross
    joint[6:, :6] = cross.T
    joint[6:, 6:] = common
    return joint


def remember(
    tracks: Tracks,
    noise: StereoNoise,
    solution: ReprojectionSolution,
    camera: StereoCamera,
    trusted: BoolArray,
    before: DisparityMemory,
) -> tuple[ReprojectionSolution, DisparityMemory]:
    """The solution with the errors in common taken into account, and the memory in terms of the
    current frame.

    Args:
        tracks: the N tracks that were solved with.
        noise: the noise of each; where no error lasts, nothing is worth remembering.
        solution: the solve, with ``before.known``.
        camera: the rectified camera.
        trusted: which of the tracks to remember, [N]; the others start anew.
        before: what was known of the tracks.
    """
    if noise.time_correlated is None or not (
        np.isfinite(solution.cov).all() and np.linalg.eigvalsh(solution.hessian)[0] > 0.0
    ):
        return solution, DisparityMemory.none()
    try:
        posterior = JointPosterior.of(solution, before)
        T = solution.T_curr_prev
        T_curr_prev = np.eye(4)
        C = np.empty((3, 3))
        t = np.empty(3)
        perturb(posterior.mean[:6].copy(), T[:3, :3].copy(), T[:3, 3].copy(), C_out=C, t_out=t)
        T_curr_prev[:3, :3] = C
        T_curr_prev[:3, 3] = t
        cov: FloatArray = posterior.root[:6] @ posterior.root[:6].T
        better = replace(solution, T_curr_prev=T_curr_prev, cov=cov)
        return better, carried_on(
            tracks,
            noise,
            better,
            camera=camera,
            trusted=trusted,
            before=before,
            posterior=posterior,
        )
    except np.linalg.LinAlgError:  # of points kilometres away, next to nothing fixes the motion
        return solution, DisparityMemory.none()


def carried_on(
    tracks: Tracks,
    noise: StereoNoise,
    solution: ReprojectionSolution,
    camera: StereoCamera,
    trusted: BoolArray,
    before: DisparityMemory,
    posterior: JointPosterior | None = None,
) -> DisparityMemory:
    """The memory after a step whose motion is known, or uncertain with the errors in common
    (``posterior``)."""
    if noise.time_correlated is None:
        return DisparityMemory.none()
    order = np.argsort(tracks.ids)
    chosen = order[(trusted & (solution.information[:, 0, 0] > 0.0))[order]]
    U = np.zeros((len(tracks), 2, SHARED))
    mean = np.zeros(12)
    if posterior is not None:
        U[before.known.rows] = posterior.common
        mean = posterior.mean
    x = np.empty((len(chosen), 2))
    cov = np.empty((len(chosen), 2, 2))
    felt = np.empty((len(chosen), 2, 12))
    points = solution.points
    solved = (solution.shared, solution.information, solution.residuals)
    jacobians = solution.jacobian, solution.disparity_jacobian
    renew(chosen, points.seen, points.error, points.cov, *solved, *jacobians, U, mean, x, cov, felt)
    cov[:, 1, 1] += WANDERING * noise.time_correlated[chosen]
    T = solution.T_curr_prev
    px = tracks.prev_px[chosen]
    right, down = camera.normalized(px[:, 0], px[:, 1])
    depth = (
        T[2, 0] * right
        + T[2, 1] * down
        + T[2, 2]
        + T[2, 3] * x[:, 0] / (camera.fu_px * camera.baseline_m)
    )
    common = np.zeros((len(chosen), 2, SHARED))
    path = np.zeros((6, SHARED))
    tied = np.zeros((6, 6))
    if posterior is not None:
        common, cov, directions = _most_felt(felt @ posterior.root, cov)
        step = posterior.root[:6]
        passed_on = posterior.root[6:]
        before_it = se3.adjoint(T) @ before.path
        path = (before_it @ passed_on + step) @ directions
        tied = before_it @ passed_on @ step.T
    ahead = depth > NEAREST
    known = KnownDisparities(
        np.arange(int(ahead.sum())), x[ahead, 0] / depth[ahead], x[ahead, 1], cov=cov[ahead]
    )
    kept = chosen[ahead]
    measured = tracks.curr_px[kept, 0] - tracks.curr_px[kept, 2]
    return DisparityMemory(
        tracks.ids[kept], known, measured, common=common[ahead], path=path, path_cross_cov=tied
    )


def _most_felt(common: FloatArray, cov: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Of twelve errors in common, [M, 2, 12], the six directions that matter most against the
    tracks' own covariances [M, 2, 2], [M, 2, 6]; the latter with the others added; and these
    directions, [12, 6]."""
    with np.errstate(divide="ignore", invalid="ignore"):  # the Cholesky factor of each, written out
        first = np.sqrt(cov[:, :1, 0])
        across = cov[:, 1, :1] / first
        rest = cov[:, 1, 1:] - across**2
    if not (rest > 0.0).all():
        raise np.linalg.LinAlgError("a track's covariance is not positive definite")
    white = np.empty_like(common)
    white[:, 0] = common[:, 0] / first
    white[:, 1] = (common[:, 1] - across * white[:, 0]) / np.sqrt(rest)
    _, directions = np.linalg.eigh(sum_products(white, white))
    kept = directions[:, SHARED:]
    dropped = directions[:, :SHARED]
    left = common @ dropped
    return common @ kept, cov + left @ np.swapaxes(left, 1, 2), kept

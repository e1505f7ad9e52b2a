"""The E-step: what the motions of a drive were, given a noise model, and what errors its features then have."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from probevo.arrays import BoolArray, FloatArray, IntArray
from probevo.camera.stereo import StereoCamera
from probevo.config import SolverConfig
from probevo.geometry import se3
from probevo.motion.reprojection import ReprojectionSolution, solve_reprojection
from probevo.motion.visual import solve
from probevo.noise.base import StereoNoise
from probevo.tracking.tracks import Tracks
from probevo.training.drive import Drive
from probevo.training.lasting import lasting_profile
from probevo.training.lesson import Lesson
from probevo.training.supervision import Supervision

UNSOLVED_SIGMA = np.array([1.0, 1.0, 1.0, 0.1, 0.1, 0.1])
"""Of a step whose features fix no motion, m and rad."""
LEAST_TRUTH_SIGMA = np.array([1e-4, 1e-4, 1e-4, 1e-5, 1e-5, 1e-5])
"""No truth is better than that, m and rad."""
FEW_STRETCHES = 20
LOOP_SIGMA = np.array([0.1, 0.1, 0.1, 0.02, 0.02, 0.02])
"""How well a loop is known to close, m and rad: it is parked by hand."""


Predict = Callable[[FloatArray], StereoNoise]
"""Noise of n features from their predictors, [n, M]."""


@dataclass(frozen=True)
class LeftOver:
    """The errors of m features at the motions."""

    steps: IntArray
    """The step of each, [m]."""
    features: IntArray
    """Which of the drive's features these are, [m]."""
    phi: FloatArray
    """Their places in the prediction space, [m, M]."""
    errors: FloatArray
    """What the noise model is to describe: residuals, or errors of single observations, [m, 4], px."""
    spread: FloatArray
    """What the doubt about the motions makes of them: their covariance, [m, 4, 4], px²."""
    log_likelihood: FloatArray
    """Of the residuals under the noise that the motions were solved with, [m], nats."""
    profile: FloatArray
    """What they tell of how much lasts of the disparity's error, as from ``lasting_profile``, [m, 4]."""

    @staticmethod
    def joined(parts: Sequence[LeftOver]) -> LeftOver:
        """One after another as one."""
        return LeftOver(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(LeftOver)))


@dataclass(frozen=True)
class Expectation:
    """The motions of a drive's K − 1 steps, and what errors they leave."""

    T_curr_prev: FloatArray
    """[K − 1, 4, 4]."""
    T_alone: FloatArray
    """The same from the features alone, without any truth."""
    left_over: LeftOver


def solve_drive(
    drive: Drive, noise: StereoNoise, camera: StereoCamera, solver: SolverConfig
) -> tuple[FloatArray, FloatArray]:
    """Motions T_curr_prev [K − 1, 4, 4] under the noise of the drive's n features, and their covariances [K − 1, 6, 6].

    A step that cannot be solved keeps the drive's own motion, with UNSOLVED_SIGMA.
    """
    motions, cov = drive.T_curr_prev.copy(), np.tile(np.diag(UNSOLVED_SIGMA**2), (len(drive.T_curr_prev), 1, 1))
    for step, chosen, tracks in _solvable(drive, solver):
        solution = solve(tracks, noise.of(chosen), motions[step], camera, None, solver)
        if solution.converged and np.isfinite(solution.cov).all():
            motions[step], cov[step] = solution.T_curr_prev, solution.cov
    return motions, cov


def expect(
    lesson: Lesson,
    predict: Predict,
    solver: SolverConfig,
    truth_sigma: FloatArray | None,
    share: float = 1.0,
    seed: tuple[int, ...] = (),
) -> Expectation:
    """Motions as the features and the truth together give them, and the errors that are left.

    The truth is a Gaussian prior on the motion over each stretch of the supervision: known exactly it decides (GK-GT),
    unknown it says nothing (GK-EM), and KITTI's, off by more than the features are, lies between. Stretches may be as
    long as the drive, but between features and motions nothing is held of it but motions and covariances.

    Args:
        lesson: the drive, which is read twice, and what is known of it; nothing, if its kind is ``none``.
        predict: the noise of n features from their predictors [n, M].
        solver: settings of the solve.
        truth_sigma: standard deviation of the truth over a stretch, m and rad, [6]; None to estimate it from how far it
            is from what the features say.
        share: of the features, how many are to be given errors; they are drawn.
        seed: of the draw: the same ones, however the drive is cut into parts.
    """
    camera, supervision = lesson.camera, lesson.supervision
    solved = [solve_drive(part, predict(part.phi), camera, solver) for part in lesson.parts()]
    alone, cov = (np.concatenate(arrays) for arrays in zip(*solved, strict=True))
    motions = alone
    if supervision.kind != "none":
        motions, cov = conditioned(alone, cov, supervision, truth_sigma)
    rng, found, step, feature = np.random.default_rng([*seed]), [], 0, 0
    for part in lesson.parts():
        steps = slice(step, step + len(part.T_curr_prev))
        wanted = part.used & (rng.random(len(part.used)) < share)
        at = replace(part, T_curr_prev=motions[steps])
        left = _left_over(at, cov[steps], predict(part.phi), camera, solver, wanted)
        found.append(replace(left, steps=left.steps + step, features=left.features + feature))
        step, feature = steps.stop, feature + len(part.phi)
    return Expectation(motions, alone, LeftOver.joined(found))


def conditioned(
    T_curr_prev: FloatArray, cov: FloatArray, supervision: Supervision, truth_sigma: FloatArray | None
) -> tuple[FloatArray, FloatArray]:
    """Motions [K − 1, 4, 4] and covariances [K − 1, 6, 6], given the true motion over each stretch.

    The motion over a stretch is T = T_m … T_1, and perturbations ξ_k of its steps move it by Σ Ad_k ξ_k with
    Ad_k = Ad(T_m … T_{k+1}). With M = Σ Ad_k C_k Ad_kᵀ, the covariance P of the truth and its distance ξ = Log(T_true
    T⁻¹), each step moves by C_k Ad_kᵀ (M + P)⁻¹ ξ. Of stretches of one step this is the fusion of two Gaussians.
    """
    motions, posterior = T_curr_prev.copy(), cov.copy()
    chains = [
        (first, last, *_chain(T_curr_prev[first:last], cov[first:last], supervision.T_world_cam[[i, i + 1]]))
        for i, (first, last) in enumerate(supervision.stretches.tolist())
    ]
    if truth_sigma is None:
        truth_sigma = LOOP_SIGMA if supervision.kind == "loop" else _sigma_of_truth(chains)
    P = np.diag(np.maximum(truth_sigma, LEAST_TRUTH_SIGMA) ** 2)
    for first, last, to_end, M, distance in chains:
        gain = cov[first:last] @ np.swapaxes(to_end, 1, 2) @ np.linalg.inv(M + P)
        motions[first:last] = se3.exp(gain @ distance) @ T_curr_prev[first:last]
        posterior[first:last] -= gain @ to_end @ cov[first:last]
    return motions, posterior


def _chain(
    T_curr_prev: FloatArray, cov: FloatArray, T_world_cam: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Ad_k of each step, [m, 6, 6], their M, [6, 6], and how far the truth of both ends is, [6]."""
    rest, to_end = np.eye(4), np.empty((len(T_curr_prev), 6, 6))
    for k in range(len(T_curr_prev) - 1, -1, -1):
        to_end[k] = se3.adjoint(rest)
        rest = rest @ T_curr_prev[k]
    M: FloatArray = np.sum(to_end @ cov @ np.swapaxes(to_end, 1, 2), axis=0)
    true = se3.inverse(T_world_cam[1]) @ T_world_cam[0]
    return to_end, M, se3.log(true @ se3.inverse(rest))


def _sigma_of_truth(chains: list[tuple[int, int, FloatArray, FloatArray, FloatArray]]) -> FloatArray:
    """What the scatter of the truth around the features' motions is, beyond what these are off by, [6], by medians.

    Few stretches may scatter little by chance: then the truth is taken to be no better than the features.
    """
    distances = np.abs([chain[4] for chain in chains]).reshape(-1, 2, 3)  # translations, rotations
    scatter = (1.4826 * np.median(distances, axis=(0, 2))) ** 2
    own = np.median(np.reshape([np.diagonal(chain[3]) for chain in chains], (-1, 2, 3)), axis=(0, 2))
    least = own if len(chains) < FEW_STRETCHES else np.zeros(2)
    sigma: FloatArray = np.repeat(np.sqrt(np.maximum(scatter - own, least)), 3)
    return sigma


def _solvable(drive: Drive, solver: SolverConfig) -> list[tuple[int, IntArray, Tracks]]:
    """Steps with features enough, which these are among the drive's, and their tracks."""
    found = []
    for step in range(len(drive.T_curr_prev)):
        rows = drive.rows(step)
        own = np.flatnonzero(drive.used[rows])
        if len(own) >= solver.min_tracks:
            found.append((step, rows.start + own, drive.tracks(step).kept(own)))
    return found


def _left_over(
    drive: Drive, cov: FloatArray, noise: StereoNoise, camera: StereoCamera, solver: SolverConfig, wanted: BoolArray
) -> LeftOver:
    """Of the wanted ones of a drive's features, at its motions, whose covariances are given."""
    nothing = np.zeros(0, np.int64)
    found = [
        LeftOver(nothing, nothing, drive.phi[:0], np.zeros((0, 4)), np.zeros((0, 4, 4)), np.zeros(0), np.zeros((0, 4)))
    ]
    for step, chosen, tracks in _solvable(drive, solver):
        own = noise.of(chosen)
        if cov[step, 0, 0] > UNSOLVED_SIGMA[0] ** 2 / 4.0:  # neither solved nor known: its residuals say nothing
            continue
        T_curr_prev = drive.T_curr_prev[step]
        solution = solve_reprojection(tracks.prev_px, tracks.curr_px, own, T_curr_prev, camera, max_iterations=0)
        kept = np.flatnonzero((solution.information[:, 0, 0] > 0.0) & wanted[chosen])  # those in front
        error, spread, sigma = _errors(solution, own, cov[step], kept)
        residual_noise = StereoNoise(sigma, own.dof[kept], np.zeros_like(error))
        likelihood = residual_noise.log_likelihood(solution.residuals[kept])
        features, profile = chosen[kept], lasting_profile(solution, own, kept)
        steps = np.full(len(kept), step)
        found.append(LeftOver(steps, features, drive.phi[features], error, spread, likelihood, profile))
    return LeftOver.joined(found)


def _errors(
    solution: ReprojectionSolution, noise: StereoNoise, cov: FloatArray, chosen: IntArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Errors as the noise speaks of them, their spread, and the scale Σ of the residuals, of some features.

    Where it speaks of observations, with scale R, the residual e is brought back to the size of one: R^½ Σ^-½ e has the
    scale R if e has Σ. The bias, which the solution has taken off, is put back.
    """
    sigma: FloatArray = np.linalg.inv(solution.information[chosen]).astype(np.float64)
    errors, moved = solution.residuals[chosen], solution.jacobian[chosen]
    if noise.refers_to == "observation":
        back = np.linalg.cholesky(noise.scale[chosen]) @ np.linalg.inv(np.linalg.cholesky(sigma))
        errors, moved = np.einsum("nij,nj->ni", back, errors), back @ moved
    return errors + noise.bias[chosen], moved @ cov @ np.swapaxes(moved, 1, 2), sigma

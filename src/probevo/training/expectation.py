"""The E-step: what the motions of a drive were, given a noise model, and what errors its features then have."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.camera.stereo import StereoCamera
from probevo.config import SolverConfig
from probevo.motion.memory import DisparityMemory, carried_on, remember
from probevo.motion.reprojection import solve_reprojection
from probevo.motion.robust import RobustLoss
from probevo.motion.trust import TRUSTED, weights_of
from probevo.motion.visual import solve
from probevo.noise.base import StereoNoise
from probevo.tracking.tracks import Tracks
from probevo.training.conditioning import conditioned
from probevo.training.drive import Drive
from probevo.training.lasting import lasting_profile
from probevo.training.left_over import LeftOver, errors_of
from probevo.training.lesson import Lesson

UNSOLVED_SIGMA = np.array([1.0, 1.0, 1.0, 0.1, 0.1, 0.1])
"""Of a step whose features fix no motion, m and rad."""


Predict = Callable[[FloatArray], StereoNoise]
"""Noise of n features from their predictors, [n, M]."""


@dataclass(frozen=True)
class Expectation:
    """The motions of a drive's K − 1 steps, and what errors they leave."""

    T_curr_prev: FloatArray
    """[K − 1, 4, 4]."""
    T_alone: FloatArray
    """The same from the features alone, without any truth."""
    left_over: LeftOver


def solve_drive(
    parts: Iterable[Drive], predict: Predict, camera: StereoCamera, solver: SolverConfig
) -> tuple[FloatArray, FloatArray]:
    """Motions T_curr_prev [K − 1, 4, 4] of a drive under the predicted noise, and their covariances [K − 1, 6, 6].

    A step that cannot be solved keeps the drive's own motion, with UNSOLVED_SIGMA.
    """
    memory, last = DisparityMemory.none(), -1
    motions, cov = [np.zeros((0, 4, 4))], [np.zeros((0, 6, 6))]
    for part in parts:
        noise = predict(part.phi)
        motions.append(part.T_curr_prev.copy())
        cov.append(np.tile(np.diag(UNSOLVED_SIGMA**2), (len(part.T_curr_prev), 1, 1)))
        for step, chosen, tracks in _steps(part):
            before = memory.of(tracks) if part.numbers[step] == last + 1 else DisparityMemory.none()
            memory, last = DisparityMemory.none(), int(part.numbers[step])
            if len(chosen) < solver.min_tracks:
                continue
            own = noise.of(chosen)
            solution = solve(tracks, own, part.T_curr_prev[step], camera, None, solver, before.known)
            if solution.converged and np.isfinite(solution.cov).all():
                if solver.method == "reprojection":
                    trusted = weights_of(solution, own.dof, solver.loss) >= TRUSTED
                    solution, memory = remember(tracks, own, solution, camera, trusted, before)
                motions[-1][step], cov[-1][step] = solution.T_curr_prev, solution.cov
    return np.concatenate(motions), np.concatenate(cov)


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
    alone, cov = solve_drive(lesson.parts(), predict, camera, solver)
    motions = alone
    if supervision.kind != "none":
        motions, cov = conditioned(alone, cov, supervision, truth_sigma)
    rng = np.random.default_rng([*seed])
    return Expectation(motions, alone, left_over(lesson.parts(), motions, cov, predict, camera, solver, share, rng))


def _steps(drive: Drive) -> Iterator[tuple[int, IntArray, Tracks]]:
    """Each step, which of the drive's features may be used in it, and their tracks."""
    for step in range(len(drive.T_curr_prev)):
        rows = drive.rows(step)
        own = np.flatnonzero(drive.used[rows])
        yield step, rows.start + own, drive.tracks(step).kept(own)


def left_over(
    parts: Iterable[Drive],
    T_curr_prev: FloatArray,
    cov: FloatArray,
    predict: Predict,
    camera: StereoCamera,
    solver: SolverConfig,
    share: float,
    rng: np.random.Generator,
) -> LeftOver:
    """Of a share of a drive's features, drawn, at these motions [K − 1, 4, 4] with covariances [K − 1, 6, 6]."""
    memory, last, found, first_step, first_feature = DisparityMemory.none(), -1, [], 0, 0
    loss = RobustLoss.named(solver.loss)
    for part in parts:
        noise = predict(part.phi)
        wanted = part.used & (rng.random(len(part.used)) < share)
        found.append(LeftOver.none(part.phi.shape[1]))
        for step, chosen, tracks in _steps(part):
            before = memory.of(tracks) if part.numbers[step] == last + 1 else DisparityMemory.none()
            memory, last, at = DisparityMemory.none(), int(part.numbers[step]), first_step + step
            if len(chosen) < solver.min_tracks or cov[at, 0, 0] > UNSOLVED_SIGMA[0] ** 2 / 4.0:
                continue  # neither solved nor known: its residuals say nothing
            own = noise.of(chosen)
            solution = solve_reprojection(
                tracks.prev_px, tracks.curr_px, own, T_curr_prev[at], camera,
                loss=loss, max_iterations=0, known=before.known,
            )  # fmt: skip
            if solver.method == "reprojection":
                trusted = weights_of(solution, own.dof, solver.loss) >= TRUSTED
                memory = carried_on(tracks, own, solution, camera, trusted, before)
            kept = np.flatnonzero((solution.information[:, 0, 0] > 0.0) & wanted[chosen])  # those in front
            error, spread, likelihood = errors_of(solution, own, cov[at], kept)
            profile = lasting_profile(solution, own, kept)
            has_past = np.zeros(len(chosen), bool)
            has_past[before.known.rows] = True
            profile[has_past[kept], 1:3] = 0.0  # there κ has no form as simple
            features, steps = first_feature + chosen[kept], np.full(len(kept), at)
            found.append(LeftOver(steps, features, part.phi[chosen[kept]], error, spread, likelihood, profile))
        first_step, first_feature = first_step + len(part.T_curr_prev), first_feature + len(part.phi)
    return LeftOver.joined(found)

"""The E-step: what the motions of a drive were, given a noise model, and what errors its features
then have."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.camera.stereo import StereoCamera
from probevo.config import SolverConfig
from probevo.estimation.disparity_filter import DisparityMemory, carried_on, remember
from probevo.estimation.feature_weights import TRUSTED, weights_of
from probevo.estimation.reprojection import solve_reprojection
from probevo.estimation.two_frame import solve
from probevo.measurements.robust_loss import RobustLoss
from probevo.noise.base import StereoNoise
from probevo.tracking.tracks import Tracks
from probevo.training.drive import Drive
from probevo.training.gk.conditioning import conditioned
from probevo.training.gk.feature_errors import FeatureErrors, errors_of
from probevo.training.gk.time_correlation import time_correlation_profile
from probevo.training.supervised_drive import SupervisedDrive

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
    feature_errors: FeatureErrors


def solve_drive(
    parts: Iterable[Drive], predict: Predict, camera: StereoCamera, solver: SolverConfig
) -> tuple[FloatArray, FloatArray]:
    """Motions T_curr_prev [K − 1, 4, 4] of a drive under the predicted noise, and their covariances
    [K − 1, 6, 6].

    A step that cannot be solved keeps the drive's own motion, with UNSOLVED_SIGMA.
    """
    memory = DisparityMemory.none()
    last = -1
    motions = [np.zeros((0, 4, 4))]
    cov = [np.zeros((0, 6, 6))]
    for part in parts:
        noise = predict(part.phi)
        motions.append(part.T_curr_prev.copy())
        cov.append(np.tile(np.diag(UNSOLVED_SIGMA**2), (len(part.T_curr_prev), 1, 1)))
        for step, chosen, tracks in _steps(part):
            before = memory.of(tracks) if part.numbers[step] == last + 1 else DisparityMemory.none()
            memory = DisparityMemory.none()
            last = int(part.numbers[step])
            if len(chosen) < solver.min_tracks:
                continue
            own = noise.subset(chosen)
            solution = solve(
                tracks,
                own,
                part.T_curr_prev[step],
                camera=camera,
                prior=None,
                config=solver,
                known=before.known,
            )
            if solution.converged and np.isfinite(solution.cov).all():
                if solver.method == "reprojection":
                    trusted = weights_of(solution, own.dof, solver.loss) >= TRUSTED
                    solution, memory = remember(
                        tracks, own, solution, camera=camera, trusted=trusted, before=before
                    )
                motions[-1][step] = solution.T_curr_prev
                cov[-1][step] = solution.cov
    return np.concatenate(motions), np.concatenate(cov)


def expect(
    drive: SupervisedDrive,
    predict: Predict,
    solver: SolverConfig,
    truth_sigma: FloatArray | None,
    share: float = 1.0,
    seed: tuple[int, ...] = (),
) -> Expectation:
    """Motions as the features and the truth together give them, and the errors that are left.

    The truth is a Gaussian prior on the motion over each stretch of the supervision: known exactly
    it decides (GK-GT),
    unknown it says nothing (GK-EM), and KITTI's, off by more than the features are, lies between.
    Stretches may be as long as the drive, but between features and motions nothing is held of it
    but motions and covariances.

    Args:
        drive: the drive, which is read twice, and what is known of it; nothing, if its kind is
            ``none``.
        predict: the noise of n features from their predictors [n, M].
        solver: settings of the solve.
        truth_sigma: standard deviation of the truth over a stretch, m and rad, [6]; None to
            estimate it from how far it is from what the features say.
        share: of the features, how many are to be given errors; they are drawn.
        seed: of the draw: the same ones, however the drive is cut into parts.
    """
    camera = drive.camera
    supervision = drive.supervision
    alone, cov = solve_drive(drive.parts(), predict, camera, solver=solver)
    motions = alone
    if supervision.kind != "none":
        motions, cov = conditioned(alone, cov, supervision, truth_sigma=truth_sigma)
    rng = np.random.default_rng([*seed])
    return Expectation(
        motions,
        alone,
        feature_errors(
            drive.parts(),
            motions,
            cov,
            predict=predict,
            camera=camera,
            solver=solver,
            share=share,
            rng=rng,
        ),
    )


def _steps(drive: Drive) -> Iterator[tuple[int, IntArray, Tracks]]:
    """Each step, which of the drive's features may be used in it, and their tracks."""
    for step in range(len(drive.T_curr_prev)):
        rows = drive.rows(step)
        own = np.flatnonzero(drive.used[rows])
        yield step, rows.start + own, drive.tracks(step).kept(own)


def feature_errors(
    parts: Iterable[Drive],
    T_curr_prev: FloatArray,
    cov: FloatArray,
    predict: Predict,
    camera: StereoCamera,
    solver: SolverConfig,
    share: float,
    rng: np.random.Generator,
) -> FeatureErrors:
    """Of a share of a drive's features, drawn, at these motions [K − 1, 4, 4] with covariances [K −
    1, 6, 6]."""
    memory = DisparityMemory.none()
    last = -1
    found = []
    first_step = 0
    first_feature = 0
    loss = RobustLoss.named(solver.loss)
    for part in parts:
        noise = predict(part.phi)
        wanted = part.used & (rng.random(len(part.used)) < share)
        found.append(FeatureErrors.none(part.phi.shape[1]))
        for step, chosen, tracks in _steps(part):
            before = memory.of(tracks) if part.numbers[step] == last + 1 else DisparityMemory.none()
            memory = DisparityMemory.none()
            last = int(part.numbers[step])
            at = first_step + step
            if len(chosen) < solver.min_tracks or cov[at, 0, 0] > UNSOLVED_SIGMA[0] ** 2 / 4.0:
                continue  # neither solved nor known: its residuals say nothing
            own = noise.subset(chosen)
            solution = solve_reprojection(
                tracks.prev_px,
                tracks.curr_px,
                own,
                guess=T_curr_prev[at],
                camera=camera,
                loss=loss,
                max_iterations=0,
                known=before.known,
            )
            if solver.method == "reprojection":
                trusted = weights_of(solution, own.dof, solver.loss) >= TRUSTED
                memory = carried_on(
                    tracks, own, solution, camera=camera, trusted=trusted, before=before
                )
            kept = np.flatnonzero(
                (solution.information[:, 0, 0] > 0.0) & wanted[chosen]
            )  # those in front
            error, spread, likelihood = errors_of(solution, own, cov[at], chosen=kept)
            profile = time_correlation_profile(solution, own, kept)
            has_past = np.zeros(len(chosen), bool)
            has_past[before.known.rows] = True
            profile[has_past[kept], 1:3] = 0.0  # there κ has no form as simple
            features = first_feature + chosen[kept]
            steps = np.full(len(kept), at)
            found.append(
                FeatureErrors(
                    steps,
                    features,
                    part.phi[chosen[kept]],
                    errors=error,
                    spread=spread,
                    log_likelihood=likelihood,
                    profile=profile,
                )
            )
        first_step = first_step + len(part.T_curr_prev)
        first_feature = first_feature + len(part.phi)
    return FeatureErrors.joined(found)

"""The E-step: the motions of a drive given a noise model, and the errors its features then have."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from probevo.arrays import BoolArray, FloatArray, IntArray
from probevo.camera.stereo import StereoCamera
from probevo.config import SolverConfig
from probevo.estimation.disparity_filter import DisparityMemory, carried_on, remember
from probevo.estimation.feature_weights import TRUSTED, weights_of
from probevo.estimation.reprojection import ReprojectionSolution, solve_reprojection
from probevo.estimation.two_frame import solve
from probevo.measurements.robust_loss import RobustLoss
from probevo.noise.base import StereoNoise
from probevo.tracking.tracks import Tracks
from probevo.training.gk.conditioning import conditioned
from probevo.training.gk.feature_errors import FeatureErrors, errors_of
from probevo.training.gk.time_correlation import time_correlation_profile
from probevo.training.supervised_drive import SupervisedDrive

UNSOLVED_SIGMA = np.array([1.0, 1.0, 1.0, 0.1, 0.1, 0.1])
"""Standard deviation of the motion of a step whose features do not fix it, m and rad."""
UNKNOWN_VARIANCE_M2 = UNSOLVED_SIGMA[0] ** 2 / 4.0
"""Variance in x, m², above which a motion is known neither from the features nor from the truth."""


Predict = Callable[[FloatArray], StereoNoise]
"""Noise of n features from their predictors, [n, M]."""


class MotionPosterior(NamedTuple):
    """Gaussians over the motions of a drive's K − 1 steps."""

    T_curr_prev: FloatArray
    """Mean of each motion, [K − 1, 4, 4]."""
    cov: FloatArray
    """Covariance of each left perturbation ξ = [ρ; φ], [K − 1, 6, 6]."""


@dataclass(frozen=True)
class Expectation:
    """The motions of a drive's K − 1 steps, and the errors of its features at these motions."""

    T_curr_prev: FloatArray
    """Motions given the features and the truth, [K − 1, 4, 4]."""
    T_features_only: FloatArray
    """Motions given the features without any truth, [K − 1, 4, 4]."""
    feature_errors: FeatureErrors


@dataclass(frozen=True)
class SolvedStep:
    """A step of a drive, and its features at its motion."""

    index: int
    """Index of the step among the K − 1 steps of the drive."""
    T_curr_prev: FloatArray
    """Motion as the drive records it, [4, 4]."""
    phi: FloatArray
    """Place of all features of the step in the prediction space, used or not, [n, M]."""
    used: IntArray
    """Indices of the N features that may be used, among the n features of the step."""
    noise: StereoNoise
    """Predicted noise of the N features."""
    has_past: BoolArray
    """Which of the N features the memory knows from the previous step, [N]."""
    solution: ReprojectionSolution | None
    """The motion and the residuals of the N features; None if the step cannot be solved."""


def expect(
    drive: SupervisedDrive,
    predict: Predict,
    solver: SolverConfig,
    truth_sigma: FloatArray | None,
    share: float = 1.0,
    *,
    seed: tuple[int, ...] = (),
) -> Expectation:
    """Compute the motions given features and truth, and the errors of the features.

    The truth is a Gaussian prior on the motion over each stretch of the supervision. Exact truth
    decides (GK-GT), no truth says nothing (GK-EM), and KITTI's truth, whose errors are larger
    than those of the features, lies between. Stretches may be as long as the drive, but between
    solving the motions and computing the errors only motions and covariances are kept in memory.

    Args:
        drive: the drive, which is read twice, and its supervision.
        predict: the noise of n features from their predictors [n, M].
        solver: settings of the solver.
        truth_sigma: standard deviation of the truth over a stretch, m and rad, [6]; None to
            estimate it from the distance between truth and features.
        share: share of the features, 0 … 1, whose errors are computed; they are drawn.
        seed: seed of the draw, which does not depend on how the drive is cut into parts.
    """
    # First pass: the motions given the features, and then also given the truth.
    solved = solve_drive(drive, predict, solver)
    posterior = solved
    if drive.supervision.kind != "none":
        T_curr_prev, cov = conditioned(
            solved.T_curr_prev, solved.cov, drive.supervision, truth_sigma=truth_sigma
        )
        posterior = MotionPosterior(T_curr_prev, cov)
    # Second pass: the errors of the features at these motions.
    rng = np.random.default_rng([*seed])
    return Expectation(
        T_curr_prev=posterior.T_curr_prev,
        T_features_only=solved.T_curr_prev,
        feature_errors=feature_errors(drive, posterior, predict, solver, share=share, rng=rng),
    )


def solve_drive(drive: SupervisedDrive, predict: Predict, solver: SolverConfig) -> MotionPosterior:
    """Solve for the motions of a drive under the predicted noise.

    A step that cannot be solved keeps the drive's own motion, with UNSOLVED_SIGMA.
    """
    motions = []
    covariances = []
    for step in solved_steps(drive, predict, solver):
        if step.solution is None:
            motions.append(step.T_curr_prev)
            covariances.append(np.diag(UNSOLVED_SIGMA**2))
        else:
            motions.append(step.solution.T_curr_prev)
            covariances.append(step.solution.cov)
    return MotionPosterior(
        T_curr_prev=np.reshape(motions, (-1, 4, 4)), cov=np.reshape(covariances, (-1, 6, 6))
    )


def feature_errors(
    drive: SupervisedDrive,
    posterior: MotionPosterior,
    predict: Predict,
    solver: SolverConfig,
    *,
    share: float,
    rng: np.random.Generator,
) -> FeatureErrors:
    """Compute the errors of a drawn share of a drive's features at given motions."""
    found = []
    first_feature = 0
    for step in solved_steps(drive, predict, solver, posterior):
        # Draw for all features of the step, so that the draw does not depend on the noise model.
        is_drawn = rng.random(len(step.phi)) < share
        if step.solution is not None:
            # Features behind the camera have no information.
            is_in_front = step.solution.information[:, 0, 0] > 0.0
            kept = np.flatnonzero(is_in_front & is_drawn[step.used])
            cov = posterior.cov[step.index]
            errors, spread, log_likelihood = errors_of(step.solution, step.noise, cov, chosen=kept)

            # The profile in closed form holds only for tracks without a known past.
            profile = time_correlation_profile(step.solution, step.noise, kept)
            profile[step.has_past[kept], 1:3] = 0.0
            found.append(
                FeatureErrors(
                    steps=np.full(len(kept), step.index),
                    features=first_feature + step.used[kept],
                    phi=step.phi[step.used[kept]],
                    errors=errors,
                    spread=spread,
                    log_likelihood=log_likelihood,
                    profile=profile,
                )
            )
        first_feature += len(step.phi)
    if not found:
        return FeatureErrors.none(len(drive.facts.moments.mean))
    return FeatureErrors.joined(found)


def solved_steps(
    drive: SupervisedDrive,
    predict: Predict,
    solver: SolverConfig,
    given: MotionPosterior | None = None,
) -> Iterator[SolvedStep]:
    """Solve the steps of a drive in their order, each with the memory of its tracks.

    Args:
        drive: the drive, which is read part by part.
        predict: the noise of n features from their predictors [n, M].
        solver: settings of the solver.
        given: motions at which the residuals are evaluated instead of solving for the motions.

    Yields:
        each step; without a solution if it has too few features, if these do not fix the motion, or
        if the given motion is not known.
    """
    memory = DisparityMemory.none()
    previous_number = -1
    index = 0
    for part in drive.parts():
        # The noise of all features of the part at once is faster than step by step.
        noise_of_part = predict(part.phi)
        for step in range(len(part.T_curr_prev)):
            rows = part.rows(step)
            used = np.flatnonzero(part.used[rows])
            noise = noise_of_part.of(rows.start + used)
            tracks = part.tracks(step).kept(used)

            # The memory holds from one step of the recording to the next, not across a gap.
            number = int(part.numbers[step])
            is_consecutive = number == previous_number + 1
            before = memory.of(tracks) if is_consecutive else DisparityMemory.none()
            previous_number = number

            # Solve for the motion, or evaluate at the given one; else the memory starts anew.
            solution = None
            memory = DisparityMemory.none()
            if len(used) >= solver.min_tracks:
                if given is None:
                    solution, memory = _solved(
                        tracks,
                        noise,
                        part.T_curr_prev[step],
                        camera=drive.camera,
                        solver=solver,
                        before=before,
                    )
                elif not given.cov[index, 0, 0] > UNKNOWN_VARIANCE_M2:
                    solution, memory = _evaluated(
                        tracks,
                        noise,
                        given.T_curr_prev[index],
                        camera=drive.camera,
                        solver=solver,
                        before=before,
                    )

            # Tracks that the memory knows share an error with the previous step.
            has_past = np.zeros(len(used), np.bool_)
            has_past[before.known.rows] = True
            yield SolvedStep(
                index=index,
                T_curr_prev=part.T_curr_prev[step],
                phi=part.phi[rows],
                used=used,
                noise=noise,
                has_past=has_past,
                solution=solution,
            )
            index += 1


def _solved(
    tracks: Tracks,
    noise: StereoNoise,
    guess: FloatArray,
    *,
    camera: StereoCamera,
    solver: SolverConfig,
    before: DisparityMemory,
) -> tuple[ReprojectionSolution | None, DisparityMemory]:
    """Solve for the motion of a step, T_curr_prev, and remember its tracks.

    The solution is None if the features do not fix the motion.
    """
    solution = solve(
        tracks,
        noise,
        guess,
        camera=camera,
        prior=None,
        config=solver,
        known=before.known,
    )
    if not solution.converged or not np.isfinite(solution.cov).all():
        return None, DisparityMemory.none()
    # Only inliers are remembered, and only the reprojection solver uses the memory.
    if solver.method != "reprojection":
        return solution, DisparityMemory.none()
    trusted = weights_of(solution, noise.dof, solver.loss) >= TRUSTED
    return remember(tracks, noise, solution, camera=camera, trusted=trusted, before=before)


def _evaluated(
    tracks: Tracks,
    noise: StereoNoise,
    T_curr_prev: FloatArray,
    *,
    camera: StereoCamera,
    solver: SolverConfig,
    before: DisparityMemory,
) -> tuple[ReprojectionSolution, DisparityMemory]:
    """Evaluate the residuals of a step at a given motion, and remember its tracks."""
    solution = solve_reprojection(
        tracks.prev_px,
        tracks.curr_px,
        noise,
        guess=T_curr_prev,
        camera=camera,
        loss=RobustLoss.named(solver.loss),
        max_iterations=0,
        known=before.known,
    )
    if solver.method != "reprojection":
        return solution, DisparityMemory.none()
    trusted = weights_of(solution, noise.dof, solver.loss) >= TRUSTED
    memory = carried_on(tracks, noise, solution, camera=camera, trusted=trusted, before=before)
    return solution, memory

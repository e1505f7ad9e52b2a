"""The E-step: the motions of a drive given a noise model, and the errors its features then have."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from probevo.arrays import BoolArray, FloatArray, IntArray, concatenated
from probevo.config import SolverConfig
from probevo.estimation.disparity_filter import DisparityFilter, StepCorrelation
from probevo.estimation.two_frame import Estimator, TwoFrameEstimate, TwoFrameEstimator
from probevo.noise.base import StereoNoise
from probevo.training.gk.conditioning import StepCorrelations, conditioned
from probevo.training.gk.feature_errors import FeatureErrors, errors_of
from probevo.training.gk.jitter import CommonUnknowns
from probevo.training.gk.time_correlation import time_correlation_profile
from probevo.training.supervised_drive import SupervisedDrive

UNSOLVED_SIGMA = np.array([1.0, 1.0, 1.0, 0.1, 0.1, 0.1])
"""Standard deviation of the motion of a step whose features do not fix it, m and rad."""
UNKNOWN_VARIANCE_M2 = UNSOLVED_SIGMA[0] ** 2 / 4.0
"""Variance in x, m², above which the truth says nothing of the motion of a step without a solve: by
itself, this has twice that σ."""


Predict = Callable[[FloatArray], StereoNoise]
"""Noise of n features from their predictors, [n, M]."""


class MotionPosterior(NamedTuple):
    """Gaussians over the motions of a drive's K − 1 steps."""

    T_curr_prev: FloatArray
    """Mean of each motion, [K − 1, 4, 4]."""
    cov: FloatArray
    """Covariance of each left perturbation ξ = [ρ; φ], [K − 1, 6, 6]."""
    is_solved: BoolArray
    """Whether the features fix each motion, [K − 1]."""
    correlations: StepCorrelations | None = None
    """What correlates the errors of the motions; None if they are used each by itself."""

    def is_known(self, index: int) -> bool:
        """Return whether the features or the truth say what the motion of a step was."""
        return bool(self.is_solved[index] or self.cov[index, 0, 0] <= UNKNOWN_VARIANCE_M2)


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
    estimate: TwoFrameEstimate | None
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
    than the features', lies between. Stretches may be as long as the drive, but between
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
            solved.T_curr_prev,
            solved.cov,
            drive.supervision,
            truth_sigma=truth_sigma,
            is_solved=solved.is_solved,
            correlations=solved.correlations,
        )
        posterior = MotionPosterior(T_curr_prev, cov, solved.is_solved)
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
    is_solved = []
    correlations = []
    for step in solved_steps(drive, predict, solver):
        is_solved.append(step.estimate is not None)
        if step.estimate is None:
            motions.append(step.T_curr_prev)
            covariances.append(np.diag(UNSOLVED_SIGMA**2))
            correlations.append(StepCorrelation.none())
        else:
            motions.append(step.estimate.solution.T_curr_prev)
            covariances.append(step.estimate.solution.cov)
            correlations.append(step.estimate.disparities.correlation)
    return MotionPosterior(
        T_curr_prev=np.reshape(motions, (-1, 4, 4)),
        cov=np.reshape(covariances, (-1, 6, 6)),
        is_solved=np.array(is_solved, np.bool_),
        correlations=StepCorrelations.of(correlations),
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
    step_errors = []
    first_feature = 0
    for step in solved_steps(drive, predict, solver, posterior):
        # Draw for all features of the step: the draw must not depend on the noise model.
        is_drawn = rng.random(len(step.phi)) < share
        if step.estimate is not None:
            solution = step.estimate.solution
            # Features behind the camera have no information: their Σ⁻¹ is set to 0.
            is_in_front = solution.features.information[:, 0, 0] > 0.0
            kept = np.flatnonzero(is_in_front & is_drawn[step.used])
            common = CommonUnknowns.of(step.estimate, posterior.cov[step.index])
            errors, error_cov, log_likelihood = errors_of(solution, step.noise, common, chosen=kept)
            moments = [] if solution.jitter is None else [common.second_moment(solution.jitter)]

            # The profile in closed form holds only for tracks without a known past.
            profile = time_correlation_profile(solution.features, step.noise, kept)
            profile = profile.without_information(step.estimate.has_history[kept])
            step_errors.append(
                FeatureErrors(
                    steps=np.full(len(kept), step.index),
                    features=first_feature + step.used[kept],
                    phi=step.phi[step.used[kept]],
                    errors=errors,
                    error_cov=error_cov,
                    log_likelihood=log_likelihood,
                    profile=profile.rows(),
                    jitter_moments=np.reshape(moments, (-1, 3, 3)),
                )
            )
        # Features are counted over all steps, solved or not.
        first_feature += len(step.phi)
    if not step_errors:
        return FeatureErrors.none(len(drive.facts.moments.mean))
    return concatenated(step_errors)


def solved_steps(
    drive: SupervisedDrive,
    predict: Predict,
    solver: SolverConfig,
    given: MotionPosterior | None = None,
) -> Iterator[SolvedStep]:
    """Solve the steps of a drive in their order, with the estimator of the odometry.

    Args:
        drive: the drive, which is read part by part.
        predict: the noise of n features from their predictors [n, M].
        solver: settings of the solver.
        given: motions at which the residuals are evaluated instead of solving for the motions.

    Yields:
        each step; without a solution if it has too few features, if these do not fix the motion, or
        if the given motion is not known.
    """
    # ``index`` counts the steps of the drive, over all parts; ``number`` the recording's steps.
    estimator: Estimator = TwoFrameEstimator(drive.camera, solver)
    disparities = DisparityFilter.none()
    previous_number = -1
    index = 0
    for part in drive.parts():
        # The noise of all features of the part at once is faster than step by step.
        noise_of_part = predict(part.phi)
        for step in range(len(part.T_curr_prev)):
            rows = part.rows(step)
            used = np.flatnonzero(part.used[rows])
            noise = noise_of_part.subset(rows.start + used)
            tracks = part.tracks(step).subset(used)

            # The disparity filter goes from step to step of the recording, not across a gap.
            number = int(part.numbers[step])
            if number != previous_number + 1:
                disparities = DisparityFilter.none()
            previous_number = number

            # Solve for the motion, or evaluate at the given one.
            estimate = None
            if len(used) >= solver.min_tracks:
                if given is None:
                    guess = part.T_curr_prev[step]
                    estimate = _determined(
                        estimator.estimate(tracks, noise, disparities, guess=guess)
                    )
                elif given.is_known(index):
                    estimate = estimator.evaluate(
                        tracks,
                        noise,
                        disparities,
                        T_curr_prev=given.T_curr_prev[index],
                        cov=given.cov[index],
                    )
            disparities = DisparityFilter.none() if estimate is None else estimate.disparities

            yield SolvedStep(
                index=index,
                T_curr_prev=part.T_curr_prev[step],
                phi=part.phi[rows],
                used=used,
                noise=noise,
                estimate=estimate,
            )
            index += 1


def _determined(estimate: TwoFrameEstimate) -> TwoFrameEstimate | None:
    """Return the estimate if the features fix the motion, and the solve has converged."""
    solution = estimate.solution
    is_determined = solution.converged and bool(np.isfinite(solution.cov).all())
    return estimate if is_determined else None

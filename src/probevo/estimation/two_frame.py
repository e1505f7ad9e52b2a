"""Tracks → motion: consensus, solve, and whether to believe the result."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from probevo.arrays import BoolArray, FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.config import OdometryConfig, SolverConfig
from probevo.errors import InputError
from probevo.estimation.alignment import solve_alignment
from probevo.estimation.disparity_filter import DisparityMemory, remember
from probevo.estimation.feature_weights import DROP_BELOW, TRUSTED, weights_of
from probevo.estimation.initial_motion import enough, first_guess
from probevo.estimation.motion_estimate import Status
from probevo.estimation.motion_model import ExpectedMotion
from probevo.estimation.reprojection import ReprojectionSolution, RotationPrior, solve_reprojection
from probevo.geometry.uncertainty import normalized_error_squared
from probevo.measurements.point_priors import KnownDisparities
from probevo.measurements.robust_loss import RobustLoss
from probevo.noise.base import NoiseModel, StereoNoise
from probevo.noise.student_t import StudentT
from probevo.stage_clock import StageClock
from probevo.tracking.last_residuals import LAST_RESIDUAL
from probevo.tracking.tracks import Tracks

BY_CHANCE = 22.46
"""Squared distance of two motions of the same tracks, in standard deviations: 99.9 % of χ²(6)."""

ALIGNED_DOF = 3.0
"""An alignment takes noise for Gaussian, with the variance of a Student-t of so many degrees of
freedom at least: the consensus has turned away what is farther out."""


@dataclass(frozen=True)
class VisualMotion:
    """What the tracks of one step say about the motion."""

    status: Status
    weights: FloatArray
    """How far each track was trusted, [N]: 0 for an outlier of the consensus, to 1 for a usual
    residual."""
    used: BoolArray
    """Which tracks the solve used, [N]; the others were turned away before."""
    solution: ReprojectionSolution | None
    """The last solve; to be believed only if the status is OK, None after too few tracks or if it
    is degenerate."""
    out_of_domain: BoolArray | None = None
    """Which of the tracks used lie where the noise model has seen no training data, [N]; None if it
    knows of no such place, or if there was no solve."""
    T_judging: FloatArray | None = None
    """The motion by which to judge features in the next step, [4, 4]; None if there was no solve.
    """
    alone: ReprojectionSolution | None = None
    """What the step says at that motion where nothing is known, of features and gyro, but what it
    shows itself."""
    memory: DisparityMemory = field(default_factory=DisparityMemory.none)
    """What the tracks used, and still trusted, have taught of their disparities, in terms of the
    current frame."""

    @property
    def astray(self) -> BoolArray:
        """Tracks that are not worth following any longer, [N]."""
        return np.asarray(self.weights < DROP_BELOW)

    @property
    def num_trusted(self) -> int:
        """Tracks that are trusted by at least one half."""
        return int((self.weights >= TRUSTED).sum())

    @property
    def num_used(self) -> int:
        """Tracks that the solve used."""
        return int(self.used.sum())

    @property
    def num_out_of_domain(self) -> int | None:
        """Those of them that lie where the noise model has seen no training data; None as for
        ``out_of_domain``."""
        return None if self.out_of_domain is None else int(self.out_of_domain.sum())

    @property
    def num_iterations(self) -> int:
        """Of the last solve."""
        return self.solution.iterations if self.solution else 0


def estimate_motion(
    tracks: Tracks,
    predictors: FloatArray,
    noise: NoiseModel,
    camera: StereoCamera,
    expected: ExpectedMotion,
    rotation: RotationPrior | None,
    memory: DisparityMemory,
    config: OdometryConfig,
    rng: np.random.Generator,
    clock: StageClock,
) -> VisualMotion:
    """Motion of N tracks: RANSAC from the expected motion, then the reprojection solve under the
    predicted noise.

    Args:
        tracks: the N tracks.
        predictors: their places in the prediction space, [N, M].
        noise: model that turns predictors into the noise of each track.
        camera: the rectified camera.
        expected: motion before looking.
        rotation: the gyro's rotation, if there is one.
        memory: what the steps before have taught of the tracks' disparities.
        config: settings of RANSAC, solver and gyro.
        rng: source of the samples.
        clock: takes the times of the stages ``consensus`` and ``solve``.
    """
    start = first_guess(tracks, camera, expected, rotation=rotation, config=config, rng=rng)
    clock.lap("consensus")
    used = start.inliers
    weights = np.zeros(len(tracks))
    if not enough(used, config):
        return VisualMotion(Status.TOO_FEW_TRACKS, weights, np.zeros_like(used), solution=None)
    prior = rotation if config.gyro.prior else None
    predicted = noise.predict(predictors[used])
    own = tracks.kept(used)
    before = memory.of(own)
    solution = solve(
        own,
        predicted,
        start.T_curr_prev,
        camera=camera,
        prior=prior,
        config=config.solver,
        known=before.known,
    )
    weights[used] = weights_of(solution, predicted.dof, config.solver.loss)
    alone = solution
    memory = DisparityMemory.none()
    if config.solver.method == "reprojection":
        solution, memory = remember(
            own, predicted, solution, camera=camera, trusted=weights[used] >= TRUSTED, before=before
        )
    if len(before.ids) or prior is not None:
        T = solution.T_curr_prev
        loss = RobustLoss.named(config.solver.loss)
        alone = solve_reprojection(
            own.prev_px, own.curr_px, predicted, guess=T, camera=camera, loss=loss, max_iterations=0
        )
    clock.lap("solve")
    status = _judge(solution, weights[used], expected, config=config)
    out_of_domain = None
    if predicted.out_of_domain is not None:
        out_of_domain = np.zeros_like(used)
        out_of_domain[used] = predicted.out_of_domain
    judging = solution.T_curr_prev
    if LAST_RESIDUAL in noise.columns:
        judging = confirmed(
            solution, own, start.T_curr_prev, camera=camera, prior=prior, config=config.solver
        )
    believed = None if status is Status.DEGENERATE else solution
    memory = memory if status is Status.OK else DisparityMemory.none()
    return VisualMotion(
        status,
        weights,
        used,
        solution=believed,
        out_of_domain=out_of_domain,
        T_judging=judging,
        alone=alone,
        memory=memory,
    )


def solve(
    tracks: Tracks,
    noise: StereoNoise,
    guess: FloatArray,
    camera: StereoCamera,
    prior: RotationPrior | None,
    config: SolverConfig,
    known: KnownDisparities | None = None,
) -> ReprojectionSolution:
    """The motion of N tracks by the method of the settings, from a guess T_curr_prev [4, 4].

    After an alignment, all but the motion and its covariance is what the reprojection has to say at
    that motion.

    Raises:
        InputError: an alignment is asked for, but the noise does not refer to single observations.
    """
    aligned = None
    iterations = config.max_iterations
    if config.method == "alignment":
        if noise.refers_to != "observation":
            what = (
                "alignment needs the noise of each observation, but this model predicts that of the"
                " residual."
            )
            raise InputError("--solver.method", what, "Take reprojection, or another noise model.")
        dof = np.maximum(np.broadcast_to(noise.dof, len(tracks)), ALIGNED_DOF)
        cov = noise.scale / (1.0 - 2.0 / dof)[:, None, None]
        aligned = solve_alignment(
            tracks.prev_px,
            tracks.curr_px,
            cov,
            cov_curr_px=cov,
            camera=camera,
            guess=guess,
            max_iterations=iterations,
        )
        guess = aligned.T_curr_prev
        iterations = 0
    solution = solve_reprojection(
        tracks.prev_px,
        tracks.curr_px,
        noise,
        guess=guess,
        camera=camera,
        loss=RobustLoss.named(config.loss),
        prior=prior,
        max_iterations=iterations,
        known=known,
    )
    if aligned is None:
        return solution
    return replace(
        solution, cov=aligned.cov, iterations=aligned.iterations, converged=aligned.converged
    )


def confirmed(
    solution: ReprojectionSolution,
    tracks: Tracks,
    guess: FloatArray,
    camera: StereoCamera,
    prior: RotationPrior | None,
    config: SolverConfig,
) -> FloatArray:
    """The motion under a learned noise, unless N tracks, all trusted alike, contradict it: then
    what they say, [4, 4].

    A model that trusts those features that agreed with the last motion confirms that motion: once
    it has gone with a
    car, it is the street that seems to be off. The judge must be one whom it cannot persuade. But
    it is the coarser one too, so that it has the word only where the two are farther apart than
    chance explains.

    Args:
        solution: under the learned noise.
        tracks, guess, camera, prior, config: as of ``solve``.
    """
    noise = StudentT().predict(np.zeros((len(tracks), 0)))
    plain = solve(tracks, noise, guess, camera=camera, prior=prior, config=config)
    cov = plain.cov + solution.cov
    if not (plain.converged and np.isfinite(cov).all()):
        return solution.T_curr_prev
    apart = normalized_error_squared(
        plain.T_curr_prev[None], solution.T_curr_prev[None], cov[None]
    )[0]
    return solution.T_curr_prev if apart < BY_CHANCE else plain.T_curr_prev


def _judge(
    solution: ReprojectionSolution,
    weights: FloatArray,
    expected: ExpectedMotion,
    config: OdometryConfig,
) -> Status:
    """Whether a solve fixed all six degrees of freedom, reached its optimum, and makes sense."""
    if not np.isfinite(solution.cov).all():
        return Status.DEGENERATE
    translation_sigma_m = np.sqrt(np.linalg.eigvalsh(solution.cov[:3, :3])[-1])
    rotation_sigma_rad = np.sqrt(np.linalg.eigvalsh(solution.cov[3:, 3:])[-1])
    if (
        translation_sigma_m > config.solver.max_translation_sigma_m
        or rotation_sigma_rad > config.solver.max_rotation_sigma_rad
    ):
        return Status.DEGENERATE
    if (weights >= TRUSTED).sum() < config.solver.min_tracks:
        return Status.TOO_FEW_TRACKS
    if not solution.converged or expected.is_absurd(solution.T_curr_prev, solution.cov):
        return Status.NOT_CONVERGED
    return Status.OK

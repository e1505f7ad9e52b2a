"""Tracks → motion: consensus, solve, and whether to believe the result."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.config import OdometryConfig
from probevo.motion.estimate import Status
from probevo.motion.motion_model import ExpectedMotion
from probevo.motion.ransac import find_consensus
from probevo.motion.reprojection import ReprojectionSolution, RotationPrior, solve_reprojection
from probevo.motion.robust import RobustLoss
from probevo.noise.base import NoiseModel
from probevo.stage_clock import StageClock
from probevo.tracking.tracks import Tracks

FEWEST_INLIERS = 0.25
"""Share of the tracks that has to agree with a motion; else the threshold is widened, and in the end it is refused."""
TRUSTED = 0.5
"""A track that keeps this much of its robust weight counts as trusted."""


@dataclass(frozen=True)
class VisualMotion:
    """What the tracks of one step say about the motion."""

    status: Status
    weights: FloatArray
    """How far each track was trusted, [N]: 0 for an outlier of the consensus, else its robust weight, at most 1."""
    solved: Tracks
    """The tracks that the solve used."""
    solution: ReprojectionSolution | None
    """The last solve; to be believed only if the status is OK, None after too few tracks or if it is degenerate."""


def estimate_motion(
    tracks: Tracks,
    predictors: FloatArray,
    noise: NoiseModel,
    camera: StereoCamera,
    expected: ExpectedMotion,
    rotation: RotationPrior | None,
    config: OdometryConfig,
    rng: np.random.Generator,
    clock: StageClock,
) -> VisualMotion:
    """Motion of N tracks: RANSAC from the expected motion, then the reprojection solve under the predicted noise.

    Args:
        tracks: the N tracks.
        predictors: their places in the prediction space, [N, M].
        noise: model that turns predictors into the noise of each track.
        camera: the rectified camera.
        expected: motion before looking.
        rotation: the gyro's rotation, if there is one.
        config: settings of RANSAC, solver and gyro.
        rng: source of the samples.
        clock: takes the times of the stages ``consensus`` and ``solve``.
    """
    rotation_from_gyro = rotation.C_curr_prev if rotation and config.ransac.rotation_from == "gyro" else None
    for widening in (1.0, 2.0, 4.0):  # where hardly anything agrees, the tracks are noisier than the threshold assumes
        consensus = find_consensus(
            tracks.prev_px,
            tracks.curr_px,
            camera,
            rng,
            guess=expected.T_curr_prev,
            C_curr_prev=rotation_from_gyro,
            threshold_px=widening * config.ransac.threshold_px,
            confidence=config.ransac.confidence,
        )
        if consensus.inliers.sum() >= max(config.solver.min_tracks, FEWEST_INLIERS * len(tracks)):
            break
    clock.lap("consensus")
    weights = np.zeros(len(tracks))
    if consensus.inliers.sum() < max(config.solver.min_tracks, FEWEST_INLIERS * len(tracks)):
        return VisualMotion(Status.TOO_FEW_TRACKS, weights, tracks.kept(consensus.inliers), None)
    used = consensus.inliers if config.ransac.reject else np.ones(len(tracks), np.bool_)
    solved = tracks.kept(used)
    solution = solve_reprojection(
        solved.prev_px,
        solved.curr_px,
        noise.predict(predictors[used]),
        consensus.T_curr_prev,
        camera,
        loss=RobustLoss.named(config.solver.loss),
        prior=rotation if config.gyro.prior else None,
        max_iterations=config.solver.max_iterations,
    )
    weights[used] = solution.weight
    clock.lap("solve")
    status = _judge(solution, expected, config)
    return VisualMotion(status, weights, solved, None if status is Status.DEGENERATE else solution)


def _judge(solution: ReprojectionSolution, expected: ExpectedMotion, config: OdometryConfig) -> Status:
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
    if (solution.weight >= TRUSTED).sum() < config.solver.min_tracks:
        return Status.TOO_FEW_TRACKS
    if not solution.converged or expected.is_absurd(solution.T_curr_prev, solution.cov):
        return Status.NOT_CONVERGED
    return Status.OK

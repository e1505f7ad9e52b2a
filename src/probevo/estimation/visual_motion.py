"""Tracks → motion: consensus, estimate, and whether to accept the result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from probevo.arrays import BoolArray, FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.config import OdometryConfig
from probevo.estimation.disparity_filter import DisparityFilter
from probevo.estimation.feature_weights import (
    INLIER_FROM,
    OUTLIER_BELOW,
    scale_of_residuals,
    tail_probability_of,
)
from probevo.estimation.initial_motion import are_enough, initial_motion
from probevo.estimation.motion_estimate import Status
from probevo.estimation.motion_model import MotionPrediction
from probevo.estimation.reprojection import ReprojectionSolution, solve_reprojection
from probevo.estimation.two_frame import Estimate, Estimator, TwoFrameEstimator
from probevo.geometry.uncertainty import normalized_error_squared
from probevo.measurements.base import MOTION, Measurement, Variable
from probevo.measurements.relative_rotation import RelativeRotation
from probevo.measurements.robust_loss import RobustLoss
from probevo.measurements.stereo_numba import BEHIND
from probevo.measurements.stereo_observations import StereoObservations
from probevo.noise.base import NoiseModel, StereoNoise
from probevo.noise.student_t import StudentT
from probevo.stage_clock import StageClock
from probevo.tracking.tracks import Tracks

LARGEST_SCALE = 30.0
"""Factor by which the variances may be larger than predicted; that is 5 times σ, or 1 px with
``student-t``. Features that differ by more rather do not agree."""
FEWEST_TRUSTED = 1.0 / 3.0
"""Share of the tracks used whose residuals are usual, below which the noise is larger than
predicted. Where the prediction holds, it is half or more."""
RAREST = 0.001
"""Probability of a residual as large as that of a track, below which the track does not agree."""
MOTIONS_DIFFER_FROM = 22.46
"""Squared Mahalanobis distance from which two motions of the same tracks differ by more than
chance: 99.9 % of χ²(6)."""


@dataclass(frozen=True)
class VisualMotion:
    """What the tracks of one step say about the motion."""

    status: Status
    weights: FloatArray
    """How far each track was trusted, [N]: 0 for an outlier of the consensus, to 1 for a usual
    residual."""
    used: BoolArray
    """Which tracks the solve used, [N]; the others were rejected before."""
    solution: ReprojectionSolution | None = None
    """The last solve; to be accepted only if the status is OK, None after too few tracks or if it
    is degenerate."""
    two_frames_only: ReprojectionSolution | None = None
    """The same features at that motion, without what earlier frames and the gyro say of them."""
    T_reference: FloatArray | None = None
    """The motion by which features are evaluated in the next step, [4, 4]; None without a solve."""
    noise: StereoNoise | None = None
    """Predicted noise of the tracks used; None without a solve."""
    disparities: DisparityFilter = field(default_factory=DisparityFilter.none)
    """The disparity filter after the step; of no track where the step taught nothing."""
    num_out_of_domain: int | None = None
    """Tracks used that lie where the noise model has seen no training data; None without a solve,
    and for models that know of no such place."""

    @property
    def outliers(self) -> BoolArray:
        """Which tracks are not worth following any longer, [N]."""
        return np.asarray(self.weights < OUTLIER_BELOW)

    @property
    def accepted_solution(self) -> ReprojectionSolution:
        """The solve of a step with status OK.

        Raises:
            ValueError: there is none.
        """
        if self.status is not Status.OK or self.solution is None:
            raise ValueError(f"a step with status {self.status.name} has no accepted solution")
        return self.solution

    @property
    def num_inliers(self) -> int:
        """Tracks with a weight of at least one half."""
        return int((self.weights >= INLIER_FROM).sum())

    @property
    def num_used(self) -> int:
        """Tracks that the solve used."""
        return int(self.used.sum())

    @property
    def num_iterations(self) -> int:
        """Iterations of the last solve."""
        return self.solution.iterations if self.solution else 0


class _FittingNoise(NamedTuple):
    """Noise as large as the residuals of N tracks."""

    agree: BoolArray
    """Which tracks agree with the motion under it, [N]."""
    noise: StereoNoise
    factor: float
    """How much larger its variances are than predicted, 1 at least."""


@dataclass(frozen=True)
class MotionPriors:
    """Knowledge of a step before its tracks are looked at."""

    prediction: MotionPrediction
    gyro: RelativeRotation | None
    """The gyro's rotation, if there is one."""
    disparities: DisparityFilter
    """The disparity filter after the previous step."""
    measurements: Sequence[Measurement] = ()
    """Measurements of the motion beside the tracks, which enter the solve."""
    curr: Variable = MOTION
    """The pose of the current frame, as these call it."""
    jitter_cov: FloatArray | None = None
    """Covariance of the rig's jitter as it is estimated on line, [3, 3], rad²; None for that of the
    noise model."""


class VisualEstimator:
    """RANSAC from the predicted motion, then the estimator under the predicted noise.

    Args:
        camera: the rectified camera.
        noise: model that turns predictors into the noise of each track.
        config: settings of RANSAC, solver and gyro.
        predicts_from_motion: whether a predictor of the noise depends on earlier motions.
    """

    def __init__(
        self,
        camera: StereoCamera,
        noise: NoiseModel,
        config: OdometryConfig,
        *,
        predicts_from_motion: bool,
    ) -> None:
        self._camera = camera
        self._noise = noise
        self._config = config
        self._predicts_from_motion = predicts_from_motion
        # A window knows the landmarks of its frames itself, better than the filter does. The motion
        # of two frames is only where its adjustment starts.
        self._estimator: Estimator = TwoFrameEstimator(
            camera, config.solver, filters_disparities=config.estimator != "window"
        )

    def estimate(
        self,
        tracks: Tracks,
        phi: FloatArray,
        priors: MotionPriors,
        *,
        rng: np.random.Generator,
        clock: StageClock,
    ) -> VisualMotion:
        """Estimate the motion of N tracks, and test it.

        Args:
            tracks: the N tracks, corrected by the rig's calibration.
            phi: their places in the prediction space, [N, M].
            priors: knowledge of the step before its tracks.
            rng: source of RANSAC's samples.
            clock: takes the times of the stages ``consensus`` and ``solve``.
        """
        # Which tracks agree on a motion, and where the solve starts.
        consensus = initial_motion(
            tracks,
            self._camera,
            priors.prediction,
            gyro=priors.gyro,
            config=self._config,
            rng=rng,
            right_sigma_px=self._right_sigma_px(priors.jitter_cov),
        )
        clock.lap("consensus")
        used = consensus.inliers
        weights = np.zeros(len(tracks))
        if not are_enough(used, self._config):
            return VisualMotion(Status.TOO_FEW_TRACKS, weights, used=np.zeros_like(used))
        # The motion of these, each under its own noise.
        inliers = tracks.kept(used)
        noise = self._noise.predict(phi[used])
        if priors.jitter_cov is not None:
            noise = replace(noise, jitter_cov=priors.jitter_cov)
        estimate = self._estimator.estimate(
            inliers,
            noise,
            priors.disparities,
            guess=consensus.T_curr_prev,
            others=priors.measurements,
            curr=priors.curr,
        )
        if self._is_noisier_than_expected(estimate):
            fitting = self._noise_that_fits(
                tracks, phi, estimate.solution.T_curr_prev, jitter_cov=noise.jitter_cov
            )
            if num_trusted(estimate) >= self._config.solver.min_tracks:
                # They fix the motion, but show too little noise: those that agree with it by chance
                # have chosen it. The covariance is that of all of them, and rather too large.
                factor = fitting.factor if are_enough(fitting.agree, self._config) else 1.0
                factor = max(factor, _scale_shown(estimate.solution.squared, noise))
                solution = estimate.solution
                estimate = replace(estimate, solution=replace(solution, cov=factor * solution.cov))
            elif are_enough(fitting.agree, self._config):
                used = fitting.agree
                inliers = tracks.kept(used)
                noise = fitting.noise.subset(np.flatnonzero(used))
                estimate = self._estimator.estimate(
                    inliers,
                    noise,
                    DisparityFilter.none(),  # its covariances are of the noise as it was
                    guess=estimate.solution.T_curr_prev,
                    others=priors.measurements,
                    curr=priors.curr,
                )
        weights[used] = estimate.weights
        solution = estimate.solution
        # The rig's calibration and the next step's predictors look at what these two frames say of
        # a feature; its residual against the filtered disparity depends on all frames before.
        two_frames_only = solution
        if estimate.has_history.any() or priors.measurements:
            observations = StereoObservations.of(
                inliers.prev_px,
                inliers.curr_px,
                noise,
                camera=self._camera,
                loss=RobustLoss.named(self._config.solver.loss),
            )
            two_frames_only = solve_reprojection(
                observations,
                guess=solution.T_curr_prev,
                eta=_of_two_frames(solution, observations),
                max_iterations=0,
            )
        clock.lap("solve")
        # Whether to accept it.
        status = evaluate_status(solution, estimate.weights, priors.prediction, config=self._config)
        T_reference = solution.T_curr_prev
        if self._predicts_from_motion:
            T_reference = self._confirmed(estimate, inliers, consensus.T_curr_prev, priors)
        outside = noise.out_of_domain
        return VisualMotion(
            status=status,
            weights=weights,
            used=used,
            solution=None if status is Status.DEGENERATE else solution,
            two_frames_only=two_frames_only,
            T_reference=T_reference,
            noise=noise,
            disparities=(estimate.disparities if status is Status.OK else DisparityFilter.none()),
            num_out_of_domain=None if outside is None else int(outside.sum()),
        )

    def _is_noisier_than_expected(self, estimate: Estimate) -> bool:
        """Whether the features agree on a motion, but few with the size of the noise.

        That is no reason to refuse them: the covariance is enlarged to what the residuals show.
        """
        fewest = max(self._config.solver.min_tracks, FEWEST_TRUSTED * len(estimate.weights))
        return self._config.solver.loss == "noise" and num_trusted(estimate) < fewest

    def _noise_that_fits(
        self,
        tracks: Tracks,
        phi: FloatArray,
        T_curr_prev: FloatArray,
        *,
        jitter_cov: FloatArray | None,
    ) -> _FittingNoise:
        """Return which of N tracks agree with a motion under noise that is as large as their
        residuals. None agree if it were larger than ``LARGEST_SCALE``.

        Those that RANSAC has rejected count, too: what is within its threshold, around the motion
        of a few, is no random sample. It would show less noise than there is, and confirm the few.
        """
        noise = replace(self._noise.predict(phi), jitter_cov=jitter_cov)
        observations = StereoObservations.of(
            tracks.prev_px, tracks.curr_px, noise, camera=self._camera
        )
        squared = solve_reprojection(observations, guess=T_curr_prev, max_iterations=0).squared
        dof = np.broadcast_to(noise.dof, (len(tracks),))
        factor = _scale_shown(squared, noise)
        agree = (squared < BEHIND) & (tail_probability_of(squared / factor, dof) > RAREST)
        if factor > LARGEST_SCALE:
            agree[:] = False
        return _FittingNoise(agree, noise.scaled(np.full(len(tracks), factor)), factor)

    def _right_sigma_px(self, jitter_cov: FloatArray | None) -> float:
        """Return the standard deviation of the offset by which the rig's yaw moves all u_r from one
        frame to the next, px."""
        if jitter_cov is None:
            return 0.0
        return self._camera.fu_px * float(np.sqrt(2.0 * jitter_cov[1, 1]))

    def _confirmed(
        self, estimate: Estimate, tracks: Tracks, guess: FloatArray, priors: MotionPriors
    ) -> FloatArray:
        """Return the motion by which features are tested next, [4, 4].

        It is that under the learned noise, unless the tracks with equal noise contradict it.

        A model that trusts those features that agreed with the last motion confirms that motion:
        once it has gone with a car, it is the street that seems to be wrong. The reference must be
        an estimate that the model cannot influence. But that is the coarser one, so that it decides
        only where the two are farther apart than chance explains.
        """
        solution = estimate.solution
        plain = self._estimator.solve(
            tracks,
            replace(StudentT().predict(np.zeros((len(tracks), 0))), jitter_cov=priors.jitter_cov),
            guess=guess,
            others=priors.measurements,
            curr=priors.curr,
        )
        # Both come from the same tracks: their difference has less than the sum, so that the test
        # rather keeps the learned one.
        cov = plain.cov + solution.cov
        if not (plain.converged and np.isfinite(cov).all()):
            return solution.T_curr_prev
        squared = normalized_error_squared(
            plain.T_curr_prev[None], solution.T_curr_prev[None], cov[None]
        )[0]
        return solution.T_curr_prev if squared < MOTIONS_DIFFER_FROM else plain.T_curr_prev


def num_trusted(estimate: Estimate) -> int:
    """Return the number of tracks whose residuals are usual."""
    return int((estimate.weights >= INLIER_FROM).sum())


def _scale_shown(squared: FloatArray, noise: StereoNoise) -> float:
    """Return how much larger the variance of N residuals is than their noise says, 1 at least.

    Args:
        squared: eᵀ Σ⁻¹ e of each, [N].
        noise: their noise.
    """
    dof = np.broadcast_to(noise.dof, (len(squared),))
    return max(1.0, scale_of_residuals(squared, dof))


def _of_two_frames(
    solution: ReprojectionSolution, observations: StereoObservations
) -> FloatArray | None:
    """Return the jitter of a solve in standard deviations of what these two frames alone know of
    it, [6]; None without a jitter."""
    if solution.jitter is None or observations.jitter is None:
        return None
    root = observations.jitter.curr_root
    both = np.column_stack([solution.jitter.curr_rad, solution.jitter.prev_rad])
    return np.linalg.solve(root, both).astype(float).T.ravel()


def evaluate_status(
    solution: ReprojectionSolution,
    weights: FloatArray,
    prediction: MotionPrediction,
    *,
    config: OdometryConfig,
) -> Status:
    """Return whether a solve fixed all six degrees of freedom, converged, and passes the gate."""
    if not np.isfinite(solution.cov).all():
        return Status.DEGENERATE
    # The largest eigenvalue, not an entry of the diagonal: the direction that is not fixed may lie
    # across the axes.
    translation_sigma_m = np.sqrt(np.linalg.eigvalsh(solution.cov[:3, :3])[-1])
    rotation_sigma_rad = np.sqrt(np.linalg.eigvalsh(solution.cov[3:, 3:])[-1])
    if (
        translation_sigma_m > config.solver.max_translation_sigma_m
        or rotation_sigma_rad > config.solver.max_rotation_sigma_rad
    ):
        return Status.DEGENERATE
    if (weights >= INLIER_FROM).sum() < config.solver.min_tracks:
        return Status.TOO_FEW_TRACKS
    # A solve that converged may have done so to a passing lorry: its tracks agree among themselves,
    # but not with where the vehicle can be.
    if not solution.converged or prediction.fails_gate(solution.T_curr_prev, solution.cov):
        return Status.NOT_CONVERGED
    return Status.OK

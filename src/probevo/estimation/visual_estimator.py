"""Tracks → motion: RANSAC, the two-frame estimator, and the test whether to accept the result."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from probevo.arrays import BoolArray, FloatArray
from probevo.camera.rig_jitter import common_sigma_px
from probevo.camera.stereo import StereoCamera
from probevo.config import OdometryConfig
from probevo.estimation.acceptance import are_beyond_chance, contradicts_prediction, evaluate_status
from probevo.estimation.disparity_filter import DisparityFilter
from probevo.estimation.feature_weights import (
    MIN_INLIER_SHARE,
    OUTLIER_BELOW,
    agree_with_noise,
    are_usual,
    num_agreeing,
    scale_of_residuals,
)
from probevo.estimation.initial_motion import are_enough, initial_motion
from probevo.estimation.motion_estimate import Status
from probevo.estimation.ransac import Consensus
from probevo.estimation.reprojection import ReprojectionSolution, evaluated_at
from probevo.estimation.rival_motion import rival_near_prediction
from probevo.estimation.two_frame import Estimator, TwoFrameEstimate, TwoFrameEstimator
from probevo.estimation.visual_motion import MotionPriors, VisualMotion
from probevo.estimation.visual_solve import VisualSolve, residual_scale
from probevo.geometry.uncertainty import MOTIONS_DIFFER_FROM, normalized_error_squared
from probevo.measurements.robust_loss import RobustLoss
from probevo.measurements.stereo_observations import StereoObservations
from probevo.noise.base import NoiseModel, StereoNoise, has_relative_scale, predicted_noise
from probevo.noise.jitter_array import learned_jitter_cov
from probevo.noise.student_t import StudentT
from probevo.stage_clock import StageClock
from probevo.tracking.tracks import Tracks

MAX_SCALE = 30.0
"""Largest factor by which the variances may exceed those of the noise model: 5 times σ, or 1 px
with ``student-t``. With more, the features do not agree on a motion."""
MAX_SMALLER_FACTOR = 0.3
"""Ratio of the variance that a step shows to the one expected, up to which it is clearly smaller:
the logarithm of what steps show scatters by up to 0.5 (``NoiseScale``), that of a dozen tracks by
0.6."""


class _AdaptedNoise(NamedTuple):
    """The predicted noise of N tracks, scaled to the size of their residuals."""

    agree: BoolArray
    """Which tracks agree with the motion under this noise, [N]."""
    noise: StereoNoise
    factor: float
    """How much larger its variances are than predicted, 1 at least."""


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
        self._scales_noise = has_relative_scale(noise) and config.solver.noise_scale == "online"
        # The window estimator models the time correlation of aligned tracks itself, as an AR(1)
        # process (``window.correlation``).
        self._drops_time_correlation = config.estimator == "window"
        # A window knows the landmarks of its frames itself, better than the filter does. The motion
        # of two frames is only where its adjustment starts.
        self._two_frame: Estimator = TwoFrameEstimator(
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
        """Estimate the motion of N tracks, and decide whether to accept it.

        Args:
            tracks: the N tracks, corrected by the rig's calibration.
            phi: the predictors of these tracks, [N, M].
            priors: what is known about the step before its tracks are used.
            rng: source of RANSAC's samples.
            clock: takes the times of the stages ``consensus`` and ``solve``.
        """
        visual = self._estimate_under(priors, tracks, phi, rng=rng, clock=clock)
        shown = visual.estimated_noise_factor
        if visual.status is not Status.DEGENERATE or shown is None:
            return visual
        if shown > MAX_SMALLER_FACTOR * priors.noise_factor:
            return visual
        # The noise is clearly smaller than expected, and so the motion may be determined after all.
        smaller = replace(priors, noise_factor=shown)
        again = self._estimate_under(smaller, tracks, phi, rng=rng, clock=clock)
        return again if again.status is Status.OK else visual

    def _estimate_under(
        self,
        priors: MotionPriors,
        tracks: Tracks,
        phi: FloatArray,
        *,
        rng: np.random.Generator,
        clock: StageClock,
    ) -> VisualMotion:
        """Estimate the motion under the noise that the model predicts, times
        ``priors.noise_factor``; see ``estimate``."""
        # RANSAC: which tracks agree on a motion, and where the solve starts.
        jitter_cov = priors.jitter_cov
        if jitter_cov is None:
            jitter_cov = learned_jitter_cov(self._noise)
        consensus = initial_motion(
            tracks,
            self._camera,
            priors.prediction,
            gyro=priors.gyro,
            config=self._config,
            rng=rng,
            right_sigma_px=common_sigma_px(jitter_cov, self._camera),
        )
        clock.lap("consensus")
        if not are_enough(consensus.inliers, self._config):
            nothing = np.zeros(len(tracks))
            return VisualMotion(Status.TOO_FEW_TRACKS, nothing, used=nothing.astype(bool))
        # The motion under the predicted noise.
        solve = self._solve_with_adapted_noise(tracks, phi, consensus, priors)
        if contradicts_prediction(solve.estimate.solution, priors.prediction):
            solve = self._solve_of_rival(tracks, phi, consensus, priors, rng=rng) or solve
        # Accept or reject it.
        solution = solve.estimate.solution
        is_supported = are_beyond_chance(
            solve.estimate.weights,
            num_tracks=len(tracks),
            need_larger_noise=solve.need_larger_noise,
            config=self._config,
        )
        status = evaluate_status(
            solution, priors.prediction, is_supported=is_supported, config=self._config
        )
        # Of a degenerate solve, a window can still use the directions that are determined.
        is_partly_determined = (
            status is Status.DEGENERATE
            and solution.converged
            and is_supported
            and priors.prediction.agrees(solution.T_curr_prev, solution.hessian)
        )
        # The residuals of the two frames alone.
        two_frames_only = self._two_frames_only(solve, priors)
        clock.lap("solve")
        # What the next step needs: the motion for its predictors, and weights of all N tracks, zero
        # for those that RANSAC rejected.
        T_reference = solution.T_curr_prev
        if self._predicts_from_motion:
            T_reference = self._reference_motion(solve, priors)
        estimated_noise_factor = None
        # Residuals show the noise in the directions that are open, too.
        is_solved = status is Status.OK or (status is Status.DEGENERATE and solution.converged)
        if self._scales_noise and is_solved and is_supported:
            estimated_noise_factor = solve.estimated_noise_factor(two_frames_only)
        disparities = DisparityFilter.none()
        if status is Status.OK:
            disparities = solve.estimate.disparities
        weights = np.zeros(len(tracks))
        weights[solve.used] = solve.estimate.weights
        outside = solve.noise.out_of_domain
        return VisualMotion(
            status=status,
            weights=weights,
            used=solve.used,
            solution=None if status is Status.DEGENERATE else solution,
            two_frames_only=two_frames_only,
            T_reference=T_reference,
            noise=solve.noise_of_current_frame(),
            disparities=disparities,
            is_partly_determined=is_partly_determined,
            num_out_of_domain=None if outside is None else int(outside.sum()),
            estimated_noise_factor=estimated_noise_factor,
        )

    def _solve_of_rival(
        self,
        tracks: Tracks,
        phi: FloatArray,
        consensus: Consensus,
        priors: MotionPriors,
        *,
        rng: np.random.Generator,
    ) -> VisualSolve | None:
        """Solve with those tracks that agree on the predicted motion, where the others may be on
        vehicles; None if there is no such motion.

        Args:
            tracks: the N tracks.
            phi: their predictors, [N, M].
            consensus: the motion that most tracks agree on, and these. It contradicts the
                prediction.
            priors: what is known about the step before its tracks are used.
            rng: source of RANSAC's samples.
        """
        if self._config.ransac.mode != "reject":
            return None
        rival = rival_near_prediction(
            consensus, tracks, self._camera, priors.prediction, config=self._config, rng=rng
        )
        if rival is None:
            return None
        solve = self._solve_with_adapted_noise(tracks, phi, rival, priors)
        return None if contradicts_prediction(solve.estimate.solution, priors.prediction) else solve

    def _solve_with_adapted_noise(
        self, tracks: Tracks, phi: FloatArray, consensus: Consensus, priors: MotionPriors
    ) -> VisualSolve:
        """Solve with the inliers of RANSAC under their predicted noise, or under a larger one if
        their residuals show that.

        Args:
            tracks: the N tracks.
            phi: their predictors, [N, M].
            consensus: the motion that RANSAC found, and its inliers.
            priors: what is known about the step before its tracks are used.
        """
        # First with the predicted noise.
        solve = self._solve_of_consensus(tracks, phi, consensus, priors)
        is_of_majority = solve.estimate.num_inliers >= MIN_INLIER_SHARE * len(tracks)
        if is_of_majority and not self._is_noisier_than_expected(solve, len(tracks)):
            return solve
        # RANSAC's threshold knows nothing of the noise: more tracks may agree near the prediction.
        rival = self._more_near_prediction(tracks, phi, solve, priors)
        if rival is not None:
            solve = self._solve_of_consensus(tracks, phi, rival, priors)
        if not self._is_noisier_than_expected(solve, len(tracks)):
            return solve
        # Then with what all tracks show of the noise, at the motion found.
        solution = solve.estimate.solution
        fitting = self._adapted_noise(
            tracks,
            phi,
            solution,
            jitter_cov=solve.noise.jitter_cov,
            noise_factor=priors.noise_factor,
        )
        most_agree = are_enough(fitting.agree, self._config)
        if solve.estimate.num_inliers >= self._config.solver.min_tracks:
            # There are inliers enough to determine the motion, but they understate the noise: the
            # solve went where some tracks agree by chance. Enlarge the covariance to the scatter of
            # all tracks, rather too much than too little.
            enlargement = residual_scale(solution.features.mahalanobis_sq, solve.noise)
            if most_agree:
                enlargement = max(enlargement, fitting.factor)
            other_information = priors.information_of_measurements(solution.T_curr_prev)
            enlarged = replace(
                solution, cov=_enlarged(solution.cov, enlargement, other_information)
            )
            return replace(
                solve,
                estimate=replace(solve.estimate, solution=enlarged),
                enlargement=enlargement,
            )
        if not most_agree:
            return solve
        # Hardly a track fits the predicted noise, but most agree under a larger one. Solve again
        # with that, instead of rejecting a frame that is only noisy.
        agreeing = tracks.subset(fitting.agree)
        larger = fitting.noise.subset(np.flatnonzero(fitting.agree))
        again = self._solve(
            agreeing,
            larger,
            DisparityFilter.none(),  # its covariances assume the smaller noise
            guess=solution.T_curr_prev,
            priors=priors,
        )
        return VisualSolve(
            solve.T_guess,
            fitting.agree,
            agreeing,
            larger,
            again,
            noise_factor=fitting.factor * priors.noise_factor,
            need_larger_noise=True,
        )

    def _solve_of_consensus(
        self, tracks: Tracks, phi: FloatArray, consensus: Consensus, priors: MotionPriors
    ) -> VisualSolve:
        """Solve with those of N tracks that agree on a motion, under their predicted noise; see
        ``_solve_with_adapted_noise``."""
        used = consensus.inliers
        inliers = tracks.subset(used)
        noise = self._noise_of(inliers, phi[used], priors.noise_factor)
        if priors.jitter_cov is not None:
            noise = replace(noise, jitter_cov=priors.jitter_cov)
        estimate = self._solve(
            inliers, noise, priors.disparities, guess=consensus.T_curr_prev, priors=priors
        )
        return VisualSolve(
            consensus.T_curr_prev, used, inliers, noise, estimate, noise_factor=priors.noise_factor
        )

    def _more_near_prediction(
        self, tracks: Tracks, phi: FloatArray, solve: VisualSolve, priors: MotionPriors
    ) -> Consensus | None:
        """Return the motion that a robust solve with all N tracks finds from the prediction, if it
        is another one than was solved for, and they agree better on it: by the sum of their weights
        under the predicted noise, and too many to do so by chance. None otherwise.

        Args:
            tracks: the N tracks.
            phi: their predictors, [N, M].
            solve: that with the inliers of RANSAC.
            priors: what is known about the step before its tracks are used.
        """
        if self._config.ransac.mode != "reject":
            return None
        noise = self._noise_of(tracks, phi, priors.noise_factor)
        found = self._solve(
            tracks,
            replace(noise, jitter_cov=solve.noise.jitter_cov),
            priors.disparities,
            guess=priors.prediction.T_curr_prev,
            priors=priors,
        )
        if num_agreeing(found.weights) < self._config.solver.min_tracks_beyond_chance:
            return None
        if found.weights.sum() <= solve.estimate.weights.sum():
            return None
        # It may be the same motion, seen with more noise than predicted.
        T_curr_prev = found.solution.T_curr_prev
        if not solve.differs_from(T_curr_prev):
            return None
        # By weight, not by RANSAC's threshold, which knows no jitter of the rig.
        return Consensus(T_curr_prev, found.weights >= OUTLIER_BELOW)

    def _solve(
        self,
        tracks: Tracks,
        noise: StereoNoise,
        disparities: DisparityFilter,
        *,
        guess: FloatArray,
        priors: MotionPriors,
    ) -> TwoFrameEstimate:
        """Solve for the motion of tracks under a noise, with all that is known beside them."""
        return self._two_frame.estimate(
            tracks,
            noise,
            disparities,
            guess=guess,
            others=priors.measurements,
            curr=priors.curr,
        )

    def _two_frames_only(self, solve: VisualSolve, priors: MotionPriors) -> ReprojectionSolution:
        """Evaluate the features of a solve at its motion, without disparity filter and other
        measurements.

        Calibration and predictors need the residuals of these two frames alone. Those against the
        filtered disparities depend on all earlier frames, which were corrected with the same
        calibration: it would confirm itself. Where the covariance of the motion was enlarged, so is
        that of its evaluation.
        """
        solution = solve.estimate.solution
        if not solve.estimate.has_history.any() and not priors.measurements:
            return solution
        observations = StereoObservations.of(
            solve.tracks.prev_px,
            solve.tracks.curr_px,
            solve.noise,
            camera=self._camera,
            loss=RobustLoss.named(self._config.solver.loss),
        )
        plain = evaluated_at(solution, observations)
        return replace(plain, cov=solve.enlargement * plain.cov)

    def _is_noisier_than_expected(self, solve: VisualSolve, num_tracks: int) -> bool:
        """Whether most residuals of a solve are larger than the predicted noise explains.

        This alone is no reason to reject the frame: if the features agree on a motion, its
        covariance is enlarged to what the residuals show.
        """
        if self._config.solver.loss != "noise":
            return False
        return not are_usual(
            solve.estimate.weights,
            num_tracks=num_tracks,
            min_tracks=self._config.solver.min_tracks,
        )

    def _adapted_noise(
        self,
        tracks: Tracks,
        phi: FloatArray,
        solution: ReprojectionSolution,
        *,
        jitter_cov: FloatArray | None,
        noise_factor: float,
    ) -> _AdaptedNoise:
        """Scale the noise to the residuals of N tracks at the motion and the jitter of a solve, and
        return which agree then.

        None agree if the variances of the noise model would have to grow by more than
        ``MAX_SCALE``. Tracks that RANSAC rejected count, too. Those within its threshold are no
        random sample: selected around the motion of a few, they would understate the noise and
        confirm these few.
        """
        noise = self._noise_of(tracks, phi, noise_factor)
        noise = replace(noise, jitter_cov=jitter_cov)
        observations = StereoObservations.of(
            tracks.prev_px, tracks.curr_px, noise, camera=self._camera
        )
        # Scale by the median of all residuals, of which at least half must be no outliers.
        squared = evaluated_at(solution, observations).features.mahalanobis_sq
        factor = max(1.0, scale_of_residuals(squared, noise.dof))
        agree = agree_with_noise(squared, noise.dof, factor)
        if noise_factor * factor > MAX_SCALE:
            agree[:] = False
        return _AdaptedNoise(agree, noise.scaled(factor), factor)

    def _noise_of(self, tracks: Tracks, phi: FloatArray, noise_factor: float) -> StereoNoise:
        """Return the noise of N tracks, given their predictors φ, [N, M]; see ``_completed``.

        Raises:
            InputError: a model of the user's own does not return the noise of N features.
        """
        return self._completed(predicted_noise(self._noise, phi), tracks, noise_factor)

    def _completed(self, noise: StereoNoise, tracks: Tracks, noise_factor: float) -> StereoNoise:
        """Return the noise of N tracks by a model with its variances multiplied by a factor, and
        with what correcting the tracks may have left."""
        if self._drops_time_correlation and tracks.are_aligned:
            noise = replace(noise, time_correlated=None)
        if noise_factor != 1.0:
            noise = noise.scaled(noise_factor)
        if tracks.velocity_error_px is not None:
            noise = noise.with_correlated_error(tracks.velocity_error_px)
        return noise

    def _reference_motion(self, solve: VisualSolve, priors: MotionPriors) -> FloatArray:
        """Return the motion at which the residuals for the next step's predictors are taken, [4,
        4].

        It is the motion under the learned noise, unless a solve with equal noise for all tracks
        differs from it significantly.

        A model that trusts features because they agreed with the last motion confirms that motion.
        Once the estimate has followed a car, the street seems to be the outlier. The solve with
        equal noise cannot be influenced by the model, but it is less accurate, so it is used only
        if the difference is significant.
        """
        solution = solve.estimate.solution
        no_predictors = np.zeros((len(solve.tracks), 0))
        equal = self._completed(
            predicted_noise(StudentT(), no_predictors), solve.tracks, priors.noise_factor
        )
        plain = self._two_frame.solve(
            solve.tracks,
            replace(equal, jitter_cov=priors.jitter_cov),
            guess=solve.T_guess,
            others=priors.measurements,
            curr=priors.curr,
        )
        # Both solves use the same tracks, so the covariance of their difference is smaller than
        # this sum. The test errs on the side of the learned noise.
        cov = plain.cov + solution.cov
        if not (plain.converged and np.isfinite(cov).all()):
            return solution.T_curr_prev
        squared = normalized_error_squared(plain.T_curr_prev, solution.T_curr_prev, cov)
        return solution.T_curr_prev if squared < MOTIONS_DIFFER_FROM else plain.T_curr_prev


def _enlarged(cov: FloatArray, factor: float, other_information: FloatArray) -> FloatArray:
    """Return the covariance of a motion, [6, 6], if that by the images is larger by a factor.

    Args:
        cov: by the images and other measurements.
        factor: 1 at least.
        other_information: that of the other measurements, [6, 6]; they are as good as before.
    """
    if not other_information.any() or not np.isfinite(cov).all():
        return factor * cov
    images_information = np.linalg.inv(cov) - other_information
    return np.asarray(np.linalg.inv(images_information / factor + other_information), np.float64)

"""The two-frame estimator: the motion between two frames, from their tracks and the disparity
filter.

Training and odometry use the same estimator, through the ``Estimator`` protocol.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from probevo.arrays import BoolArray, FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.config import SolverConfig
from probevo.errors import InputError
from probevo.estimation.alignment import solve_alignment
from probevo.estimation.disparity_filter import (
    CommonErrors,
    DisparityFilter,
    update_at_known_motion,
    update_with_common_mode,
)
from probevo.estimation.feature_weights import INLIER_FROM, feature_weights
from probevo.estimation.reprojection import ReprojectionSolution, solve_reprojection
from probevo.measurements.base import MOTION, Measurement, PosePair, Variable
from probevo.measurements.point_priors import DisparityPrior
from probevo.measurements.robust_loss import LEAST_VARIANCE_DOF, RobustLoss
from probevo.measurements.stereo_observations import StereoObservations
from probevo.noise.base import StereoNoise
from probevo.tracking.tracks import Tracks


@dataclass(frozen=True)
class TwoFrameEstimate:
    """The motion of N tracks, their weights, and the updated disparity filter."""

    solution: ReprojectionSolution
    weights: FloatArray
    """Weight of each track, [N], from 0 (outlier) to 1 (``feature_weights``)."""
    disparities: DisparityFilter
    """The disparity filter after the step, its disparities those of the current frame."""
    has_history: BoolArray
    """Which tracks the filter already knew before the step, [N]."""
    common: CommonErrors | None = None
    """The errors of a given motion, of the rig's jitter and of the disparities, as far as all
    tracks have them in common; None if they are those of the solution alone."""

    @property
    def num_inliers(self) -> int:
        """Tracks with a weight of at least one half."""
        return int((self.weights >= INLIER_FROM).sum())


class Estimator(Protocol):
    """Maps tracks, noise and the disparity filter to a motion and the updated filter; stateless."""

    def solve(
        self,
        tracks: Tracks,
        noise: StereoNoise,
        *,
        guess: FloatArray,
        others: Sequence[Measurement] = (),
        curr: Variable = MOTION,
    ) -> ReprojectionSolution:
        """Solve for the motion of N tracks from these two frames alone, without the filter.

        Args:
            tracks: inliers, corrected by the rig's calibration.
            noise: the noise of each track.
            guess: T_curr_prev to start from, [4, 4].
            others: measurements of the motion other than the tracks.
            curr: the variable by which these refer to the pose of the current frame.
        """

    def estimate(
        self,
        tracks: Tracks,
        noise: StereoNoise,
        disparities: DisparityFilter,
        *,
        guess: FloatArray,
        others: Sequence[Measurement] = (),
        curr: Variable = MOTION,
    ) -> TwoFrameEstimate:
        """Estimate the motion of N tracks, with their disparities filtered over earlier frames.

        Args:
            tracks: inliers, corrected by the rig's calibration.
            noise: the noise of each track.
            disparities: the disparity filter after the previous frame.
            guess: T_curr_prev to start from, [4, 4].
            others: measurements of the motion other than the tracks.
            curr: the variable by which these refer to the pose of the current frame.
        """

    def evaluate(
        self,
        tracks: Tracks,
        noise: StereoNoise,
        disparities: DisparityFilter,
        *,
        T_curr_prev: FloatArray,
        cov: FloatArray | None = None,
    ) -> TwoFrameEstimate:
        """Evaluate N tracks at a known motion and update the filter, as in training.

        Args:
            tracks: inliers, corrected by the rig's calibration.
            noise: the noise of each track.
            disparities: the disparity filter after the previous frame.
            T_curr_prev: the motion, [4, 4].
            cov: its covariance, [6, 6]; None if it is known exactly.
        """


class TwoFrameEstimator:
    """The estimator of two frames: one solve, then an update of the disparity filter.

    Args:
        camera: the rectified camera.
        config: settings of the solve.
        filters_disparities: whether the disparities of one step are to be known in the next one.
    """

    def __init__(
        self, camera: StereoCamera, config: SolverConfig, *, filters_disparities: bool = True
    ) -> None:
        self.camera = camera
        self.config = config
        self._method = METHODS[config.method]
        self._filters_disparities = filters_disparities and self._method.filters_disparities

    def solve(
        self,
        tracks: Tracks,
        noise: StereoNoise,
        *,
        guess: FloatArray,
        others: Sequence[Measurement] = (),
        curr: Variable = MOTION,
    ) -> ReprojectionSolution:
        """Solve for the motion by the method of the settings."""
        observations = self._observations(tracks, noise, DisparityPrior.none(), curr=curr)
        return self._method.solve(
            tracks,
            observations,
            guess=guess,
            camera=self.camera,
            config=self.config,
            others=others,
        )

    def estimate(
        self,
        tracks: Tracks,
        noise: StereoNoise,
        disparities: DisparityFilter,
        *,
        guess: FloatArray,
        others: Sequence[Measurement] = (),
        curr: Variable = MOTION,
    ) -> TwoFrameEstimate:
        """Solve for the motion, then update the disparities of the inliers."""
        # Solve, with the filtered disparities as a prior on the points.
        prior = disparities.of_tracks(tracks)
        solution = self._method.solve(
            tracks,
            self._observations(tracks, noise, prior.states, curr=curr),
            guess=guess,
            camera=self.camera,
            config=self.config,
            others=others,
        )
        weights = feature_weights(solution, noise.dof, self.config.loss)
        # The solve treated the errors of different tracks as independent. The filter's common-mode
        # errors correlate them, which is accounted for only now: an outlier would corrupt them, and
        # the inliers are not known before.
        after = DisparityFilter.none()
        if self._filters_disparities:
            solution, after = update_with_common_mode(
                prior,
                tracks,
                noise,
                solution=solution,
                camera=self.camera,
                inliers=weights >= INLIER_FROM,
            )
        return TwoFrameEstimate(
            solution=solution,
            weights=weights,
            disparities=after,
            has_history=_has_history(prior, tracks),
        )

    def evaluate(
        self,
        tracks: Tracks,
        noise: StereoNoise,
        disparities: DisparityFilter,
        *,
        T_curr_prev: FloatArray,
        cov: FloatArray | None = None,
    ) -> TwoFrameEstimate:
        """Evaluate the features at the motion, then update the disparities of the inliers."""
        prior = disparities.of_tracks(tracks)
        # Holding the motion, the solve is over the rig's jitter alone, if there is one.
        observations = self._observations(tracks, noise, prior.states)
        solution = solve_reprojection(observations, guess=T_curr_prev, holds_motion=True)
        weights = feature_weights(solution, noise.dof, self.config.loss)
        after = DisparityFilter.none()
        common = None
        if self._filters_disparities:
            after, common = update_at_known_motion(
                prior,
                tracks,
                noise,
                solution=solution,
                camera=self.camera,
                inliers=weights >= INLIER_FROM,
                motion_cov=cov,
            )
        return TwoFrameEstimate(
            solution=solution,
            weights=weights,
            disparities=after,
            has_history=_has_history(prior, tracks),
            common=common,
        )

    def _observations(
        self,
        tracks: Tracks,
        noise: StereoNoise,
        disparity_prior: DisparityPrior,
        *,
        curr: Variable = MOTION,
    ) -> StereoObservations:
        if not self._method.filters_disparities:
            noise = replace(noise, jitter_cov=None)  # an alignment does not model common errors
        return StereoObservations.of(
            tracks.prev_px,
            tracks.curr_px,
            noise,
            camera=self.camera,
            poses=PosePair(curr),
            loss=RobustLoss.named(self.config.loss),
            disparity_prior=disparity_prior,
        )


def _has_history(prior: DisparityFilter, tracks: Tracks) -> BoolArray:
    """Return which of N tracks the filter knows, [N]."""
    known = np.zeros(len(tracks), np.bool_)
    known[prior.states.rows] = True
    return known


class SolveMethod(Protocol):
    """A way to solve for the motion, chosen by ``solver.method``."""

    filters_disparities: bool
    """Whether the method can use the disparity filter."""

    def solve(
        self,
        tracks: Tracks,
        observations: StereoObservations,
        *,
        guess: FloatArray,
        camera: StereoCamera,
        config: SolverConfig,
        others: Sequence[Measurement],
    ) -> ReprojectionSolution:
        """Find the motion of N tracks, which are the observations, from a guess T_curr_prev."""


class _Reprojection:
    """Minimise reprojection errors (PROBE-GK eq. 14)."""

    filters_disparities = True

    def solve(
        self,
        tracks: Tracks,
        observations: StereoObservations,
        *,
        guess: FloatArray,
        camera: StereoCamera,
        config: SolverConfig,
        others: Sequence[Measurement],
    ) -> ReprojectionSolution:
        """Minimise the reprojection errors of all tracks, and those of other measurements."""
        return solve_reprojection(
            observations, guess=guess, others=others, max_iterations=config.max_iterations
        )


class _Alignment:
    """Align triangulated points, each with its covariance (PROBE eqs. 7-15)."""

    filters_disparities = False

    def solve(
        self,
        tracks: Tracks,
        observations: StereoObservations,
        *,
        guess: FloatArray,
        camera: StereoCamera,
        config: SolverConfig,
        others: Sequence[Measurement],
    ) -> ReprojectionSolution:
        """Align the points. Motion and covariance are the alignment's; all else is evaluated by
        reprojection at that motion.

        Raises:
            InputError: the noise does not refer to single observations, or there are measurements
                of the motion beside the tracks.
        """
        if others:
            raise InputError(
                "--solver.method",
                "alignment takes no measurement of the motion beside the features, and a sensor has"
                " given one.",
                "Take reprojection.",
            )
        noise = observations.noise
        if noise.refers_to != "observation":
            raise InputError(
                "--solver.method",
                "alignment needs the noise of each observation, but this model predicts that of"
                " the residual.",
                "Take reprojection, or another noise model.",
            )
        # A Student-t has the covariance scale · ν/(ν − 2), which is infinite for ν ≤ 2.
        dof = np.maximum(noise.dof, LEAST_VARIANCE_DOF)
        covariance_per_scale = 1.0 / (1.0 - 2.0 / dof)[:, None, None]
        prev_scale = noise.scale if noise.prev_scale is None else noise.prev_scale
        aligned = solve_alignment(
            tracks.prev_px,
            tracks.curr_px - noise.bias,
            covariance_per_scale * prev_scale,
            cov_curr_px=covariance_per_scale * noise.scale,
            camera=camera,
            guess=guess,
            max_iterations=config.max_iterations,
        )
        # Evaluate residuals and weights in the image, so that statistics and reports mean the same
        # for both methods.
        solution = solve_reprojection(observations, guess=aligned.T_curr_prev, max_iterations=0)
        return replace(
            solution,
            cov=aligned.cov,
            iterations=aligned.iterations,
            converged=aligned.converged,
        )


METHODS: dict[str, SolveMethod] = {"reprojection": _Reprojection(), "alignment": _Alignment()}
"""By the name in the settings."""

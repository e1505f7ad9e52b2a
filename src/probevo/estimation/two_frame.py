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
    update_with_latent_errors,
)
from probevo.estimation.feature_weights import INLIER_FROM, feature_weights, num_inliers
from probevo.estimation.reprojection import ReprojectionSolution, solve_reprojection
from probevo.measurements.base import Measurement
from probevo.measurements.point_priors import DisparityPrior
from probevo.measurements.robust_loss import RobustLoss
from probevo.measurements.stereo_observations import StereoObservations
from probevo.measurements.variables import MOTION, PosePair, Variable
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
        return num_inliers(self.weights)


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
        # An alignment of points can use neither the disparity filter nor other common errors.
        self._aligns_points = config.method == "alignment"
        self._filters_disparities = filters_disparities and not self._aligns_points

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
        return self._motion_of(tracks, observations, guess=guess, others=others)

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
        observations = self._observations(tracks, noise, prior.states, curr=curr)
        solution = self._motion_of(tracks, observations, guess=guess, others=others)
        weights = feature_weights(solution.features, noise.dof, self.config.loss)
        # The solve treated the errors of different tracks as independent. The filter's latent
        # errors correlate them, which is accounted for only now: an outlier would corrupt them, and
        # the inliers are not known before.
        after = DisparityFilter.none()
        if self._filters_disparities:
            solution, after = update_with_latent_errors(
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
        weights = feature_weights(solution.features, noise.dof, self.config.loss)
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

    def _motion_of(
        self,
        tracks: Tracks,
        observations: StereoObservations,
        *,
        guess: FloatArray,
        others: Sequence[Measurement],
    ) -> ReprojectionSolution:
        """Solve by the method of the settings; the tracks are the observations."""
        max_iterations = self.config.max_iterations
        if self._aligns_points:
            return _aligned_points(
                tracks,
                observations,
                guess=guess,
                camera=self.camera,
                others=others,
                max_iterations=max_iterations,
            )
        # PROBE-GK eq. 14
        return solve_reprojection(
            observations, guess=guess, others=others, max_iterations=max_iterations
        )

    def _observations(
        self,
        tracks: Tracks,
        noise: StereoNoise,
        disparity_prior: DisparityPrior,
        *,
        curr: Variable = MOTION,
    ) -> StereoObservations:
        if self._aligns_points:
            noise = replace(noise, jitter_cov=None)
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


def _aligned_points(
    tracks: Tracks,
    observations: StereoObservations,
    *,
    guess: FloatArray,
    camera: StereoCamera,
    others: Sequence[Measurement],
    max_iterations: int,
) -> ReprojectionSolution:
    """Align triangulated points, each with its covariance (PROBE eqs. 7-15).

    Motion and covariance are the alignment's; all else is evaluated by reprojection at that motion.

    Args:
        tracks: N tracks.
        observations: the same, with their noise.
        guess: T_curr_prev to start from, [4, 4].
        camera: the rectified camera.
        others: measurements of the motion, of which there must be none.
        max_iterations: of the alignment.

    Raises:
        InputError: the noise does not refer to single observations, or there are measurements of
            the motion beside the tracks.
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
            "alignment needs the noise of each observation, but this model predicts that of the"
            " residual.",
            "Take reprojection, or another noise model.",
        )
    covariance_per_scale = noise.covariance_factor[:, None, None]
    aligned = solve_alignment(
        tracks.prev_px,
        tracks.curr_px - noise.bias,
        covariance_per_scale * noise.scale_of_prev,
        cov_curr_px=covariance_per_scale * noise.scale,
        camera=camera,
        guess=guess,
        max_iterations=max_iterations,
    )
    # Evaluate residuals and weights in the image, so that statistics and reports mean the same for
    # both methods.
    solution = solve_reprojection(observations, guess=aligned.T_curr_prev, max_iterations=0)
    return replace(
        solution,
        cov=aligned.cov,
        iterations=aligned.iterations,
        converged=aligned.converged,
    )

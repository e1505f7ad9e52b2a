"""A Kalman filter of each track's disparity, and of the errors that all tracks have in common.

The two-frame estimator and training use it. With the window, the default estimator, it stays empty:
the window knows the landmarks of its frames itself, better than the filter does.

**State.** The error of a measured disparity persists from frame to frame (the time-correlated error
of ``StereoNoise``). A single residual hardly shows it, but the parallax of many frames does. The
state of a track is therefore x = (d, δ): its true disparity, and the error of the measured one. The
first observation gives d = measured and δ = 0, with covariance [[S_dd + τ², −τ²], [−τ², τ²]]. Every
further one is a Kalman update with the residual of the motion's solve.

**Latent errors.** The motion that turns parallax into disparity is uncertain, too, and its
error is the same for all tracks. If it were taken as known, 300 tracks that are all 1 % too near
would become certain of their disparities to 0.1 %. The error of x is therefore ε + U c, where ε is
independent for each track and the six latent errors c ~ N(0, I) are the same for all. Motion
and latent errors are estimated jointly, ξ and c from e = J ξ + H U c + …. Their posterior has
twelve directions. The six that move the tracks most are kept as the next latent errors; the others
are added to ε.

**Jitter.** If the noise model has a jitter of the rig, the jitters of both frames, η, are estimated
with the motion. That of the previous frame has moved all disparities measured in it, so what is
unknown of it is another common error. That of the current frame will be the previous one in the
next step: the three directions of the posterior that it consists of are kept beside the six.

**Why the place in the image is no state.** A tracker follows a patch from frame to frame. If it
slips, it follows another patch from there on, so a track *is* where it was last seen. On KITTI the
likelihood of the next residuals agrees: compared with no filter, it rises by 0.3 to 0.9 nats a
feature. It falls by as much if the track is modelled as one point of the world, observed with
independent noise in each frame.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from probevo.arrays import BoolArray, FloatArray, IntArray, rows_of
from probevo.camera.stereo import StereoCamera
from probevo.camera.transfer_numba import NEAREST
from probevo.estimation.disparity_filter_numba import (
    NUM_LATENT,
    LatentEquations,
    LinearizedFeatures,
    PosteriorStates,
    PriorStates,
    add_squares,
    joint_posterior,
    latent_equations,
    split_rows,
    update_states,
    whiten,
)
from probevo.estimation.reprojection import ReprojectionSolution, SolvedJitter, sum_products
from probevo.geometry import se3
from probevo.geometry.se3_numba import perturb
from probevo.measurements.jitter_numba import JITTER_DIM
from probevo.measurements.point_priors import DisparityPrior, JitterPrior
from probevo.noise.base import StereoNoise
from probevo.tracking.tracks import Tracks

RANDOM_WALK = 0.02
"""Variance of the random walk of δ from frame to frame, in units of τ². Chosen by likelihood on
KITTI: half as much costs 0.03 nats a feature, three times as much 0.04, and an additional decay
towards zero 0.01."""
MIN_DISPARITY_PX = 0.1
"""Smallest disparity for which the ratio of two disparities is meaningful."""
_CHOSEN = 1.0
"""Eigenvalue, negated, that sorts the directions of the jitter before all others, whose eigenvalues
are not negative."""


class StackedErrors(NamedTuple):
    """Where each part of z = (ξ, η', η°, c) is: the errors that all tracks of a step have in
    common.

    If the noise has no jitter, z = (ξ, c), and the slices of η' and η° are empty.
    """

    motion: slice
    """ξ, the error of the motion, [6], m and rad."""
    curr_jitter: slice
    """η', that of the rig's jitter in the current frame, [3] or [0], in standard deviations of its
    prior."""
    prev_jitter: slice
    """η°, the same for the previous frame, [3] or [0]."""
    latent: slice
    """c ~ N(0, I), the latent errors of the disparities in the filter, [6]."""

    @staticmethod
    def of(jitter: SolvedJitter | None) -> StackedErrors:
        """Return the places for a solve with this jitter, or without any."""
        axes = 0 if jitter is None else JITTER_DIM
        return StackedErrors(
            motion=slice(0, 6),
            curr_jitter=slice(6, 6 + axes),
            prev_jitter=slice(6 + axes, 6 + 2 * axes),
            latent=slice(6 + 2 * axes, 6 + 2 * axes + NUM_LATENT),
        )

    @property
    def before_step(self) -> slice:
        """(η°, c), which have moved the states of the tracks before the step already, [K], with
        K = 6, or 9 with a jitter."""
        return slice(self.prev_jitter.start, self.size)

    @property
    def size(self) -> int:
        """Length of z, 12, or 18 with a jitter."""
        return int(self.latent.stop)


class StepCorrelation(NamedTuple):
    """What correlates the error of a step's motion with those of the steps before and after it.

    The latent errors c, of covariance I before and after each step, mediate the correlation:
    given them, the errors of two successive steps are independent.
    """

    with_before: FloatArray
    """Cross-covariance of the step's error with c before the step, [6, K]; 0 if the filter was
    empty then."""
    with_after: FloatArray
    """Cross-covariance of the step's error with c after the step, [6, K]."""
    transition: FloatArray
    """Cross-covariance of c before the step with c after it, [K, K]."""

    @staticmethod
    def none() -> StepCorrelation:
        """Return the correlation of a step whose error is independent of all others."""
        return StepCorrelation(
            with_before=np.zeros((6, NUM_LATENT)),
            with_after=np.zeros((6, NUM_LATENT)),
            transition=np.zeros((NUM_LATENT, NUM_LATENT)),
        )


@dataclass(frozen=True)
class DisparityFilter:
    """The states of M tracks, given all frames so far."""

    ids: IntArray
    """Identities of the tracks, ascending, [M]."""
    states: DisparityPrior
    """Mean and covariance of (d, δ) of each, in terms of the last frame; and the posterior of the
    rig's jitter in that frame, with its part of ``common``, None if the noise has no jitter, or the
    filter is empty."""
    measured_px: FloatArray
    """The disparity measured in the last frame, [M], px."""
    common: FloatArray
    """∂(d, δ)/∂c of the latent errors c ~ N(0, I), [M, 2, K], px: first the three of the rig's
    jitter in the last frame, if the noise has one, then U; K = 9 or 6. The next step has them as
    ``StackedErrors.before_step``."""
    path_sensitivity: FloatArray
    """∂(path)/∂c, along the axes of the last frame, [6, K]."""
    path_cross_cov: FloatArray
    """Cross-covariance of the path's error before the last step with that of the step, along the
    axes of the last frame, [6, 6]."""
    correlation: StepCorrelation = field(default_factory=StepCorrelation.none)
    """Correlation of the last step with its neighbours."""

    @staticmethod
    def none() -> DisparityFilter:
        """Return an empty filter, as before the first step and after a step without a solve."""
        return DisparityFilter(
            ids=np.zeros(0, np.int64),
            states=DisparityPrior.none(),
            measured_px=np.zeros(0),
            common=np.zeros((0, 2, NUM_LATENT)),
            path_sensitivity=np.zeros((6, NUM_LATENT)),
            path_cross_cov=np.zeros((6, 6)),
        )

    @property
    def common_without_jitter(self) -> FloatArray:
        """U, the columns of ``common`` behind those of the jitter, [M, 2, 6], px."""
        return self.common[:, :, -NUM_LATENT:]

    def of_tracks(self, tracks: Tracks) -> DisparityFilter:
        """Return the states of those of N tracks that the filter knows, listed in
        ``states.rows``."""
        place = rows_of(tracks.ids, self.ids)
        rows = np.flatnonzero(place >= 0)
        place = place[rows]
        measured_px = tracks.prev_px[rows, 0] - tracks.prev_px[rows, 2]
        jitter = self.states.jitter
        if jitter is not None:
            jitter = jitter._replace(sensitivity=jitter.sensitivity[place])
        # The rig's calibration may have been updated since, which changes the corrected
        # measurement. The true disparity is the same, so its error δ takes the difference.
        states = DisparityPrior(
            rows=rows,
            disparity=self.states.disparity[place],
            error=self.states.error[place] + measured_px - self.measured_px[place],
            cov=self.states.cov[place],
            jitter=jitter,
        )
        return DisparityFilter(
            ids=tracks.ids[rows],
            states=states,
            measured_px=measured_px,
            common=self.common[place],
            path_sensitivity=self.path_sensitivity,
            path_cross_cov=self.path_cross_cov,
            correlation=self.correlation,
        )


class CommonErrors(NamedTuple):
    """The errors z = (ξ, η, c) that N features have in common: of the motion, of the rig's jitter
    if the noise has one, and of the disparities."""

    jacobian: FloatArray
    """Derivative of the prediction by z, [N, 4, m + 6], with m = 6, or 12 with a jitter."""
    mean: FloatArray
    """Their mean, [m + 6]."""
    cov: FloatArray
    """Their covariance, [m + 6, m + 6]."""


@dataclass(frozen=True)
class _JointPosterior:
    """The joint posterior of motion, rig's jitter and latent errors, z = (ξ, η, c)."""

    errors: StackedErrors
    """Where z has them."""
    mean: FloatArray
    """[m + 6], with m = 6, or 12 with a jitter."""
    root: FloatArray
    """A square root of the covariance of z, [m + 6, m + 6]."""
    common: FloatArray
    """U of the tracks in the filter, at the refined disparities of the solve, [M, 2, 6]."""
    linearized: LinearizedFeatures
    """The features of the solve."""

    @staticmethod
    def of(
        solution: ReprojectionSolution, prior: DisparityFilter, *, knows_motion: bool = False
    ) -> _JointPosterior:
        """Take one Gauss–Newton step over (ξ, η, c) from a solve that ignored latent errors.

        The robust weights are those of the solve. For c = 0, the covariance of the solve is kept,
        robust loss included.

        Args:
            solution: the solve.
            prior: the filter's states of its tracks.
            knows_motion: whether the motion is known, and not part of the step.
        """
        rows = prior.states.rows
        # A common scale error moves each disparity in proportion to it. Evaluate its derivative at
        # the refined disparities: with other linearisation points in each step, the scale would
        # seem observable, as in a filter with inconsistent linearisation points.
        point = solution.features.points.point[rows, 2]
        refined = solution.features.refined[rows, 2]
        is_measurable = point > MIN_DISPARITY_PX
        growth = np.where(is_measurable, refined / np.maximum(point, MIN_DISPARITY_PX), 1.0)
        # Of the filter's common errors only c: η° is among the unknowns of the solve. The row of d
        # is scaled, that of δ stays.
        common = prior.common_without_jitter.copy()
        common[:, 0] *= growth[:, None]
        # M = H U of each feature, summed to the blocks c × (ξ, η), c × c and the gradient of c.
        linearized = _linearized(solution)
        equations = LatentEquations(
            cross=np.empty((linearized.jacobian.shape[2], NUM_LATENT)),
            hessian=np.empty((NUM_LATENT, NUM_LATENT)),
            gradient=np.empty(NUM_LATENT),
        )
        latent_equations(
            rows,
            linearized,
            solution.features.irls_weight,
            common=common,
            equations=equations,
        )
        errors = StackedErrors.of(solution.jitter)
        mean = np.zeros(errors.size)
        root = np.zeros((errors.size, errors.size))
        if not joint_posterior(
            solution.full_hessian,
            solution.full_cov,
            equations,
            num_known=errors.motion.stop if knows_motion else 0,
            mean=mean,
            root=root,
        ):
            raise np.linalg.LinAlgError("the normal equations are singular to working precision")
        return _JointPosterior(
            errors=errors, mean=mean, root=root, common=common, linearized=linearized
        )

    @staticmethod
    def at_known_motion(
        solution: ReprojectionSolution, prior: DisparityFilter, motion_cov: FloatArray
    ) -> _JointPosterior:
        """Return the posterior where something else than the features tells the motion, too.

        Args:
            solution: the features at the mean of the motion.
            prior: the filter's states of its tracks.
            motion_cov: covariance of the motion, [6, 6].
        """
        # (η, c) given ξ = 0: its mean, its derivative G by ξ, and its covariance V. With P the
        # covariance of the motion, the joint covariance is [[P, P Gᵀ], [G P, V + G P Gᵀ]].
        known = _JointPosterior.of(solution, prior, knows_motion=True)
        unknown = _JointPosterior.of(solution, prior)
        cov = unknown.root @ unknown.root.T
        gain = np.linalg.solve(cov[:6, :6], cov[:6, 6:]).T
        rest = known.root[6:] @ known.root[6:].T
        cross = gain @ motion_cov
        joint = np.block([[motion_cov, cross.T], [cross, rest + cross @ gain.T]])
        return replace(known, root=np.linalg.cholesky(joint))

    def common_errors(self, prior: DisparityFilter) -> CommonErrors:
        """Return how z moves the predictions of all features, its mean and its covariance."""
        # M = H U of the tracks in the filter: d moves the whole prediction, δ its u_r alone.
        rows = prior.states.rows
        common_jacobian = np.zeros((len(self.linearized.jacobian), 4, NUM_LATENT))
        common_jacobian[rows] = (
            self.linearized.disparity_jacobian[rows, :, None] * self.common[:, None, 0]
        )
        common_jacobian[rows, 2] -= self.common[:, 1]
        jacobian = np.concatenate([self.linearized.jacobian, common_jacobian], axis=2)
        return CommonErrors(jacobian, self.mean, self.root @ self.root.T)


def update_with_latent_errors(
    prior: DisparityFilter,
    tracks: Tracks,
    noise: StereoNoise,
    *,
    solution: ReprojectionSolution,
    camera: StereoCamera,
    inliers: BoolArray,
) -> tuple[ReprojectionSolution, DisparityFilter]:
    """Correct a solve for the latent errors, and update the filter.

    Args:
        prior: the filter's states of these tracks (``of_tracks``).
        tracks: the N tracks that were solved with.
        noise: the noise of each; without time-correlated errors there is nothing to filter.
        solution: the solve, which had ``prior.states`` as its disparity prior.
        camera: the rectified camera.
        inliers: which of the tracks to keep in the filter, [N]; the others start afresh.

    Returns:
        The corrected motion with its covariance, and the filter after the step.
    """
    is_determined = np.isfinite(solution.cov).all()
    if noise.time_correlated is None or not is_determined:
        return solution, DisparityFilter.none()
    try:
        posterior = _JointPosterior.of(solution, prior)
        T_curr_prev = np.empty((4, 4))
        motion = posterior.errors.motion
        perturb(posterior.mean[motion].copy(), solution.T_curr_prev, T_curr_prev)
        cov: FloatArray = posterior.root[motion] @ posterior.root[motion].T
        updated = replace(solution, T_curr_prev=T_curr_prev, cov=cov)
        after = _update(
            prior,
            tracks,
            noise,
            solution=updated,
            camera=camera,
            inliers=inliers,
            posterior=posterior,
        )
    except np.linalg.LinAlgError:
        # If all points are kilometres away, the translation is unobservable to working precision.
        return solution, DisparityFilter.none()
    return updated, after


def update_at_known_motion(
    prior: DisparityFilter,
    tracks: Tracks,
    noise: StereoNoise,
    *,
    solution: ReprojectionSolution,
    camera: StereoCamera,
    inliers: BoolArray,
    motion_cov: FloatArray | None = None,
) -> tuple[DisparityFilter, CommonErrors | None]:
    """Update the filter with a motion that is known.

    Args:
        prior: the filter's states of these tracks (``of_tracks``).
        tracks: the N tracks.
        noise: the noise of each; without time-correlated errors there is nothing to filter.
        solution: the tracks at the mean of the motion.
        camera: the rectified camera.
        inliers: which of the tracks to keep in the filter, [N]; the others start afresh.
        motion_cov: covariance of the motion, [6, 6]; None if it is known exactly.

    Returns:
        The filter after the step, and the errors that the tracks have in common; None where the
        motion is exact, or the features do not determine it.
    """
    posterior = None
    common = None
    try:
        if noise.time_correlated is not None and np.isfinite(solution.cov).all():
            if motion_cov is not None:
                posterior = _JointPosterior.at_known_motion(solution, prior, motion_cov)
                common = posterior.common_errors(prior)
            elif solution.jitter is not None:
                posterior = _JointPosterior.of(solution, prior, knows_motion=True)
        after = _update(
            prior,
            tracks,
            noise,
            solution=solution,
            camera=camera,
            inliers=inliers,
            posterior=posterior,
        )
    except np.linalg.LinAlgError:
        return DisparityFilter.none(), None
    return after, common


def _update(
    prior: DisparityFilter,
    tracks: Tracks,
    noise: StereoNoise,
    *,
    solution: ReprojectionSolution,
    camera: StereoCamera,
    inliers: BoolArray,
    posterior: _JointPosterior | None,
) -> DisparityFilter:
    """Update the states of the inliers with the residuals of a step, and move them to its frame.

    Args:
        prior: the filter's states of these tracks (``of_tracks``).
        tracks: the N tracks.
        noise: the noise of each; without time-correlated errors there is nothing to filter.
        solution: the tracks at the motion of the step.
        camera: the rectified camera.
        inliers: which of the tracks to keep in the filter, [N].
        posterior: of the errors z that the tracks have in common; None if z is taken as zero, as
            where the motion is exact.

    Raises:
        numpy.linalg.LinAlgError: a covariance is not positive definite to working precision.
    """
    if noise.time_correlated is None:
        return DisparityFilter.none()
    chosen = _sorted_inliers(tracks, solution, inliers)
    states = _updated_states(chosen, prior, solution, posterior)
    # Random walk of δ until the next frame: its variance grows by a share of τ².
    states.cov[:, 1, 1] += RANDOM_WALK * noise.time_correlated[chosen]
    # The errors that the tracks have in common after the step; the rest is added to ``states.cov``.
    if posterior is None:
        latent = _NextLatentErrors.none(len(chosen))
    else:
        latent = _split_errors(prior, solution, posterior, states)
    # Move the disparities to the current frame. Points that the motion has taken behind the camera
    # have none any more.
    depth_ratio = _depth_ratio(
        tracks.prev_px[chosen], states.mean[:, 0], solution.T_curr_prev, camera=camera
    )
    ahead = depth_ratio > NEAREST
    kept = chosen[ahead]
    common = latent.sensitivity[ahead]
    jitter = latent.jitter
    if jitter is not None:
        jitter = jitter._replace(sensitivity=common[:, :, :JITTER_DIM])
    curr_px = tracks.curr_px[kept]
    return DisparityFilter(
        ids=tracks.ids[kept],
        states=DisparityPrior(
            rows=np.arange(len(kept)),
            disparity=states.mean[ahead, 0] / depth_ratio[ahead],
            error=states.mean[ahead, 1],
            cov=states.cov[ahead],
            jitter=jitter,
        ),
        measured_px=curr_px[:, 0] - curr_px[:, 2],
        common=common,
        path_sensitivity=latent.path_sensitivity,
        path_cross_cov=latent.path_cross_cov,
        correlation=latent.correlation,
    )


def _sorted_inliers(tracks: Tracks, solution: ReprojectionSolution, inliers: BoolArray) -> IntArray:
    """Return the indices of the tracks to keep, [M], sorted by identity, so that ``of_tracks`` can
    find them by bisection.

    Args:
        tracks: the N tracks.
        solution: the solve, in which tracks behind the camera have no information.
        inliers: which of the tracks are inliers, [N].
    """
    order = np.argsort(tracks.ids)
    return order[(inliers & (solution.features.information[:, 0, 0] > 0.0))[order]]


def _updated_states(
    chosen: IntArray,
    prior: DisparityFilter,
    solution: ReprojectionSolution,
    posterior: _JointPosterior | None,
) -> PosteriorStates:
    """Return the Kalman update of (d, δ) with the residual of each track, for given errors z.

    How (d, δ) depend on z is propagated along.

    Args:
        chosen: indices of the tracks to update, [M].
        prior: the filter's states of the N tracks before the step (``of_tracks``).
        solution: the N tracks at the motion of the step.
        posterior: of z; None if z is taken as zero.
    """
    errors = StackedErrors.of(solution.jitter)
    linearized = _linearized(solution) if posterior is None else posterior.linearized
    mean = np.zeros(errors.size) if posterior is None else posterior.mean
    # How c, and η° if there is a jitter, have moved (d, δ) before the step. Tracks new to the
    # filter do not move with c.
    common = np.zeros((len(linearized.jacobian), 2, NUM_LATENT))
    if posterior is not None:
        common[prior.states.rows] = posterior.common
    if solution.jitter is not None:
        prev_jitter_sensitivity = solution.jitter.unknown.effects.sensitivity[:, 2:]
        common = np.concatenate([prev_jitter_sensitivity, common], axis=2)
    states = PosteriorStates(
        mean=np.empty((len(chosen), 2)),
        cov=np.empty((len(chosen), 2, 2)),
        sensitivity=np.empty((len(chosen), 2, errors.size)),
    )
    update_states(
        chosen,
        PriorStates(
            point=solution.features.points.point,
            error=solution.features.points.error,
            cov=solution.features.points.cov,
            cross_cov=solution.features.cross_cov,
            common=common,
        ),
        linearized,
        mean=mean,
        posterior=states,
    )
    return states


class _NextLatentErrors(NamedTuple):
    """The latent errors after a step, by which its tracks, its motion and the path depend on
    each other."""

    sensitivity: FloatArray
    """``DisparityFilter.common``, of all tracks that were updated, [M, 2, K], px."""
    path_sensitivity: FloatArray
    """Sensitivity of the path to the latent errors, [6, K], as in ``DisparityFilter``."""
    path_cross_cov: FloatArray
    """Cross-covariance of the path with the step, [6, 6], as in ``DisparityFilter``."""
    correlation: StepCorrelation
    """Correlation of the step with its neighbours."""
    jitter: JitterPrior | None
    """Posterior of the current frame's jitter, without the sensitivity of the tracks; None if the
    noise has none."""

    @staticmethod
    def none(num_tracks: int) -> _NextLatentErrors:
        """Return the latent errors of tracks whose errors are independent."""
        return _NextLatentErrors(
            sensitivity=np.zeros((num_tracks, 2, NUM_LATENT)),
            path_sensitivity=np.zeros((6, NUM_LATENT)),
            path_cross_cov=np.zeros((6, 6)),
            correlation=StepCorrelation.none(),
            jitter=None,
        )


def _split_errors(
    prior: DisparityFilter,
    solution: ReprojectionSolution,
    posterior: _JointPosterior,
    states: PosteriorStates,
) -> _NextLatentErrors:
    """Split the errors z of a step into the next latent ones and the rest.

    z = mean + root w, with whitened errors w ~ N(0, I); a direction is one of the space of w.

    Args:
        prior: the filter before the step.
        solution: the solve, at the motion of the step.
        posterior: of z.
        states: those of the M tracks; the covariance of the rest is added to ``states.cov``.
    """
    errors = posterior.errors
    root = posterior.root
    # The jitter of the current frame is the previous one of the next step, and therefore kept.
    jitter_rows = np.zeros((errors.size, 0))
    jitter = None
    if solution.jitter is not None:
        # ω' = L' η'.
        curr_root = solution.jitter.unknown.curr_root
        jitter_rows, jitter = _jitter_after(
            solution.jitter.curr_rad + curr_root @ posterior.mean[errors.curr_jitter],
            curr_root @ root[errors.curr_jitter],
        )
    sensitivity, directions = _strongest_directions(
        states.sensitivity, root, cov=states.cov, chosen=jitter_rows
    )
    # Path and step depend on the same whitened errors: hence their cross-covariance. The path
    # before the step depends on η° and c only, and is turned to the axes of the current frame.
    before_step = root[errors.before_step]
    correlation = _correlation_of(
        root[errors.motion],
        before_step,
        directions,
        is_first=not prior.path_sensitivity.any(),
    )
    path_before = se3.adjoint(solution.T_curr_prev) @ _path_sensitivity(prior, len(before_step))
    return _NextLatentErrors(
        sensitivity=sensitivity,
        path_sensitivity=path_before @ correlation.transition + correlation.with_after,
        path_cross_cov=path_before @ correlation.with_before.T,
        correlation=correlation,
        jitter=jitter,
    )


def _depth_ratio(
    prev_px: FloatArray, disparity: FloatArray, T_curr_prev: FloatArray, camera: StereoCamera
) -> FloatArray:
    """Return the ratio of new to old depth, q_z, by which the disparity is divided
    (``camera.transfer``).

    Args:
        prev_px: observations of M tracks in the previous frame, [M, 4], px.
        disparity: their disparities in that frame, [M], px.
        T_curr_prev: the motion, [4, 4].
        camera: the rectified camera.
    """
    # λ = d/(f_u b), and q_z = (C m)_z + λ t_z with m = (x, y, 1).
    T = T_curr_prev
    x, y = camera.normalized(prev_px[:, 0], prev_px[:, 1])
    inverse_depth = disparity / (camera.fu_px * camera.baseline_m)
    ratio: FloatArray = T[2, 0] * x + T[2, 1] * y + T[2, 2] + T[2, 3] * inverse_depth
    return ratio


def _correlation_of(
    step: FloatArray, common_before: FloatArray, directions: FloatArray, *, is_first: bool
) -> StepCorrelation:
    """Return how a step is correlated with its neighbours, through L whitened errors of the step.

    Args:
        step: derivatives of the motion by the whitened errors, [6, L].
        common_before: those of c before the step, [K, L].
        directions: the directions of the whitened errors that are c after the step, [L, K].
        is_first: whether there was no step before, with which c has nothing to do then.
    """
    if is_first:
        common_before = np.zeros_like(common_before)
    return StepCorrelation(
        with_before=step @ common_before.T,
        with_after=step @ directions,
        transition=common_before @ directions,
    )


def _path_sensitivity(prior: DisparityFilter, count: int) -> FloatArray:
    """Return ∂(path)/∂c before a step, [6, count]; zero if the filter has been reset."""
    known = prior.path_sensitivity
    return known if known.shape[1] == count else np.zeros((6, count))


def _jitter_after(mean: FloatArray, root: FloatArray) -> tuple[FloatArray, JitterPrior]:
    """Return the posterior of the current frame's jitter as the prior of the next step.

    Args:
        mean: its mean, [3], rad.
        root: its derivatives by the L whitened errors of the step, [3, L], rad.

    Returns:
        The three orthonormal directions of the whitened errors that it depends on, [L, 3], and the
        prior, without the sensitivity of the tracks.
    """
    # root = L Dᵀ with L triangular and Dᵀ D = I: L is the root of the covariance, D the directions.
    lower = np.empty((JITTER_DIM, JITTER_DIM))
    directions = np.empty((root.shape[1], JITTER_DIM))
    if not split_rows(root, lower, directions):
        raise np.linalg.LinAlgError("the covariance of the jitter is singular")
    return directions, JitterPrior(mean, lower, np.zeros((0, 2, JITTER_DIM)))


def _linearized(solution: ReprojectionSolution) -> LinearizedFeatures:
    return LinearizedFeatures(
        jacobian=solution.full_jacobian,
        disparity_jacobian=solution.features.disparity_jacobian,
        information=solution.features.information,
        residuals=solution.features.residuals,
    )


def _strongest_directions(
    sensitivity: FloatArray, root: FloatArray, cov: FloatArray, chosen: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Split common errors into the six directions that move the tracks most, and the rest.

    Args:
        sensitivity: ∂(d, δ)/∂z of each track, [M, 2, L].
        root: z as a linear map of L whitened errors, [L, L].
        cov: each track's own covariance, [M, 2, 2], in units of which the effect of an error is
            measured; that of the remaining directions is added to it.
        chosen: orthonormal directions of the whitened errors that are kept in any case, [L, K],
            beside the six.

    Returns:
        The sensitivity to the K + 6 directions, [M, 2, K + 6], and these directions, [L, K + 6].
    """
    # Project the chosen directions out and give them a negative eigenvalue. Eigenvalues ascend, so
    # the chosen directions come first, and the strongest six last.
    white = _transformed(sensitivity, root - (root @ chosen) @ chosen.T)
    if not whiten(white, cov):
        raise np.linalg.LinAlgError("a track's covariance is not positive definite")
    _, directions = np.linalg.eigh(sum_products(white, white) - _CHOSEN * (chosen @ chosen.T))
    # Transform to all directions at once, in the order (chosen, rest, strongest).
    first = chosen.shape[1]
    last = len(root) - NUM_LATENT
    directions[:, :first] = chosen
    moved = _transformed(sensitivity, root @ directions)
    add_squares(moved, first, last, cov=cov)
    kept = np.concatenate([moved[:, :, :first], moved[:, :, last:]], axis=2)
    return kept, np.concatenate([directions[:, :first], directions[:, last:]], axis=1)


def _transformed(sensitivity: FloatArray, transform: FloatArray) -> FloatArray:
    """Return the sensitivities to linearly transformed errors, [M, 2, K], as one matrix product.

    Args:
        sensitivity: to L errors, [M, 2, L].
        transform: the L errors as a linear map of K others, [L, K].
    """
    count, rows, errors = sensitivity.shape
    transformed: FloatArray = sensitivity.reshape(count * rows, errors) @ transform
    return transformed.reshape(count, rows, transform.shape[1])

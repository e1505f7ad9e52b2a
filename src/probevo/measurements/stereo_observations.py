"""All stereo observations of a frame as one measurement: the reprojection residuals of PROBE-GK.

The residual of a feature is e = y' − f(T g(y)), with y its observation in the previous frame, y' in
the current one, and T = T_curr_prev. Its scale Σ follows from the noise of both observations
(``stereo_numba.propagate_noise``), and its loss from the tails of that noise (PROBE-GK eq. 14).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.camera.transfer_numba import Intrinsics
from probevo.geometry import se3
from probevo.measurements.base import (
    TWO_FRAMES,
    Linearization,
    Outcome,
    PosePair,
    Values,
    Variable,
)
from probevo.measurements.point_priors import DisparityPrior, PointPrior
from probevo.measurements.relative_rotation import relative_motion
from probevo.measurements.robust_loss import RobustLoss
from probevo.measurements.stereo_numba import (
    BEHIND,
    FeatureWeights,
    LossParameters,
    NormalEquations,
    PointPairs,
    PropagatedNoise,
    StereoJacobians,
    normal_equations,
    propagate_noise,
    residual_jacobians,
    sum_information,
    weigh,
)
from probevo.noise.base import StereoNoise

EXPECTED_FEATURES = 20.0
"""How many features the noise model's own word counts for in the scale of the covariance, against
those seen."""
DIM = 4


@dataclass(frozen=True)
class StereoObservations:
    """N stereo observations of one frame, each of a point that the previous frame saw, too."""

    points: PointPrior
    """The points, before the motion is estimated."""
    pairs: PointPairs
    noise: StereoNoise
    loss: RobustLoss
    loss_parameters: LossParameters
    camera: Intrinsics
    poses: PosePair
    propagated_noise: PropagatedNoise
    """Σ⁻¹ and the points of linearisation, at the motion that ``propagated`` was last given."""

    @staticmethod
    def of(
        prev_px: FloatArray,
        curr_px: FloatArray,
        noise: StereoNoise,
        *,
        camera: StereoCamera,
        poses: PosePair = TWO_FRAMES,
        loss: RobustLoss | None = None,
        disparity_prior: DisparityPrior | None = None,
    ) -> StereoObservations:
        """Build the measurement from observations of N features in two frames.

        Args:
            prev_px: observations y in the previous frame, rectified, [N, 4], px. The disparity may
                be zero or slightly negative: a point at infinity still contributes to rotation.
            curr_px: the same points in the current frame, y', [N, 4], px.
            noise: of the N features.
            camera: the rectified camera.
            poses: the poses of both frames; by default, the world is the previous camera.
            loss: robust loss; by default that of the noise's own Student-t.
            disparity_prior: what earlier frames say of some of the disparities.
        """
        count = len(prev_px)
        loss = RobustLoss.student_t() if loss is None else loss
        # Copies: a model may give one scale to all features, as a read-only view without strides,
        # for which Numba would compile everything once more.
        scale = np.empty((count, 4, 4))
        scale[:] = noise.scale
        dof = np.empty(count)
        dof[:] = noise.dof
        points = PointPrior.of(
            prev_px,
            scale=scale if noise.prev_scale is None else np.array(noise.prev_scale, order="C"),
            propagate=noise.refers_to == "observation",
            time_correlated=noise.time_correlated,
        )
        if disparity_prior is not None:
            points = points.given(disparity_prior)
        curr_unbiased = np.subtract(curr_px, noise.bias, order="C")
        # A known error of the measured disparity d = u_l − u_r is taken out of u_r.
        curr_unbiased[:, 2] += points.error
        return StereoObservations(
            points=points,
            pairs=PointPairs(
                point=points.point,
                point_cov=points.cov,
                curr=curr_unbiased,
                curr_scale=scale,
            ),
            noise=replace(noise, dof=dof),
            loss=loss,
            loss_parameters=LossParameters(int(loss.kind), loss.parameters(dof)),
            camera=Intrinsics.of(camera),
            poses=poses,
            propagated_noise=_not_yet_propagated(points.point),
        )

    def __len__(self) -> int:
        """Return the number of features, N."""
        return len(self.pairs.curr)

    @property
    def variables(self) -> tuple[Variable, ...]:
        """The poses of both frames, or only the current one."""
        curr, prev = self.poses
        return (curr,) if prev is None else (prev, curr)

    def propagated(self, values: Values) -> StereoObservations:
        """Return the same observations with Σ and the refined points at these poses."""
        T_curr_prev = relative_motion(values, self.poses.curr, self.poses.prev)
        # The refined points are where the loop linearises, so that it begins with the last ones.
        noise = _not_yet_propagated(self.propagated_noise.refined)
        propagate_noise(T_curr_prev, self.camera, self.pairs, noise)
        return replace(self, propagated_noise=noise)

    def linearize(self, values: Values, *, newton: bool = False) -> Linearization:
        """Return cost and normal equations in one compiled pass."""
        T_curr_prev = relative_motion(values, self.poses.curr, self.poses.prev)
        cost, system = self._normal_equations(T_curr_prev, newton=newton)
        motion = Linearization(cost=cost, hessian=system.hessian, gradient=system.gradient)
        return motion if self.poses.prev is None else of_both_poses(motion, T_curr_prev)

    def information(self, values: Values) -> FloatArray:
        """Return the Fisher information on the poses, [6, 6] or [12, 12]."""
        T_curr_prev = relative_motion(values, self.poses.curr, self.poses.prev)
        motion = Linearization(0.0, self.at(T_curr_prev).information, np.zeros(6))
        return (motion if self.poses.prev is None else of_both_poses(motion, T_curr_prev)).hessian

    def outcome(self, values: Values) -> Outcome:
        """Return what became of the N residuals."""
        at = self.at(relative_motion(values, self.poses.curr, self.poses.prev))
        return Outcome(
            squared=at.squared,
            weight=at.weights.relative,
            gated=np.asarray(at.squared >= BEHIND),
        )

    def at(self, T_curr_prev: FloatArray) -> StereoResult:
        """Evaluate everything about the features at a motion, [4, 4]."""
        count = len(self)
        jacobians = StereoJacobians(
            residual=np.empty((count, 4)),
            motion=np.empty((count, 4, 6)),
            white=np.empty((count, 4, 6)),
            disparity=np.empty((count, 4)),
            squared=np.empty(count),
        )
        residual_jacobians(
            T_curr_prev,
            self.camera,
            self.pairs.curr,
            propagated=self.propagated_noise,
            out=jacobians,
        )
        weights = FeatureWeights(
            weight=np.empty(count), curvature=np.empty(count), relative=np.empty(count)
        )
        scatter, curved = weigh(self.loss_parameters, jacobians.squared, weights)
        hessian, information = self._information(jacobians, weights)
        return StereoResult(
            squared=jacobians.squared,
            weights=weights,
            jacobians=jacobians,
            hessian=hessian,
            information=information / self._variance_factor(scatter, curved),
        )

    def _normal_equations(
        self, T_curr_prev: FloatArray, *, newton: bool
    ) -> tuple[float, NormalEquations]:
        system = NormalEquations(
            hessian=np.empty((6, 6)), gradient=np.empty(6), squared=np.empty(len(self))
        )
        cost = normal_equations(
            T_curr_prev,
            self.camera,
            self.pairs.curr,
            propagated=self.propagated_noise,
            loss=self.loss_parameters,
            newton=newton,
            system=system,
        )
        return cost, system

    def _information(
        self, jacobians: StereoJacobians, weights: FeatureWeights
    ) -> tuple[FloatArray, FloatArray]:
        """Return Σ w Jᵀ Σ⁻¹ J, and Σ a Jᵀ Σ⁻¹ J without what disparity noise adds to it.

        The translation's columns of J are proportional to the disparity d. Refined, d leans towards
        the solution, so it is set back to the one seen; squared, its noise σ² has a mean of its
        own: E[d²] − σ² is what the true disparity contributes. Only where all disparities are
        mostly noise does that matter, and there it tells an unobservable translation from an
        observed one.
        """
        refined = self.propagated_noise.refined[:, 2]
        disparity = np.where(np.abs(refined) > 1e-9, refined, np.inf)
        hessian = np.empty((6, 6))
        information = np.empty((6, 6))
        sum_information(
            jacobians,
            weights,
            self.pairs.point[:, 2] / disparity,
            disparity_noise_share=self.pairs.point_cov[:, 2, 2] / disparity**2,
            hessian=hessian,
            information=information,
        )
        return hessian, information

    def _variance_factor(self, scatter: float, curved: float) -> float:
        """Return how much larger the covariance is than the inverse of A = Σ a Jᵀ Σ⁻¹ J.

        The covariance of an M-estimate is A⁻¹ B A⁻¹, with a = w + (2/d) w' s, the curvature of the
        loss (over a Student-t its mean is (ν+d)/(ν+d+2); for an outlier it vanishes), and
        B = Σ b Jᵀ Σ⁻¹ J, b = w² s/d, the scatter of its gradient. B is taken as A times the ratio
        of the sums of b and a: one if the noise is as the model says, larger if the residuals are.
        The sums start with the model's own a and b (``RobustLoss.moments``), as if a few features
        had shown them.
        """
        count = len(self)
        moments = self.loss.moments(self.noise.dof)
        expected_curvature, expected_scatter = (
            float(np.mean(moment)) if count else 1.0 for moment in moments
        )
        spent = count * DIM / max(count * DIM - 6.0, 1.0)
        seen = EXPECTED_FEATURES * expected_scatter + spent * scatter
        return seen / (EXPECTED_FEATURES * expected_curvature + curved)


@dataclass(frozen=True)
class StereoResult:
    """N stereo observations evaluated at one motion."""

    squared: FloatArray
    """eᵀ Σ⁻¹ e of each feature, [N]; Σ is the scale of its residual."""
    weights: FeatureWeights
    jacobians: StereoJacobians
    hessian: FloatArray
    """Σ w Jᵀ Σ⁻¹ J with the IRLS weights w, [6, 6]. Its inverse is not the covariance."""
    information: FloatArray
    """Information on ξ of T_curr_prev, [6, 6]."""


def of_both_poses(motion: Linearization, T_curr_prev: FloatArray) -> Linearization:
    """Turn normal equations over ξ of T_curr_prev into those over (ξ_prev, ξ_curr) of both poses.

    T_curr_prev = T_curr_world T_prev_world⁻¹ moves by ξ = ξ_curr − Ad(T_curr_prev) ξ_prev.
    """
    lift = np.hstack([-se3.adjoint(T_curr_prev), np.eye(6)])
    return Linearization(
        cost=motion.cost,
        hessian=lift.T @ motion.hessian @ lift,
        gradient=lift.T @ motion.gradient,
    )


def _not_yet_propagated(refined: FloatArray) -> PropagatedNoise:
    count = len(refined)
    return PropagatedNoise(
        refined=refined.copy(),
        offset=np.zeros((count, 4)),
        information=np.zeros((count, 4, 4)),
        cross_cov=np.zeros((count, 4, 2)),
    )

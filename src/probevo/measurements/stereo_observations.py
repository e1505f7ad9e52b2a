"""All stereo observations of a frame as one measurement: the reprojection residuals of PROBE-GK.

The residual of a feature is e = y' − f(T g(y)), with y its observation in the previous frame, y' in
the current one, and T = T_curr_prev. Its scale Σ follows from the noise of both observations
(``stereo_numba.propagate_noise``), and its loss from the tails of that noise (PROBE-GK eq. 14).

If the noise model has a jitter ω of the rig (``camera.rig_jitter``), an error that is common to all
features of a frame, then the jitter of both frames is a further unknown, η ~ N(0, I). The jitter of
the current frame moves its right observations; the jitter of the previous frame moves the points:
e = y' − f(T g(y)) − D η (``jitter_numba``). The robust weights follow from the residuals after η
is estimated, and the covariance of the motion is marginalised over η. Derivation:
docs/conventions.md.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.rig_jitter import jitter_offsets
from probevo.camera.stereo import StereoCamera
from probevo.camera.transfer_numba import Intrinsics
from probevo.geometry import se3
from probevo.measurements.base import Linearization, Outcome
from probevo.measurements.jitter_numba import (
    JITTER_DIM,
    JITTER_PAIR_DIM,
    Iterate,
    JitterEffects,
    JitterEquations,
    LinearizedJitter,
    jitter_effects,
    jitter_information,
    joint_normal_equations,
    propagate_with_jitter,
    subtract_jitter,
)
from probevo.measurements.point_priors import DisparityPrior, JitterPrior, PointPrior
from probevo.measurements.relative import relative_motion
from probevo.measurements.robust_loss import RobustLoss
from probevo.measurements.robust_loss_numba import LossKind
from probevo.measurements.stereo_numba import (
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
from probevo.measurements.variables import TWO_FRAMES, PosePair, Values, Variable
from probevo.noise.base import MIN_VARIANCE_DOF, StereoNoise

EXPECTED_FEATURES = 20.0
"""Number of features that the noise model's prediction counts for, against the observed residuals,
in the scale of the covariance. Their scatter alone, of ten features, would be off by a third."""
DIM = 4
JITTER_PRIOR = np.eye(JITTER_PAIR_DIM)
"""Information of the prior of η, [6, 6]."""


@dataclass(frozen=True)
class JitterUnknown:
    """The rig's jitter in both frames as an unknown of the solve: η = (η', η°) ~ N(0, I)."""

    variable: Variable
    """η, [6]."""
    curr_root: FloatArray
    """L', [3, 3], rad: the jitter of the current frame is L' η', with L' L'ᵀ = S."""
    prev: JitterPrior
    """Prior of the jitter in the previous frame, m + L° η°; observations are corrected for m."""
    effects: JitterEffects
    """∂(observations)/∂η of the features."""

    @staticmethod
    def of(
        prev_px: FloatArray,
        curr_px: FloatArray,
        points: PointPrior,
        *,
        jitter_priors: JitterPriors,
        prior: DisparityPrior | None,
        camera: Intrinsics,
        frame: int,
    ) -> JitterUnknown:
        """Build the unknown.

        Args:
            prev_px: observations of N features in the previous frame, [N, 4], px.
            curr_px: those in the current frame, [N, 4], px.
            points: the points of the previous frame.
            jitter_priors: the priors of the jitter in both frames.
            prior: prior of disparities and jitter by the disparity filter.
            camera: the intrinsics.
            frame: the index of the current frame.
        """
        effects = jitter_effects(
            prev_px,
            curr_px,
            camera,
            curr_root=jitter_priors.curr_root,
            prev_root=jitter_priors.prev.root,
            gain=points.gain,
        )
        # The disparity filter knows how the previous jitter has moved its states; for the others,
        # it moves the disparity like the observation.
        if prior is not None and len(prior.rows):
            known = prior.jitter
            effects.sensitivity[prior.rows, 2:] = 0.0 if known is None else known.sensitivity
        return JitterUnknown(
            variable=Variable(kind="jitter", frame=frame),
            curr_root=jitter_priors.curr_root,
            prev=jitter_priors.prev,
            effects=effects,
        )


class JitterPriors(NamedTuple):
    """The priors of the jitter in both frames."""

    curr_root: FloatArray
    """L', [3, 3], rad."""
    prev: JitterPrior
    """Prior of the previous frame's jitter; without an estimate it is N(0, S)."""

    @staticmethod
    def of(cov: FloatArray, prior: DisparityPrior | None) -> JitterPriors:
        """Build them from S, [3, 3], rad², and from the prior by earlier frames, if any."""
        root = np.linalg.cholesky(cov).astype(float)
        if prior is not None and prior.jitter is not None:
            return JitterPriors(root, prior.jitter)
        prev = JitterPrior(
            mean=np.zeros(JITTER_DIM), root=root, sensitivity=np.zeros((0, 2, JITTER_DIM))
        )
        return JitterPriors(root, prev)


@dataclass(frozen=True)
class StereoObservations:
    """Stereo observations of N points in the current frame that the previous frame saw as well."""

    points: PointPrior
    """The points, before the motion is estimated."""
    pairs: PointPairs
    noise: StereoNoise
    loss: RobustLoss
    loss_parameters: LossParameters
    camera: Intrinsics
    poses: PosePair
    propagated_noise: PropagatedNoise
    """Σ⁻¹ and the linearisation points, at the motion of the last call of ``propagated``."""
    jitter: JitterUnknown | None = None
    """The rig's jitter; None if the noise has none."""
    linearized_jitter: LinearizedJitter | None = None
    """The jitter, linearised at the motion of the last call of ``propagated``."""

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
            noise: noise of the N features.
            camera: the rectified camera.
            poses: the poses of both frames; by default, the world is the previous camera.
            loss: robust loss; by default the one of the noise's own Student-t.
            disparity_prior: the disparity filter's prior of some of the disparities.
        """
        count = len(prev_px)
        jitter_priors = None
        if noise.jitter_cov is not None:
            jitter_priors = JitterPriors.of(noise.jitter_cov, disparity_prior)
            prev_px = np.array(prev_px, order="C")
            # The known part of the previous jitter is a correction of the observations.
            if jitter_priors.prev.mean.any():
                prev_px[:, 2:] -= jitter_offsets(prev_px, camera) @ jitter_priors.prev.mean
        loss = RobustLoss.student_t() if loss is None else loss
        # Copy: a model may give all features the same scale, as a read-only view without strides. A
        # view is another type for Numba, which would compile everything again.
        scale = np.empty((count, 4, 4))
        scale[:] = noise.scale
        dof = np.empty(count)
        dof[:] = noise.dof
        # Points by the previous observation, then by the disparity filter for the tracks it knows
        points = PointPrior.of(
            prev_px,
            scale=scale if noise.prev_scale is None else np.array(noise.prev_scale, order="C"),
            propagate=noise.refers_to == "observation",
            time_correlated=noise.time_correlated,
        )
        if disparity_prior is not None:
            points = points.given(disparity_prior)
        curr_unbiased = np.subtract(curr_px, noise.bias, order="C")
        # Correct u_r for the known error of the measured disparity d = u_l − u_r.
        curr_unbiased[:, 2] += points.error
        intrinsics = Intrinsics.of(camera)
        jitter = None
        if jitter_priors is not None:
            jitter = JitterUnknown.of(
                prev_px,
                curr_unbiased,
                points,
                jitter_priors=jitter_priors,
                prior=disparity_prior,
                camera=intrinsics,
                frame=poses.curr.frame,
            )
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
            camera=intrinsics,
            poses=poses,
            propagated_noise=_not_yet_propagated(points.point),
            jitter=jitter,
        )

    def __len__(self) -> int:
        """Return the number of features, N."""
        return len(self.pairs.curr)

    @property
    def variables(self) -> tuple[Variable, ...]:
        """The poses of both frames, or only the current one; then the jitter, if there is one."""
        curr, prev = self.poses
        poses = (curr,) if prev is None else (prev, curr)
        return poses if self.jitter is None else (*poses, self.jitter.variable)

    def _curr(self, values: Values) -> FloatArray:
        """Return the current observations, corrected for the jitter at these values, [N, 4]."""
        if self.jitter is None or self.linearized_jitter is None:
            return self.pairs.curr
        curr = np.empty((len(self), 4))
        subtract_jitter(self.linearized_jitter, values[self.jitter.variable], curr)
        return curr

    def points_at(self, values: Values) -> PointPrior:
        """Return the N points before the solve, corrected for the jitter at these values."""
        if self.jitter is None:
            return self.points
        points = self.points
        # V η°, [N, 4]: it moves (u, v, d, δ).
        offset = self.jitter.effects.sensitivity @ values[self.jitter.variable][JITTER_DIM:]
        return PointPrior(
            point=points.point + offset[:, :3],
            error=points.error + offset[:, 3],
            cov=points.cov,
            gain=points.gain,
        )

    def propagated(self, values: Values) -> StereoObservations:
        """Return the same observations with Σ and the refined points at these poses."""
        T_curr_prev = relative_motion(values, self.poses.curr, self.poses.prev)
        # The loop linearises at the refined points: start from the last call's. On the first call
        # they are the points themselves.
        noise = _not_yet_propagated(self.propagated_noise.refined)
        if self.jitter is None:
            propagate_noise(T_curr_prev, self.camera, self.pairs, noise)
            return replace(self, propagated_noise=noise)
        jitter = LinearizedJitter.empty(len(self))
        propagate_with_jitter(
            Iterate(T_curr_prev, values[self.jitter.variable]),
            self.camera,
            self.pairs,
            effects=self.jitter.effects,
            propagated=noise,
            jitter=jitter,
        )
        return replace(self, propagated_noise=noise, linearized_jitter=jitter)

    def linearize(self, values: Values, *, newton: bool = False) -> Linearization:
        """Return cost and normal equations in one compiled pass."""
        T_curr_prev = relative_motion(values, self.poses.curr, self.poses.prev)
        if self.jitter is None or self.linearized_jitter is None:
            motion = self._motion_equations(T_curr_prev, newton=newton)
        else:
            equations = JitterEquations.empty()
            cost = joint_normal_equations(
                Iterate(T_curr_prev, values[self.jitter.variable]),
                self.camera,
                self.propagated_noise,
                jitter=self.linearized_jitter,
                loss=self.loss_parameters,
                newton=newton,
                equations=equations,
            )
            motion = Linearization(cost, equations.hessian, equations.gradient)
        return motion if self.poses.prev is None else of_both_poses(motion, T_curr_prev)

    def information(self, values: Values) -> FloatArray:
        """Return the Fisher information on the n unknowns, [n, n]."""
        T_curr_prev = relative_motion(values, self.poses.curr, self.poses.prev)
        information = self.at(values).information
        motion = Linearization(0.0, information, np.zeros(len(information)))
        return (motion if self.poses.prev is None else of_both_poses(motion, T_curr_prev)).hessian

    def outcome(self, values: Values) -> Outcome:
        """Return weights and gating of the N residuals."""
        at = self.at(values)
        return Outcome(
            mahalanobis_sq=at.mahalanobis_sq,
            weight=at.weights.relative,
            gated=~at.jacobians.contributes,
        )

    def at(self, values: Values) -> StereoResult:
        """Evaluate residuals, Jacobians, weights and information at these values."""
        T_curr_prev = relative_motion(values, self.poses.curr, self.poses.prev)
        count = len(self)
        jacobians = StereoJacobians(
            residual=np.empty((count, 4)),
            motion=np.empty((count, 4, 6)),
            white=np.empty((count, 4, 6)),
            disparity=np.empty((count, 4)),
            squared=np.empty(count),
            contributes=np.empty(count, dtype=np.bool_),
        )
        residual_jacobians(
            T_curr_prev,
            self.camera,
            self._curr(values),
            propagated=self.propagated_noise,
            out=jacobians,
        )
        # Robust weights, and the sums that the scale of the covariance follows from.
        weights = FeatureWeights(
            weight=np.empty(count), curvature=np.empty(count), relative=np.empty(count)
        )
        scatter, curved = weigh(
            self.loss_parameters, jacobians.squared, jacobians.contributes, weights
        )
        points = self.points_at(values)
        # Information on (ξ, η), scaled to the observed residuals; the jitter's prior is exact, and
        # hence added after.
        hessian, information = self._information(jacobians, weights, points.point[:, 2])
        information /= self._variance_factor(scatter, curved)
        if self.jitter is not None:
            hessian[6:, 6:] += JITTER_PRIOR
            information[6:, 6:] += JITTER_PRIOR
        return StereoResult(
            mahalanobis_sq=jacobians.squared,
            weights=weights,
            jacobians=jacobians,
            hessian=hessian,
            information=information,
            points=points,
        )

    def _motion_equations(self, T_curr_prev: FloatArray, *, newton: bool) -> Linearization:
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
        return Linearization(cost=cost, hessian=system.hessian, gradient=system.gradient)

    def _information(
        self, jacobians: StereoJacobians, weights: FeatureWeights, seen_px: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return Σ w Jᵀ Σ⁻¹ J, and Σ a Jᵀ Σ⁻¹ J without the bias that disparity noise adds to it.

        The columns of J for the translation are proportional to the disparity d. The refined d is
        biased towards the solution, so the observed one is used. Its square is too large by the
        variance σ² of its noise: the true disparity contributes E[d²] − σ². This matters only if
        all disparities are mostly noise; there it distinguishes an unobservable translation from an
        observable one.
        """
        # The columns were formed with the refined disparity d̂: (d/d̂)² − σ²/d̂² is the factor of
        # their square. Where d̂ is zero, so are they, and ∞ makes their shares zero.
        refined = self.propagated_noise.refined[:, 2]
        disparity = np.where(np.abs(refined) > 1e-9, refined, np.inf)
        dof = 6 if self.jitter is None else 6 + JITTER_PAIR_DIM
        hessian = np.empty((dof, dof))
        information = np.empty((dof, dof))
        disparity_share = seen_px / disparity
        sum_information(
            jacobians,
            weights,
            disparity_share,
            disparity_noise_share=self.pairs.point_cov[:, 2, 2] / disparity**2,
            hessian=hessian,
            information=information,
        )
        if self.linearized_jitter is not None:
            jitter_information(
                jacobians,
                weights,
                self.linearized_jitter,
                disparity_share=disparity_share,
                hessian=hessian,
                information=information,
            )
        return hessian, information

    def _variance_factor(self, scatter: float, curved: float) -> float:
        """Return the factor by which the covariance exceeds the inverse of A = Σ a Jᵀ Σ⁻¹ J.

        The covariance of an M-estimate is A⁻¹ B A⁻¹, with a = w + (2/d) w' s, the curvature of the
        loss (over a Student-t its mean is (ν+d)/(ν+d+2); for an outlier it vanishes), and
        B = Σ b Jᵀ Σ⁻¹ J, b = w² s/d, the scatter of its gradient. B is approximated by A times the
        ratio of the sums of b and a: one if the noise model is right, larger if the residuals are.
        The sums start with the a and b that the model expects (``RobustLoss.moments``), as if a few
        features had shown them, so that few features cannot give a tiny covariance by chance.
        """
        count = len(self)
        expected_curvature = expected_scatter = 1.0
        if count:
            # A single feature without a variance would leave least squares without information.
            dof = self.noise.dof
            if self.loss.kind is LossKind.L2:
                dof = np.maximum(dof, MIN_VARIANCE_DOF)
            curvatures, scatters = self.loss.moments(dof)
            expected_curvature = float(curvatures.sum()) / count
            expected_scatter = float(scatters.sum()) / count
        # Σ b over Σ a. Bessel's correction for b: six degrees of freedom were fitted to the
        # residuals; the jitter's have a prior.
        spent = count * DIM / max(count * DIM - 6.0, 1.0)
        seen = EXPECTED_FEATURES * expected_scatter + spent * scatter
        return seen / (EXPECTED_FEATURES * expected_curvature + curved)


@dataclass(frozen=True)
class StereoResult:
    """N stereo observations evaluated at one motion."""

    mahalanobis_sq: FloatArray
    """eᵀ Σ⁻¹ e of each feature, [N]; Σ is the scale of its residual."""
    weights: FeatureWeights
    jacobians: StereoJacobians
    hessian: FloatArray
    """Σ w Jᵀ Σ⁻¹ J with the IRLS weights w, [6, 6], or [12, 12] over (ξ, η) with the jitter's
    prior. Its inverse is not the covariance."""
    information: FloatArray
    """Information on ξ of T_curr_prev, [6, 6], or on (ξ, η), [12, 12]."""
    points: PointPrior
    """The N points before the solve, corrected for the jitter."""


def of_both_poses(motion: Linearization, T_curr_prev: FloatArray) -> Linearization:
    """Turn normal equations over ξ of T_curr_prev into those over (ξ_prev, ξ_curr) of both poses.

    T_curr_prev = T_curr_world T_prev_world⁻¹ moves by ξ = ξ_curr − Ad(T_curr_prev) ξ_prev. Further
    unknowns behind ξ stay behind.
    """
    further = len(motion.gradient) - 6
    # ξ and further unknowns as a linear map of (ξ_prev, ξ_curr, further unknowns).
    lift = np.zeros((6 + further, 12 + further))
    lift[:6, :6] = -se3.adjoint(T_curr_prev)
    lift[:, 6:] = np.eye(6 + further)
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

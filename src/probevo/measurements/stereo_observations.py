"""All stereo observations of a frame as one measurement: the reprojection residuals of PROBE-GK.

The residual of a feature is e = y' − f(T g(y)), with y its observation in the previous frame, y' in
the current one, and T = T_curr_prev. Its scale Σ follows from the noise of both observations
(``stereo_numba.propagate_noise``), and its loss from the tails of that noise (PROBE-GK eq. 14).

Where the noise has an error that all features of a frame share, the rig's jitter ω
(``camera.rig_jitter``), that of both frames is a further unknown, η ~ N(0, I): the jitter of the
current frame moves its right observations, and what is not known of that of the previous frame
moves the points, from which the solve starts: e = y' − f(T g(y)) − D η (``jitter_numba``). The
weights of the features are those after η is estimated, and the covariance of the motion is
marginalised over it. Derivation: docs/conventions.md.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.rig_jitter import jitter_offsets
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
from probevo.measurements.jitter_numba import (
    AXES,
    DOF,
    JitterEquations,
    LinearizedJitter,
    jitter_columns,
    jitter_equations,
    jitter_information,
    without_jitter,
)
from probevo.measurements.point_priors import DisparityPrior, JitterPrior, PointPrior
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
class JitterUnknown:
    """The rig's jitter in both frames as an unknown of the solve: η = (η', η°) ~ N(0, I)."""

    variable: Variable
    """η, [6]."""
    curr_root: FloatArray
    """L', [3, 3], rad: the jitter of the current frame is L' η', with L' L'ᵀ = S."""
    prev: JitterPrior
    """The prior of the jitter of the previous frame, m + L° η°; m is corrected for."""
    basis: FloatArray
    """B = ∂(u_r', v_r')/∂η', [N, 2, 3], px."""
    sensitivity: FloatArray
    """V = ∂(u, v, d, δ)/∂η°, the points of the previous frame, [N, 4, 3], px."""
    columns: FloatArray
    """D = −∂e/∂η where it was last linearised, [N, 4, 6], px."""
    at: FloatArray
    """(0, η°) there, [6]: the points are those at this value."""
    curr: FloatArray
    """y' of these points, with their δ, [N, 4], px."""

    @staticmethod
    def of(
        prev_px: FloatArray,
        curr_px: FloatArray,
        points: PointPrior,
        *,
        cov: FloatArray,
        prior: DisparityPrior | None,
        camera: StereoCamera,
        frame: int,
    ) -> JitterUnknown:
        """Build the unknown.

        Args:
            prev_px: observations of N features in the previous frame, [N, 4], px.
            curr_px: those in the current frame, [N, 4], px.
            points: the points of the former.
            cov: covariance S of the jitter in a frame, [3, 3], rad².
            prior: what earlier frames say of disparities and jitter.
            camera: the rectified camera.
            frame: the index of the current frame.
        """
        curr_root = np.linalg.cholesky(cov).astype(float)
        prev = jitter_before(cov, prior)
        # The observation is the true one plus G ω, and so the true point is that of the
        # observation less K G ω.
        offsets = jitter_offsets(prev_px, camera) @ prev.root
        sensitivity = np.zeros((len(prev_px), 4, AXES))
        sensitivity[:, :3] = -(points.gain[:, :, 2:] @ offsets)
        if prior is not None:
            sensitivity[prior.rows, 2:] = 0.0 if prior.jitter is None else prior.jitter.sensitivity
        return JitterUnknown(
            variable=Variable(kind="jitter", frame=frame),
            curr_root=curr_root,
            prev=prev,
            basis=np.ascontiguousarray(jitter_offsets(curr_px, camera) @ curr_root),
            sensitivity=sensitivity,
            columns=np.zeros((len(prev_px), 4, DOF)),
            at=np.zeros(DOF),
            curr=curr_px,
        )


def jitter_before(cov: FloatArray, prior: DisparityPrior | None) -> JitterPrior:
    """Return the prior of the previous frame's jitter: at least that it is N(0, S)."""
    if prior is not None and prior.jitter is not None:
        return prior.jitter
    root = np.linalg.cholesky(cov).astype(float)
    return JitterPrior(mean=np.zeros(AXES), root=root, sensitivity=np.zeros((0, 2, AXES)))


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
    jitter: JitterUnknown | None = None
    """The rig's jitter; None if the noise has none."""

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
        if noise.jitter_cov is not None:
            before = jitter_before(noise.jitter_cov, disparity_prior)
            prev_px = prev_px.copy()
            prev_px[:, 2:] -= jitter_offsets(prev_px, camera) @ before.mean
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
        jitter = None
        if noise.jitter_cov is not None:
            jitter = JitterUnknown.of(
                prev_px,
                curr_unbiased,
                points,
                cov=noise.jitter_cov,
                prior=disparity_prior,
                camera=camera,
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
            camera=Intrinsics.of(camera),
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
        """Return the current observations less what the jitter at these values moves, [N, 4]."""
        if self.jitter is None:
            return self.pairs.curr
        jitter = self.jitter
        shifted = np.empty_like(jitter.curr)
        change = values[jitter.variable] - jitter.at
        without_jitter(jitter.curr, jitter.columns, change, shifted=shifted)
        return shifted

    def points_at(self, values: Values) -> PointPrior:
        """Return the N points as the jitter at these values moves them, before the solve."""
        if self.jitter is None:
            return self.points
        offset = self.jitter.sensitivity @ values[self.jitter.variable][AXES:]
        return replace(
            self.points,
            point=self.points.point + offset[:, :3],
            error=self.points.error + offset[:, 3],
        )

    def propagated(self, values: Values) -> StereoObservations:
        """Return the same observations with Σ and the refined points at these poses."""
        T_curr_prev = relative_motion(values, self.poses.curr, self.poses.prev)
        # The refined points are where the loop linearises, so that it begins with the last ones.
        noise = _not_yet_propagated(self.propagated_noise.refined)
        if self.jitter is None:
            propagate_noise(T_curr_prev, self.camera, self.pairs, noise)
            return replace(self, propagated_noise=noise)
        eta = values[self.jitter.variable]
        offset = self.jitter.sensitivity @ eta[AXES:]
        curr = self.pairs.curr.copy()
        curr[:, 2] += offset[:, 3]
        unjittered = curr.copy()
        unjittered[:, 2:] -= self.jitter.basis @ eta[:AXES]
        pairs = self.pairs._replace(point=self.pairs.point + offset[:, :3], curr=unjittered)
        propagate_noise(T_curr_prev, self.camera, pairs, noise)
        columns = np.empty_like(self.jitter.columns)
        jitter_columns(
            T_curr_prev,
            self.camera,
            noise.refined,
            basis=self.jitter.basis,
            sensitivity=self.jitter.sensitivity,
            columns=columns,
        )
        at = np.concatenate([np.zeros(AXES), eta[AXES:]])
        jitter = replace(self.jitter, columns=columns, at=at, curr=curr)
        return replace(self, propagated_noise=noise, jitter=jitter)

    def linearize(self, values: Values, *, newton: bool = False) -> Linearization:
        """Return cost and normal equations in one compiled pass."""
        T_curr_prev = relative_motion(values, self.poses.curr, self.poses.prev)
        curr = self._curr(values)
        cost, system = self._normal_equations(T_curr_prev, curr, newton=newton)
        motion = Linearization(cost=cost, hessian=system.hessian, gradient=system.gradient)
        if self.jitter is not None:
            equations = JitterEquations.empty()
            jitter_equations(
                T_curr_prev,
                self.camera,
                curr,
                propagated=self.propagated_noise,
                loss=self.loss_parameters,
                jitter=LinearizedJitter(self.jitter.columns, system.squared, newton),
                equations=equations,
            )
            motion = _with_jitter(motion, equations, values[self.jitter.variable])
        return motion if self.poses.prev is None else of_both_poses(motion, T_curr_prev)

    def information(self, values: Values) -> FloatArray:
        """Return the Fisher information on the n unknowns, [n, n]."""
        T_curr_prev = relative_motion(values, self.poses.curr, self.poses.prev)
        found = self.at(values).information
        motion = Linearization(0.0, found, np.zeros(len(found)))
        return (motion if self.poses.prev is None else of_both_poses(motion, T_curr_prev)).hessian

    def outcome(self, values: Values) -> Outcome:
        """Return what became of the N residuals."""
        at = self.at(values)
        return Outcome(
            squared=at.squared,
            weight=at.weights.relative,
            gated=np.asarray(at.squared >= BEHIND),
        )

    def at(self, values: Values) -> StereoResult:
        """Evaluate everything about the features at these values."""
        T_curr_prev = relative_motion(values, self.poses.curr, self.poses.prev)
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
            self._curr(values),
            propagated=self.propagated_noise,
            out=jacobians,
        )
        weights = FeatureWeights(
            weight=np.empty(count), curvature=np.empty(count), relative=np.empty(count)
        )
        scatter, curved = weigh(self.loss_parameters, jacobians.squared, weights)
        hessian, information = self._information(
            jacobians, weights, self.points_at(values).point[:, 2]
        )
        information = information / self._variance_factor(scatter, curved)
        if self.jitter is not None:
            hessian[6:, 6:] += np.eye(DOF)
            information[6:, 6:] += np.eye(DOF)
        return StereoResult(
            squared=jacobians.squared,
            weights=weights,
            jacobians=jacobians,
            hessian=hessian,
            information=information,
        )

    def _normal_equations(
        self, T_curr_prev: FloatArray, curr: FloatArray, *, newton: bool
    ) -> tuple[float, NormalEquations]:
        system = NormalEquations(
            hessian=np.empty((6, 6)), gradient=np.empty(6), squared=np.empty(len(self))
        )
        cost = normal_equations(
            T_curr_prev,
            self.camera,
            curr,
            propagated=self.propagated_noise,
            loss=self.loss_parameters,
            newton=newton,
            system=system,
        )
        return cost, system

    def _information(
        self, jacobians: StereoJacobians, weights: FeatureWeights, seen_px: FloatArray
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
        disparity_share = seen_px / disparity
        sum_information(
            jacobians,
            weights,
            disparity_share,
            disparity_noise_share=self.pairs.point_cov[:, 2, 2] / disparity**2,
            hessian=hessian,
            information=information,
        )
        if self.jitter is None:
            return hessian, information
        equations = JitterEquations.empty()
        joint = []
        for of_motion, weight, share in (
            (hessian, weights.weight, np.ones(len(self))),
            (information, weights.curvature, disparity_share),
        ):
            jitter_information(
                jacobians.motion,
                self.propagated_noise.information,
                weight,
                columns=self.jitter.columns,
                translation_share=share,
                equations=equations,
            )
            joint.append(_joint(of_motion, equations))
        return joint[0], joint[1]

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
    """Σ w Jᵀ Σ⁻¹ J with the IRLS weights w, [6, 6], or [12, 12] over (ξ, η) with the jitter's
    prior. Its inverse is not the covariance."""
    information: FloatArray
    """Information on ξ of T_curr_prev, [6, 6], or on (ξ, η), [12, 12]."""


def of_both_poses(motion: Linearization, T_curr_prev: FloatArray) -> Linearization:
    """Turn normal equations over ξ of T_curr_prev into those over (ξ_prev, ξ_curr) of both poses.

    T_curr_prev = T_curr_world T_prev_world⁻¹ moves by ξ = ξ_curr − Ad(T_curr_prev) ξ_prev. Further
    unknowns behind ξ stay behind.
    """
    further = len(motion.gradient) - 6
    lift = np.zeros((6 + further, 12 + further))
    lift[:6, :6] = -se3.adjoint(T_curr_prev)
    lift[:, 6:] = np.eye(6 + further)
    return Linearization(
        cost=motion.cost,
        hessian=lift.T @ motion.hessian @ lift,
        gradient=lift.T @ motion.gradient,
    )


def _joint(of_motion: FloatArray, equations: JitterEquations) -> FloatArray:
    """Return the matrix over (ξ, η), [12, 12]."""
    joint = np.empty((6 + DOF, 6 + DOF))
    joint[:6, :6] = of_motion
    joint[:6, 6:] = equations.cross
    joint[6:, :6] = equations.cross.T
    joint[6:, 6:] = equations.hessian
    return joint


def _with_jitter(
    motion: Linearization, equations: JitterEquations, eta: FloatArray
) -> Linearization:
    """Extend normal equations over ξ to those over (ξ, η), the prior of η included."""
    hessian = _joint(motion.hessian, equations)
    hessian[6:, 6:] += np.eye(DOF)
    return Linearization(
        cost=motion.cost + 0.5 * float(eta @ eta),
        hessian=hessian,
        gradient=np.concatenate([motion.gradient, equations.gradient - eta]),
    )


def _not_yet_propagated(refined: FloatArray) -> PropagatedNoise:
    count = len(refined)
    return PropagatedNoise(
        refined=refined.copy(),
        offset=np.zeros((count, 4)),
        information=np.zeros((count, 4, 4)),
        cross_cov=np.zeros((count, 4, 2)),
    )

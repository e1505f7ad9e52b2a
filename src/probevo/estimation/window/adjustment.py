"""Bundle adjustment of a sliding window, and marginalisation of what leaves it.

Given observations y, the window estimates poses and landmarks x and the errors b of the rig, of its
disparities and lenses. It maximises

    log p(x | b, y) + (1/c) log p(y | b) + log p(b).

The errors of neighbouring features are correlated, and consecutive frames repeat them, hence the
tempering of the likelihood of b by 1/c (``CORRELATED_FEATURES``). The information of p(y | b) is
the Schur complement of x in the normal equations. Each solve divides it by c. The marginal prior
stores it undivided, so that nothing is tempered twice.

The jitter of the rig in each frame, ω_k ~ N(0, S), is eliminated from the normal equations once all
landmarks are. When landmarks leave the window, they take what they say of it along, so that the
prior and the landmarks that remain each have a jitter of their own for one and the same frame. If
G groups of landmarks say the same with variances G S, together they say it with S: those that leave
do so with G S.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from probevo.arrays import BoolArray, FloatArray, IntArray
from probevo.camera.image_errors import DISPARITY_SIGMA_PX
from probevo.camera.rig_calibration import (
    CONSTANT_SIGMA_PX,
    CORRELATED_FEATURES,
)
from probevo.camera.stereo import StereoCamera
from probevo.camera.transfer_numba import Intrinsics
from probevo.config import OdometryConfig
from probevo.estimation.window import inertial_steps
from probevo.estimation.window.equations import (
    FRAME,
    JITTER,
    LANDMARK,
    POSE,
    RIG,
    LandmarkElimination,
    RobustNoise,
    WindowEquations,
    WindowGeometry,
    WindowLandmarks,
)
from probevo.estimation.window.further_measurements import (
    linearized_measurements,
    with_dead_reckoning_in_prior,
)
from probevo.estimation.window.inertial import Inertial
from probevo.estimation.window.inertial_equations import InertialSystem
from probevo.estimation.window.jitter_elimination import (
    JitterElimination,
    eliminate_jitter,
    jitter_columns,
)
from probevo.estimation.window.marginalization import (
    kept_positive,
    pose_covariance,
    without_poses,
)
from probevo.estimation.window.new_frame import first_states
from probevo.estimation.window.normal_equations_numba import (
    accumulate,
    move_landmarks,
    static_weights,
)
from probevo.estimation.window.window import MarginalPrior, Window, selected
from probevo.geometry import se3
from probevo.measurements.robust_loss import RobustLoss

LENS_SIGMA = 0.02
"""Prior standard deviation of k₁: what is seen 45° from the axis moves by 2 % of the focal
length."""
RIG_SIGMA = np.array([CONSTANT_SIGMA_PX, *DISPARITY_SIGMA_PX, LENS_SIGMA])
"""Prior standard deviation of b₀, b₁ and b₂, px, and k₁."""
FLAWLESS = 1e-6
"""Factor of these standard deviations without self-calibration: a rig that is taken as calibrated
has the same states, which the prior holds at zero."""
CONVERGED_BELOW = 0.1
"""A step after which further ones would lower the cost by less than this, in nats, is the last."""
MIN_DAMPING = 1e-4
"""Share of its diagonal that is first added to the Hessian, after a step that raised the cost."""
COST_TOLERANCE = 1.0
"""Nats by which a step may raise the cost."""


@dataclass(frozen=True)
class _System:
    """The normal equations of a window at its current values."""

    window: Window
    cost: float
    equations: WindowEquations
    elimination: LandmarkElimination
    jitter: JitterElimination
    inertial: InertialSystem | None


class WindowAdjustment:
    """Adjusts the frames of a window together, and marginalises the oldest.

    Args:
        camera: the rectified camera.
        config: settings of window, loss and self-calibration.
    """

    def __init__(self, camera: StereoCamera, config: OdometryConfig) -> None:
        self._camera = camera
        self._max_iterations = config.window.max_iterations
        loss = RobustLoss.named(config.solver.loss)
        self._noise = RobustNoise(loss=int(loss.kind), correlation=config.window.correlation)
        rig_sigma = RIG_SIGMA if config.self_calibration else FLAWLESS * RIG_SIGMA
        self._rig_information = np.diag(rig_sigma**-2.0)
        self._intrinsics = Intrinsics.of(camera)

    def adjusted(self, window: Window) -> Window:
        """Minimise the cost over poses, rig and landmarks by Levenberg–Marquardt, with the Fisher
        information of the robust loss as the Hessian.

        The increments descend the tempered cost, but are accepted by the untempered one. One may
        therefore raise that by what its own quadratic model predicts.
        """
        # Which landmarks seem to move by themselves is decided before, so that the cost to minimise
        # is one and the same in all iterations.
        window = self._with_static_weights(window)
        # It is plain Gauss–Newton until an increment has raised the cost. ``candidate`` is the
        # window to return; it is ahead of ``system`` only after the last, small increment.
        system = self._system(window)
        candidate = window
        damping = 0.0
        prev_decrease = 0.0
        for _ in range(self._max_iterations):
            increment, decrease = self._increment(system, damping)
            candidate = self._incremented(system, increment)
            # Where decreases shrink by a factor from one to the next, those to come add up to this.
            remaining = decrease
            if prev_decrease > 0.0:
                remaining = decrease * min(1.0, decrease / prev_decrease)
            prev_decrease = decrease
            if damping == 0.0 and remaining < CONVERGED_BELOW:
                # Cost and curvature hardly change any more, and need not be formed again.
                break
            # Accept, and damp less, or go back, and damp more.
            candidate_system = self._system(candidate)
            hessian, gradient = system.equations
            predicted_rise = max(0.0, float(increment @ (0.5 * hessian @ increment - gradient)))
            if candidate_system.cost <= system.cost + predicted_rise + COST_TOLERANCE:
                system = candidate_system
                damping = 0.1 * damping if damping > MIN_DAMPING else 0.0
            else:
                damping = max(MIN_DAMPING, 10.0 * damping)
                candidate = system.window
        # The covariance is that of the last equations formed, at most that small increment before.
        cov, cov_of_motions = self._covariances(system.equations.hessian)
        inertial = candidate.inertial.with_covariance(system.inertial, cov)
        return replace(candidate, cov=cov, cov_of_motions=cov_of_motions, inertial=inertial)

    def disparities(self, window: Window, ids: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return the disparities of landmarks in their anchor frames, [N], px, and their variances
        for given poses, [N], px².

        Args:
            window: K frames.
            ids: identities of N landmarks that the newest of them sees.
        """
        rows = window.rows_seen_last(ids, len(window) - 1)
        variances = self._system(window).elimination.inverse[:, 2, 2]
        return window.landmarks.state[rows, 2], variances[rows]

    def without_oldest(self, window: Window) -> Window:
        """Return the window without its oldest frame, whose information goes into the prior.

        With the frame go the landmarks that it saw. Those that the last frame still sees begin
        anew with their last observation, which ends the one landmark and begins the next, as it
        does in a chain of motions of two frames. Without it, nothing would connect the last two
        frames where all landmarks are of one age.
        """
        is_first = np.arange(len(window)) == 0
        window = with_dead_reckoning_in_prior(window, is_first)
        observations = window.observations
        rows = window.landmark_rows
        # Which landmarks leave, and which of them begin anew.
        # Landmarks of the oldest frame are anchored in it, and leave with all their observations.
        is_old = observations.slot[observations.start[:-1]] == 0
        is_alive = is_old & (window.last_seen == len(window) - 1)
        is_last = np.zeros(len(rows), np.bool_)
        is_last[observations.start[1:] - 1] = True
        begins_anew = is_last & is_alive[rows]  # of which that observation stays, too
        # G of those that share a frame's jitter: the effective number of ages, (Σ n)²/Σ n². A
        # frame's observations of one age have the same anchor frame, and so leave at the same time.
        seen_at_age = np.bincount(window.age, minlength=1)
        groups = max(1.0, seen_at_age.sum() ** 2 / max(1, (seen_at_age**2).sum()))
        # The normal equations of these landmarks and the prior alone, without the dead reckoning of
        # other frames, and without the IMU, whose first factor is marginalised with them below.
        system = self._system(
            replace(
                window,
                observations=selected(observations, is_old[rows]),
                landmarks=_selected_landmarks(window.landmarks, is_old),
                jitter_cov=groups * window.jitter_cov,
                dead_reckoning=(),
                inertial=Inertial.none(),
            )
        )
        # At the offsets x, gradient = η − Λ x of the new prior, so that η = gradient + Λ x. The
        # system has the old prior in it already.
        information = system.equations.hessian
        vector = system.equations.gradient + information @ window.offsets()
        # With inertial states, pose, velocity and biases of the frame are marginalised in one
        # block: the IMU's factor correlates them.
        remaining = window.without_frames(is_first)
        marginalised = inertial_steps.marginalize_first_frame(window, system.equations)
        if marginalised is None:
            prior = without_poses(MarginalPrior(information, vector), is_first)
        else:
            prior, states = marginalised
            remaining = replace(remaining, inertial=replace(remaining.inertial, states=states))
        # The landmarks that begin anew are those of their last observation by itself.
        state = window.landmarks.state.copy()
        last_px = observations.pixels[observations.start[1:] - 1]
        state[is_alive] = first_states(last_px[is_alive], window.rig_errors, self._camera)
        stays = ~is_old | is_alive
        kept = selected(observations, ~is_old[rows] | begins_anew)
        return replace(
            remaining,
            prior=kept_positive(prior),
            ids=window.ids[stays],
            landmarks=_selected_landmarks(window.landmarks._replace(state=state), stays),
            observations=kept._replace(slot=kept.slot - 1),
        )

    def _with_static_weights(self, window: Window) -> Window:
        """Return the window with each landmark tested for a motion of its own."""
        static_weight = static_weights(
            self._geometry(window), window.observations, window.landmarks, self._noise
        )
        return replace(window, landmarks=window.landmarks._replace(static_weight=static_weight))

    def _geometry(self, window: Window) -> WindowGeometry:
        return WindowGeometry(
            T_cam_world=window.T_cam_world,
            T_linear=window.T_linear,
            jitter=window.jitter,
            rig_errors=window.rig_errors,
            camera=self._intrinsics,
        )

    def _system(self, window: Window) -> _System:
        """Form the normal equations of a window, its prior and dead reckoning included."""
        num_frames = len(window)
        size = FRAME * num_frames + RIG
        num_observations = len(window.observations.slot)
        num_landmarks = len(window.landmarks.state)
        # The prior ½ xᵀ Λ x − ηᵀ x has the gradient η − Λ x towards its optimum, and is itself
        # −½ xᵀ (η + η − Λ x).
        x = window.offsets()
        towards_prior = window.prior.vector - window.prior.information @ x
        equations = WindowEquations(hessian=np.zeros((size, size)), gradient=np.zeros(size))
        elimination = LandmarkElimination(
            coupling=np.empty((num_observations, LANDMARK, FRAME)),
            rig_coupling=np.empty((num_landmarks, LANDMARK, RIG)),
            inverse=np.empty((num_landmarks, LANDMARK, LANDMARK)),
            gradient=np.empty((num_landmarks, LANDMARK)),
        )
        # The features first: landmarks are eliminated while their equations are summed.
        cost = accumulate(
            self._geometry(window),
            window.observations,
            window.landmarks,
            noise=self._noise,
            equations=equations,
            elimination=elimination,
        )
        # Eliminate the jitters; what remains are equations of poses and rig, [6K + 4].
        reduced, jitter, jitter_cost = eliminate_jitter(window, equations)
        cost += jitter_cost - 0.5 * float(x @ (window.prior.vector + towards_prior))
        hessian = reduced.hessian + window.prior.information
        gradient = reduced.gradient + towards_prior
        for joint, linear in linearized_measurements(window, window.dead_reckoning):
            cost += linear.cost
            hessian[np.ix_(joint, joint)] += linear.hessian
            gradient[joint] += linear.gradient
        inertial_system = inertial_steps.system_of(window)
        if inertial_system is not None:  # its velocities, biases and gravity are eliminated, too
            imu_hessian, imu_gradient = inertial_system.reduced()
            cost += inertial_system.cost
            hessian += imu_hessian
            gradient += imu_gradient
        return _System(
            window=window,
            cost=cost,
            equations=WindowEquations(hessian=hessian, gradient=gradient),
            elimination=elimination,
            jitter=jitter,
            inertial=inertial_system,
        )

    def _increment(self, system: _System, damping: float) -> tuple[FloatArray, float]:
        """Solve for the increment of poses and rig, [6K + 4], with tempered information about the
        rig.

        Returns:
            The increment, and its product with the gradient that it follows, the tempered one:
            about twice the decrease of the tempered cost.
        """
        hessian, gradient = system.equations
        poses = slice(None, -RIG)
        rig = slice(-RIG, None)
        # H_pp⁻¹ (H_pr, g_p), damped by a share of the diagonal of H_pp (Marquardt's scaling).
        damped = hessian[poses, poses] + damping * np.diag(np.diagonal(hessian)[poses])
        right_hand_sides = np.column_stack([hessian[poses, rig], gradient[poses]])
        try:
            solved = np.linalg.solve(damped, right_hand_sides)
        except np.linalg.LinAlgError:
            solved = pose_covariance(damped).world_cov @ right_hand_sides
        # The rig first, by the Schur complement S = H_rr − H_rp H_pp⁻¹ H_pr, tempered by 1/c: with
        # its prior information Λ, (Λ + S/c) δr = (g_r − H_rp H_pp⁻¹ g_p)/c − Λ r. Then the poses
        # for it, δp = H_pp⁻¹ (g_p − H_pr δr).
        gain = solved[:, :RIG]
        rig_information = hessian[rig, rig] - hessian[rig, poses] @ gain
        rig_gradient = gradient[rig] - gain.T @ gradient[poses]
        tempered = (
            rig_gradient / CORRELATED_FEATURES - self._rig_information @ system.window.rig_errors
        )
        rig_increment = self._rig_covariance(rig_information) @ tempered
        decrease = gradient[poses] @ solved[:, RIG] + rig_increment @ tempered
        pose_increment = solved[:, RIG] - gain @ rig_increment
        return np.concatenate([pose_increment, rig_increment]), float(decrease)

    def _covariances(self, hessian: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the joint covariance of poses and rig, and the one for motions between the poses.

        Both are [6K + 4, 6K + 4]; the rig's is tempered.
        """
        poses = slice(None, -RIG)
        world_cov, motion_cov = pose_covariance(hessian[poses, poses])
        cov = self._with_rig(world_cov, hessian)
        # They are the same unless the position in the world is as good as unknown.
        return cov, cov if motion_cov is world_cov else self._with_rig(motion_cov, hessian)

    def _with_rig(self, pose_cov: FloatArray, hessian: FloatArray) -> FloatArray:
        """Return the joint covariance of poses and rig, [6K + 4, 6K + 4].

        Args:
            pose_cov: covariance of the poses for a rig that is known exactly, [6K, 6K].
            hessian: of poses and rig, [6K + 4, 6K + 4].
        """
        poses = slice(None, -RIG)
        rig = slice(-RIG, None)
        # The inverse by blocks: with the gain G = H_pp⁻¹ H_pr and the tempered covariance Σ_rr of
        # the rig, Σ_pp = H_pp⁻¹ + G Σ_rr Gᵀ and Σ_pr = −G Σ_rr.
        gain = pose_cov @ hessian[poses, rig]
        information = hessian[rig, rig] - hessian[rig, poses] @ gain
        rig_cov = self._rig_covariance(information)
        cov = np.empty_like(hessian)
        cov[poses, poses] = pose_cov + gain @ rig_cov @ gain.T
        cov[poses, rig] = -gain @ rig_cov
        cov[rig, poses] = cov[poses, rig].T
        cov[rig, rig] = rig_cov
        return cov

    def _rig_covariance(self, information: FloatArray) -> FloatArray:
        """Return (Λ + S/c)⁻¹ for the information S about the rig, [4, 4], and its prior's, Λ.

        No observation makes the rig less certain than the prior. Where the window knows next to
        nothing of its position, rounding may leave an S that is negative.
        """
        # In units of the prior's standard deviations, Λ is the identity.
        sigma = np.diagonal(self._rig_information) ** -0.5
        scaled = sigma[:, None] * information * sigma / CORRELATED_FEATURES
        values, directions = np.linalg.eigh(scaled)
        directions = sigma[:, None] * directions
        return np.asarray(directions / (1.0 + np.maximum(values, 0.0)) @ directions.T)

    def _incremented(self, system: _System, increment: FloatArray) -> Window:
        """Return the window after an increment of poses and rig; the landmarks follow."""
        window = system.window
        # Back-substitution in the reverse order of the elimination: jitters, then landmarks.
        jitter_increment = system.jitter.offset - system.jitter.gain @ increment
        at_jitter, at_others = jitter_columns(len(window))
        full_increment = np.empty(FRAME * len(window) + RIG)
        full_increment[at_jitter] = jitter_increment
        full_increment[at_others] = increment
        state = np.empty_like(window.landmarks.state)
        move_landmarks(
            window.landmarks.state, window.observations, system.elimination, full_increment, state
        )
        # T ← Exp(ξ) T for each pose.
        T_cam_world = se3.exp(increment[:-RIG].reshape(-1, POSE)) @ window.T_cam_world
        # First-estimates Jacobians: a pose in the prior keeps its linearisation point. One of which
        # the prior says nothing yet may be linearised where it is.
        known = np.diagonal(window.prior.information)[:-RIG].reshape(-1, POSE)
        is_fixed = known.max(axis=1) > 0.0
        return replace(
            window,
            T_cam_world=T_cam_world,
            T_linear=np.where(is_fixed[:, None, None], window.T_linear, T_cam_world),
            rig_errors=window.rig_errors + increment[-RIG:],
            jitter=window.jitter + jitter_increment.reshape(-1, JITTER),
            inertial=window.inertial.after_increment(system.inertial, increment),
            landmarks=window.landmarks._replace(state=state),
        )


def _selected_landmarks(landmarks: WindowLandmarks, keep: BoolArray) -> WindowLandmarks:
    return WindowLandmarks(
        state=landmarks.state[keep],
        error_information=landmarks.error_information[keep],
        static_weight=landmarks.static_weight[keep],
        bias=landmarks.bias[keep],
    )

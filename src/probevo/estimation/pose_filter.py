"""The pose in the world with its covariance: motions compounded, and measurements of the pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from probevo.arrays import FloatArray
from probevo.estimation import levenberg_marquardt
from probevo.estimation.motion_estimate import COMMON_MODE_COLUMNS, MotionEstimate
from probevo.estimation.scaled_inverse import scaled_inverse
from probevo.geometry import se3
from probevo.measurements.base import Measurement
from probevo.measurements.north import NORTH
from probevo.measurements.pose_prior import PosePrior
from probevo.measurements.variables import Values, Variable
from probevo.measurements.vector_measurement import VectorMeasurement

MIN_SIGMA = np.array([1e-6, 1e-6, 1e-6, 1e-8, 1e-8, 1e-8])
"""Standard deviation to which the first pose is known, m and rad: it is the world's origin by
definition, but a prior needs a covariance that can be inverted."""
POSE = 6
HEADING_KNOWN_FROM_RAD = 0.5
"""Standard deviation of the first camera's heading below which a measurement may be linearised at
its mean."""
HEADINGS = 8
"""Number of headings from which the update starts if the heading is unknown."""


@dataclass(frozen=True)
class FurtherState:
    """A vector that is estimated with the pose, such as the heading of the first camera."""

    variable: Variable
    value: FloatArray
    """[n]."""


@dataclass(frozen=True)
class UncorrectedPath:
    """The pose as it would be without the measurements that have corrected it.

    Its error is w. How the error of a step depends on that of the path before it is known for this
    path (``MotionEstimate.path_cross_cov``). Corrected pose and further states have the error
    K w + n, where n is independent of w and of the steps to come.
    """

    pose: PoseFilter
    gain: FloatArray
    """K, [6 + n, 6]."""

    def advanced(self, motion: MotionEstimate) -> tuple[UncorrectedPath, FloatArray]:
        """Return the path after a step, and the cross-covariance of corrected pose and further
        states, moved by the step, with its error ε, [6 + n, 6]."""
        adjoint = se3.adjoint(motion.T_curr_prev)
        moved = self.gain.copy()
        moved[:POSE] = adjoint @ moved[:POSE]
        moved = moved @ se3.adjoint(se3.inverse(motion.T_curr_prev))
        cross_cov = moved @ motion.path_cross_cov
        # With the step, w becomes w⁺ = Ad w + ε, and the error of the corrected pose K' w⁺ + (1 −
        # K') ε + n: regress ε on w⁺.
        pose = self.pose.advanced(motion)
        with_path = (
            motion.own_cov
            + motion.path_cross_cov.T
            + motion.common_mode @ pose.common_mode[:POSE].T
        )
        step_share = with_path @ scaled_inverse(pose.cov + np.diag(MIN_SIGMA**2))
        step_weight = np.eye(len(moved), POSE) - moved
        return UncorrectedPath(pose, moved + step_weight @ step_share), cross_cov


@dataclass(frozen=True)
class PoseFilter:
    """A Gaussian estimate of the pose of the current camera; the world is the first camera.

    Further states are estimated jointly with the pose. They are constant in time, and follow the
    pose in the joint covariance of 6 + n dimensions.
    """

    T_world_cam: FloatArray
    """[4, 4], m."""
    own_cov: FloatArray
    """Covariance of the left perturbation ξ = [ρ; φ] of T_cam_world, and of the further states,
    without the common-mode part, [6 + n, 6 + n], m and rad."""
    common_mode: FloatArray
    """∂(pose, further states)/∂(common-mode errors), [6 + n, COMMON_MODE_COLUMNS]; those of all
    steps add up."""
    uncorrected: UncorrectedPath | None = None
    """The pose without corrections; None if no measurement of the pose has corrected it."""
    further: tuple[FurtherState, ...] = ()

    @staticmethod
    def at_origin() -> PoseFilter:
        """Return the pose of the first camera."""
        return PoseFilter(
            T_world_cam=np.eye(4),
            own_cov=np.zeros((6, 6)),
            common_mode=np.zeros((6, COMMON_MODE_COLUMNS)),
        )

    @property
    def is_corrected(self) -> bool:
        """Whether a measurement of the pose has corrected it."""
        return self.uncorrected is not None

    @property
    def joint_cov(self) -> FloatArray:
        """Covariance of the pose and the further states, [6 + n, 6 + n]."""
        return self.own_cov + self.common_mode @ self.common_mode.T

    @property
    def cov(self) -> FloatArray:
        """Covariance of the left perturbation ξ of T_cam_world, [6, 6], m and rad."""
        return self.joint_cov[:POSE, :POSE]

    def slice_of(self, variable: Variable) -> slice | None:
        """Return where a further state is in the joint covariance; None if there is none."""
        start = POSE
        for state in self.further:
            stop = start + len(state.value)
            if state.variable == variable:
                return slice(start, stop)
            start = stop
        return None

    def values(self, pose: Variable) -> Values:
        """Return the estimates by their variables, that of the pose being ``pose``."""
        found = {pose: se3.inverse(self.T_world_cam)}
        return found | {state.variable: state.value for state in self.further}

    def with_state(self, variable: Variable, value: FloatArray, cov: FloatArray) -> PoseFilter:
        """Return the filter with one more state, [n], with this prior and independent of all
        else."""
        before = len(self.own_cov)
        size = before + len(value)
        own_cov = np.zeros((size, size))
        own_cov[:before, :before] = self.own_cov
        own_cov[before:, before:] = cov
        uncorrected = self.uncorrected
        if uncorrected is not None:
            gain = np.vstack([uncorrected.gain, np.zeros((len(value), POSE))])
            uncorrected = replace(uncorrected, gain=gain)
        return replace(
            self,
            own_cov=own_cov,
            uncorrected=uncorrected,
            common_mode=np.vstack([self.common_mode, np.zeros((len(value), COMMON_MODE_COLUMNS))]),
            further=(*self.further, FurtherState(variable, value)),
        )

    def moved_to(self, pose: PoseFilter) -> PoseFilter:
        """Return the filter with another estimate of the pose, on which the further states do not
        depend."""
        own_cov = self.own_cov.copy()
        own_cov[:POSE, :POSE] = pose.own_cov
        common_mode = self.common_mode.copy()
        common_mode[:POSE] = pose.common_mode
        return replace(self, T_world_cam=pose.T_world_cam, own_cov=own_cov, common_mode=common_mode)

    def after(self, motion: MotionEstimate, in_window: PoseFilter | None) -> PoseFilter:
        """Return the pose after a step.

        As long as no sensor has corrected it, it is the window's own; without a window, or once
        corrected, the motion is added to it.

        Args:
            motion: the step.
            in_window: the pose after it by the window; None for the two-frame estimator.
        """
        if in_window is None or self.is_corrected:
            return self.advanced(motion)
        return self.moved_to(in_window)

    def advanced(self, motion: MotionEstimate) -> PoseFilter:
        """Return the pose after a step: P = Ad P Adᵀ + cov + X + Xᵀ, X the cross-covariance."""
        # T_curr_world = T_curr_prev T_prev_world: a left perturbation ξ of the pose before becomes
        # Ad ξ, and that of the motion is added. Further states do not move.
        adjoint = np.eye(len(self.own_cov))
        adjoint[:POSE, :POSE] = se3.adjoint(motion.T_curr_prev)
        # Common-mode errors are the same in all steps, so their roots add up, not their
        # covariances: the error grows with the length of the path, not with its square root.
        own_cov = adjoint @ self.own_cov @ adjoint.T
        own_cov[:POSE, :POSE] += motion.own_cov
        uncorrected = self.uncorrected
        if uncorrected is None:
            own_cov[:POSE, :POSE] += motion.path_cross_cov + motion.path_cross_cov.T
        else:
            uncorrected, cross_cov = uncorrected.advanced(motion)
            own_cov[:, :POSE] += cross_cov
            own_cov[:POSE] += cross_cov.T
        common_mode = adjoint @ self.common_mode
        common_mode[:POSE] += motion.common_mode
        return replace(
            self,
            T_world_cam=self.T_world_cam @ se3.inverse(motion.T_curr_prev),
            own_cov=own_cov,
            common_mode=common_mode,
            uncorrected=uncorrected,
        )

    @property
    def knows_heading(self) -> bool:
        """Whether measurements relative to north may be linearised: their heading is known."""
        at = self.slice_of(NORTH)
        if at is None:
            return True
        return bool(self.joint_cov[at, at][2, 2] < HEADING_KNOWN_FROM_RAD**2)

    def innovation(
        self, measurement: VectorMeasurement, pose: Variable
    ) -> tuple[FloatArray, FloatArray]:
        """Return what is measured minus what is predicted, [d], and its covariance, [d, d]."""
        values = self.values(pose)
        # J over pose and further states; an innovation has the covariance J P Jᵀ + R. A variable
        # that the filter does not hold has no columns, as if it were known.
        columns = np.zeros((len(measurement.covariance), len(self.own_cov)))
        for variable, jacobian in zip(
            measurement.variables, measurement.jacobians(values), strict=True
        ):
            at = slice(0, POSE) if variable == pose else self.slice_of(variable)
            if at is not None:
                columns[:, at] = jacobian
        covariance = columns @ self.joint_cov @ columns.T + measurement.covariance
        return measurement.residual(values), covariance

    def updated(self, measurements: Sequence[Measurement], pose: Variable) -> PoseFilter:
        """Return the pose given measurements of it: one Gauss–Newton solve with this as prior.

        With Λ the measurements' information, P⁺ = (P⁻¹ + Λ)⁻¹, and an error ξ before is A ξ after,
        A = P⁺ P⁻¹. So the common-mode part shrinks by A, and the rest of P⁺ is the pose's own.

        Where the heading of the first camera is unknown, the solve starts from several.
        """
        if not measurements:
            return self
        # The prior: this estimate, common-mode part included, regularised, since the first pose is
        # known exactly.
        prior_cov = self.joint_cov
        prior_cov[range(POSE), range(POSE)] += MIN_SIGMA**2
        T_cam_world = se3.inverse(self.T_world_cam)
        prior: VectorMeasurement
        if self.further:
            prior = _JointPrior(pose, T_cam_world, self.further, prior_cov)
        else:
            prior = PosePrior(pose, T_cam_world, prior_cov)
        # Solve, from several headings if it is unknown, and take the least cost.
        free = prior.variables
        found = [
            levenberg_marquardt.minimize([prior, *measurements], start, free)
            for start in self._starts(pose)
        ]
        optimum = found[0] if len(found) == 1 else min(found, key=_cost)
        # The posterior, split again into the common-mode part and the rest.
        information = levenberg_marquardt.information(optimum.measurements, optimum.values, free)
        cov = scaled_inverse(information)
        # s⁺ = A s with A = P⁺ P⁻¹; of P⁺, what is not s⁺ s⁺ᵀ is the pose's own.
        A = cov @ scaled_inverse(prior_cov)
        common_mode = A @ self.common_mode
        before = self.uncorrected or UncorrectedPath(
            self._without_further_states(), gain=np.eye(len(prior_cov), POSE)
        )
        return PoseFilter(
            T_world_cam=se3.inverse(optimum.values[pose]),
            own_cov=cov - common_mode @ common_mode.T,
            common_mode=common_mode,
            uncorrected=replace(before, gain=A @ before.gain),
            further=tuple(
                replace(state, value=optimum.values[state.variable]) for state in self.further
            ),
        )

    def _without_further_states(self) -> PoseFilter:
        """Return the filter without further states."""
        return PoseFilter(
            T_world_cam=self.T_world_cam,
            own_cov=self.own_cov[:POSE, :POSE],
            common_mode=self.common_mode[:POSE],
        )

    def _starts(self, pose: Variable) -> list[Values]:
        """Return where to start: at the estimate, and with other headings if none is known."""
        values = self.values(pose)
        if self.knows_heading:
            return [values]
        turns = np.linspace(0.0, 2.0 * np.pi, HEADINGS, endpoint=False)
        return [{**values, NORTH: values[NORTH] + np.array([0.0, 0.0, turn])} for turn in turns]


class _JointPrior(VectorMeasurement):
    """A Gaussian prior on a pose and further states, with all cross-covariances.

    Args:
        pose: the variable.
        T_cam_world: its mean, [4, 4].
        further: the other states with their means, n numbers in all.
        covariance: joint, [6 + n, 6 + n], the pose first.
    """

    def __init__(
        self,
        pose: Variable,
        T_cam_world: FloatArray,
        further: tuple[FurtherState, ...],
        covariance: FloatArray,
    ) -> None:
        super().__init__(0.5 * (covariance + covariance.T))
        self._information = scaled_inverse(self.covariance)
        self._pose_prior = PosePrior(pose, T_cam_world, np.eye(POSE))
        self.further = further

    @property
    def variables(self) -> tuple[Variable, ...]:
        """The pose, and the others."""
        return (*self._pose_prior.variables, *(state.variable for state in self.further))

    def residual(self, values: Values) -> FloatArray:
        """Return mean minus value of each, [6 + n]."""
        others = [state.value - values[state.variable] for state in self.further]
        return np.concatenate([self._pose_prior.residual(values), *others])

    def jacobians(self, values: Values) -> tuple[FloatArray, ...]:
        """Return ∂e/∂ξ of the pose, see ``PosePrior``, and −1 for the others."""
        # One [6 + n, ·] for each variable, whose own rows alone are not zero.
        size = len(self.covariance)
        pose_rows = np.zeros((size, POSE))
        pose_rows[:POSE] = self._pose_prior.jacobians(values)[0]
        found = [pose_rows]
        start = POSE
        for state in self.further:
            stop = start + len(state.value)
            column = np.zeros((size, stop - start))
            column[start:stop] = -np.eye(stop - start)
            found.append(column)
            start = stop
        return tuple(found)


def _cost(optimum: levenberg_marquardt.Optimum) -> float:
    """Return the cost of all measurements where a solve ended."""
    return sum(one.linearize(optimum.values).cost for one in optimum.measurements)

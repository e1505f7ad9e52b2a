"""A velocity that stays the same over two successive motions, but for a random acceleration."""

from __future__ import annotations

from probevo.arrays import FloatArray
from probevo.geometry import se3
from probevo.measurements.relative_pose import RelativePose
from probevo.measurements.variables import Values, Variable
from probevo.measurements.vector_measurement import VectorMeasurement


class ConstantVelocity(VectorMeasurement):
    """Equal velocities of the steps a → b and b → c: ξ = Log(T_cb Exp(s Log T_ba)⁻¹) ~ N(0,
    covariance), with s the ratio of their durations.

    Unlike a dead-reckoned motion it depends on the estimate of the step before, so that steps that
    follow each other do not count the same velocity twice.

    Args:
        before: pose of a.
        prev: pose of b.
        curr: pose of c.
        duration_ratio: s, the duration of b → c divided by the duration of a → b.
        covariance: of ξ, [6, 6], m and rad.
    """

    def __init__(
        self,
        before: Variable,
        prev: Variable,
        curr: Variable,
        *,
        duration_ratio: float,
        covariance: FloatArray,
    ) -> None:
        super().__init__(covariance, dim=6)
        self.before = before
        self.prev = prev
        self.curr = curr
        self.duration_ratio = duration_ratio

    @property
    def variables(self) -> tuple[Variable, ...]:
        """The three poses."""
        return (self.before, self.prev, self.curr)

    @property
    def prev_frame(self) -> int:
        """Index of the frame where the motion starts."""
        return self.prev.frame

    def expected(self, values: Values) -> FloatArray:
        """Return the motion T_cb by the step before, Exp(s Log T_ba), [4, 4]."""
        last_motion = se3.log(values[self.prev] @ se3.inverse(values[self.before]))
        return se3.exp(self.duration_ratio * last_motion)

    def from_prev(self, values: Values, last_motion_cov: FloatArray) -> RelativePose:
        """Return the expected motion with its covariance, as if it were independent of the step
        before.

        Args:
            values: the poses of that step.
            last_motion_cov: covariance of its motion, [6, 6].
        """
        # Far from the world's origin, rounding leaves the difference of two poses unsymmetric.
        symmetric_cov = 0.5 * (last_motion_cov + last_motion_cov.T)
        cov = self.covariance + self.duration_ratio**2 * symmetric_cov
        return RelativePose(self.expected(values), cov, curr=self.curr, prev=self.prev)

    def residual(self, values: Values) -> FloatArray:
        """Return −Log(T_cb Exp(s Log T_ba)⁻¹), [6]."""
        T_curr_prev = values[self.curr] @ se3.inverse(values[self.prev])
        return -se3.log(T_curr_prev @ se3.inverse(self.expected(values)))

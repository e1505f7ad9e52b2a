"""What all measurements of the motion between two frames have in common."""

from __future__ import annotations

from probevo.arrays import FloatArray
from probevo.geometry import se3
from probevo.measurements.variables import Values, Variable
from probevo.measurements.vector_measurement import VectorMeasurement


class RelativeMeasurement(VectorMeasurement):
    """A measurement that depends on the motion T_curr_prev between two frames only.

    Args:
        covariance: of its residual, [d, d].
        curr: pose of the current frame.
        prev: pose of the previous frame; None if the world of the poses is the previous camera.
        dim: d, where a subclass knows it.

    Raises:
        InputError: the covariance is not symmetric positive definite, or not [d, d].
    """

    def __init__(
        self,
        covariance: FloatArray,
        curr: Variable,
        prev: Variable | None = None,
        *,
        dim: int | None = None,
    ) -> None:
        super().__init__(covariance, dim=dim)
        self.curr = curr
        self.prev = prev

    @property
    def variables(self) -> tuple[Variable, ...]:
        """The poses of both frames, or only the current one."""
        return (self.curr,) if self.prev is None else (self.prev, self.curr)

    @property
    def prev_frame(self) -> int:
        """Index of the frame where the motion starts.

        Raises:
            ValueError: the world of the poses is the previous camera.
        """
        if self.prev is None:
            raise ValueError("the measurement has no previous pose")
        return self.prev.frame

    def motion(self, values: Values) -> FloatArray:
        """Return T_curr_prev at these values, [4, 4]."""
        return relative_motion(values, self.curr, self.prev)


def relative_motion(values: Values, curr: Variable, prev: Variable | None) -> FloatArray:
    """Return T_curr_prev, [4, 4]; without ``prev``, the world is the previous camera."""
    if prev is None:
        return values[curr]
    motion: FloatArray = values[curr] @ se3.inverse(values[prev])
    return motion

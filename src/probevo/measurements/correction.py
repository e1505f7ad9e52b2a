"""What a correction of a motion is: asked after the solve, it returns the motion as it should be.

The motion of the images is part of what a correction measures, so that its error contains theirs:
it takes the place of the motion, with the covariance of its own error. To fuse both as if they were
independent would count the images twice.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

from probevo.arrays import FloatArray
from probevo.errors import InputError
from probevo.measurements.relative_pose import RelativePose
from probevo.measurements.sensor import NoMeasurement, Reading
from probevo.sequences.frame import Frame


class MotionCorrection(ABC):
    """A sensor of how far the motion that the images have given is off (thesis chapter 6)."""

    name: str
    """By which it is reported."""

    @abstractmethod
    def correct(
        self, prev_frame: Frame, frame: Frame, T_curr_prev: FloatArray, *, cov: FloatArray
    ) -> RelativePose | NoMeasurement:
        """Return the corrected motion between two frames, or why there is none.

        Args:
            prev_frame: the previous frame.
            frame: the current frame.
            T_curr_prev: the motion that was solved for, [4, 4], m.
            cov: its covariance, [6, 6], m and rad.
        """


def read_correction(
    correction: MotionCorrection,
    frames: tuple[Frame, Frame],
    T_curr_prev: FloatArray,
    *,
    name: str,
    cov: FloatArray,
) -> Reading:
    """Ask a correction about a step.

    Args:
        correction: the correction.
        frames: the previous and the current frame.
        T_curr_prev: the motion that was solved for, [4, 4], m.
        name: by which the correction is reported.
        cov: covariance of the motion, [6, 6].

    Raises:
        InputError: it returns something else than a ``RelativePose`` or a reason. Whatever else it
            raises is left as it is.
    """
    answer = correction.correct(*frames, T_curr_prev, cov=cov)
    if isinstance(answer, NoMeasurement):
        return Reading(name, reason=answer.reason)
    if not isinstance(answer, RelativePose):
        what = f"it returned {type(answer).__name__}."
        raise InputError(f"sensor {name}", what, "It returns RelativePose, or NoMeasurement.")
    return Reading(name, (answer,), corrects=True)

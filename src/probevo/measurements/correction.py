"""The interface of corrections: called after the solve, they return the corrected motion.

A correction is computed from the same images as the motion, so their errors are correlated. It
therefore replaces the motion, with a covariance of its own. Fusing both as if they were independent
would count the images twice.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from probevo.arrays import FloatArray
from probevo.errors import InputError
from probevo.measurements.relative_pose import RelativePose
from probevo.measurements.sensor import NoMeasurement, Reading
from probevo.measurements.variables import pose_of
from probevo.sequences.frame import Frame


class MotionCorrection(ABC):
    """A sensor that corrects the motion solved from images (thesis chapter 6)."""

    name: str
    """Name in reports."""

    @abstractmethod
    def correct(
        self, prev_frame: Frame, frame: Frame, T_curr_prev: FloatArray, *, cov: FloatArray
    ) -> RelativePose | NoMeasurement:
        """Return the corrected motion between two frames, or a reason why there is none.

        Args:
            prev_frame: the previous frame.
            frame: the current frame.
            T_curr_prev: the solved motion, [4, 4], m.
            cov: its covariance, [6, 6], m and rad.
        """


def read_correction(
    correction: MotionCorrection,
    prev_frame: Frame,
    frame: Frame,
    T_curr_prev: FloatArray,
    *,
    name: str,
    cov: FloatArray,
) -> Reading:
    """Call a correction for a step, and check its answer.

    Args:
        correction: the correction.
        prev_frame: the previous frame.
        frame: the current frame.
        T_curr_prev: the solved motion, [4, 4], m.
        name: name of the correction in reports.
        cov: covariance of the motion, [6, 6].

    Raises:
        InputError: the answer is neither a ``RelativePose`` nor a reason, or it is a motion between
            other frames. Exceptions of the correction itself are passed on.
    """
    answer = correction.correct(prev_frame, frame, T_curr_prev, cov=cov)
    if isinstance(answer, NoMeasurement):
        return Reading(name, reason=answer.reason)
    if not isinstance(answer, RelativePose):
        what = f"it returned {type(answer).__name__}."
        raise InputError(f"sensor {name}", what, "It returns RelativePose, or NoMeasurement.")
    if not np.isfinite(answer.T_curr_prev).all():
        return Reading(name, reason="not a finite value")
    if answer.variables != (pose_of(prev_frame.index), pose_of(frame.index)):
        what = "its motion is not from the previous frame's pose to the current frame's."
        cure = "Give curr=pose_of(frame.index) and prev=pose_of(prev_frame.index)."
        raise InputError(f"sensor {name}", what, cure)
    return Reading(name, (answer,), corrects=True)

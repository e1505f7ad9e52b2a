"""All further sensors, called once per frame."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from probevo.arrays import FloatArray
from probevo.errors import InputError
from probevo.measurements.correction import MotionCorrection, read_correction
from probevo.measurements.sensor import Reading, Sensor, read_sensor, sensor_names
from probevo.sequences.frame import Frame


class SensorSuite:
    """The further sensors in their order, each with a unique name.

    Args:
        sensors: further sensors, and at most one correction of the motion.

    Raises:
        InputError: one is no sensor, or there are several corrections.
    """

    def __init__(self, sensors: Sequence[Sensor | MotionCorrection]) -> None:
        self.sensors = tuple(sensors)
        self.names = sensor_names(self.sensors)
        corrections = [
            (name, sensor)
            for name, sensor in zip(self.names, self.sensors, strict=True)
            if isinstance(sensor, MotionCorrection)
        ]
        if len(corrections) > 1:
            what = f"{len(corrections)} of them correct the motion."
            raise InputError("sensors", what, "Take one: it was learned from what it corrects.")
        self._correction = corrections[0] if corrections else None

    def read(
        self, prev_frame: Frame, frame: Frame, *, is_excluded: Callable[[str], bool]
    ) -> list[Reading]:
        """Call all sensors that are not excluded.

        Args:
            prev_frame: the previous frame.
            frame: the current frame.
            is_excluded: tells, by its name, whether a sensor is excluded.
        """
        readings = []
        for name, sensor in zip(self.names, self.sensors, strict=True):
            if is_excluded(name) or isinstance(sensor, MotionCorrection):
                readings.append(Reading(name))  # a correction is called after the solve
            else:
                readings.append(read_sensor(name, sensor, prev_frame, frame))
        return readings

    def read_correction(
        self,
        prev_frame: Frame,
        frame: Frame,
        T_curr_prev: FloatArray,
        *,
        cov: FloatArray,
        is_solved: bool,
    ) -> Reading | None:
        """Call the correction for a solved motion; None if there is no correction.

        Args:
            prev_frame: the previous frame.
            frame: the current frame.
            T_curr_prev: the motion, [4, 4].
            cov: its covariance, [6, 6].
            is_solved: whether the motion was solved; a dead-reckoned one is not corrected.
        """
        if self._correction is None:
            return None
        name, correction = self._correction
        if not is_solved:
            return Reading(name, reason="dead-reckoned step")
        return read_correction(correction, prev_frame, frame, T_curr_prev, name=name, cov=cov)

"""The interface of further sensors: called once per frame, they return measurements or a reason."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from probevo.errors import InputError, brief
from probevo.geometry import se3
from probevo.measurements.base import Measurement
from probevo.measurements.north import WORLD_STATES
from probevo.measurements.relative import RelativeMeasurement
from probevo.measurements.variables import Values, Variable, pose_of
from probevo.measurements.vector_measurement import VectorMeasurement
from probevo.sequences.frame import Frame


@dataclass(frozen=True)
class NoMeasurement:
    """The answer of a sensor that has no measurement of a frame."""

    reason: str
    """Why, in a few words, by which reports count: ``no fix``, ``night``."""


Sensor = Callable[[Frame, Frame], Sequence[Measurement] | NoMeasurement]
"""Maps the previous and the current frame to measurements of their poses, ``pose_of(frame.index)``,
or to a reason why there are none.

Measurements of both poses enter the solve of the motion. Measurements of the current pose, alone or
with ``NORTH``, correct the pose in the world. A step may be repeated after an exception, so sensors
must be stateless: a sensor looks up its measurement by the time of the frame."""


@dataclass(frozen=True)
class Reading:
    """The answer of one sensor for a frame."""

    name: str
    measurements: tuple[Measurement, ...] = ()
    reason: str | None = None
    """Why there is no measurement, if there is none."""
    corrects: bool = False
    """Whether the measurement replaces the motion of the images."""

    def pose_measurements(self, pose: Variable) -> tuple[Measurement, ...]:
        """Return the measurements of this pose alone, or of it and the world's states."""
        own = {pose, *WORLD_STATES}
        return tuple(
            measurement for measurement in self.measurements if own >= set(measurement.variables)
        )

    def motion_measurements(self, pose: Variable) -> tuple[Measurement, ...]:
        """Return the measurements that also depend on the previous pose, with a bounded loss: a
        wrong one has no influence on the solve."""
        own = {pose, *WORLD_STATES}
        return tuple(
            measurement.bounded() if isinstance(measurement, VectorMeasurement) else measurement
            for measurement in self.measurements
            if not own >= set(measurement.variables)
        )

    def without_motion(self, pose: Variable) -> Reading:
        """Keep only the measurements of this pose: a dead-reckoned step has no solve for
        measurements of the motion."""
        kept = self.pose_measurements(pose)
        reason = self.reason
        if self.measurements and not kept:
            reason = "dead-reckoned step"
        return Reading(self.name, kept, reason)


def read_sensor(name: str, sensor: Sensor, prev_frame: Frame, frame: Frame) -> Reading:
    """Call a sensor for a frame, and check its answer.

    Measurements whose residual is not finite are left out; if none is left, the reading says so.

    Raises:
        InputError: the answer is neither a list of measurements nor a reason, or a measurement is
            not one of the current pose, or one of the motion from an unknown pose, or of a motion
            and north, or depends on anything else. Exceptions of the sensor itself are passed on.
    """
    answer = sensor(prev_frame, frame)
    if isinstance(answer, NoMeasurement):
        return Reading(name, reason=answer.reason)
    if not isinstance(answer, list | tuple):
        what = f"it returned {type(answer).__name__}."
        raise InputError(f"sensor {name}", what, "It returns a list, or NoMeasurement(reason).")
    for measurement in answer:
        if not hasattr(measurement, "linearize") or not hasattr(measurement, "variables"):
            what = f"it returned a list with {type(measurement).__name__}."
            raise InputError(f"sensor {name}", what, "Its items are measurements.")
        _check_poses(measurement, f"sensor {name}", prev_frame, frame)
    finite = tuple(measurement for measurement in answer if _is_finite(measurement))
    if answer and not finite:
        return Reading(name, reason="not a finite value")
    return Reading(name, finite)


def _is_finite(measurement: Measurement) -> bool:
    """Return whether a measurement has a value: NaN is what a receiver gives before its first
    fix."""
    if not isinstance(measurement, VectorMeasurement):
        return True
    # Any poses will do, if no motion between them is special.
    values: Values = {
        variable: np.full(3, 0.1)
        if variable in WORLD_STATES
        else se3.exp(0.1 * k * np.arange(1.0, 7.0))
        for k, variable in enumerate(measurement.variables, start=1)
    }
    return bool(np.isfinite(measurement.residual(values)).all())


def _check_poses(measurement: Measurement, where: str, prev_frame: Frame, frame: Frame) -> None:
    """Refuse a measurement of a pose of any third frame, of the previous frame's pose alone, of
    both poses and north, or of anything else.

    Raises:
        InputError: it is such a measurement.
    """
    curr = pose_of(frame.index)
    variables = measurement.variables
    for variable in variables:
        if not isinstance(variable, Variable):
            what = f"at frame {frame.index} it measured {brief(variable)}, which is no pose."
            raise InputError(where, what, "Give the current frame's: pose_of(frame.index).")
    poses = {variable for variable in variables if variable.kind == curr.kind}
    if curr not in poses or not poses <= {curr, pose_of(prev_frame.index)}:
        frames = ", ".join(str(pose.frame) for pose in sorted(poses)) or "none"
        what = f"at frame {frame.index} it measured the pose of frame {frames}."
        cure = "Measure the current frame's pose, alone or together with the previous frame's."
        raise InputError(where, what, cure)
    others = [variable for variable in variables if variable not in poses | WORLD_STATES]
    if others:
        what = f"at frame {frame.index} it measured {others[0]}."
        raise InputError(where, what, "Measure poses of the camera, and north.")
    if len(poses) > 1 and WORLD_STATES & set(variables):
        # The solve of a motion is along the axes of the previous camera, and knows no north.
        what = f"at frame {frame.index} it measured north together with the previous pose."
        cure = (
            "Measure north with the current pose alone, as Heading(…, north=NORTH) does, or the"
            " motion without north."
        )
        raise InputError(where, what, cure)
    if isinstance(measurement, RelativeMeasurement) and measurement.prev is None:
        what = f"at frame {frame.index} it measured a motion, and did not say from which pose."
        raise InputError(where, what, "Give it: prev=pose_of(prev_frame.index).")


def sensor_names(sensors: Sequence[object]) -> tuple[str, ...]:
    """Return a name for each sensor: its own ``name``, or the name of the function or class.

    Sensors of one name are numbered.

    Raises:
        InputError: one can neither be called nor correct a motion.
    """
    names: list[str] = []
    for sensor in sensors:
        if not callable(sensor) and not hasattr(sensor, "correct"):
            what = f"{type(sensor).__name__} cannot be called."
            cure = "A sensor is a function of the previous and the current frame."
            raise InputError("sensors", what, cure)
        name = getattr(sensor, "name", None) or getattr(sensor, "__name__", type(sensor).__name__)
        name = str(name)
        candidates = itertools.chain([name], (f"{name} {number}" for number in itertools.count(2)))
        names.append(next(candidate for candidate in candidates if candidate not in names))
    return tuple(names)

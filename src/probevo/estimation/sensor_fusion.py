"""Fusion of sensors with the path, and exclusion of those that lie.

A sensor may be wrong now and then, or all the time. Against the first, an innovation beyond the
gate is turned away, and a large one counts for less (``bounded_weight``). Against the second there
are two sequential tests with memory, both on measurements of the pose:

- **Offset.** A filter of its own estimates a constant offset b of the sensor beside the pose, from
  all sensors. Its covariance knows how far the odometry itself may have drifted, and what the
  heading of the first camera leaves open. If b is not zero with near certainty, the sensor lies.
- **Innovations.** Those of the filter that uses the sensor are white, and their squares χ². Their
  cumulative sum above what is usual (CUSUM, Page 1954) grows without bound if they are larger.

Each sensor has a filter that does without it (solution separation, as receivers of satellite
navigation have it). This becomes the estimate as soon as the sensor is excluded, and nothing of
what it said remains. An excluded sensor does not come back.

Measurements of the motion enter the solve of the step; of them, only the innovations are tested.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc, chdtri

from probevo.arrays import FloatArray
from probevo.config import NorthConfig
from probevo.estimation.motion_estimate import MotionEstimate, SensorOutcome
from probevo.estimation.pose_filter import PoseFilter
from probevo.estimation.reprojection import ReprojectionSolution
from probevo.measurements.base import (
    Measurement,
    Values,
    Variable,
    VectorMeasurement,
    bounded_weight,
    large_from,
)
from probevo.measurements.north import NORTH
from probevo.measurements.sensor import Reading

GATE = 1e-4
"""Probability of an innovation as large as one that is turned away."""
LIE = 1e-5
"""Probability of an estimated offset as large as one that excludes a sensor. It also has to be
larger than the standard deviation that the sensor claims: a smaller one does little harm."""
OFFSET_VARIANCE = 100.0
"""Prior variance of an offset, in variances of the sensor."""
OFFSET_WALK = 1.0 / 2500.0
"""Variance by which an offset may change from one measurement to the next, in variances of the
sensor; so some fifty measurements count, and a sensor that fails late is found, too."""
USUAL = 3.5
"""What an innovation may add to the sum, of which χ²(2) has 2 on average."""
MOST_OF_ONE = 12.0
"""What one innovation can add at most; a few wild ones are not a lie."""
ALARM = 39.0
"""The sum that excludes a sensor: by chance, once in a million measurements."""

UNKNOWN_HEADING_RAD = 100.0
"""Standard deviation of a heading of which nothing is known: many turns."""


class _Tested(NamedTuple):
    """A filter after measurements, with what became of each of them."""

    pose: PoseFilter
    squared: tuple[float | None, ...]
    """Squared Mahalanobis distance of each innovation; None where it was not tested."""
    weights: tuple[float, ...]


@dataclass(frozen=True)
class SensorMemory:
    """What is remembered of one sensor."""

    name: str
    without: PoseFilter
    """Estimate from all sensors that are not excluded, except this one."""
    with_offset: PoseFilter
    """The same with this sensor, and its offset as a further state."""
    sum_above: float = 0.0
    """Sum of its innovations above what is usual."""
    excluded: str | None = None
    """Why it is excluded; None if it is not."""


@dataclass(frozen=True)
class SensorFusion:
    """The pose from odometry and sensors, and what is remembered of each sensor."""

    pose: PoseFilter
    """Estimate from all sensors that are not excluded."""
    odometry: PoseFilter
    """Estimate from no sensor at all."""
    memories: tuple[SensorMemory, ...] = ()

    @staticmethod
    def at_origin(names: Sequence[str]) -> SensorFusion:
        """Return the state at the first frame, of sensors with these names."""
        origin = PoseFilter.at_origin()
        memories = tuple(SensorMemory(name, origin, origin) for name in names)
        return SensorFusion(origin, origin, memories)

    def advanced(self, advance: Callable[[PoseFilter], PoseFilter]) -> SensorFusion:
        """Return the state after a motion, given how a filter advances by it."""
        return SensorFusion(
            pose=advance(self.pose),
            odometry=advance(self.odometry) if self.memories else self.odometry,
            memories=tuple(
                memory
                if memory.excluded is not None
                else replace(
                    memory,
                    without=advance(memory.without),
                    with_offset=advance(memory.with_offset),
                )
                for memory in self.memories
            ),
        )

    def after(self, motion: MotionEstimate) -> SensorFusion:
        """Return the state after the motion of two frames."""
        return self.advanced(lambda pose: pose.advanced(motion))

    def is_excluded(self, name: str) -> bool:
        """Return whether the sensor of that name is excluded."""
        return any(memory.name == name and memory.excluded for memory in self.memories)

    def updated(
        self,
        readings: Sequence[Reading],
        pose: Variable,
        north: NorthConfig,
        *,
        motion_squared: Mapping[str, Sequence[float | None]],
    ) -> tuple[SensorFusion, tuple[SensorOutcome, ...]]:
        """Return the state after what the sensors measured at a frame, and what became of each.

        Args:
            readings: of each sensor, in order.
            pose: the pose of the frame.
            north: prior of the attitude of the world against north.
            motion_squared: by sensor, the squared Mahalanobis distances of the innovations of its
                measurements of the motion, which the solve has used.
        """
        measured = [
            () if memory.excluded is not None else reading.of_pose(pose)
            for memory, reading in zip(self.memories, readings, strict=True)
        ]
        main = _tested(self.pose, _joined(measured), pose, north)
        memories: list[SensorMemory] = []
        outcomes: list[SensorOutcome] = []
        suspects: list[_Suspect] = []
        start = 0
        for index, (memory, reading) in enumerate(zip(self.memories, readings, strict=True)):
            own = slice(start, start + len(measured[index]))
            start = own.stop
            of_motion = () if memory.excluded is not None else reading.of_motion(pose)
            squared = (*main.squared[own], *motion_squared.get(memory.name, ()))
            weights = (*main.weights[own], *(1.0 for _ in of_motion))
            outcomes.append(_outcome(memory, reading, squared, weights))
            if memory.excluded is None and weights:
                dims = [_dimension(one) for one in (*measured[index], *of_motion)]
                others = _joined([*measured[:index], *measured[index + 1 :]])
                memory = replace(
                    memory,
                    without=_tested(memory.without, others, pose, north).pose,
                    with_offset=_tested_with_offset(
                        memory.with_offset, measured[index], others, pose=pose, north=north
                    ),
                    sum_above=_sum_above(memory.sum_above, dims, squared),
                )
                suspects += _suspects(memory, index, measured[index])
            elif memory.excluded is None:
                others = _joined(measured)
                memory = replace(
                    memory,
                    without=_tested(memory.without, others, pose, north).pose,
                    with_offset=_tested(memory.with_offset, others, pose, north).pose,
                )
            memories.append(memory)
        after = SensorFusion(main.pose, self.odometry, tuple(memories))
        if not suspects:
            return after, tuple(outcomes)
        # Of several, the one farthest beyond its threshold; the others then start anew without it.
        liar = max(suspects, key=lambda suspect: suspect.ratio)
        after = after.without(liar.sensor, liar.shows)
        outcomes[liar.sensor] = SensorOutcome(
            name=after.memories[liar.sensor].name, state="excluded", reason=liar.shows
        )
        return after, tuple(outcomes)

    def without(self, index: int, reason: str) -> SensorFusion:
        """Return the state without one of the sensors, as if it had never said anything."""
        memories = []
        for at, memory in enumerate(self.memories):
            if at == index:
                memories.append(replace(memory, excluded=reason))
            elif memory.excluded is not None:
                memories.append(memory)
            else:
                memories.append(SensorMemory(memory.name, self.odometry, self.odometry))
        return SensorFusion(
            pose=self.memories[index].without,
            odometry=self.odometry,
            memories=tuple(memories),
        )


class _Suspect(NamedTuple):
    """A sensor that has failed a test."""

    sensor: int
    """Its place among the sensors."""
    ratio: float
    """Its statistic over the threshold."""
    shows: str
    """What the test shows, in words."""


def _outcome(
    memory: SensorMemory,
    reading: Reading,
    squared: Sequence[float | None],
    weights: Sequence[float],
) -> SensorOutcome:
    """Return what became of a sensor, unless it is excluded just now."""
    if memory.excluded is not None:
        return SensorOutcome(memory.name, "excluded", memory.excluded)
    if not weights:
        return SensorOutcome(memory.name, "silent", reading.reason)
    return SensorOutcome(
        name=memory.name,
        state="used" if max(weights) > 0.0 else "gated",
        squared=max((one for one in squared if one is not None), default=None),
        weight=min(weights),
    )


def _joined(measured: Sequence[Sequence[Measurement]]) -> list[Measurement]:
    return [one for measurements in measured for one in measurements]


def _dimension(measurement: Measurement) -> int:
    """Return d of a measurement with a single residual; 0 of any other."""
    return len(measurement.covariance) if isinstance(measurement, VectorMeasurement) else 0


def _tested(
    pose_filter: PoseFilter,
    measurements: Sequence[Measurement],
    pose: Variable,
    north: NorthConfig,
) -> _Tested:
    """Return a filter updated with measurements, of which wrong ones are turned away.

    The gate is on the innovation, whose covariance includes that of the pose: how large a residual
    may be, depends on how far the odometry may have drifted. A measurement that comes with a loss
    of its own is used as it is.
    """
    if not measurements:
        return _Tested(pose_filter, (), ())
    if pose_filter.slice_of(NORTH) is None and any(NORTH in one.variables for one in measurements):
        mean, cov = _prior_of(north)
        pose_filter = pose_filter.with_state(NORTH, mean, cov)
    kept: list[Measurement] = []
    squares: list[float | None] = []
    weights: list[float] = []
    for measurement in measurements:
        squared = _innovation_squared(pose_filter, measurement, pose)
        weight = 1.0
        if squared is not None and isinstance(measurement, VectorMeasurement):
            dim = len(measurement.covariance)
            weight = bounded_weight(squared, large_from(dim))
            if squared > chdtri(dim, GATE):
                weight = 0.0
            else:
                measurement = measurement.scaled(1.0 / weight)
        if weight > 0.0:
            kept.append(measurement)
        squares.append(squared)
        weights.append(weight)
    return _Tested(pose_filter.updated(kept, pose), tuple(squares), tuple(weights))


def _prior_of(north: NorthConfig) -> tuple[FloatArray, FloatArray]:
    """Return mean, [3], and covariance, [3, 3], of the attitude against north, rad."""
    tilt = math.radians(north.tilt_sigma_deg)
    heading = math.radians(north.heading_sigma_deg)
    if north.heading_deg is None:
        heading = UNKNOWN_HEADING_RAD
    mean = np.array([0.0, 0.0, math.radians(north.heading_deg or 0.0)])
    return mean, np.diag([tilt**2, tilt**2, heading**2])


def _innovation_squared(
    pose_filter: PoseFilter, measurement: Measurement, pose: Variable
) -> float | None:
    """Return the squared Mahalanobis distance of an innovation; None if it cannot be tested."""
    if not isinstance(measurement, VectorMeasurement) or measurement.has_own_loss:
        return None
    if NORTH in measurement.variables and not pose_filter.knows_heading:
        return None
    innovation, covariance = pose_filter.innovation(measurement, pose)
    return float(innovation @ np.linalg.solve(covariance, innovation))


def _tested_with_offset(
    pose_filter: PoseFilter,
    measurements: Sequence[Measurement],
    others: Sequence[Measurement],
    *,
    pose: Variable,
    north: NorthConfig,
) -> PoseFilter:
    """Return a filter updated with other sensors, and with one whose offset it estimates.

    Args:
        pose_filter: the filter; the offsets are further states of it.
        measurements: of the sensor.
        others: of the other sensors.
        pose: the pose of the frame.
        north: prior of the attitude of the world against north.
    """
    offset: list[WithOffset] = []
    for variable, measurement in _with_offsets(measurements):
        at = pose_filter.slice_of(variable)
        if at is None:
            pose_filter = pose_filter.with_state(
                variable,
                np.zeros(len(measurement.covariance)),
                OFFSET_VARIANCE * measurement.covariance,
            )
        else:
            own_cov = pose_filter.own_cov.copy()
            own_cov[at, at] += OFFSET_WALK * measurement.covariance
            pose_filter = replace(pose_filter, own_cov=own_cov)
        offset.append(WithOffset(measurement, variable))
    return _tested(pose_filter, [*offset, *others], pose, north).pose


def _with_offsets(
    measurements: Sequence[Measurement],
) -> Iterator[tuple[Variable, VectorMeasurement]]:
    """Yield those measurements whose offset is estimated, each with its variable."""
    for place, measurement in enumerate(measurements):
        if isinstance(measurement, VectorMeasurement) and not measurement.has_own_loss:
            yield Variable(kind=f"offset {len(measurement.covariance)}", frame=place), measurement


class WithOffset(VectorMeasurement):
    """A measurement that is off by a further state.

    Args:
        measurement: what the sensor said.
        offset: the state, [d].
    """

    def __init__(self, measurement: VectorMeasurement, offset: Variable) -> None:
        super().__init__(measurement.covariance)
        self.measurement = measurement
        self.offset = offset

    @property
    def variables(self) -> tuple[Variable, ...]:
        """Those of the measurement, and the offset."""
        return (*self.measurement.variables, self.offset)

    def residual(self, values: Values) -> FloatArray:
        """Return the residual of what is measured less the offset, [d]."""
        return self.measurement.residual(values) - values[self.offset]

    def jacobians(self, values: Values) -> tuple[FloatArray, ...]:
        """Return those of the measurement, and −1."""
        return (*self.measurement.jacobians(values), -np.eye(len(self.covariance)))


def _suspects(
    memory: SensorMemory, sensor: int, measurements: Sequence[Measurement]
) -> list[_Suspect]:
    """Return the tests that a sensor has failed with these measurements."""
    found = []
    values = {state.variable: state.value for state in memory.with_offset.further}
    for variable, measurement in _with_offsets(measurements):
        at = memory.with_offset.slice_of(variable)
        if at is None:
            continue
        offset = values[variable]
        cov = memory.with_offset.joint_cov[at, at]
        squared = float(offset @ np.linalg.solve(cov, offset))
        claimed = float(offset @ np.linalg.solve(measurement.covariance, offset))
        ratio = squared / float(chdtri(len(offset), LIE))
        if ratio > 1.0 and claimed > 1.0:
            size = float(np.linalg.norm(offset))
            found.append(_Suspect(sensor, ratio, f"a constant offset of {size:.2g} (rad or m)"))
    if memory.sum_above > ALARM:
        shows = "innovations larger than its covariance explains"
        found.append(_Suspect(sensor, memory.sum_above / ALARM, shows))
    return found


def _sum_above(before: float, dims: Sequence[int], squares: Sequence[float | None]) -> float:
    """Return the sum of innovations above what is usual; of any dimension on the scale of χ²(2)."""
    total = before
    for dim, squared in zip(dims, squares, strict=True):
        if squared is None:
            continue
        rarity = max(float(chdtrc(dim, squared)), 1e-300)
        total = max(0.0, total + min(-2.0 * math.log(rarity), MOST_OF_ONE) - USUAL)
    return total


def solve_innovations_squared(
    readings: Sequence[Reading], curr: Variable, solution: ReprojectionSolution | None
) -> dict[str, list[float | None]]:
    """Return, by sensor, the squared Mahalanobis distances that its measurements of the motion had.

    Without a solve, they have no innovation to test. A correction has taken the place of the solve,
    and cannot be tested against it.

    Args:
        readings: of each sensor.
        curr: the pose of the current frame.
        solution: the solve, which has used the measurements of the motion; None if there is none.
    """
    found: dict[str, list[float | None]] = {}
    for reading in readings:
        of_motion = reading.of_motion(curr)
        found[reading.name] = [None] * len(of_motion)
        if solution is not None and not reading.corrects:
            found[reading.name] = motion_innovations_squared(
                of_motion, solution.T_curr_prev, curr, cov=solution.cov
            )
    return found


def motion_innovations_squared(
    measurements: Sequence[Measurement],
    T_curr_prev: FloatArray,
    curr: Variable,
    *,
    cov: FloatArray,
) -> list[float | None]:
    """Return the squared Mahalanobis distances of the innovations of a solve's own measurements.

    The solve has used them. With r its residual, R its covariance over its weight, and P that of
    the motion without the measurement, P⁻¹ = cov⁻¹ − Jᵀ R⁻¹ J, the innovation is
    (R + J P Jᵀ) R⁻¹ r.

    Args:
        measurements: of the motion.
        T_curr_prev: where the solve ended, [4, 4].
        curr: the pose that it solved for; any other, of the previous frame, is the identity.
        cov: its covariance, [6, 6].
    """
    if not measurements:
        return []
    values = {variable: np.eye(4) for one in measurements for variable in one.variables}
    values[curr] = T_curr_prev
    information = np.linalg.inv(cov)
    found: list[float | None] = []
    for measurement in measurements:
        found.append(None)
        if not isinstance(measurement, VectorMeasurement) or measurement.has_own_loss:
            continue
        jacobian = measurement.jacobians(values)[measurement.variables.index(curr)]
        R = measurement.covariance
        used = R / max(float(measurement.outcome(values).weight[0]), 1e-12)
        without = information - jacobian.T @ np.linalg.solve(used, jacobian)
        if np.linalg.eigvalsh(without)[0] <= 0.0:
            continue  # nothing else fixes what it measures
        spread = jacobian @ np.linalg.solve(without, jacobian.T)
        innovation = (used + spread) @ np.linalg.solve(used, measurement.residual(values))
        found[-1] = float(innovation @ np.linalg.solve(R + spread, innovation))
    return found

"""Fusion of sensors with the path, and exclusion of faulty ones.

A sensor may be wrong now and then, or all the time. Against single outliers, an innovation beyond
the gate is rejected, and a large one is down-weighted (``bounded_weight``). Persistent faults are
found by two sequential tests:

- **Offset.** For measurements of the pose, a separate filter estimates a constant offset b of the
  sensor together with the pose. Its covariance includes the drift of the odometry and the unknown
  heading of the first camera. If b differs from zero with near certainty, the sensor is faulty.
- **Innovations.** If the sensor is consistent, its innovations are white and their squares χ². If
  they are larger, their cumulative sum above the expected value grows without bound (CUSUM, Page
  1954).

For each sensor, a further filter estimates the pose from all others (solution separation, as in
receivers of satellite navigation). When the sensor is excluded, that estimate replaces the pose, so
that no influence of its measurements of the pose remains. An excluded sensor does not come back.

Where nothing else says where the world is, the first fix decides it, and the first headings which
way is north. If that one is an outlier, all that follow contradict it. A sensor that fails a test
among its first measurements therefore is reset, a few times, before it is excluded.

Measurements of the motion enter the solve of the step with a bounded loss. Only their innovations
are tested, and the steps that they have entered stay as they are.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc, chdtri

from probevo.arrays import FloatArray
from probevo.config import NorthConfig
from probevo.errors import InputError
from probevo.estimation.motion_estimate import MotionEstimate, SensorOutcome
from probevo.estimation.pose_filter import PoseFilter
from probevo.estimation.reprojection import ReprojectionSolution
from probevo.geometry.uncertainty import squared_mahalanobis
from probevo.measurements.base import Measurement
from probevo.measurements.north import NORTH, ORIGIN
from probevo.measurements.position import VAGUENESS, Position
from probevo.measurements.sensor import Reading
from probevo.measurements.variables import Values, Variable
from probevo.measurements.vector_measurement import (
    VectorMeasurement,
    bounded_weight,
    large_residual_threshold,
)

GATE_TAIL = 1e-4
"""Tail probability of an innovation beyond which it is rejected."""
OFFSET_TAIL = 1e-5
"""Tail probability of an estimated offset beyond which the sensor is excluded. The offset also has
to be larger than the standard deviation that the sensor claims: a smaller one does little harm."""
OFFSET_VARIANCE = 100.0
"""Prior variance of an offset, in variances of the sensor."""
OFFSET_WALK = 1.0 / 2500.0
"""Variance of the offset's random walk from one measurement to the next, in variances of the
sensor. The estimate then rests on the last fifty measurements or so, and late failures are found,
too."""
CUSUM_ALLOWANCE = 3.5
"""Allowance that is subtracted from each squared innovation before it is summed; the mean of χ²(2)
is 2."""
CUSUM_LARGEST_TERM = 12.0
"""Largest term that one innovation adds to the sum, so that a few outliers exclude no sensor."""
CUSUM_ALARM = 39.0
"""Sum at which a sensor is excluded; a consistent one reaches it once in a million measurements."""

STARTING_MEASUREMENTS = 20
"""First measurements of a sensor, after which a failed test resets it. The cumulative sum reaches
its alarm after five that are beyond the gate, and after a dozen that are nearly so."""
MAX_RESTARTS = 2
"""Restarts of a sensor. Where one measurement in ten is an outlier, one start in a thousand is bad
three times in a row."""

UNKNOWN_HEADING_RAD = 100.0
"""Standard deviation of an unknown heading: many turns."""


class SensorInnovation(NamedTuple):
    """The squared innovation of a measurement, and its robust weight."""

    mahalanobis_sq: float | None
    """Squared Mahalanobis distance; None where it was not tested."""
    weight: float
    """Robust weight of the measurement; 0 if it is rejected."""
    is_gated: bool = False
    """Whether it is beyond the gate; one of the motion then has a small weight instead of 0."""


class _GatedUpdate(NamedTuple):
    """A filter after an update, with the innovation of each measurement."""

    pose: PoseFilter
    innovations: tuple[SensorInnovation, ...]


@dataclass(frozen=True)
class SensorMemory:
    """The tests of one sensor, over all frames so far."""

    name: str
    without_sensor: PoseFilter
    """Estimate from the motions and the measurements of the pose by all sensors that are not
    excluded, except this one."""
    with_offset: PoseFilter
    """Estimate from all sensors, with the offset of this one as a further state."""
    sum_above: float = 0.0
    """Cumulative sum of its squared innovations above the allowance (CUSUM)."""
    excluded: str | None = None
    """Why it is excluded; None if it is not."""
    num_steps: int = 0
    """Steps in which it has measured something, since its start."""
    num_restarts: int = 0
    """How often it has been reset."""

    def after(self, motion: MotionEstimate, in_window: PoseFilter | None) -> SensorMemory:
        """Return the memory after a step; see ``PoseFilter.after``."""
        if self.excluded is not None:
            return self
        return replace(
            self,
            without_sensor=self.without_sensor.after(motion, in_window),
            with_offset=self.with_offset.after(motion, in_window),
        )

    def updated(
        self,
        reading: Reading,
        innovations: Sequence[SensorInnovation],
        others: Sequence[Measurement],
        *,
        pose: Variable,
        north: NorthConfig,
    ) -> SensorMemory:
        """Return the memory after the measurements at a frame.

        Args:
            reading: of this sensor.
            innovations: those of its measurements, first of the pose, then of the motion.
            others: measurements of the pose by the other sensors.
            pose: the pose of the frame.
            north: prior of the attitude of the world relative to north.
        """
        if self.excluded is not None:
            return self
        pose_measurements = reading.pose_measurements(pose)
        measurements = (*pose_measurements, *reading.motion_measurements(pose))
        return replace(
            self,
            without_sensor=_gated_update(self.without_sensor, others, pose, north).pose,
            with_offset=_gated_update_with_offset(
                self.with_offset, pose_measurements, others, pose=pose, north=north
            ),
            sum_above=_sum_above(self.sum_above, measurements, innovations),
            num_steps=self.num_steps + bool(innovations),
        )

    def reset_to(self, odometry: PoseFilter) -> SensorMemory:
        """Return the memory with its tests reset, and its filters set to the odometry."""
        if self.excluded is not None:
            return self
        return replace(self, without_sensor=odometry, with_offset=odometry, sum_above=0.0)

    def may_restart(self, measurements: Sequence[Measurement], north: NorthConfig) -> bool:
        """Return whether a failed test may be the fault of the sensor's first measurements, which
        have decided where the world is."""
        undecided = {ORIGIN} if north.heading_deg is not None else {ORIGIN, NORTH}
        decides = any(undecided.intersection(one.variables) for one in measurements)
        return (
            decides and self.num_steps <= STARTING_MEASUREMENTS and self.num_restarts < MAX_RESTARTS
        )


@dataclass(frozen=True)
class SensorFusion:
    """The pose from odometry and sensors, and the tests of each sensor."""

    pose: PoseFilter
    """Estimate from all sensors that are not excluded."""
    odometry: PoseFilter
    """Estimate from the motions alone."""
    memories: tuple[SensorMemory, ...] = ()

    @staticmethod
    def at_origin(names: Sequence[str]) -> SensorFusion:
        """Return the state at the first frame, of sensors with these names."""
        origin = PoseFilter.at_origin()
        memories = tuple(SensorMemory(name, origin, origin) for name in names)
        return SensorFusion(origin, origin, memories)

    def after(self, motion: MotionEstimate, in_window: PoseFilter | None = None) -> SensorFusion:
        """Return the state after a step.

        Args:
            motion: the step.
            in_window: the pose after it by the window; None for the two-frame estimator.
        """
        odometry = self.odometry
        if self.memories:
            odometry = odometry.after(motion, in_window)
        return SensorFusion(
            pose=self.pose.after(motion, in_window),
            odometry=odometry,
            memories=tuple(memory.after(motion, in_window) for memory in self.memories),
        )

    def is_excluded(self, name: str) -> bool:
        """Return whether the sensor of that name is excluded."""
        return any(memory.name == name and memory.excluded for memory in self.memories)

    def updated(
        self,
        readings: Sequence[Reading],
        pose: Variable,
        north: NorthConfig,
        *,
        motion_innovations: Mapping[str, Sequence[SensorInnovation]],
    ) -> tuple[SensorFusion, tuple[SensorOutcome, ...]]:
        """Update the pose with the measurements at a frame, and test each sensor.

        Args:
            readings: of each sensor, in order.
            pose: the pose of the frame.
            north: prior of the attitude of the world relative to north.
            motion_innovations: by sensor, the innovations of its measurements of the motion, which
                the solve has used.

        Returns:
            The state after the update, and the outcome of each sensor.
        """
        # Whatever an excluded sensor may measure does not count.
        readings = [
            reading if memory.excluded is None else Reading(memory.name)
            for memory, reading in zip(self.memories, readings, strict=True)
        ]
        pose_measurements = [reading.pose_measurements(pose) for reading in readings]
        # The pose from all sensors, which gives the innovation of each measurement of the pose.
        fused = _gated_update(self.pose, _joined(pose_measurements), pose, north)
        # Then each sensor by itself: its outcome, and its tests.
        outcomes = []
        memories = []
        start = 0
        for index, (memory, reading) in enumerate(zip(self.memories, readings, strict=True)):
            stop = start + len(pose_measurements[index])
            innovations = (
                *fused.innovations[start:stop],
                *motion_innovations.get(reading.name, ()),
            )
            start = stop
            outcomes.append(_outcome(memory, reading, innovations))
            others = _joined([*pose_measurements[:index], *pose_measurements[index + 1 :]])
            memories.append(memory.updated(reading, innovations, others, pose=pose, north=north))
        after = SensorFusion(fused.pose, self.odometry, tuple(memories))
        suspects = [
            suspect
            for index, memory in enumerate(memories)
            for suspect in _suspects(memory, index, pose_measurements[index])
        ]
        if not suspects:
            return after, tuple(outcomes)
        # Exclude only the sensor farthest beyond its threshold: one faulty sensor makes the others
        # look faulty, too. Their tests are reset.
        worst = max(suspects, key=lambda suspect: suspect.ratio)
        after, outcomes[worst.sensor] = after._excluding(
            worst, pose_measurements[worst.sensor], north
        )
        return after, tuple(outcomes)

    def _excluding(
        self, suspect: _Suspect, measurements: Sequence[Measurement], north: NorthConfig
    ) -> tuple[SensorFusion, SensorOutcome]:
        """Return the state without a sensor that has failed a test, and the outcome of the sensor.

        If the fault may be that of its first measurements, it is reset, and not excluded.

        Args:
            suspect: the sensor.
            measurements: its measurements of the pose at this frame.
            north: prior of the attitude of the world relative to north.
        """
        memory = self.memories[suspect.sensor]
        forgotten = self.without_measurements_of(suspect.sensor)
        if memory.may_restart(measurements, north):
            reason = f"it is reset, since it has shown {suspect.evidence}"
            return forgotten, SensorOutcome(memory.name, "gated", reason)
        memories = list(forgotten.memories)
        memories[suspect.sensor] = replace(memories[suspect.sensor], excluded=suspect.evidence)
        outcome = SensorOutcome(memory.name, "excluded", suspect.evidence)
        return replace(forgotten, memories=tuple(memories)), outcome

    def without_measurements_of(self, index: int) -> SensorFusion:
        """Return the state as if a sensor had not measured the pose so far.

        The tests of all sensors are reset.
        """
        memories = [memory.reset_to(self.odometry) for memory in self.memories]
        own = memories[index]
        memories[index] = replace(own, num_steps=0, num_restarts=own.num_restarts + 1)
        return SensorFusion(
            pose=self.memories[index].without_sensor,
            odometry=self.odometry,
            memories=tuple(memories),
        )


class _Suspect(NamedTuple):
    """A sensor that has failed a test."""

    sensor: int
    """Its index among the sensors."""
    ratio: float
    """Its statistic over the threshold."""
    evidence: str
    """What the test shows, in words."""


def _outcome(
    memory: SensorMemory, reading: Reading, innovations: Sequence[SensorInnovation]
) -> SensorOutcome:
    """Return the outcome of a sensor in this step, before exclusions of this step."""
    if memory.excluded is not None:
        return SensorOutcome(memory.name, "excluded", memory.excluded)
    if not innovations:
        return SensorOutcome(memory.name, "silent", reading.reason)
    is_used = any(one.weight > 0.0 and not one.is_gated for one in innovations)
    return SensorOutcome(
        name=memory.name,
        state="used" if is_used else "gated",
        mahalanobis_sq=max(
            (one.mahalanobis_sq for one in innovations if one.mahalanobis_sq is not None),
            default=None,
        ),
        weight=min(one.weight for one in innovations),
    )


def _joined(measured: Sequence[Sequence[Measurement]]) -> list[Measurement]:
    return [one for measurements in measured for one in measurements]


def _gated_update(
    pose_filter: PoseFilter,
    measurements: Sequence[Measurement],
    pose: Variable,
    north: NorthConfig,
) -> _GatedUpdate:
    """Update a filter with measurements, gating each innovation.

    The covariance of the innovation includes that of the pose, so the gate widens as the odometry
    drifts. A measurement with its own robust loss is used as it is.
    """
    if not measurements:
        return _GatedUpdate(pose_filter, ())
    pose_filter = _with_world_states(pose_filter, measurements, pose, north)
    kept: list[Measurement] = []
    innovations: list[SensorInnovation] = []
    for measurement in measurements:
        # All innovations are against the pose before any of these measurements. What fails the gate
        # is left out; a weight below one enlarges the covariance.
        mahalanobis_sq = _innovation_squared(pose_filter, measurement, pose)
        if mahalanobis_sq is None or not isinstance(measurement, VectorMeasurement):
            outcome = measurement.outcome(pose_filter.values(pose))
            weight = float(outcome.weight.min(initial=1.0))
        else:
            dim = len(measurement.covariance)
            weight = bounded_weight(mahalanobis_sq, large_residual_threshold(dim))
            if _is_beyond_gate(mahalanobis_sq, dim):
                weight = 0.0
            else:
                measurement = measurement.scaled(1.0 / weight)
        if weight > 0.0:
            kept.append(measurement)
        innovations.append(SensorInnovation(mahalanobis_sq, weight, is_gated=weight == 0.0))
    return _GatedUpdate(pose_filter.updated(kept, pose), tuple(innovations))


def _is_beyond_gate(mahalanobis_sq: float, dim: int) -> bool:
    """Return whether an innovation of that dimension is too unlikely to be one of noise."""
    return bool(mahalanobis_sq > chdtri(dim, GATE_TAIL))


def _with_world_states(
    pose_filter: PoseFilter,
    measurements: Sequence[Measurement],
    pose: Variable,
    north: NorthConfig,
) -> PoseFilter:
    """Return the filter with the states of the world that the measurements need: they become states
    with the first one.

    Raises:
        InputError: positions are measured, and the heading of the first camera is unknown.
    """
    needed = {variable for one in measurements for variable in one.variables}
    if NORTH in needed and pose_filter.slice_of(NORTH) is None:
        mean, cov = _prior_of(north)
        pose_filter = pose_filter.with_state(NORTH, mean, cov)
    if ORIGIN in needed and pose_filter.slice_of(ORIGIN) is None:
        if north.heading_deg is None:
            raise InputError(
                "north.heading_deg",
                "positions are measured, and the heading of the first camera is unknown.",
                "Give it with its heading_sigma_deg, such as the course of the first fixes.",
            )
        values = pose_filter.values(pose)
        first = next((one for one in measurements if isinstance(one, Position)), None)
        if first is None:
            raise InputError(
                "sensors",
                "the origin of positions is measured before any position.",
                "Measure a Position first, or leave out ORIGIN until then.",
            )
        pose_filter = pose_filter.with_state(
            ORIGIN, first.origin_m(values), VAGUENESS**2 * first.covariance
        )
    return pose_filter


def _prior_of(north: NorthConfig) -> tuple[FloatArray, FloatArray]:
    """Return mean, [3], and covariance, [3, 3], of the attitude relative to north, rad."""
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
    return float(squared_mahalanobis(innovation, covariance))


def _gated_update_with_offset(
    pose_filter: PoseFilter,
    measurements: Sequence[Measurement],
    others: Sequence[Measurement],
    *,
    pose: Variable,
    north: NorthConfig,
) -> PoseFilter:
    """Update a filter with all sensors, and estimate a constant offset of one of them.

    Args:
        pose_filter: the filter; the offsets are further states of it.
        measurements: those of the sensor whose offset is estimated.
        others: those of the other sensors.
        pose: the pose of the frame.
        north: prior of the attitude of the world relative to north.
    """
    pose_filter = _with_world_states(pose_filter, [*measurements, *others], pose, north)
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
    return _gated_update(pose_filter, [*offset, *others], pose, north).pose


def _with_offsets(
    measurements: Sequence[Measurement],
) -> Iterator[tuple[Variable, VectorMeasurement]]:
    """Yield the measurements whose offset can be estimated, each with the variable of its
    offset."""
    for number, measurement in enumerate(measurements):
        if isinstance(measurement, VectorMeasurement) and not measurement.has_own_loss:
            yield Variable(kind=f"offset {len(measurement.covariance)}", frame=number), measurement


class WithOffset(VectorMeasurement):
    """A measurement of a sensor with an unknown offset, which is a further state.

    Args:
        measurement: the measurement without the offset.
        offset: the state, [d].
    """

    def __init__(self, measurement: VectorMeasurement, offset: Variable) -> None:
        super().__init__(measurement.covariance)
        self.measurement = measurement
        self.offset = offset

    @property
    def variables(self) -> tuple[Variable, ...]:
        """The variables of the measurement, and the offset."""
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
    """Return the tests that a sensor fails with these measurements of the pose."""
    if memory.excluded is not None:
        return []
    found = []
    values = {state.variable: state.value for state in memory.with_offset.further}
    for variable, measurement in _with_offsets(measurements):
        at = memory.with_offset.slice_of(variable)
        if at is None:
            continue
        # The offset against its own covariance, and against that of the sensor: both have to be
        # exceeded.
        offset = values[variable]
        cov = memory.with_offset.joint_cov[at, at]
        mahalanobis_sq = float(squared_mahalanobis(offset, cov))
        claimed = float(squared_mahalanobis(offset, measurement.covariance))
        ratio = mahalanobis_sq / float(chdtri(len(offset), OFFSET_TAIL))
        if ratio > 1.0 and claimed > 1.0:
            size = float(np.linalg.norm(offset))
            found.append(_Suspect(sensor, ratio, f"a constant offset of {size:.2g} (rad or m)"))
    if memory.sum_above > CUSUM_ALARM:
        evidence = "innovations larger than its covariance explains"
        found.append(_Suspect(sensor, memory.sum_above / CUSUM_ALARM, evidence))
    return found


def _sum_above(
    before: float, measurements: Sequence[Measurement], innovations: Sequence[SensorInnovation]
) -> float:
    """Update the cumulative sum of squared innovations above the allowance (CUSUM)."""
    # Innovations of any dimension are compared by their tail probability, on the scale of χ²(2).
    total = before
    for measurement, innovation in zip(measurements, innovations, strict=True):
        if innovation.mahalanobis_sq is None or not isinstance(measurement, VectorMeasurement):
            continue
        # −2 ln p of a uniformly distributed p is χ²(2) distributed.
        dim = len(measurement.covariance)
        rarity = max(float(chdtrc(dim, innovation.mahalanobis_sq)), 1e-300)
        total = max(0.0, total + min(-2.0 * math.log(rarity), CUSUM_LARGEST_TERM) - CUSUM_ALLOWANCE)
    return total


def solve_innovations(
    readings: Sequence[Reading],
    curr: Variable,
    solution: ReprojectionSolution | None,
    common_mode: FloatArray,
    reckoned: MotionEstimate | None = None,
) -> dict[str, list[SensorInnovation]]:
    """Return, by sensor, the innovations of its measurements of the motion.

    A correction replaces the motion of the solve, so it cannot be tested against it.

    Args:
        readings: of each sensor.
        curr: the pose of the current frame.
        solution: the solve, which has used the measurements of the motion; None if there is none.
        common_mode: how errors of the rig move the motion of its images (``CommonMode.columns``).
        reckoned: the dead-reckoned motion that they are tested against without a solve; None if
            there is none either, and nothing is tested.
    """
    found: dict[str, list[SensorInnovation]] = {}
    for reading in readings:
        motion_measurements = reading.motion_measurements(curr)
        found[reading.name] = [SensorInnovation(None, 1.0)] * len(motion_measurements)
        if reading.corrects:
            continue
        if solution is not None:
            found[reading.name] = motion_innovations(
                motion_measurements,
                solution.T_curr_prev,
                curr,
                cov=solution.cov,
                common_mode=common_mode,
            )
        elif reckoned is not None:
            found[reading.name] = [
                _reckoned_innovation(one, curr, reckoned) for one in motion_measurements
            ]
    return found


def _reckoned_innovation(
    measurement: Measurement, curr: Variable, reckoned: MotionEstimate
) -> SensorInnovation:
    """Return the innovation of a measurement of the motion against a dead-reckoned one."""
    if not isinstance(measurement, VectorMeasurement) or measurement.has_own_loss:
        return SensorInnovation(None, 1.0)
    values = {variable: np.eye(4) for variable in measurement.variables}
    values[curr] = reckoned.T_curr_prev
    mahalanobis_sq = measurement.innovation_squared(values, reckoned.cov, of=curr)
    dim = len(measurement.covariance)
    return SensorInnovation(
        mahalanobis_sq,
        bounded_weight(mahalanobis_sq, large_residual_threshold(dim)),
        is_gated=_is_beyond_gate(mahalanobis_sq, dim),
    )


def motion_innovations(
    measurements: Sequence[Measurement],
    T_curr_prev: FloatArray,
    curr: Variable,
    *,
    cov: FloatArray,
    common_mode: FloatArray,
) -> list[SensorInnovation]:
    """Return the innovations of a solve's own measurements of the motion.

    The residuals after a solve that used a measurement are too small for a test. The innovation is
    recovered from them: with r the residual, R the covariance of the measurement over its weight,
    and P the covariance of the motion without it, P⁻¹ = cov⁻¹ − Jᵀ R⁻¹ J, the innovation is
    (R + J P Jᵀ) R⁻¹ r. Errors of the rig, which are no part of P, are in it, too: its covariance is
    R + J (P + U Uᵀ) Jᵀ.

    Args:
        measurements: of the motion.
        T_curr_prev: the solved motion, [4, 4].
        curr: the pose that was solved for; the previous pose is the identity.
        cov: covariance of the solved motion, [6, 6].
        common_mode: U, how errors of the rig move the motion of the images, [6, C].
    """
    if not measurements:
        return []
    values = {variable: np.eye(4) for one in measurements for variable in one.variables}
    values[curr] = T_curr_prev
    information = np.linalg.inv(cov)
    found: list[SensorInnovation] = []
    for measurement in measurements:
        weight = float(measurement.outcome(values).weight.min())
        found.append(SensorInnovation(None, weight))
        if not isinstance(measurement, VectorMeasurement) or measurement.has_own_loss:
            continue
        # r = R_w (R_w + J P Jᵀ)⁻¹ ν for the innovation ν, with R_w the covariance over the weight.
        jacobian = measurement.jacobians(values)[measurement.variables.index(curr)]
        R = measurement.covariance
        used = R / max(weight, 1e-12)
        without = information - jacobian.T @ np.linalg.solve(used, jacobian)
        if np.linalg.eigvalsh(without)[0] <= 0.0:
            continue  # no other measurement constrains what this one measures
        spread = jacobian @ np.linalg.solve(without, jacobian.T)
        innovation = (used + spread) @ np.linalg.solve(used, measurement.residual(values))
        # Tested with its own covariance R, not with that over the weight.
        rig_error = jacobian @ common_mode
        innovation_cov = R + spread + rig_error @ rig_error.T
        mahalanobis_sq = float(squared_mahalanobis(innovation, innovation_cov))
        found[-1] = SensorInnovation(
            mahalanobis_sq, weight, is_gated=_is_beyond_gate(mahalanobis_sq, len(R))
        )
    return found

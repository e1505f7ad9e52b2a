"""Levenberg–Marquardt over a small set of variables, for whatever measurements constrain them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from probevo.arrays import FloatArray
from probevo.compiled import compiled, solve_positive_definite
from probevo.measurements.base import Linearization, Measurement
from probevo.measurements.variables import Values, Variable, blocks_of, retract

CONVERGED_BELOW = 1e-3
"""The solve has converged once a step is shorter than this many standard deviations."""
PROPAGATE_AFTER = 1.0
"""Distance, in standard deviations, from where the measurements' covariances were last
propagated, beyond which they are propagated again. Within one, their age changes the estimate by
less than a hundredth of a standard deviation."""
MAX_PROPAGATIONS = 50
"""A bound against cycles. From a guess as good as RANSAC's it takes two or three; where few
features agree with their noise, reweighted least squares creeps, and it may take thirty."""
COST_ROUNDING = 1e-12
"""Relative rise of the cost that rounding explains."""
FIRST_DAMPING = 1e-6
"""Share of the Hessian's diagonal that is first added to it."""
RETRY_DAMPING = 1e-3
"""Smallest damping after a step that has raised the cost."""
NEWTON_BELOW = 1e-3
"""Damping below which, after two accepted steps, the solve is close enough for Newton's Hessian."""


@dataclass(frozen=True)
class Optimum:
    """The result of a solve."""

    values: Values
    measurements: tuple[Measurement, ...]
    """The measurements, with their covariances as last propagated."""
    iterations: int
    converged: bool


@dataclass(frozen=True)
class _Layout:
    """Where the free variables lie in the joint vector, and in that of each measurement."""

    blocks: dict[Variable, slice]
    dof: int
    placements: tuple[tuple[tuple[slice, slice], ...], ...]
    """For each measurement, for each of its free variables: where it lies in the joint vector, and
    where in the measurement's own."""
    is_single: bool
    """Whether there is one measurement, of just the free variables: its normal equations are the
    sum."""

    @staticmethod
    def of(
        measurements: Sequence[Measurement], values: Values, free: Sequence[Variable]
    ) -> _Layout:
        """Place the blocks of each measurement among those of the free variables."""
        blocks, dof = blocks_of(free, values)
        placements = []
        for measurement in measurements:
            own, _ = blocks_of(measurement.variables, values)
            placements.append(tuple((blocks[key], at) for key, at in own.items() if key in blocks))
        is_single = len(measurements) == 1 and tuple(free) == measurements[0].variables
        return _Layout(blocks, dof, tuple(placements), is_single)

    def add_up(
        self, measurements: Sequence[Measurement], values: Values, *, newton: bool
    ) -> Linearization:
        """Sum the normal equations of all measurements."""
        # The usual case, the features of a frame and nothing else, needs no copies.
        if self.is_single:
            return measurements[0].linearize(values, newton=newton)
        total = Linearization(0.0, np.zeros((self.dof, self.dof)), np.zeros(self.dof))
        cost = 0.0
        for measurement, placement in zip(measurements, self.placements, strict=True):
            own = measurement.linearize(values, newton=newton)
            cost += own.cost
            for rows, own_rows in placement:
                total.gradient[rows] += own.gradient[own_rows]
                for columns, own_columns in placement:
                    total.hessian[rows, columns] += own.hessian[own_rows, own_columns]
        return total._replace(cost=cost)

    def moved(self, values: Values, step: FloatArray) -> Values:
        """Move the free variables by their parts of a step."""
        free = {key: retract(values[key], step[at]) for key, at in self.blocks.items()}
        return {**values, **free}


def minimize(
    measurements: Sequence[Measurement],
    values: Values,
    free: Sequence[Variable],
    *,
    max_iterations: int = 20,
) -> Optimum:
    """Find the most likely values of the free variables: the minimum of the measurements' costs.

    The covariances of measurements that depend on the values (as a triangulated point's does on the
    motion) are propagated when the values have moved by a good part of their own standard
    deviation, and are held otherwise, so that the cost is one function near the optimum.

    Args:
        measurements: whatever constrains the variables.
        values: where to start, of all variables; those that are not free stay as they are.
        free: the variables to solve for.
        max_iterations: 0 keeps the values, and propagates the covariances there.
    """
    layout = _Layout.of(measurements, values, free)
    # Covariances of measurements are those at the start, until the values have moved far.
    measurements = tuple(measurement.propagated(values) for measurement in measurements)
    if max_iterations == 0:
        return Optimum(values, measurements, iterations=0, converged=True)
    system = layout.add_up(measurements, values, newton=False)
    damping = FIRST_DAMPING
    newton = False  # whether the current system has Newton's Hessian
    accepted = 0
    propagations = 1
    distance = 0.0  # sum of the lengths of all steps since the last propagation, in σ
    step = np.empty(layout.dof)
    for iteration in range(1, max_iterations + 1):
        if not _damped_step(system.hessian, system.gradient, damping, step):
            if not newton:
                return Optimum(values, measurements, iteration, converged=False)
            # Newton's Hessian may be indefinite; that of IRLS is not.
            newton = False
            accepted = 0
            system = layout.add_up(measurements, values, newton=False)
            continue
        trial = layout.moved(values, step)
        # IRLS converges linearly under a loss of heavy tails. Newton's Hessian, which has the
        # curvature of the loss, makes that quadratic, but is positive definite near the optimum
        # only.
        trial_newton = accepted > 1 and damping < NEWTON_BELOW
        trial_system = layout.add_up(measurements, trial, newton=trial_newton)
        # stepᵀ H step for an undamped step: its squared length in standard deviations, and twice
        # the decrease of the cost that the quadratic model predicts.
        step_squared = float(np.sum(step * system.gradient))
        # A cost of NaN is rejected, too.
        if not trial_system.cost <= system.cost * (1.0 + COST_ROUNDING):
            if not newton and step_squared < CONVERGED_BELOW**2:
                # It is at the optimum; only rounding makes the cost rise, as without noise.
                return Optimum(
                    values, measurements, iteration, converged=distance <= PROPAGATE_AFTER
                )
            # The cost has risen: retry with the IRLS Hessian, which is positive definite, then with
            # a shorter step.
            if newton:
                newton = False
                system = layout.add_up(measurements, values, newton=False)
            else:
                damping = max(RETRY_DAMPING, 10.0 * damping)
            continue
        # Accept the step, and damp the next one less.
        values = trial
        system = trial_system
        newton = trial_newton
        damping *= 0.1
        accepted += 1
        distance += math.sqrt(max(step_squared, 0.0))
        # The covariance of a triangulated point depends on the motion. If it varied within the
        # cost, the solve could reduce the cost by moving to where points are uncertain. So hold it,
        # and propagate it again only after a large move.
        if distance > PROPAGATE_AFTER and propagations < MAX_PROPAGATIONS:
            propagations += 1
            distance = 0.0
            if iteration < max_iterations:
                measurements = tuple(each.propagated(values) for each in measurements)
                system = layout.add_up(measurements, values, newton=newton)
        elif step_squared < CONVERGED_BELOW**2:
            return Optimum(values, measurements, iteration, converged=distance <= PROPAGATE_AFTER)
    return Optimum(values, measurements, max_iterations, converged=False)


def information(
    measurements: Sequence[Measurement], values: Values, variables: Sequence[Variable]
) -> FloatArray:
    """Sum the information of measurements on some variables, [n, n]; the others are held."""
    layout = _Layout.of(measurements, values, variables)
    total = np.zeros((layout.dof, layout.dof))
    for measurement, placement in zip(measurements, layout.placements, strict=True):
        own = measurement.information(values)
        for rows, own_rows in placement:
            for columns, own_columns in placement:
                total[rows, columns] += own[own_rows, own_columns]
    return total


@compiled
def _damped_step(
    hessian: FloatArray, gradient: FloatArray, damping: float, step: FloatArray
) -> bool:
    """Solve (H + λ diag H) step = gradient; False where that is not positive definite."""
    dof = len(gradient)
    # Damping by the diagonal (Marquardt) does not depend on the units of metres and radians.
    damped = hessian.copy()
    for i in range(dof):
        damped[i, i] += damping * hessian[i, i]
    return solve_positive_definite(damped, gradient, np.zeros((dof, dof)), step)

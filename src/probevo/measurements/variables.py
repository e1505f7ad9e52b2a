"""The unknowns of an estimate: poses and vectors, each of a frame, with their values and steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from probevo.arrays import FloatArray
from probevo.geometry.se3_numba import perturb


class Variable(NamedTuple):
    """An unknown of the problem."""

    kind: str
    """Its kind, e.g. ``pose``."""
    frame: int
    """Index of the frame that it belongs to."""


def pose_of(frame: int) -> Variable:
    """Return the variable T_cam_world of a frame, [4, 4], perturbed from the left by ξ, [6]."""
    return Variable(kind="pose", frame=frame)


class PosePair(NamedTuple):
    """The poses of the two frames that a relative measurement connects."""

    curr: Variable
    """Pose of the current frame."""
    prev: Variable | None = None
    """Pose of the previous frame; None if the world of the poses is the previous camera."""


MOTION = pose_of(0)
"""The default variable of a two-frame solve. With the previous camera as the world, the pose of the
current camera is the motion T_curr_prev."""

TWO_FRAMES = PosePair(MOTION)
"""The poses of a two-frame solve."""

Values = Mapping[Variable, FloatArray]
"""A value for each variable: poses T_cam_world [4, 4], anything else a vector [n]."""


def dimension(value: FloatArray) -> int:
    """Return the number of degrees of freedom of a variable's value."""
    return 6 if value.shape == (4, 4) else len(value)


def retract(value: FloatArray, step: FloatArray) -> FloatArray:
    """Move a value by a step: Exp(ξ) T for a pose, plain addition for a vector.

    Args:
        value: T_cam_world, [4, 4], m; or a vector, [n], in units of its own.
        step: ξ = [ρ; φ], [6], m and rad, in the camera's frame; or a vector, [n].
    """
    if value.shape != (4, 4):
        return value + step
    moved = np.empty((4, 4))
    perturb(step, value, moved)
    return moved


def blocks_of(variables: Sequence[Variable], values: Values) -> tuple[dict[Variable, slice], int]:
    """Return where each variable's degrees of freedom lie in the joint vector, and their number."""
    slices: dict[Variable, slice] = {}
    start = 0
    for variable in variables:
        stop = start + dimension(values[variable])
        slices[variable] = slice(start, stop)
        start = stop
    return slices, start

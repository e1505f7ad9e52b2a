"""Elimination of the rig's jitter from the normal equations of a window.

ω_k ~ N(0, S) is new in each frame (``camera.rig_jitter``). The landmarks are eliminated before,
which couples the jitters of all frames that saw the same one: all 3K are eliminated together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.estimation.window import Window
from probevo.estimation.window_numba import FRAME, POSE, RIG, NormalEquations


@dataclass(frozen=True)
class JitterElimination:
    """What finds the jitters once poses and rig are known: ω' − ω = offset − gain · step."""

    offset: FloatArray
    """[3K], rad."""
    gain: FloatArray
    """[3K, 6K + 4]."""


def jitter_places(num_frames: int) -> tuple[IntArray, IntArray]:
    """Return where the jitters lie in a vector of frames and rig, [3K], and all else, [6K + 4]."""
    size = FRAME * num_frames + RIG
    is_jitter = np.zeros(size, np.bool_)
    is_jitter[: FRAME * num_frames].reshape(-1, FRAME)[:, POSE:] = True
    return np.flatnonzero(is_jitter), np.flatnonzero(~is_jitter)


def without_jitter(
    window: Window, equations: NormalEquations
) -> tuple[NormalEquations, JitterElimination, float]:
    """Eliminate the jitters of all frames, with their prior N(0, S).

    Args:
        window: K frames.
        equations: of their poses, jitters and the rig, without the prior.

    Returns:
        The equations of poses and rig, what finds the jitters, and the cost of their prior.
    """
    jitter, others = jitter_places(len(window))
    information = np.kron(np.eye(len(window)), np.linalg.inv(window.jitter_cov))
    towards_prior = -information @ window.jitter.ravel()
    of_jitter = equations.hessian[np.ix_(jitter, jitter)] + information
    coupling = equations.hessian[np.ix_(jitter, others)]
    gradient = equations.gradient[jitter] + towards_prior
    solved = np.asarray(
        np.linalg.solve(of_jitter, np.column_stack([coupling, gradient])), np.float64
    )
    gain = solved[:, :-1]
    offset = solved[:, -1]
    hessian = equations.hessian[np.ix_(others, others)] - coupling.T @ gain
    reduced = NormalEquations(
        hessian=0.5 * (hessian + hessian.T),
        gradient=equations.gradient[others] - coupling.T @ offset,
    )
    cost = -0.5 * float(window.jitter.ravel() @ towards_prior)
    return reduced, JitterElimination(offset=offset, gain=gain), cost

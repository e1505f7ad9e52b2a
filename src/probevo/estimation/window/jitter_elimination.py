"""Elimination of the rig's jitter from the normal equations of a window.

ω_k ~ N(0, S) is new in each frame (``camera.rig_jitter``). The landmarks are eliminated before,
which couples the jitters of all frames that saw the same one: all 3K are eliminated together.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.estimation.window.equations import FRAME, JITTER, POSE, RIG, WindowEquations
from probevo.estimation.window.window import Window


@dataclass(frozen=True)
class JitterElimination:
    """What finds the jitters once poses and rig are known: ω' − ω = offset − gain · step."""

    offset: FloatArray
    """[3K], rad."""
    gain: FloatArray
    """[3K, 6K + 4]."""


@lru_cache(maxsize=32)
def jitter_columns(num_frames: int) -> tuple[IntArray, IntArray]:
    """Return where the jitters lie in a vector of frames and rig, [3K], and all else, [6K + 4].

    Both are kept for the next call with as many frames, and cannot be written to.
    """
    size = FRAME * num_frames + RIG
    is_jitter = np.zeros(size, np.bool_)
    is_jitter[: FRAME * num_frames].reshape(-1, FRAME)[:, POSE:] = True
    columns = np.flatnonzero(is_jitter), np.flatnonzero(~is_jitter)
    for part in columns:
        part.flags.writeable = False
    return columns


def eliminate_jitter(
    window: Window, equations: WindowEquations
) -> tuple[WindowEquations, JitterElimination, float]:
    """Eliminate the jitters of all frames, with their prior N(0, S).

    Args:
        window: K frames.
        equations: of their poses, jitters and the rig, without the prior.

    Returns:
        The equations of poses and rig, what finds the jitters, and the cost of their prior.
    """
    jitter, others = jitter_columns(len(window))
    information = np.linalg.inv(window.jitter_cov)
    towards_prior = -window.jitter @ information  # [K, 3]
    rows_of_jitter = equations.hessian[jitter]
    jitter_hessian = rows_of_jitter[:, jitter]
    # The Hessian block of all jitters, [3K, 3K]. S⁻¹ of each frame stands in a block of its own on
    # the diagonal.
    for at in range(0, len(jitter), JITTER):
        jitter_hessian[at : at + JITTER, at : at + JITTER] += information
    # One solve for both right-hand sides: the coupling to poses and rig, and the gradient.
    right_hand_sides = np.empty((len(jitter), len(others) + 1))
    right_hand_sides[:, :-1] = rows_of_jitter[:, others]
    right_hand_sides[:, -1] = equations.gradient[jitter] + towards_prior.ravel()
    solved = np.asarray(np.linalg.solve(jitter_hessian, right_hand_sides), np.float64)
    gain = solved[:, :-1]
    offset = solved[:, -1]
    # The Schur complement H_oo − H_oj H_jj⁻¹ H_jo of the others o and the jitters j; the last
    # column is that of the gradient, g_o − H_oj H_jj⁻¹ g_j.
    reduced = right_hand_sides[:, :-1].T @ solved
    hessian = equations.hessian[others][:, others] - reduced[:, :-1]
    equations_of_rest = WindowEquations(
        hessian=0.5 * (hessian + hessian.T),
        gradient=equations.gradient[others] - reduced[:, -1],
    )
    # ½ Σ ωᵀ S⁻¹ ω.
    cost = -0.5 * float(window.jitter.ravel() @ towards_prior.ravel())
    return equations_of_rest, JitterElimination(offset=offset, gain=gain), cost

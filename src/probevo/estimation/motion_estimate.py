"""The result of one step: a relative motion, how sure it is, and how it came about."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np

from probevo.arrays import FloatArray


class Status(IntEnum):
    """How a motion came about. In all but FIRST and OK it is carried on from gyro and last
    velocity, much less sure."""

    FIRST = 0
    """The first frame: identity, zero covariance."""
    OK = 1
    DEGENERATE = 2
    """The features do not fix all six degrees of freedom."""
    TOO_FEW_TRACKS = 3
    NOT_CONVERGED = 4
    """The solve did not reach an optimum, or reached one that the motion so far makes absurd."""
    GAP = 5
    """The motion could not be solved, and frames are missing before this one."""


@dataclass(frozen=True)
class MotionEstimate:
    """Motion of the camera from the previous frame to this one."""

    T_curr_prev: FloatArray
    """p_curr = T_curr_prev p_prev, [4, 4], m."""
    cov: FloatArray
    """Covariance of the left perturbation ξ = [ρ; φ], T = Exp(ξ) T_curr_prev, [6, 6], m and rad."""
    status: Status
    num_tracks: int
    """Tracks that the step had."""
    num_inliers: int = 0
    """Tracks that are trusted by at least one half, of 0 to 1 (``motion.trust``)."""
    iterations: int = 0
    common_mode: FloatArray = field(default_factory=lambda: np.zeros((6, 3)))
    """The part of ``cov`` that all steps have in common, the doubt about the calibration: ξ moves
    along these columns, [6, 3], by the same three numbers of unit variance in every step, and cov
    contains common_mode common_modeᵀ."""
    path_cross_cov: FloatArray = field(default_factory=lambda: np.zeros((6, 6)))
    """Covariance of the error of the path before this step, along the axes of the current camera,
    with that of the step, [6, 6]: both know the same tracks, or the same velocity. A path P = Ad P
    Adᵀ + cov grows by path_cross_cov + path_cross_covᵀ besides."""
    stage_ms: Mapping[str, float] = field(default_factory=dict)
    """Wall time of each stage of this step, ms."""
    num_used: int = 0
    """Tracks that the solve used; 0 where there was none."""
    num_out_of_domain: int | None = None
    """Those of them that lie where the noise model has seen no training data; None where there was
    no solve, or for models that have seen none at all."""

"""How badly a feature fitted the motion of the step before."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray

FLOOR_PX = 0.1
"""Residuals below this are as good as none."""


def last_residual(size_px: FloatArray) -> FloatArray:
    """ln(0.1 + ‖e‖/px) of the residual that a feature left in the step before, at the motion
    believed then. Ours.

    What errs goes on to err: a car drives on, a window goes on slipping. Unlike ``residual_flow``
    this does not look at
    the current observation, so that it cannot confirm the motion that is expected.

    Args:
        size_px: ‖e‖ in the step before, [N], px; NaN where unknown.

    Returns:
        [N], ln px; NaN where the residual is unknown.
    """
    return np.log(FLOOR_PX + size_px)

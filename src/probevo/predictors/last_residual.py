"""The residual of a feature in the previous step."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.predictors.base import Needs, Predictor

FLOOR_PX = 0.1
"""Added to the residual: smaller ones hardly differ from none."""


def last_residual(size_px: FloatArray) -> FloatArray:
    """Compute ln(0.1 + ‖e‖/px) of a feature's residual e at the previous step's motion. Ours.

    Errors are correlated in time: a car drives on, a window goes on slipping. Unlike
    ``residual_flow``, this predictor does not look at the current observation, so that it cannot
    confirm the predicted motion. But it depends on the motion that was estimated before.

    Args:
        size_px: ‖e‖ in the previous step, [N], px; NaN where unknown.

    Returns:
        [N], ln(0.1 + px); NaN where the previous step has no residual of the feature.
    """
    return np.log(FLOOR_PX + size_px)


LAST_RESIDUAL = Predictor(
    name="last_residual",
    columns={"last_residual": "ln(0.1 + px)"},
    source="ours",
    needs=Needs.TRACKS,
    compute=lambda step: last_residual(step.previous_residual_px),
    undefined="where the previous step has none",
    depends_on_previous_motion=True,
)

"""Detection of frozen images: they do not change although the camera moves, as when a driver
hangs."""

from __future__ import annotations

import numpy as np

from probevo.estimation.motion_model import MotionModel, MotionPrediction
from probevo.sequences.frame import Frame, is_repeated, looks_repeated


def are_frozen(
    prev_frame: Frame,
    frame: Frame,
    model: MotionModel,
    prediction: MotionPrediction,
    *,
    were_frozen: bool,
) -> bool:
    """Return whether the images do not change although the camera moves.

    They are the same bytes, or the same except for noise, and the camera was too fast to have come
    to rest within the step. They count as frozen until they change.

    Args:
        prev_frame: the previous frame.
        frame: the current frame.
        model: the motion model before the step.
        prediction: the motion that it predicts.
        were_frozen: whether the images were frozen in the previous frame.
    """
    if not model.is_moving:
        return False
    if is_repeated(prev_frame, frame):
        return True
    cannot_rest = prediction.fails_gate(np.eye(4), np.zeros((6, 6)))
    return (were_frozen or cannot_rest) and looks_repeated(prev_frame, frame)

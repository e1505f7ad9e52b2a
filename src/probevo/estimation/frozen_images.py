"""Whether images that repeat are those of a camera that hangs, or of one at rest."""

from __future__ import annotations

from enum import Enum

import numpy as np

from probevo.estimation.motion_model import MotionModel, MotionPrediction
from probevo.sequences.frame import Frame
from probevo.tracking.repeated_images import are_repeated, look_repeated


class Repetition(Enum):
    """Whether the images of a frame repeat those of the previous one."""

    NONE = "none"
    AMBIGUOUS = "ambiguous"
    """They repeat, and the camera either rests or moves unseen."""
    FROZEN = "frozen"
    """They do not change although the camera moves."""


def repetition_of(
    prev_frame: Frame,
    frame: Frame,
    model: MotionModel,
    prediction: MotionPrediction,
    *,
    were_frozen: bool,
) -> Repetition:
    """Return whether the images of a frame repeat those of the previous one.

    Args:
        prev_frame: the previous frame.
        frame: the current frame.
        model: the motion model before the step.
        prediction: the motion that it predicts.
        were_frozen: whether the images were frozen in the previous frame.
    """
    if _are_frozen(prev_frame, frame, model, prediction, were_frozen=were_frozen):
        return Repetition.FROZEN
    if _may_be_frozen(prev_frame, frame, model):
        return Repetition.AMBIGUOUS
    return Repetition.NONE


def _are_frozen(
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
    """
    if not model.is_moving:
        return False
    if are_repeated(prev_frame, frame):
        return True
    cannot_rest = prediction.squared_distance(np.eye(4), np.zeros((6, 6))) > prediction.gate
    return (were_frozen or cannot_rest) and look_repeated(prev_frame, frame)


def _may_be_frozen(prev_frame: Frame, frame: Frame, model: MotionModel) -> bool:
    """Return whether the images repeat without telling whether the camera rests.

    Equal bytes mean a dropped frame, except from a camera without noise. Images that are equal but
    for noise are ambiguous if the last solved motion followed repeated images, or if a solve was
    rejected, as in a video whose frames come twice.
    """
    if are_repeated(prev_frame, frame):
        return True
    is_ambiguous = model.is_after_repetition or model.rejections > 0
    return is_ambiguous and look_repeated(prev_frame, frame)

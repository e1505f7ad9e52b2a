"""A step with self-calibration, from its tracks: ``from calibrated_steps import calibrated``."""

import numpy as np

from probevo.estimation.disparity_filter import DisparityFilter
from probevo.estimation.motion_model import MotionModel
from probevo.estimation.self_calibration import CalibratedMotion, SelfCalibratingEstimator
from probevo.estimation.visual_estimator import VisualEstimator
from probevo.estimation.visual_motion import MotionPriors
from probevo.stage_clock import StageClock
from probevo.tracking.corrected_tracks import CorrectedTracks
from worlds import CAMERA


def calibrated(
    visual: VisualEstimator,
    corrected: CorrectedTracks,
    model: MotionModel,
    duration_s: float,
    last: MotionModel | None = None,
) -> CalibratedMotion:
    """Return the motion of tracks that have no predictors.

    Args:
        visual: estimates the motion of corrected tracks.
        corrected: the tracks.
        model: predicts the motion.
        duration_s: time between the two frames.
        last: with the velocity of the previous step, if it is not that of ``model``.
    """
    return SelfCalibratingEstimator(CAMERA, visual).estimate(
        corrected,
        np.zeros((len(corrected.raw), 0)),
        MotionPriors(model.predict(duration_s, None), None, DisparityFilter.none()),
        motion_model=model if last is None else last,
        duration_s=duration_s,
        seed=(0, 1),
        clock=StageClock(),
    )

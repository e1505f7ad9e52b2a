"""The residual of the previous step, as a predictor of the current one."""

import math
from dataclasses import replace

import numpy as np

from probevo.predictors import Step, prediction_space
from probevo.predictors.last_residual import FLOOR_PX, last_residual
from probevo.sequences.frame import Frame
from probevo.tracking.last_residuals import LastResiduals
from worlds import CAMERA, FORWARD, FRAME_NS, seen_twice

SPACE = prediction_space(["last_residual"])
TRACKS = seen_twice(np.random.default_rng(0), 4)
FIRST_STEP = Step(
    tracks=TRACKS,
    camera=CAMERA,
    predicted_T_curr_prev=FORWARD,
    prev_frame=Frame(0, 0),
    curr_frame=Frame(1, FRAME_NS),
)


def test_it_is_a_logarithm_with_a_floor() -> None:
    values = last_residual(np.array([0.0, 0.9, 30.0, np.nan]))
    np.testing.assert_allclose(
        values, [math.log(FLOOR_PX), 0.0, math.log(30.1), np.nan], atol=1e-15
    )


def test_residuals_are_those_of_the_same_features_in_the_previous_step() -> None:
    """TRACKS have the identities 0, 1, 2, 3."""
    residuals = LastResiduals(np.array([7, 3, 1]), np.array([5.0, 0.4, 1.9]))
    phi = SPACE(replace(FIRST_STEP, previous_residuals=residuals))
    np.testing.assert_allclose(
        phi[:, 0], [np.nan, math.log(2.0), np.nan, math.log(0.5)], atol=1e-15
    )


def test_a_first_step_has_none() -> None:
    assert np.isnan(SPACE(FIRST_STEP)).all()
    assert SPACE.may_be_undefined == (True,)

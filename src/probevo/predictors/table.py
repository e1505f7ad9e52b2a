"""Every predictor there is, with unit, source and needs. Yours: add a ``Predictor`` to a
``PredictionSpace``."""

from __future__ import annotations

from collections.abc import Sequence
from difflib import get_close_matches

import numpy as np

from probevo.arrays import FloatArray
from probevo.errors import InputError
from probevo.predictors.acceleration import acceleration
from probevo.predictors.age import age
from probevo.predictors.base import Needs, PredictionSpace, Predictor, Step
from probevo.predictors.blur import blur
from probevo.predictors.disparity import disparity
from probevo.predictors.disparity_change import disparity_change
from probevo.predictors.entropy import entropy
from probevo.predictors.flow import flow
from probevo.predictors.flow_variance import flow_variance
from probevo.predictors.forward_backward import forward_backward
from probevo.predictors.frequency import frequency
from probevo.predictors.last_residual import last_residual
from probevo.predictors.motion import velocity
from probevo.predictors.place import place
from probevo.predictors.residual_flow import residual_flow
from probevo.predictors.row_offset import row_offset
from probevo.predictors.structure import structure
from probevo.predictors.turn_rate import turn_rate
from probevo.predictors.window_difference import window_difference
from probevo.tracking.last_residuals import LAST_RESIDUAL

OFF_IMAGE = "where the patch leaves the image"


def _for_all(values: FloatArray, step: Step) -> FloatArray:
    """What is the same for all N features, [C] to [N, C]."""
    return np.broadcast_to(values, (len(step.tracks), len(values)))


def _scaled(size_px: float, step: Step) -> float:
    """What a size on KITTI's images, whose focal length is 720 px, is on this camera's."""
    return size_px * step.camera.fu_px / 720.0


_TABLE = (
    # Of PROBE, in its order.
    Predictor(
        "acceleration",
        {"acceleration": "m/s²", "vibration": "m/s²"},
        "PROBE IV-C.1",
        needs=Needs.ACCELEROMETER,
        compute=lambda s: _for_all(acceleration(s.imu), s),
        undefined="where samples of the IMU are missing",
    ),
    Predictor(
        "turn_rate",
        {
            "turn_rate_x": "rad/s",
            "turn_rate_y": "rad/s",
            "turn_rate_z": "rad/s",
            "turn_rate": "rad/s",
        },
        "PROBE IV-C.1; signed: ours",
        needs=Needs.TRACKS,
        compute=lambda s: _for_all(turn_rate(s.expected, s.duration_s), s),
    ),
    Predictor(
        "blur",
        {"blur": "0 sharp … 1 blurred"},
        "PROBE IV-C.3; Crete et al. 2007",
        needs=Needs.LEFT,
        compute=lambda s: blur(s.left, s.uv),
        undefined=OFF_IMAGE,
    ),
    Predictor(
        "entropy",
        {"entropy": "bit"},
        "PROBE eq. (16)",
        needs=Needs.LEFT,
        compute=lambda s: entropy(s.left, s.uv),
        undefined=OFF_IMAGE,
    ),
    Predictor(
        "frequency",
        {"low_frequency": "ln(1 + grey levels)", "high_frequency": "ln(1 + grey levels)"},
        "PROBE IV-C.5",
        needs=Needs.LEFT,
        compute=lambda s: frequency(s.left, s.uv),
        undefined=OFF_IMAGE,
    ),
    Predictor(
        "flow_variance",
        {"flow_variance": "ln of a ratio"},
        "PROBE eq. (17)",
        needs=Needs.TRACKS,
        compute=lambda s: flow_variance(
            s.previous_uv, s.uv, small_px=_scaled(50, s), large_px=_scaled(200, s)
        ),
        undefined="where a feature has fewer than two neighbours",
    ),
    # Of PROBE-GK.
    Predictor(
        "place",
        {"x": "focal lengths", "y": "focal lengths"},
        "PROBE-GK: pixel location",
        needs=Needs.TRACKS,
        compute=lambda s: place(s.uv, s.camera),
    ),
    Predictor(
        "velocity",
        {"velocity_x": "m/s", "velocity_y": "m/s", "velocity_z": "m/s"},
        "PROBE-GK: transform parameters",
        needs=Needs.TRACKS,
        compute=lambda s: _for_all(velocity(s.expected, s.duration_s), s),
    ),
    # Ours.
    Predictor(
        "disparity",
        {"disparity": "ln px"},
        "ours",
        needs=Needs.TRACKS,
        compute=lambda s: disparity(s.tracks.curr_px),
    ),
    Predictor(
        "disparity_change",
        {"disparity_change": "ln(1 + px)"},
        "ours",
        needs=Needs.TRACKS,
        compute=lambda s: disparity_change(
            s.tracks.prev_px, s.tracks.curr_px, s.expected, camera=s.camera
        ),
    ),
    Predictor(
        "flow",
        {"flow": "ln(1 + px)"},
        "ours",
        needs=Needs.TRACKS,
        compute=lambda s: flow(s.tracks.prev_px, s.tracks.curr_px),
    ),
    Predictor(
        "residual_flow",
        {"residual_flow": "ln(1 + px)"},
        "ours",
        needs=Needs.TRACKS,
        compute=lambda s: residual_flow(
            s.tracks.prev_px, s.tracks.curr_px, s.expected, camera=s.camera
        ),
    ),
    Predictor(
        LAST_RESIDUAL,
        {LAST_RESIDUAL: "ln(0.1 + px)"},
        "ours",
        needs=Needs.TRACKS,
        compute=lambda s: last_residual(s.last_residual_px),
        undefined="where the step before left none",
    ),
    Predictor(
        "row_offset",
        {"row_offset": "px"},
        "ours",
        needs=Needs.TRACKS,
        compute=lambda s: row_offset(s.tracks.curr_px),
    ),
    Predictor(
        "age", {"age": "ln frames"}, "ours", needs=Needs.TRACKS, compute=lambda s: age(s.tracks.age)
    ),
    Predictor(
        "window_difference",
        {
            "difference_in_time": "ln(1 + grey levels)",
            "difference_in_stereo": "ln(1 + grey levels)",
        },
        "ours",
        needs=Needs.LEFT,
        compute=lambda s: window_difference(s.tracks),
    ),
    Predictor(
        "forward_backward",
        {"forward_backward": "ln(0.01 + px)"},
        "ours",
        needs=Needs.LEFT | Needs.PREVIOUS_LEFT,
        compute=lambda s: forward_backward(s.previous_left, s.left, s.previous_uv, uv=s.uv),
        undefined="where the search fails",
    ),
    Predictor(
        "structure",
        {"structure_min": "ln(1 + (grey level/px)²)", "structure_max": "ln(1 + (grey level/px)²)"},
        "Shi & Tomasi 1994",
        needs=Needs.LEFT,
        compute=lambda s: structure(s.left, s.uv),
        undefined=OFF_IMAGE,
    ),
)
PREDICTORS = {predictor.name: predictor for predictor in _TABLE}


def prediction_space(names: Sequence[str]) -> PredictionSpace:
    """The space of these predictors, in this order.

    Raises:
        InputError: one of them is not known.
    """
    unknown = [name for name in names if name not in PREDICTORS]
    if unknown:
        near = get_close_matches(unknown[0], PREDICTORS, n=1)
        cure = f"Did you mean {near[0]}?" if near else f"Known are {', '.join(PREDICTORS)}."
        raise InputError("--predictors", f"{unknown[0]} is not known.", cure)
    return PredictionSpace(tuple(PREDICTORS[name] for name in names))


def space_for(columns: Sequence[str], given: PredictionSpace | None = None) -> PredictionSpace:
    """The space that has exactly these columns, in this order: the given one, or else one of known
    predictors.

    A model that needs no columns takes any space.

    Raises:
        InputError: the given space has other columns or another order, or a column belongs to no
            known predictor.
    """
    if given is None:
        owners = {column: predictor for predictor in _TABLE for column in predictor.columns}
        unknown = [column for column in columns if column not in owners]
        if unknown:
            cure = (
                "In Python, give StereoOdometry the predictors of the training; commands know the"
                " built-in ones."
            )
            raise InputError("noise model", f"its predictor {unknown[0]} is not known.", cure)
        given = PredictionSpace(
            tuple({owners[column].name: owners[column] for column in columns}.values())
        )
    if columns and given.columns != tuple(columns):
        what = (
            f"it was trained on {', '.join(columns)}, in this order, but gets"
            f" {', '.join(given.columns) or 'none'}."
        )
        raise InputError(
            "noise model", what, "Give it the predictors that it was trained with, in their order."
        )
    return given

"""Every predictor there is, with unit, source and needs. Yours: add a ``Predictor`` to a ``PredictionSpace``."""

from __future__ import annotations

from collections.abc import Sequence

from probevo.errors import InputError
from probevo.predictors.base import Needs, PredictionSpace, Predictor
from probevo.predictors.blur import blur

OFF_IMAGE = "where the patch leaves the image"

_TABLE = (
    Predictor("blur", {"blur": "0 sharp … 1 blurred"}, "Crete et al. 2007; PROBE IV-C.3", Needs.LEFT,
              lambda step: blur(step.left, step.uv), undefined=OFF_IMAGE),
)  # fmt: skip
PREDICTORS = {predictor.name: predictor for predictor in _TABLE}


def prediction_space(names: Sequence[str]) -> PredictionSpace:
    """The space of these predictors, in this order.

    Raises:
        InputError: one of them is not known.
    """
    unknown = [name for name in names if name not in PREDICTORS]
    if unknown:
        raise InputError("predictors", f"{unknown[0]} is not known.", f"Known are {', '.join(PREDICTORS)}.")
    return PredictionSpace(tuple(PREDICTORS[name] for name in names))


def space_for(columns: Sequence[str], given: PredictionSpace | None = None) -> PredictionSpace:
    """The space that has exactly these columns, in this order: the given one, or else one of known predictors.

    A model that needs no columns takes any space.

    Raises:
        InputError: the given space has other columns or another order, or a column belongs to no known predictor.
    """
    if given is None:
        owners = {column: predictor for predictor in _TABLE for column in predictor.columns}
        unknown = [column for column in columns if column not in owners]
        if unknown:
            cure = "Give the predictors that it was trained with to StereoOdometry."
            raise InputError("noise model", f"its predictor {unknown[0]} is not known.", cure)
        given = PredictionSpace(tuple(dict.fromkeys(owners[column] for column in columns)))
    if columns and given.columns != tuple(columns):
        what = f"it was trained on {', '.join(columns)}, in this order, but gets {', '.join(given.columns) or 'none'}."
        raise InputError("noise model", what, "Give it the predictors that it was trained with, in their order.")
    return given

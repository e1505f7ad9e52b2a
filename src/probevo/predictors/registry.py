"""The registry of predictors: the built-in ones, and the ones that other installed packages add.

A built-in predictor is listed here, once. Another package offers its own by an entry point in the
group ``probevo.predictors`` that names a ``Predictor``; CONTRIBUTING.md shows how.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from difflib import get_close_matches

from probevo.entry_points import entry_points, entry_text, load_entry
from probevo.errors import InputError
from probevo.predictors.acceleration import ACCELERATION
from probevo.predictors.age import AGE
from probevo.predictors.alignment import ALIGNMENT
from probevo.predictors.base import Predictor
from probevo.predictors.blur import BLUR
from probevo.predictors.disparity import DISPARITY
from probevo.predictors.disparity_change import DISPARITY_CHANGE
from probevo.predictors.entropy import ENTROPY
from probevo.predictors.flow import FLOW
from probevo.predictors.flow_variance import FLOW_VARIANCE
from probevo.predictors.forward_backward import FORWARD_BACKWARD
from probevo.predictors.frequency import FREQUENCY
from probevo.predictors.last_residual import LAST_RESIDUAL
from probevo.predictors.place import PLACE
from probevo.predictors.residual_flow import RESIDUAL_FLOW
from probevo.predictors.row_offset import ROW_OFFSET
from probevo.predictors.space import PredictionSpace
from probevo.predictors.structure import STRUCTURE
from probevo.predictors.turn_rate import TURN_RATE
from probevo.predictors.velocity import VELOCITY
from probevo.predictors.window_difference import WINDOW_DIFFERENCE

ENTRY_POINTS = "probevo.predictors"
"""Group of the entry points by which other packages offer predictors."""

_BUILT_IN = (
    # PROBE, in the order of the paper
    ACCELERATION,
    TURN_RATE,
    BLUR,
    ENTROPY,
    FREQUENCY,
    FLOW_VARIANCE,
    # PROBE-GK
    PLACE,
    VELOCITY,
    # Ours
    DISPARITY,
    DISPARITY_CHANGE,
    FLOW,
    RESIDUAL_FLOW,
    LAST_RESIDUAL,
    ROW_OFFSET,
    AGE,
    WINDOW_DIFFERENCE,
    FORWARD_BACKWARD,
    STRUCTURE,
    ALIGNMENT,
)
PREDICTORS: Mapping[str, Predictor] = {predictor.name: predictor for predictor in _BUILT_IN}
"""The built-in predictors by their names, in the order of their columns."""


def all_predictors() -> Mapping[str, Predictor]:
    """Collect the built-in predictors and the ones of installed entry points, by their names.

    Raises:
        InputError: an entry point cannot be loaded, or yields no predictor, or one whose name or
            column is taken.
    """
    predictors = dict(PREDICTORS)
    columns = {column for predictor in PREDICTORS.values() for column in predictor.columns}
    for entry in entry_points(group=ENTRY_POINTS):
        predictor = load_entry(entry, Predictor)
        if predictor.name in predictors or not columns.isdisjoint(predictor.columns):
            raise InputError(
                entry_text(entry),
                f"the name of the predictor {predictor.name}, or of a column of it, is taken.",
                "Give it other names, or uninstall its package.",
            )
        predictors[predictor.name] = predictor
        columns |= set(predictor.columns)
    return predictors


def prediction_space(names: Sequence[str]) -> PredictionSpace:
    """Make the space of the predictors of these names, in this order.

    Raises:
        InputError: one of them is not known.
    """
    known = PREDICTORS
    if not set(names) <= set(known):
        known = all_predictors()  # imports other packages, so only if one of theirs may be meant
    unknown = [name for name in names if name not in known]
    if unknown:
        near = get_close_matches(unknown[0], known, n=1)
        cure = f"Did you mean {near[0]}?" if near else f"Known are {', '.join(known)}."
        raise InputError("--predictors", f"{unknown[0]} is not known.", cure)
    return PredictionSpace(tuple(known[name] for name in names))


def space_for(columns: Sequence[str], given: PredictionSpace | None = None) -> PredictionSpace:
    """Find the space that has exactly these columns, in this order.

    This is the given space or, without one, a space of known predictors. A model that needs no
    columns takes any space.

    Args:
        columns: the columns of a noise model.
        given: the space that the user wants, such as one with predictors of their own.

    Raises:
        InputError: the given space has other columns or another order, or a column belongs to no
            known predictor.
    """
    space = _space_with(columns) if given is None else given
    if columns and space.columns != tuple(columns):
        needed = ", ".join(columns)
        gets = ", ".join(space.columns) or "none"
        raise InputError(
            "noise model",
            f"its columns are {needed}, in this order, but it gets {gets}.",
            "Give it the predictors that it was trained with, in their order. A model of your own"
            " names all columns of each predictor that it needs, such as x and y of place.",
        )
    return space


def _space_with(columns: Sequence[str]) -> PredictionSpace:
    """Make the space of the known predictors that own these columns, in their order."""
    owners = _column_owners(PREDICTORS)
    if not set(columns) <= set(owners):
        owners = _column_owners(all_predictors())
    unknown = [column for column in columns if column not in owners]
    if unknown:
        raise InputError(
            "noise model",
            f"its predictor {unknown[0]} is not known.",
            "In Python, give StereoOdometry the predictors of the training; commands know the"
            " built-in ones and those of installed packages.",
        )
    owning = {owners[column].name: owners[column] for column in columns}
    return PredictionSpace(tuple(owning.values()))


def _column_owners(predictors: Mapping[str, Predictor]) -> dict[str, Predictor]:
    return {column: each for each in predictors.values() for column in each.columns}

"""The known predictors, by name and by column, and those of other packages."""

from importlib.metadata import EntryPoint
from typing import Protocol

import pytest

from predictors.steps import own, ramp
from probevo.errors import InputError
from probevo.predictors import (
    PREDICTORS,
    PredictionSpace,
    all_predictors,
    prediction_space,
    registry,
    space_for,
)

RAMP = own("ramp", ramp)
NAMED_BLUR = own("blur", ramp, "other")
WITH_COLUMN_X = own("other", ramp, "x")
NO_PREDICTOR = ramp
"""What entry points of another package may name."""


class Install(Protocol):
    def __call__(self, *names: str) -> None: ...


@pytest.fixture
def install(monkeypatch: pytest.MonkeyPatch) -> Install:
    """Install a package with entry points to these names of this module."""

    def with_entry_points(*names: str) -> None:
        entries = [
            EntryPoint(name.lower(), f"{__name__}:{name}", registry.ENTRY_POINTS) for name in names
        ]
        monkeypatch.setattr(registry, "entry_points", lambda group: entries)

    return with_entry_points


def test_no_two_predictors_share_a_column() -> None:
    """A model knows its predictors only by their columns."""
    columns = [column for predictor in PREDICTORS.values() for column in predictor.columns]
    assert len(set(columns)) == len(columns)
    assert list(PREDICTORS) == [predictor.name for predictor in PREDICTORS.values()]


def test_the_order_of_the_columns_stays() -> None:
    """Model files hold their columns in this order."""
    assert prediction_space(list(PREDICTORS)).columns == (
        *("acceleration", "vibration"),
        *("turn_rate_x", "turn_rate_y", "turn_rate_z", "turn_rate"),
        *("blur", "entropy", "low_frequency", "high_frequency", "flow_variance"),
        *("x", "y", "velocity_x", "velocity_y", "velocity_z"),
        *("disparity", "disparity_change", "flow", "residual_flow", "last_residual"),
        *("row_offset", "age", "difference_in_time", "difference_in_stereo"),
        *("forward_backward", "structure_min", "structure_max"),
        *("alignment_u", "alignment_v", "alignment_correlation", "alignment_right"),
    )


@pytest.mark.parametrize("names", [["blurr"], ["blur", "speed", "place"], [""]])
def test_an_unknown_predictor_is_named(names: list[str]) -> None:
    with pytest.raises(InputError) as caught:
        prediction_space(names)
    unknown = next(name for name in names if name not in PREDICTORS)
    assert str(caught.value).startswith(f"--predictors: {unknown} is not known.")
    cure = "Did you mean blur?" if unknown == "blurr" else "Known are acceleration, turn_rate, blur"
    assert cure in caught.value.cure


@pytest.mark.parametrize(
    "names", [["blur"], ["disparity", "place", "acceleration"], list(PREDICTORS), []]
)
def test_the_space_of_a_model_is_found_by_its_columns(names: list[str]) -> None:
    space = prediction_space(names)
    found = space_for(space.columns)
    assert found.names == tuple(names)
    assert found.columns == space.columns


def test_a_given_space_with_the_right_columns_is_taken() -> None:
    space = PredictionSpace((RAMP, *prediction_space(["place"]).predictors))
    assert space_for(("ramp", "x", "y"), space) is space


def test_a_model_that_needs_no_columns_takes_any_space() -> None:
    space = prediction_space(["place"])
    assert space_for((), space) is space
    assert space_for(()).columns == ()


def test_a_column_of_no_known_predictor_is_named() -> None:
    with pytest.raises(InputError) as caught:
        space_for(("x", "y", "ramp"))
    assert "noise model: its predictor ramp is not known." in str(caught.value)
    assert "StereoOdometry" in caught.value.cure


@pytest.mark.parametrize(
    "columns",
    [("y", "x"), ("x",), ("x", "y", "x"), ("x", "disparity", "y"), ("turn_rate",), ("vibration",)],
)
def test_columns_that_no_order_of_predictors_gives_are_refused(columns: tuple[str, ...]) -> None:
    """Half a predictor, or its columns swapped."""
    with pytest.raises(InputError, match=f"its columns are {', '.join(columns)}, in this order"):
        space_for(columns)


@pytest.mark.parametrize(
    "names", [["disparity", "place"], ["place"], ["place", "disparity", "age"], []]
)
def test_a_given_space_with_other_columns_is_refused(names: list[str]) -> None:
    given = prediction_space(names)
    with pytest.raises(InputError) as caught:
        space_for(("x", "y", "disparity"), given)
    gets = ", ".join(given.columns) or "none"
    assert f"its columns are x, y, disparity, in this order, but it gets {gets}." in str(
        caught.value
    )
    assert "Give it the predictors that it was trained with, in their order." in str(caught.value)


def test_a_predictor_of_another_package_is_known_by_name_and_by_column(install: Install) -> None:
    install("RAMP")
    assert list(all_predictors()) == [*PREDICTORS, "ramp"]
    assert prediction_space(["place", "ramp"]).predictors == (PREDICTORS["place"], RAMP)
    assert space_for(("ramp", "x", "y")).names == ("ramp", "place")


@pytest.mark.parametrize(
    ("name", "complaint"),
    [
        ("NO_PREDICTOR", "it is of type function, not Predictor"),
        ("NAMED_BLUR", "the predictor blur, .* is taken"),
        ("WITH_COLUMN_X", "the predictor other, .* is taken"),
    ],
)
def test_an_entry_point_that_is_no_new_predictor_is_refused(
    install: Install, name: str, complaint: str
) -> None:
    install(name)
    with pytest.raises(InputError, match=complaint) as caught:
        all_predictors()
    assert f"{__name__}:{name}" in caught.value.where


def test_built_in_predictors_do_not_import_other_packages(install: Install) -> None:
    """A run with a built-in model must not fail, or wait, for a package that it does not use."""
    install("NO_PREDICTOR")
    assert prediction_space(["place"]).columns == ("x", "y")
    assert space_for(("x", "y")).names == ("place",)

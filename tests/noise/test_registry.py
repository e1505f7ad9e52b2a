"""The registry of noise models, and what an entry point of another package may do to it."""

from dataclasses import replace
from importlib.metadata import EntryPoint

import numpy as np
import pytest

from probevo.entry_points import imported
from probevo.errors import InputError
from probevo.noise import Fixed, GeneralizedKernel, NearestNeighbors, StudentT, registry
from probevo.noise.named import noise_model
from probevo.noise.registry import (
    NoiseKind,
    kind_of,
    noise_kinds,
    untrained_model,
    untrained_names,
)


class Wide(Fixed):
    """A Gaussian of 1 px."""

    def __init__(self) -> None:
        super().__init__(np.eye(4))


WIDE = NoiseKind(name="wide", model=Wide, summary="1 px for every observation", untrained=Wide)
FIXED_AGAIN = replace(WIDE, name="fixed")


def install(monkeypatch: pytest.MonkeyPatch, *values: str) -> None:
    """Let installed packages have these entry points, of this module."""
    points = [
        EntryPoint(name=f"point{number}", value=value, group="probevo.noise")
        for number, value in enumerate(values)
    ]
    monkeypatch.setattr(registry, "entry_points", lambda group: points)


def test_the_built_in_kinds_are_known_by_name_and_by_class() -> None:
    classes = {
        "fixed": Fixed,
        "student-t": StudentT,
        "knn": NearestNeighbors,
        "gk": GeneralizedKernel,
    }
    assert {name: kind.model for name, kind in noise_kinds().items()} == classes
    for name, model in classes.items():
        assert noise_kinds()[name].name == name
        assert kind_of(model()).name == name


def test_untrained_models_are_made_by_name() -> None:
    assert untrained_names() == ("fixed", "student-t")
    assert type(untrained_model("fixed")) is Fixed
    assert type(untrained_model("student-t")) is StudentT


@pytest.mark.parametrize("name", ["knn", "gk", "oracle", ""])
def test_a_model_that_has_to_be_trained_cannot_be_made_by_name(name: str) -> None:
    with pytest.raises(InputError, match="Known are fixed, student-t"):
        untrained_model(name)


def test_a_class_that_is_not_registered_has_no_kind() -> None:
    with pytest.raises(InputError, match="Wide is of no registered kind"):
        kind_of(Wide())


def test_an_entry_point_adds_a_kind(monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, f"{__name__}:WIDE")
    assert noise_kinds()["wide"] is WIDE
    assert kind_of(Wide()) is WIDE
    assert isinstance(noise_model("wide"), Wide)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (["no_such_module:KIND"], "point0 = no_such_module:KIND .* cannot be loaded"),
        ([f"{__name__}:NOTHING"], "point0 = .*:NOTHING .* cannot be loaded"),
        ([f"{__name__}:Wide"], "point0 = .* is of type type, not NoiseKind"),
        ([f"{__name__}:FIXED_AGAIN"], "point0 = .* 'fixed', whose name is taken"),
        ([f"{__name__}:WIDE", f"{__name__}:WIDE"], "point1 = .* 'wide', whose name is taken"),
    ],
)
def test_an_entry_point_that_is_broken_or_a_duplicate_is_named(
    monkeypatch: pytest.MonkeyPatch, values: list[str], message: str
) -> None:
    install(monkeypatch, *values)
    with pytest.raises(InputError, match=f"entry point {message}") as caught:
        noise_kinds()
    assert caught.value.cure


def test_a_function_is_imported_by_its_name() -> None:
    assert imported("probevo.noise.registry:noise_kinds") is noise_kinds

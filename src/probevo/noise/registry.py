"""The kinds of noise model there are: what each is called, read by, trained by and shown by.

A kind is registered in one place, ``NOISE_KINDS``, or by another package's entry point in the group
``probevo.noise``. Nothing else in probevo asks which kind a model is of.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any

from probevo.errors import InputError
from probevo.noise.base import NoiseModel
from probevo.noise.fixed import Fixed
from probevo.noise.gk.generalized_kernel import GeneralizedKernel
from probevo.noise.model_file import ModelFile
from probevo.noise.probe.nearest_neighbors import NearestNeighbors
from probevo.noise.student_t import StudentT

ENTRY_POINTS = "probevo.noise"


@dataclass(frozen=True)
class NoiseKind:
    """One kind of noise model, and who does what with it.

    ``trainer`` and ``inspection`` are named as ``module:function`` and imported when they are
    needed, so that a run does not wait for what only training or a page needs.
    """

    name: str
    """As in ``--noise`` and ``--kind``, and in the file of a model."""
    model: type[Any]
    """Its class."""
    summary: str
    """One line for help texts."""
    untrained: Callable[[], NoiseModel] | None = None
    """Makes the model that ``--noise NAME`` means; None for a kind that has to be trained."""
    from_file: Callable[[ModelFile], NoiseModel] | None = None
    """Reads a trained model; None for a kind that is never trained."""
    trainer: str = ""
    """Function that learns a model from drives, ``module:function``; empty without training."""
    inspection: str = ""
    """Function that makes the sections of its page in ``probevo inspect``, ``module:function``."""


_BUILT_IN = (
    NoiseKind(
        name="fixed",
        model=Fixed,
        summary="one Gaussian covariance for every observation",
        untrained=Fixed,
    ),
    NoiseKind(
        name="student-t",
        model=StudentT,
        summary="one Student-t for every observation",
        untrained=StudentT,
        from_file=StudentT.from_file,
        trainer="probevo.training.gk.learn:train_student_t",
    ),
    NoiseKind(
        name="knn",
        model=NearestNeighbors,
        summary="PROBE: a weight for each feature from its nearest neighbours",
        from_file=NearestNeighbors.from_file,
        trainer="probevo.training.probe.learn:train_knn",
    ),
    NoiseKind(
        name="gk",
        model=GeneralizedKernel,
        summary="PROBE-GK: a covariance for each feature from a generalized kernel",
        from_file=GeneralizedKernel.from_file,
        trainer="probevo.training.gk.learn:train_gk",
    ),
)


def noise_kinds() -> Mapping[str, NoiseKind]:
    """All kinds by their names: the built-in ones, and those of installed entry points."""
    found = {kind.name: kind for kind in _BUILT_IN}
    for entry in entry_points(group=ENTRY_POINTS):
        kind = entry.load()
        found.setdefault(kind.name, kind)
    return found


def kind_of(model: NoiseModel) -> NoiseKind:
    """Look up the kind that a model is of.

    Raises:
        InputError: its class is not registered.
    """
    for kind in noise_kinds().values():
        if type(model) is kind.model:
            return kind
    raise InputError("noise model", f"{type(model).__name__} is of no registered kind.")


def imported(function: str) -> Callable[..., Any]:
    """Import ``module:function``."""
    module, _, name = function.partition(":")
    found: Callable[..., Any] = getattr(import_module(module), name)
    return found

"""The registry of noise models: the name of each kind, its loader, its trainer and its page.

A kind is registered here, in ``_BUILT_IN``, or by another package through an entry point of the
group ``probevo.noise`` whose value is a ``NoiseKind``. No other module of probevo compares the name
of a kind. The models do not import the registry; it imports them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from probevo.entry_points import entry_points, entry_text, load_entry
from probevo.errors import InputError
from probevo.noise.base import LearnedNoiseModel, NoiseModel
from probevo.noise.fixed import Fixed
from probevo.noise.gk.generalized_kernel import GeneralizedKernel
from probevo.noise.model_file import ModelFile
from probevo.noise.probe.nearest_neighbors import NearestNeighbors
from probevo.noise.student_t import StudentT

ENTRY_POINTS = "probevo.noise"
"""Group of the entry points by which other packages register kinds."""


@dataclass(frozen=True)
class NoiseKind:
    """One kind of noise model, and the functions that make, read, train and show it.

    ``trainer`` and ``inspection`` are written as ``module:name`` and imported on demand, so that a
    run does not import what only training or a page needs.
    """

    name: str
    """Name of the kind in ``--noise``, in ``--kind`` and in the file of a model."""
    model: type[Any]
    """Class of the models."""
    summary: str
    """One line for help texts."""
    untrained: Callable[[], NoiseModel] | None = None
    """Makes the model that ``--noise NAME`` selects; None for a kind that has to be trained."""
    from_file: Callable[[ModelFile], LearnedNoiseModel] | None = None
    """Reads a trained model; None for a kind that is never trained."""
    trainer: str = ""
    """Its ``training.trainer.Trainer``, ``module:name``; empty for a kind that is never trained."""
    inspection: str = ""
    """Function that makes the sections of its page in ``probevo inspect``, ``module:name``."""


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
        trainer="probevo.training.gk.learn:STUDENT_T_TRAINER",
        inspection="probevo.output.inspection.student_t:sections",
    ),
    NoiseKind(
        name="knn",
        model=NearestNeighbors,
        summary="PROBE: a weight for each feature from its nearest neighbours",
        from_file=NearestNeighbors.from_file,
        trainer="probevo.training.probe.learn:KNN_TRAINER",
        inspection="probevo.output.inspection.knn:sections",
    ),
    NoiseKind(
        name="gk",
        model=GeneralizedKernel,
        summary="PROBE-GK: a covariance for each feature from a generalized kernel",
        from_file=GeneralizedKernel.from_file,
        trainer="probevo.training.gk.learn:GK_TRAINER",
        inspection="probevo.output.inspection.gk:sections",
    ),
)


def noise_kinds() -> Mapping[str, NoiseKind]:
    """Return all kinds by name: the built-in ones, then the ones of installed entry points.

    Raises:
        InputError: an entry point cannot be loaded, is no ``NoiseKind``, or its name is taken.
    """
    kinds = {kind.name: kind for kind in _BUILT_IN}
    for entry in entry_points(group=ENTRY_POINTS):
        kind = load_entry(entry, NoiseKind)
        if kind.name in kinds:
            raise InputError(
                entry_text(entry),
                f"it registers the noise model {kind.name!r}, whose name is taken.",
                "Uninstall one of the packages, or rename the kind.",
            )
        kinds[kind.name] = kind
    return kinds


def kind_of(model: NoiseModel) -> NoiseKind:
    """Look up the kind of a model by its class.

    Raises:
        InputError: its class is not registered.
    """
    for kind in noise_kinds().values():
        if type(model) is kind.model:
            return kind
    raise InputError("noise model", f"{type(model).__name__} is of no registered kind.")


def untrained_names() -> tuple[str, ...]:
    """Return the names of the kinds that need no training."""
    return tuple(name for name, kind in noise_kinds().items() if kind.untrained is not None)


def untrained_model(name: str) -> NoiseModel:
    """Make the noise model of a kind that needs no training.

    Raises:
        InputError: there is no such kind, or it has to be trained.
    """
    kind = noise_kinds().get(name)
    if kind is None or kind.untrained is None:
        raise InputError(
            "noise model",
            f"{name!r} names no model that works without training.",
            f"Known are {', '.join(untrained_names())}.",
        )
    return kind.untrained()

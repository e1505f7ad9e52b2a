"""Learned noise models to and from files."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from probevo.errors import InputError
from probevo.noise.gk.generalized_kernel import GeneralizedKernel
from probevo.noise.model_file import ModelFile, read_model_file, write_model_file
from probevo.noise.probe.nearest_neighbors import NearestNeighbors
from probevo.noise.student_t import StudentT

Learned = GeneralizedKernel | NearestNeighbors | StudentT
_KINDS: dict[str, type[GeneralizedKernel] | type[NearestNeighbors] | type[StudentT]] = {
    "gk": GeneralizedKernel,
    "knn": NearestNeighbors,
    "student-t": StudentT,
}


class Storable(Protocol):
    """A noise model that can be put into a file."""

    def to_file(self) -> ModelFile:
        """What the file needs to hold."""


def save_model(model: Storable, path: Path | str) -> None:
    """Write a fitted model; the same model gives the same bytes.

    Raises:
        InputError: the file cannot be written.
    """
    write_model_file(Path(path), model.to_file())


def load_model(path: Path | str) -> Learned:
    """Read a model. A file is data only: nothing in it is ever run.

    Raises:
        InputError: the file is missing, damaged, or no noise model of a known kind.
    """
    path = Path(path)
    file = read_model_file(path)
    if file.kind not in _KINDS:
        raise InputError(
            path, f"a noise model of kind {file.kind!r}.", f"Known are {', '.join(_KINDS)}."
        )
    try:
        return _KINDS[file.kind].from_file(file)
    except (KeyError, ValueError, InputError) as error:
        raise InputError(
            path, f"it is no whole {file.kind} model ({error}).", "Train it again."
        ) from error

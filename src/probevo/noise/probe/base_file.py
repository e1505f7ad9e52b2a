"""The static model whose noise PROBE scales, as the file of a PROBE model keeps it.

Both kinds are stored as a Student-t, which a Gaussian is for ν = ∞.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np

from probevo.arrays import AnyArray
from probevo.config.settings import Settings
from probevo.errors import InputError
from probevo.noise.base import NoiseModel
from probevo.noise.fixed import Fixed
from probevo.noise.model_file import ModelFile
from probevo.noise.student_t import StudentT

PREFIX = "base_"
"""What the names of its arrays begin with."""


class BaseFacts(Settings):
    """The facts that the file of a PROBE model states about its base."""

    name: Literal["fixed", "student-t"]
    student_t: dict[str, Any]
    """Facts of the Student-t that its noise is."""


def base_parts(base: NoiseModel) -> tuple[dict[str, AnyArray], dict[str, Any]]:
    """Return the arrays and the facts of a base for the file of the model that scales it.

    Raises:
        InputError: the base is of a class that a file cannot name.
    """
    # A subclass may predict anything.
    if type(base) is Fixed:
        name = "fixed"
        file = StudentT(np.inf, base.covariance, time_correlation_ratio=0.0).to_file()
    elif type(base) is StudentT:
        name = "student-t"
        file = base.to_file()
    else:
        raise InputError(
            "nearest neighbours",
            f"a base of type {type(base).__name__} cannot be stored.",
            "Use a Fixed or a StudentT.",
        )
    arrays = {PREFIX + key: array for key, array in file.arrays.items()}
    return arrays, {"name": name, "student_t": dict(file.facts)}


def base_from_parts(facts: BaseFacts, arrays: Mapping[str, AnyArray]) -> Fixed | StudentT:
    """Read the base that ``base_parts`` has described from all arrays of the file.

    Raises:
        KeyError, ValueError, InputError: the file does not hold such a model.
    """
    own = {
        key.removeprefix(PREFIX): array for key, array in arrays.items() if key.startswith(PREFIX)
    }
    student = StudentT.from_file(ModelFile("student-t", own, facts.student_t))
    return Fixed(student.scale) if facts.name == "fixed" else student

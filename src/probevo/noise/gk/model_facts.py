"""The facts in the file of a generalized kernel, and the check that its arrays fit together."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from pydantic import Field, field_validator

from probevo.arrays import AnyArray
from probevo.noise.base import RefersTo
from probevo.noise.gk.centers import MAX_LOG, Centers
from probevo.noise.metric import Metric, have_shapes
from probevo.noise.origin import OriginFacts
from probevo.noise.positive_definite import is_positive_definite
from probevo.noise.student_t_arrays import DIM, NUM_PARAMETERS, StudentTBatch

Variant = Literal["robust", "published"]
MOST = 1e100
"""Squares of larger numbers would overflow."""


class KernelFacts(OriginFacts):
    """The facts that a file states beside its arrays."""

    columns: tuple[str, ...]
    may_be_undefined: tuple[bool, ...]
    variant: Variant
    neighbors: int = Field(ge=1)
    reach: float = Field(gt=0, le=MOST)
    domain_radius: float = Field(gt=0, le=MOST)
    prior_counts: float = Field(gt=0, le=MOST)
    refers_to: RefersTo
    time_correlation_ratio: float = Field(0.0, ge=0, le=1e6)
    samples: int = Field(ge=1)

    @field_validator("training")
    @classmethod
    def _check_searches(cls, training: dict[str, Any]) -> dict[str, Any]:
        for name, search in training.get("searches", {}).items():
            if "gains" not in search:
                raise ValueError("a search lacks gains")
            if name != "weights" and not isinstance(search.get("chosen"), float | int | str):
                raise ValueError("a search lacks what was chosen")
        return training


def check_arrays(metric: Metric, centers: Centers, prior: StudentTBatch) -> None:
    """Refuse arrays that do not fit together: the compiled loops would read beyond their ends.

    Raises:
        ValueError: they do not.
    """
    contributing = int((metric.weight > 0.0).sum())
    count = len(centers.parameters) if centers.parameters.ndim else 0
    expected: list[tuple[AnyArray, tuple[int, ...], type]] = [
        (centers.points, (contributing, count), np.float32),
        (centers.parameters, (count, NUM_PARAMETERS), np.float32),
        (prior.scale, (1, DIM, DIM), np.float64),
        (prior.dof, (1,), np.float64),
        (prior.bias, (1, DIM), np.float64),
    ]
    fits = (
        metric.is_valid
        and have_shapes(expected)
        and (np.abs(centers.logarithms) < MAX_LOG).all()
        and count > 0
        and (prior.dof > 0.0).all()
        and is_positive_definite(prior.scale[0], DIM)
    )
    if not fits:
        raise ValueError("its arrays do not fit together")

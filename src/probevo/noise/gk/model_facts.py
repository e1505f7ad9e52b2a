"""What the file of a generalized kernel says, and whether its arrays fit together."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field

from probevo.arrays import AnyArray
from probevo.noise.base import Refers
from probevo.noise.gk.centers import LARGEST_LOGARITHM, VALUES, Centers
from probevo.noise.gk.hyperparameter_search import LARGEST_WEIGHT
from probevo.noise.metric import Metric
from probevo.noise.origin import OriginFacts
from probevo.noise.student_t_fit import DIM, Students

Variant = Literal["robust", "published"]


class KernelFacts(OriginFacts):
    """What a file says beside its arrays."""

    columns: tuple[str, ...]
    may_be_undefined: tuple[bool, ...]
    variant: Variant
    neighbors: int = Field(ge=1)
    reach: float = Field(gt=0)
    edge: float = Field(gt=0)
    prior_counts: float = Field(gt=0)
    refers_to: Refers
    time_correlation: float = Field(0.0, ge=0)
    samples: int = Field(ge=1)


def check_arrays(metric: Metric, centers: Centers, prior: Students) -> None:
    """Refuse arrays that do not fit together: they would be read beyond their ends.

    Raises:
        ValueError: they do not.
    """
    dimension = len(metric.columns)
    count = len(centers.values) if centers.values.ndim else 0
    expected: list[tuple[AnyArray, tuple[int, ...], type]] = [
        (centers.places, (int((metric.weight > 0.0).sum()), count), np.float32),
        (centers.values, (count, VALUES), np.float32),
        (prior.scale, (1, DIM, DIM), np.float64),
        (prior.dof, (1,), np.float64),
        (prior.bias, (1, DIM), np.float64),
        *(
            (array, (dimension,), np.float64)
            for array in (metric.mean, metric.spread, metric.weight)
        ),
    ]
    fits = (
        all(
            a.shape == shape and a.dtype == dtype and np.isfinite(a).all()
            for a, shape, dtype in expected
        )
        and len(set(metric.columns)) == dimension == len(metric.may_be_undefined)
        and (metric.spread > 0.0).all()
        and (np.abs(centers.logarithms) < LARGEST_LOGARITHM).all()
        and ((metric.weight >= 0.0) & (metric.weight <= LARGEST_WEIGHT)).all()
        and count > 0
        and (prior.dof > 0.0).all()
        and bool(np.linalg.eigvalsh(prior.scale)[0, 0] > 0.0)
    )
    if not fits:
        raise ValueError("its arrays do not fit together")

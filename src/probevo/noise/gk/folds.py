"""Blocks of time left out, by whose likelihood a generalized kernel is judged."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probevo.arrays import FloatArray, IntArray, evenly
from probevo.noise.base import StereoNoise
from probevo.noise.gk.posterior import prior_of
from probevo.noise.student_t_fit import Students, fit_static

FOLDS = 5
MOST_SAMPLES = 12_000
MOST_QUERIES = 600
"""Of a fold, to learn from and to judge by while weights are chosen."""


@dataclass(frozen=True)
class Fold:
    """Samples to learn from, and such of other groups to judge by."""

    coordinates: FloatArray
    errors: FloatArray
    spread: FloatArray | None
    places: FloatArray
    asked: FloatArray
    prior: Students
    static: FloatArray
    """Log-likelihood of each of the asked under the one Student-t of the samples, nats."""


def folds_of(
    coordinates: FloatArray,
    errors: FloatArray,
    spread: FloatArray | None,
    groups: IntArray | None,
    published: bool,
) -> list[Fold]:
    """Up to FOLDS of N samples; ``groups`` as in ``choose_shape``."""
    count = len(errors)
    if groups is None:
        groups = np.arange(count) * 2 * FOLDS // max(count, 1)
    fold = np.unique(groups, return_inverse=True)[1] % FOLDS
    found = []
    for number in np.unique(fold):
        own = np.flatnonzero(fold == number)
        other = np.flatnonzero(fold != number)
        own = own[evenly(len(own), MOST_QUERIES)]
        other = other[evenly(len(other), MOST_SAMPLES)]
        if not len(other):
            continue
        parts = errors[other], None if spread is None else spread[other]
        student = fit_static(*parts)
        prior = prior_of(*parts, published=True) if published else student
        noise = StereoNoise(student.scale, student.dof, student.bias)
        static = noise.log_likelihood(errors[own])
        found.append(Fold(coordinates[other], *parts, coordinates[own], errors[own], prior, static))
    return found

"""Cross-validation folds of whole groups, by whose likelihood hyperparameters are compared."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probevo.arrays import FloatArray, IntArray, evenly
from probevo.noise.base import StereoNoise
from probevo.noise.gk.posterior import KernelSamples, prior_of
from probevo.noise.student_t_arrays import StudentTBatch
from probevo.noise.student_t_fit import fit_static

FOLDS = 5
MAX_SAMPLES = 12_000
"""Number of training samples of a fold, at most."""
MAX_HELD_OUT = 600
"""Number of held-out samples of a fold, at most."""


@dataclass(frozen=True)
class Fold:
    """Training samples, and held-out samples of other groups."""

    training: KernelSamples
    held_out: KernelSamples
    prior: StudentTBatch
    """Prior of the kernel, fitted to the training samples, C = 1."""
    static: FloatArray
    """Log-likelihood of each held-out error under the static Student-t of the training samples,
    nats."""
    groups: IntArray
    """Group of each held-out sample, [Q], whose number no group of another fold has."""


def folds_of(samples: KernelSamples, groups: IntArray | None, published: bool) -> list[Fold]:
    """Divide N samples into up to FOLDS folds; samples of one group are in the same fold.

    Args:
        samples: the samples.
        groups: number of the group of each sample, [N]; by default blocks of consecutive samples.
        published: whether the prior is the published variant's.
    """
    # Whole groups go into a fold: neighbouring samples of a drive are correlated, and a model would
    # seem good that has only memorised them.
    count = len(samples.errors)
    if groups is None:
        groups = np.arange(count) * 2 * FOLDS // max(count, 1)
    group = np.unique(groups, return_inverse=True)[1]
    # Groups are dealt to the folds in turn, which spreads the groups of a fold over the data.
    fold = group % FOLDS
    folds = []
    for number in np.unique(fold):
        inside = np.flatnonzero(fold == number)
        outside = np.flatnonzero(fold != number)
        if not len(outside):
            continue
        # Thinned out evenly, to bound the time of the search.
        held_out_rows = inside[evenly(len(inside), MAX_HELD_OUT)]
        held_out = samples.subset(held_out_rows)
        training = samples.subset(outside[evenly(len(outside), MAX_SAMPLES)])
        # The static fit is the baseline of the score, and the prior of the robust kernel.
        fitted = fit_static(training.errors, training.error_cov)
        noise = StereoNoise(scale=fitted.scale, dof=fitted.dof, bias=fitted.bias)
        folds.append(
            Fold(
                training=training,
                held_out=held_out,
                prior=prior_of(training, published=True) if published else fitted,
                static=noise.log_likelihood(held_out.errors),
                groups=group[held_out_rows],
            )
        )
    return folds

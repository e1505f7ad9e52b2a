"""Thinning: if the drives have more features than EM uses, only some of their steps are kept."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from probevo.arrays import BoolArray
from probevo.training.drive import Drive
from probevo.training.gk.error_samples import MAX_FEATURES
from probevo.training.supervised_drive import DriveOnDisk
from probevo.training.supervision import Supervision
from probevo.training.workers import Workers

FEATURES_PER_DRAWN = 4
"""Ratio of the features in the kept steps to those that a model is fitted to, which
``error_samples`` draws from them. Errors within a step are correlated, so some features of many
steps are worth more than all features of a few."""
STEPS_TOGETHER = 20
"""Number of consecutive steps that are kept together, since the disparity filter needs successive
steps."""


@dataclass(frozen=True)
class _Task:
    drive: DriveOnDisk
    steps: BoolArray
    """Which steps to keep, [K − 1]."""


def thinned(drives: Sequence[DriveOnDisk], seed: int, workers: Workers) -> list[DriveOnDisk]:
    """Return the drives with fewer steps each, if they have more features than EM can use.

    Args:
        drives: drives without supervision, so that no truth links their steps.
        seed: seed of the draw, which does not depend on how the drives are cut into parts.
        workers: processes that read and write the drives.
    """
    # Thin only where the steps that are kept still have enough features to draw from.
    num_used = sum(drive.facts.used for drive in drives)
    # Share of the steps whose features are FEATURES_PER_DRAWN times those that are drawn from them
    share = FEATURES_PER_DRAWN * MAX_FEATURES / max(num_used, 1)
    if share >= 1.0:
        return list(drives)

    # Each drive has its own stream of random numbers, and so the same steps by any worker.
    tasks = []
    for number, drive in enumerate(drives):
        rng = np.random.default_rng((seed, number, 1))
        tasks.append(_Task(drive, _drawn_steps(drive.facts.steps, share, rng)))
    names = [f"recording {number + 1}" for number in range(len(tasks))]
    return workers.map(_thin, tasks, names)


def _drawn_steps(num_steps: int, share: float, rng: np.random.Generator) -> BoolArray:
    """Draw runs of ``STEPS_TOGETHER`` steps, about as many as make this share: [num_steps]."""
    # One draw a run; the last one, which may be cut short, counts like the others.
    is_drawn = rng.random(num_steps // STEPS_TOGETHER + 1) < share
    return np.repeat(is_drawn, STEPS_TOGETHER)[:num_steps]


def _thin(task: _Task) -> DriveOnDisk:
    """Write the thinned drive beside the whole one, unless it is there."""
    thin = replace(task.drive, name="thin")
    if not thin.is_complete:
        facts = task.drive.facts

        def parts() -> Iterator[Drive]:
            """Yield the steps drawn, part by part."""
            for part in task.drive.parts():
                yield part.subset(task.steps[part.numbers])

        thin.keep_drive(parts(), lambda: facts.digest, len(facts.moments.mean))
        # Without truth, the stretches of the supervision are never used.
        unknown = np.full((2, 4, 4), np.nan)
        thin.keep_supervision(Supervision("none", np.zeros(2, np.int64), unknown))
    return thin

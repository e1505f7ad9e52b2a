"""Of more drives than EM can make use of, some of the steps: what the rest cost is to record them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from probevo.arrays import BoolArray
from probevo.training.drive import Drive
from probevo.training.gk.evidence import MOST_FEATURES
from probevo.training.supervised_drive import DriveOnDisk
from probevo.training.supervision import Supervision
from probevo.training.workers import Workers

STEPS_PER_FEATURE = 4
"""Steps are kept with so many times the features that a model is fitted to, of which ``evidence``
then draws: features of one step have much in common, so that some of many steps tell more than all
of a few."""
STRETCH = 20
"""Steps are kept in stretches of so many, as what tracks remember goes on from step to step."""


@dataclass(frozen=True)
class _Task:
    drive: DriveOnDisk
    steps: BoolArray
    """Which to keep, [K − 1]."""


def thinned(drives: Sequence[DriveOnDisk], seed: int, workers: Workers) -> list[DriveOnDisk]:
    """Drives of which nothing is known but the drive, so that no truth links its steps, with fewer
    steps each.

    Args:
        drives: the drives.
        seed: of the draw, which is the same however the drives are cut into parts.
        workers: who does it.
    """
    used = sum(drive.facts.used for drive in drives)
    share = STEPS_PER_FEATURE * MOST_FEATURES / max(used, 1)
    if share >= 1.0:
        return list(drives)
    tasks = [
        _Task(drive, _drawn(drive.facts.steps, share, np.random.default_rng((seed, number, 1))))
        for number, drive in enumerate(drives)
    ]
    return workers.map(_thin, tasks, [f"recording {number + 1}" for number in range(len(tasks))])


def _drawn(steps: int, share: float, rng: np.random.Generator) -> BoolArray:
    """Stretches of all these steps, whole ones, about as many as make this share."""
    return np.repeat(rng.random(steps // STRETCH + 1) < share, STRETCH)[:steps]


def _thin(task: _Task) -> DriveOnDisk:
    thin = replace(task.drive, name="thin")
    if not thin.is_complete:
        facts = task.drive.facts

        def parts() -> Iterator[Drive]:
            for part in task.drive.parts():
                yield part.kept(task.steps[part.numbers])

        thin.keep_drive(parts(), lambda: facts.digest, len(facts.moments.mean))
        nothing = np.full((2, 4, 4), np.nan)
        thin.keep_supervision(Supervision("none", np.zeros(2, np.int64), nothing))
    return thin

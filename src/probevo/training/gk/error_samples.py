"""The E-step over all drives: each is one worker's task, and what comes back is no more than a
model is fitted to."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.config import SolverConfig
from probevo.errors import InputError
from probevo.geometry import se3
from probevo.noise.base import NoiseModel
from probevo.training.gk.expectation import expect
from probevo.training.settings import KernelSettings, TrainSettings
from probevo.training.supervised_drive import SupervisedDrive
from probevo.training.supervision import Supervision
from probevo.training.workers import Workers

BLOCKS_A_DRIVE = 10
STEPS_A_BLOCK = 20
"""At most, and at least: of shorter blocks, one holds the tracks of the next."""
MOST_FEATURES = 500_000
"""That a model is fitted to; of more, about so many are drawn, evenly from all drives and times."""


@dataclass(frozen=True)
class Evidence:
    """Errors of N features to learn from, and how well the model explained them."""

    phi: FloatArray
    """Their places in the prediction space, [N, M]."""
    errors: FloatArray
    """[N, 4], px."""
    spread: FloatArray
    """Covariance of what is not known of each error, [N, 4, 4], px²."""
    groups: IntArray
    """Block of time and drive of each; blocks of one drive after those of another, [N]."""
    log_likelihood: FloatArray
    """Of their residuals under the model, [N], nats."""
    profile: FloatArray
    """What they tell of how much lasts of the disparity's error, as from ``time_correlation_profile``, [N,
    4]."""
    gaps_m: FloatArray
    """Of each drive with both ends known, how far its motions end from there."""

    @property
    def progress(self) -> dict[str, float]:
        """What a turn is judged by (PROBE-GK Fig. 8): likelihood a feature, and how far loops are
        from closing."""
        progress = {"log_likelihood": float(np.mean(self.log_likelihood))}
        return progress | (
            {"loop_error_m": float(np.mean(self.gaps_m))} if len(self.gaps_m) else {}
        )


@dataclass(frozen=True)
class _Task:
    number: int
    drive: SupervisedDrive
    model: NoiseModel
    settings: TrainSettings
    share: float
    blocks: int


def gather_evidence(
    drives: Sequence[SupervisedDrive],
    model: NoiseModel,
    settings: TrainSettings,
    workers: Workers,
    on_part: Callable[[float], None],
) -> Evidence:
    """What the features of all drives tell, given what is known of their noise so far.

    Args:
        drives: the drives.
        model: of the noise.
        settings: all settings.
        workers: who does it.
        on_part: called with the share of the work that is done.

    Raises:
        InputError: there is nothing to learn from, or what ``workers`` raise.
    """
    share = min(1.0, MOST_FEATURES / max(sum(drive.facts.used for drive in drives), 1))
    blocks = blocks_of([drive.facts.steps for drive in drives])
    tasks = [
        _Task(n, drive, model, settings=settings, share=share, blocks=blocks[n])
        for n, drive in enumerate(drives)
    ]
    through: set[int] = set()

    def on_done(number: int) -> None:
        through.add(number)
        on_part(len(through) / len(tasks))

    names = [f"recording {number + 1}" for number in range(len(tasks))]
    parts = workers.map(_evidence, tasks, names, on_done)
    found = Evidence(
        *(
            np.concatenate([getattr(part, field.name) for part in parts])
            for field in fields(Evidence)
        )
    )
    if not len(found.errors):
        what = f"no step has {settings.odometry.solver.min_tracks} features to learn from."
        raise InputError("training data", what, "Give other recordings.")
    return found


def blocks_of(steps: Sequence[int]) -> list[int]:
    """How many blocks of time to cut each drive of so many steps into; at least two in all."""
    blocks = [min(BLOCKS_A_DRIVE, max(1, count // STEPS_A_BLOCK)) for count in steps]
    return blocks if sum(blocks) > 1 else [2] * len(blocks)


def _evidence(task: _Task) -> Evidence:
    settings = task.settings
    supervision = task.drive.supervision
    seed = (settings.odometry.seed, task.number)
    sigma = _truth_sigma(settings.gk)
    expectation = expect(
        task.drive,
        task.model.predict,
        _solver(settings),
        truth_sigma=sigma,
        share=task.share,
        seed=seed,
    )
    left = expectation.feature_errors
    steps = len(expectation.T_alone)
    groups = task.number * BLOCKS_A_DRIVE + left.steps * task.blocks // max(steps, 1)
    gap_m = _loop_error_m(supervision, expectation.T_alone)
    gaps_m = np.array([gap_m] if np.isfinite(gap_m) else [])
    return Evidence(
        left.phi,
        left.errors,
        left.spread,
        groups=groups,
        log_likelihood=left.log_likelihood,
        profile=left.profile,
        gaps_m=gaps_m,
    )


def _solver(settings: TrainSettings) -> SolverConfig:
    solver = settings.odometry.solver
    return solver.model_copy(update={"loss": "l2"}) if settings.gk.quadratic else solver


def _truth_sigma(given: KernelSettings) -> FloatArray | None:
    """Standard deviation of the truth over a stretch, m and rad, [6]; None if it is to be
    estimated."""
    if given.truth_sigma_m is None or given.truth_sigma_deg is None:
        return None
    return np.repeat([given.truth_sigma_m, np.deg2rad(given.truth_sigma_deg)], 3)


def _loop_error_m(supervision: Supervision, T_curr_prev: FloatArray) -> float:
    """How far motions [K − 1, 4, 4] end from where the last known pose is against the first; NaN if
    one is unknown."""
    first, last = supervision.frames[[0, -1]]
    start, end = se3.chain_motions(T_curr_prev)[[first, last]]
    true_start, true_end = supervision.T_world_cam[[0, -1]]
    apart = se3.inverse(start) @ end - se3.inverse(true_start) @ true_end
    return float(np.linalg.norm(apart[:3, 3]))

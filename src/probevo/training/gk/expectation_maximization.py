"""PROBE-GK from drives: motions given the noise, the noise given their residuals, in turns
(PROBE-GK Alg. 3).

With truth that is exact one turn would do (Alg. 1): the motions are known. Without, the noise
starts as the static Student-t, itself fitted so. A turn is EM in spirit: motions enter as Gaussians
around the solve, residuals of observation noise by a fixed point (``expectation``), and the gyro
does not contribute. The likelihood of a turn is that of the residuals at its motions.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from probevo.noise.base import LearnedNoiseModel
from probevo.noise.gk.generalized_kernel import GeneralizedKernel
from probevo.noise.metric import Metric
from probevo.noise.student_t import StudentT
from probevo.training.gk.evidence import Evidence, gather_evidence
from probevo.training.gk.time_correlation import smallest_likely_ratio
from probevo.training.settings import KernelSettings, TrainSettings
from probevo.training.supervised_drive import SupervisedDrive
from probevo.training.workers import Workers

STATIC_TURNS = 5
TIME_CORRELATION_GAIN = 0.03
"""Nats a feature that errors that last must gain. Where there are none, but noise that differs from
place to place, they seem to gain up to 0.02 (point world, six laws); on KITTI it is 0.15 to 0.65.
"""
Model = StudentT | GeneralizedKernel


class Memory(Protocol):
    """Where models are kept from turn to turn; a ``Checkpoint`` is one."""

    def turn(self, number: int) -> LearnedNoiseModel | None:
        """The model after that turn, if it is kept."""

    def keep_turn(self, number: int, model: Model) -> None:
        """Keep it."""


class NoMemory:
    """A memory that keeps no turn."""

    def turn(self, number: int) -> LearnedNoiseModel | None:
        """None."""

    def keep_turn(self, number: int, model: Model) -> None:
        """Forget it."""


HERE = Workers()
NOWHERE = NoMemory()


@dataclass(frozen=True)
class Course:
    """What goes on around the turns of EM."""

    workers: Workers = HERE
    """Who goes through the drives; the fit to what they find is this process's."""
    memory: Memory = NOWHERE
    """Turns that are there need not be done."""
    on_turn: Callable[[], None] = lambda: None
    """Called after each turn."""
    on_part: Callable[[float], None] = lambda share: None
    """Called within a turn with the share of it that is done."""


ALONE = Course()


def learn_student_t(
    drives: Sequence[SupervisedDrive],
    settings: TrainSettings,
    recordings: Sequence[Mapping[str, Any]],
    course: Course = ALONE,
) -> StudentT:
    """The one Student-t, with its full scale matrix, that the drives are most likely under.
    Arguments as below.

    What lasts comes last, and only stays if it makes the residuals likelier by a margin: where
    noise differs from place
    to place, a model that is the same everywhere may take that for errors that last.
    """
    gk = settings.gk
    model = StudentT(
        refers_to=gk.refers_to,
        camera=drives[0].camera,
        training={"turns": []},
        time_correlation_ratio=0.0,
    )
    fresh = model
    for number in range(_static_turns(gk)):
        if number == STATIC_TURNS:
            fresh = model
            model = copy(model)
        kept = course.memory.turn(number)
        if isinstance(kept, StudentT):
            model = kept
        else:
            evidence = gather_evidence(
                drives, model, settings, workers=course.workers, on_part=course.on_part
            )
            model.fit(evidence.phi, evidence.errors, error_cov=evidence.spread)
            model.time_correlation_ratio = (
                0.0 if number < STATIC_TURNS else _lasting(evidence, model)
            )
            model.training = {"turns": [*model.training["turns"], evidence.progress]}
            course.memory.keep_turn(number, model)
        course.on_turn()
    turns = model.training["turns"]
    if (
        gk.learns_time_correlation
        and turns[-1]["log_likelihood"]
        < turns[STATIC_TURNS]["log_likelihood"] + TIME_CORRELATION_GAIN
    ):
        model = fresh
        turns = turns[: STATIC_TURNS + 1]
    model.training = _training(settings, recordings, turns, searches={})
    return model


def learn_kernel(
    drives: Sequence[SupervisedDrive],
    metric: Metric,
    settings: TrainSettings,
    recordings: Sequence[Mapping[str, Any]],
    course: Course = ALONE,
) -> GeneralizedKernel:
    """The generalized kernel of the drives. Its shape is chosen at the first turn.

    Args:
        drives: the drives, and what is known of them.
        metric: of the prediction space.
        settings: all settings.
        recordings: what the model should remember of each recording.
        course: who does it, who hears of it, and what is done already.
    """
    static = learn_student_t(drives, settings, recordings, course=course)
    model = GeneralizedKernel(training={"turns": [], "searches": {}})
    given = settings.gk.given()
    first = _static_turns(settings.gk)
    for number in range(first, num_turns(settings)):
        kept = course.memory.turn(number)
        if isinstance(kept, GeneralizedKernel):
            model = kept
        else:
            before = model if number > first else static
            model = _turn(
                drives,
                before,
                model.training,
                metric=metric,
                settings=settings,
                given=given,
                course=course,
            )
            course.memory.keep_turn(number, model)
        given = _restored(model.training["given"])
        model.weights_ = given["weights"]
        course.on_turn()
    last = gather_evidence(
        drives, model, settings, workers=course.workers, on_part=lambda share: None
    ).progress
    model.camera = drives[0].camera
    turns = [*model.training["turns"], last]
    model.training = _training(settings, recordings, turns, searches=model.training["searches"])
    return model


def _turn(
    drives: Sequence[SupervisedDrive],
    before: Model,
    training: Mapping[str, Any],
    metric: Metric,
    settings: TrainSettings,
    given: Mapping[str, Any],
    course: Course,
) -> GeneralizedKernel:
    """The next model, without its samples; ``training`` tells of the turns so far, and then of this
    one too."""
    evidence = gather_evidence(
        drives,
        before,
        settings,
        workers=course.workers,
        on_part=lambda share: course.on_part(0.5 * share),
    )
    gk = settings.gk
    model = GeneralizedKernel(gk.variant, **given, centers=gk.centers, refers_to=gk.refers_to).fit(
        evidence.phi,
        evidence.errors,
        evidence.groups,
        error_cov=evidence.spread,
        metric=metric,
        on_progress=lambda done, total: course.on_part(0.5 + 0.5 * done / max(total, 1)),
    )
    model.time_correlation_ratio = (
        _lasting(evidence, before) if before.time_correlation_ratio else 0.0
    )
    model.training = {
        "turns": [*training["turns"], evidence.progress],
        "searches": training["searches"] or model.search_,
        "given": _plain(model.shape_.as_given() | {"weights": model.weights_.tolist()}),
    }
    return model.without_samples()


def _lasting(evidence: Evidence, before: Model) -> float:
    """Half the way from what the last turn held to what is most likely: scale and κ explain the
    same residuals, and would overshoot together."""
    return 0.5 * (before.time_correlation_ratio + smallest_likely_ratio(evidence.profile))


def _plain(given: Mapping[str, Any]) -> dict[str, Any]:
    """For JSON, which knows no infinity."""
    return {name: None if value == np.inf else value for name, value in given.items()}


def _restored(plain: Mapping[str, Any]) -> dict[str, Any]:
    given = {name: np.inf if value is None else value for name, value in plain.items()}
    return given | {"weights": np.array(given["weights"])}


def num_turns(settings: TrainSettings) -> int:
    """How many turns there are."""
    return _static_turns(settings.gk) + (settings.gk.turns if settings.kind == "gk" else 0)


def _static_turns(settings: KernelSettings) -> int:
    return STATIC_TURNS * (2 if settings.learns_time_correlation else 1)


def _training(
    settings: TrainSettings,
    recordings: Sequence[Mapping[str, Any]],
    turns: Sequence[Mapping[str, float]],
    searches: Mapping[str, Any],
) -> dict[str, Any]:
    return {
        "settings": settings.model_dump(mode="json"),
        "recordings": [dict(recording) for recording in recordings],
        "turns": [dict(turn) for turn in turns],
        "searches": dict(searches),
    }

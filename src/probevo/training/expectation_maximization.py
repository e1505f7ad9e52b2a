"""PROBE-GK from drives: motions given the noise, the noise given their residuals, in turns (PROBE-GK Alg. 3).

With truth that is exact one turn would do (Alg. 1): the motions are known. Without, the noise starts as the static
Student-t, itself fitted so. A turn is EM in spirit: motions enter as Gaussians around the solve, residuals of
observation noise by a fixed point (``expectation``), and the gyro has no say. The likelihood of a turn is that of the
residuals at its motions.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from probevo.noise.generalized_kernel import GeneralizedKernel
from probevo.noise.metric import Metric
from probevo.noise.student_t import StudentT
from probevo.training.evidence import Evidence, gather_evidence
from probevo.training.lesson import Lesson
from probevo.training.settings import KernelSettings, TrainSettings
from probevo.training.workers import Workers

STATIC_TURNS = 5
HERE = Workers()
OnTurn = Callable[[], None]
"""Called after each of ``num_turns``."""
OnPart = Callable[[float], None]
"""Called within a turn with the share of it that is done."""


def learn_student_t(
    lessons: Sequence[Lesson],
    settings: TrainSettings,
    recordings: Sequence[Mapping[str, Any]],
    on_turn: OnTurn = lambda: None,
    on_part: OnPart = lambda share: None,
    workers: Workers = HERE,
) -> StudentT:
    """The one Student-t, with its full scale matrix, that the drives are most likely under. Arguments as below."""
    model = StudentT(refers_to=settings.gk.refers_to, camera=lessons[0].camera)
    turns: list[dict[str, float]] = []
    for _ in range(STATIC_TURNS):
        evidence = gather_evidence(lessons, model, settings, workers, on_part)
        turns.append(evidence.progress)
        model.fit(evidence.phi, evidence.errors, spread=evidence.spread)
        on_turn()
    model.training = _training(settings, recordings, turns, {})
    return model


def learn_kernel(
    lessons: Sequence[Lesson],
    metric: Metric,
    settings: TrainSettings,
    recordings: Sequence[Mapping[str, Any]],
    on_turn: OnTurn = lambda: None,
    on_part: OnPart = lambda share: None,
    workers: Workers = HERE,
) -> GeneralizedKernel:
    """The generalized kernel of the drives. Its shape is chosen at the first turn.

    Args:
        lessons: the drives, and what is known of them.
        metric: of the prediction space.
        settings: all settings.
        recordings: what the model should remember of each recording.
        on_turn, on_part: how far it is.
        workers: who goes through the drives; the fit to what they find is this process's.
    """
    static = learn_student_t(lessons, settings, recordings, on_turn, on_part, workers)
    model, turns = GeneralizedKernel(), list[dict[str, float]]()
    given, searches = settings.gk.given(), {}
    for turn in range(settings.gk.turns):
        before = model if turn else static
        evidence = gather_evidence(lessons, before, settings, workers, lambda share: on_part(0.5 * share))
        turns.append(evidence.progress)
        fitted = _fitted(evidence, given, metric, settings.gk, lambda share: on_part(0.5 + 0.5 * share))
        if turn == 0:
            searches, given = fitted.search_, fitted.shape_.as_given() | {"weights": fitted.weights_}
        model = fitted.without_samples()
        del evidence, fitted  # before the samples of the next turn come in
        on_turn()
    turns.append(gather_evidence(lessons, model, settings, workers, lambda share: None).progress)
    model.camera = lessons[0].camera
    model.training = _training(settings, recordings, turns, searches)
    return model


def _fitted(
    evidence: Evidence, given: Mapping[str, Any], metric: Metric, settings: KernelSettings, on_part: OnPart
) -> GeneralizedKernel:
    model = GeneralizedKernel(settings.variant, **given, centers=settings.centers, refers_to=settings.refers_to)
    return model.fit(
        evidence.phi,
        evidence.errors,
        evidence.groups,
        spread=evidence.spread,
        metric=metric,
        on_progress=lambda done, total: on_part(done / max(total, 1)),
    )


def num_turns(settings: TrainSettings) -> int:
    """How often ``on_turn`` is called."""
    return STATIC_TURNS + (settings.gk.turns if settings.kind == "gk" else 0)


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

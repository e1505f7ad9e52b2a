"""PROBE-GK from drives: motions given the noise, the noise given their residuals, in turns (PROBE-GK Alg. 3).

With truth that is exact one turn would do (Alg. 1): the motions are known. Without, the noise starts as the static
Student-t, itself fitted so. A turn is EM in spirit: motions enter as Gaussians around the solve, residuals of
observation noise by a fixed point (``expectation``), and the gyro has no say. The likelihood of a turn is that of the
residuals at its motions.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.camera.stereo import StereoCamera
from probevo.errors import InputError
from probevo.geometry import se3
from probevo.noise.base import StereoNoise
from probevo.noise.generalized_kernel import GeneralizedKernel
from probevo.noise.metric import Metric
from probevo.noise.student_t import StudentT
from probevo.training.drive import Drive
from probevo.training.expectation import Expectation, expect
from probevo.training.settings import KernelSettings, TrainSettings
from probevo.training.supervision import Supervision, path

BLOCKS_A_DRIVE = 10
STATIC_TURNS = 5


@dataclass(frozen=True)
class Lesson:
    """A drive, and what is known of it."""

    drive: Drive
    camera: StereoCamera
    supervision: Supervision

    @property
    def group_of_step(self) -> IntArray:
        """Block of time of each step, [K − 1]."""
        steps = len(self.drive.T_curr_prev)
        blocks: IntArray = np.arange(steps) * BLOCKS_A_DRIVE // steps
        return blocks


def learn_student_t(
    lessons: Sequence[Lesson],
    settings: TrainSettings,
    recordings: Sequence[Mapping[str, Any]],
    on_turn: Callable[[], None] | None = None,
) -> StudentT:
    """The one Student-t, with its full scale matrix, that the drives are most likely under."""
    model = StudentT(refers_to=settings.gk.refers_to, camera=lessons[0].camera)
    turns: list[dict[str, float]] = []
    for _ in range(STATIC_TURNS):
        expectations = _expect(lessons, [model.predict(lesson.drive.phi) for lesson in lessons], settings)
        turns.append(_progress(lessons, expectations))
        errors, spread = _samples(expectations)
        model.fit(np.zeros((len(errors), 0)), errors, spread=spread)
        if on_turn is not None:
            on_turn()
    model.training = _training(settings, recordings, turns, {})
    return model


def learn_kernel(
    lessons: Sequence[Lesson],
    metric: Metric,
    settings: TrainSettings,
    recordings: Sequence[Mapping[str, Any]],
    on_turn: Callable[[], None] | None = None,
    on_search: Callable[[int, int], None] | None = None,
) -> GeneralizedKernel:
    """The generalized kernel of the drives. Its shape is chosen at the first turn.

    Args:
        lessons: the drives.
        metric: of the prediction space.
        settings: all settings.
        recordings: what the model should remember of each recording.
        on_turn: called after each of ``num_turns``.
        on_search: called within a turn, with how many steps of a search are done, and how many there are at most.
    """
    static = learn_student_t(lessons, settings, recordings, on_turn)
    noises = [static.predict(lesson.drive.phi) for lesson in lessons]
    turns: list[dict[str, float]] = []
    given, model, searches = settings.gk.given(), GeneralizedKernel(), {}
    for turn in range(settings.gk.turns):
        expectations = _expect(lessons, noises, settings)
        turns.append(_progress(lessons, expectations))
        errors, spread = _samples(expectations)
        model = GeneralizedKernel(
            settings.gk.variant, **given, centers=settings.gk.centers, refers_to=settings.gk.refers_to
        )
        phi = np.concatenate([lesson.drive.phi[e.features] for lesson, e in zip(lessons, expectations, strict=True)])
        model.fit(phi, errors, _groups(lessons, expectations), spread=spread, metric=metric, on_progress=on_search)
        if turn == 0:
            searches = model.search_
            given = model.shape_.as_given() | {"weights": model.weights_}
        noises = [model.predict(lesson.drive.phi) for lesson in lessons]
        if on_turn is not None:
            on_turn()
    turns.append(_progress(lessons, _expect(lessons, noises, settings)))
    model.camera = lessons[0].camera
    model.training = _training(settings, recordings, turns, searches)
    return model


def num_turns(settings: TrainSettings) -> int:
    """How often ``on_turn`` is called."""
    return STATIC_TURNS + (settings.gk.turns if settings.kind == "gk" else 0)


def _expect(lessons: Sequence[Lesson], noises: Sequence[StereoNoise], settings: TrainSettings) -> list[Expectation]:
    solver = settings.odometry.solver
    if settings.gk.quadratic:
        solver = solver.model_copy(update={"loss": "l2"})
    sigma = _truth_sigma(settings.gk)
    found = [
        expect(lesson.drive, noise, lesson.camera, solver, lesson.supervision, sigma)
        for lesson, noise in zip(lessons, noises, strict=True)
    ]
    if not any(len(expectation.features) for expectation in found):
        what = f"no step has {solver.min_tracks} features to learn from."
        raise InputError("training data", what, "Give other recordings.")
    return found


def _truth_sigma(given: KernelSettings) -> FloatArray | None:
    """Standard deviation of the truth over a stretch, m and rad, [6]; None if it is to be estimated."""
    if given.truth_sigma_m is None or given.truth_sigma_deg is None:
        return None
    return np.repeat([given.truth_sigma_m, np.deg2rad(given.truth_sigma_deg)], 3)


def _samples(expectations: Sequence[Expectation]) -> tuple[FloatArray, FloatArray]:
    errors, spread = (np.concatenate([getattr(e, name) for e in expectations]) for name in ("errors", "spread"))
    return errors, spread


def _groups(lessons: Sequence[Lesson], expectations: Sequence[Expectation]) -> IntArray:
    """Block of time and drive of each sample; blocks of one drive after those of another."""
    groups = [
        number * BLOCKS_A_DRIVE + lesson.group_of_step[lesson.drive.step_of_feature[expectation.features]]
        for number, (lesson, expectation) in enumerate(zip(lessons, expectations, strict=True))
    ]
    return np.concatenate(groups)


def _progress(lessons: Sequence[Lesson], expectations: Sequence[Expectation]) -> dict[str, float]:
    """What a turn is judged by (PROBE-GK Fig. 8): likelihood a feature, and how far loops are from closing."""
    progress = {"log_likelihood": float(np.mean(np.concatenate([e.log_likelihood for e in expectations])))}
    gaps = [
        gap
        for lesson, expectation in zip(lessons, expectations, strict=True)
        if np.isfinite(gap := _loop_error_m(lesson.supervision, expectation.T_alone))
    ]
    return progress | ({"loop_error_m": float(np.mean(gaps))} if gaps else {})


def _loop_error_m(supervision: Supervision, T_curr_prev: FloatArray) -> float:
    """How far motions [K − 1, 4, 4] end from where the last known pose is against the first; NaN if one is unknown."""
    first, last = supervision.frames[[0, -1]]
    start, end = path(T_curr_prev)[[first, last]]
    true_start, true_end = supervision.T_world_cam[[0, -1]]
    apart = se3.inverse(start) @ end - se3.inverse(true_start) @ true_end
    return float(np.linalg.norm(apart[:3, 3]))


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

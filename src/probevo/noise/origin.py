"""The origin of a learned noise model, as its file states it: the camera and the training."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from typing import Annotated, Any, Self

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from probevo.camera.likeness import difference_text
from probevo.camera.stereo import StereoCamera, check_camera
from probevo.config.settings import Settings
from probevo.errors import InputError
from probevo.noise.base import NoiseModel
from probevo.noise.model_file import ModelFile
from probevo.sequences.content import SeenRecording


def origin_facts(camera: StereoCamera | None, training: Mapping[str, Any]) -> dict[str, Any]:
    """Return camera and training as plain values for a file, from which ``OriginFacts`` reads."""
    return {
        "camera": json.loads(json.dumps(asdict(camera))) if camera else None,
        "training": dict(training),
    }


class _TrainingPart(BaseModel):
    """A part of the account of a training; what else it holds is not shown anywhere."""

    model_config = ConfigDict(strict=True, extra="allow", allow_inf_nan=False)


class _Recording(_TrainingPart):
    """A recording that a model was learned from."""

    name: str
    frames: int = Field(ge=0, le=10**12)
    sha256: str
    view: str | None = None
    """Digest of what its first frames show, by which it is recognised; older files lack it."""


class _Iteration(_TrainingPart):
    """What an EM iteration found."""

    log_likelihood: float
    loop_error_m: float | None = None


class _Search(_TrainingPart):
    """The search for a hyperparameter: the candidates, and the gain or the error of each."""

    candidates: list[float | str]
    gains: list[float] | None = None
    errors: list[float] | None = None
    chosen: float | str | dict[str, float] | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        figures = self.gains if self.errors is None else self.errors
        if figures is None or len(figures) != len(self.candidates):
            raise ValueError("a search has another number of candidates than of gains or errors")
        if not isinstance(self.chosen, dict | None) and self.chosen not in self.candidates:
            raise ValueError("what a search has chosen is none of its candidates")
        if self.errors is not None and any(isinstance(each, str) for each in self.candidates):
            raise ValueError("a candidate is not a number")
        return self


class _TrainingFacts(_TrainingPart):
    """The account of a training, as far as pages and tables show it; each part may be missing."""

    recordings: list[_Recording] = []
    iterations: list[_Iteration] = []
    searches: dict[str, _Search] = {}
    kept_iteration: int | None = Field(None, ge=0, le=10**6)
    """Number of EM iterations after which the model was taken."""
    time_correlation_gain: float | None = None
    """Gain in likelihood by time-correlated errors, nats a feature."""
    recording_factors: list[Annotated[float, Field(gt=0)]] = []
    """Factor of the variances of the model in each recording."""
    settings: dict[str, Any] = {}


class OriginFacts(Settings):
    """The facts that the file of every learned model states beside its arrays.

    Types are checked strictly: a number in quotes is refused.
    """

    model_config = ConfigDict(strict=True)
    camera: StereoCamera | None
    training: dict[str, Any]

    @field_validator("training")
    @classmethod
    def _check_training(cls, training: dict[str, Any]) -> dict[str, Any]:
        _TrainingFacts.model_validate(training)
        return training

    @classmethod
    def of(cls, file: ModelFile) -> Self:
        """Read the facts of a file.

        Raises:
            ValueError, InputError: a fact is missing or wrong, or the camera is impossible.
        """
        facts = cls.model_validate_json(json.dumps(dict(file.facts)))
        if facts.camera is not None:
            check_camera(facts.camera, "camera")
        return facts


def learned_from(model: NoiseModel) -> tuple[SeenRecording, ...]:
    """Return the recordings that a noise model was learned from; none if untrained."""
    training: Mapping[str, Any] = getattr(model, "training", {})
    return tuple(
        SeenRecording(str(recording["name"]), recording.get("view"))
        for recording in training.get("recordings", ())
    )


def refuse_other_camera(trained: StereoCamera | None, camera: StereoCamera) -> None:
    """Refuse a camera unlike ``trained``, the camera of the training; None accepts any.

    Raises:
        InputError: the cameras differ; the message says in what.
    """
    if trained is None:
        return
    unlike = difference_text(camera, trained, owner="this one's")
    if unlike:
        raise InputError(
            "noise model",
            f"it was trained with another camera: {unlike}.",
            "Train one with this camera.",
        )

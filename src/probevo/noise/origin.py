"""The origin of a learned noise model, as its file states it: the camera and the training."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, Self

from pydantic import ConfigDict

from probevo.camera.likeness import difference
from probevo.camera.stereo import StereoCamera, check_camera
from probevo.errors import InputError
from probevo.noise.base import NoiseModel
from probevo.noise.model_file import ModelFile
from probevo.settings import Settings


def origin_facts(camera: StereoCamera | None, training: Mapping[str, Any]) -> dict[str, Any]:
    """Return camera and training as plain values for a file, from which ``OriginFacts`` reads."""
    return {
        "camera": json.loads(json.dumps(asdict(camera))) if camera else None,
        "training": dict(training),
    }


class OriginFacts(Settings):
    """The facts that the file of every learned model states beside its arrays.

    Types are checked strictly: a number in quotes is refused.
    """

    model_config = ConfigDict(strict=True)
    camera: StereoCamera | None
    training: dict[str, Any]

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


def learned_from(model: NoiseModel) -> frozenset[str]:
    """Return the names of the recordings that a noise model was learned from; none if untrained."""
    training: Mapping[str, Any] = getattr(model, "training", {})
    return frozenset(str(recording["name"]) for recording in training.get("recordings", ()))


def refuse_other_camera(trained: StereoCamera | None, camera: StereoCamera) -> None:
    """Refuse a camera unlike ``trained``, that of the training; None accepts any.

    Raises:
        InputError: the cameras differ; the message says in what.
    """
    if trained is None:
        return
    unlike = difference(camera, trained)
    if unlike:
        unlike = unlike.replace("its", "this one's", 1)
        raise InputError(
            "noise model",
            f"it was trained with another camera: {unlike}.",
            "Train one with this camera.",
        )

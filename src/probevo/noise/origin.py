"""Where a learned noise model comes from, as its file says it: the camera, and the training."""

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
    """What ``OriginFacts`` reads."""
    return {
        "camera": json.loads(json.dumps(asdict(camera))) if camera else None,
        "training": dict(training),
    }


class OriginFacts(Settings):
    """What the file of every learned model says beside its arrays; of no other type than it is
    written."""

    model_config = ConfigDict(strict=True)
    camera: StereoCamera | None
    training: dict[str, Any]

    @classmethod
    def of(cls, file: ModelFile) -> Self:
        """Those of a file.

        Raises:
            ValueError, InputError: it does not hold such facts, or a camera that cannot be.
        """
        facts = cls.model_validate_json(json.dumps(dict(file.facts)))
        if facts.camera is not None:
            check_camera(facts.camera, "camera")
        return facts


def learned_from(model: NoiseModel) -> frozenset[str]:
    """Names of the recordings that a noise model was learned from; of a classical one there are
    none."""
    training: Mapping[str, Any] = getattr(model, "training", {})
    return frozenset(str(recording["name"]) for recording in training.get("recordings", ()))


def refuse_other_camera(trained: StereoCamera | None, camera: StereoCamera) -> None:
    """Refuse a camera unlike the one that a noise model was trained with; None was trained with
    none.

    Raises:
        InputError: says in what it differs.
    """
    unlike = difference(camera, trained) if trained else ""
    if unlike:
        unlike = unlike.replace("its", "this one's", 1)
        raise InputError(
            "noise model",
            f"it was trained with another camera: {unlike}.",
            "Train one with this camera.",
        )

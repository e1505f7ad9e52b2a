"""Noise models as the user names them: a classical one by its name, a learned one by the path of
its file."""

from __future__ import annotations

import os
from collections.abc import Collection
from difflib import get_close_matches
from pathlib import Path

from probevo.camera.stereo import StereoCamera
from probevo.errors import InputError
from probevo.noise.base import NoiseModel
from probevo.noise.classical import CLASSICAL
from probevo.noise.model_io import load_model


def noise_model(spec: str, others: Collection[str] = ()) -> NoiseModel:
    """The noise model of that name, or that the file of that path holds.

    Args:
        spec: a name of ``CLASSICAL``, or a path; a file that is called like one of them is meant by
            ``./fixed``.
        others: more names that would have been right where the user gave this one; for the message.

    Raises:
        InputError: it is neither a name nor a file, or the file holds no noise model.
    """
    if spec in CLASSICAL:
        return CLASSICAL[spec]()
    if not os.path.isfile(spec):
        raise _unknown(spec, (*CLASSICAL, *others))
    return load_model(Path(spec))


def check_model_camera(spec: str, model: NoiseModel, camera: StereoCamera) -> None:
    """Refuse a camera for which the noise model that ``spec`` names does not hold, and say which
    file it is.

    Raises:
        InputError: the model was learned with another camera.
    """
    try:
        model.check_camera(camera)
    except InputError as error:
        if spec in CLASSICAL:
            raise
        raise InputError(spec, error.what, error.cure) from error


def portable(spec: str) -> str:
    """The same noise model from any working directory: a path is made absolute."""
    return spec if spec in CLASSICAL else str(Path(spec).resolve())


def _unknown(spec: str, names: Collection[str]) -> InputError:
    if os.path.isdir(spec):
        return InputError(
            "--noise", f"{spec!r} is a folder.", "Give the model file (.safetensors) in it."
        )
    folder = os.path.dirname(spec) or "."
    files = (
        [name for name in sorted(os.listdir(folder)) if name.endswith(".safetensors")]
        if _readable(folder)
        else []
    )
    beside = [os.path.join(os.path.dirname(spec), name) for name in files]
    near = get_close_matches(spec, [*names, *beside], n=2)
    what = f"{spec!r} is no known name, and no such file exists."
    known = f"Known are {', '.join(names)}; or give a model file (.safetensors)."
    cure = f"Did you mean {' or '.join(near)}? {known}" if near else known
    return InputError("--noise", what, cure)


def _readable(folder: str) -> bool:
    return os.path.isdir(folder) and os.access(folder, os.R_OK)

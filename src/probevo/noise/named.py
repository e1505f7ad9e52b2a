"""Noise models as ``--noise`` selects them: untrained ones by kind, learned ones by file."""

from __future__ import annotations

import os
from collections.abc import Collection
from difflib import get_close_matches
from pathlib import Path

from probevo.camera.stereo import StereoCamera
from probevo.errors import InputError
from probevo.noise.base import NoiseModel
from probevo.noise.model_io import load_model
from probevo.noise.registry import untrained_model, untrained_names


def noise_model(spec: str, others: Collection[str] = ()) -> NoiseModel:
    """Return the noise model that a name or a path selects.

    Args:
        spec: the name of a kind that needs no training, or the path of a model file. A name takes
            precedence over a file: a file called ``fixed`` is selected by ``./fixed``.
        others: further names that the option accepts, listed in the message of the error.

    Raises:
        InputError: it is neither a name nor a file, or the file holds no noise model.
    """
    names = untrained_names()
    if spec in names:
        return untrained_model(spec)
    if not os.path.isfile(spec):
        raise _unknown(spec, (*names, *others))
    return load_model(Path(spec))


def check_model_camera(
    spec: str, model: NoiseModel, camera: StereoCamera, *, or_else: str = ""
) -> None:
    """Refuse a camera unlike the training's, in an error that names the model file.

    Args:
        spec: what the user named the model by.
        model: the model.
        camera: the camera of the recording.
        or_else: what else is a cure, as a sentence.

    Raises:
        InputError: the model was learned with another camera.
    """
    try:
        model.check_camera(camera)
    except InputError as error:
        if spec in untrained_names():
            raise
        raise InputError(spec, error.what, f"{error.cure} {or_else}".strip()) from error


def other_camera(model: NoiseModel, camera: StereoCamera) -> str | None:
    """Return in what a camera differs from the one of a model's training; None if it does not."""
    try:
        model.check_camera(camera)
    except InputError as error:
        return error.what
    return None


def is_learned(model: NoiseModel) -> bool:
    """Return whether a model says that it was learned from recordings."""
    return bool(getattr(model, "training", None))


def portable(spec: str) -> str:
    """Return ``spec`` so that it holds in any working directory: a path is made absolute."""
    return spec if spec in untrained_names() else str(Path(spec).resolve())


def _unknown(spec: str, names: Collection[str]) -> InputError:
    """Return the error for a ``spec`` that is neither a name nor a file, with similar spellings."""
    if os.path.isdir(spec):
        return InputError(
            "noise", f"{spec!r} is a folder.", "Give the model file (.safetensors) in it."
        )
    # Similar names and similar files in the same folder, in case of a typing error.
    parent = os.path.dirname(spec)
    folder = parent or "."
    files = []
    if os.path.isdir(folder) and os.access(folder, os.R_OK):
        files = [name for name in sorted(os.listdir(folder)) if name.endswith(".safetensors")]
    candidates = [*names, *(os.path.join(parent, name) for name in files)]
    similar = get_close_matches(spec, candidates, n=2)
    cure = f"Known are {', '.join(names)}; or give a model file (.safetensors)."
    if similar:
        cure = f"Did you mean {' or '.join(similar)}? {cure}"
    return InputError("noise", f"{spec!r} is not a known name, and no such file exists.", cure)

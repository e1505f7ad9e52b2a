"""Reads a YAML file into a pydantic model; every error names the file and the key."""

from __future__ import annotations

from pathlib import Path
from typing import TypeVar

import yaml
from pydantic import BaseModel, ValidationError

from probevo.errors import InputError
from probevo.sequences.text import read_text

Model = TypeVar("Model", bound=BaseModel)


def read_yaml(path: Path, model: type[Model], cure: str = "") -> Model:
    """The file as a ``model``.

    Raises:
        InputError: missing, not YAML, or not what the model allows; all the faults of the keys at once.
    """
    text = read_text(path, cure)
    if text.startswith("%YAML:"):  # OpenCV's header, as EuRoC has it, is no valid YAML
        text = text.partition("\n")[2]
    try:
        return model.model_validate(yaml.safe_load(text))
    except yaml.YAMLError as error:
        raise InputError(path, f"this is not YAML: {' '.join(str(error).split())}.", cure) from error
    except ValidationError as error:
        faults = [f"{'.'.join(map(str, fault['loc'])) or 'content'}: {fault['msg']}" for fault in error.errors()]
        raise InputError(path, "; ".join(faults) + ".", cure) from error

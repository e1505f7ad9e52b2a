"""Readers of YAML files and their pydantic models; every error names the file and the key."""

from __future__ import annotations

from collections.abc import Hashable
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ValidationError

from probevo.errors import InputError
from probevo.sequences.text import read_text

Model = TypeVar("Model", bound=BaseModel)
MERGE = "tag:yaml.org,2002:merge"


def read_yaml(path: Path, model: type[Model], cure: str = "") -> Model:
    """Read a YAML file as a ``model``.

    Raises:
        InputError: it is missing, not YAML, or not what the model allows.
    """
    return validated(load_yaml(path, cure), model, path, cure)


def validated(content: object, model: type[Model], path: Path, cure: str = "") -> Model:
    """Return the content of a file as a ``model``.

    Raises:
        InputError: the content is not what the model allows; names all keys at fault.
    """
    try:
        return model.model_validate(content)
    except ValidationError as error:
        faults = [
            f"{'.'.join(map(str, fault['loc'])) or 'content'}: {fault['msg']}"
            for fault in error.errors()
        ]
        raise InputError(path, "; ".join(faults) + ".", cure) from error


def load_yaml(path: Path, cure: str = "", *, loader: type[yaml.SafeLoader] | None = None) -> Any:
    """Read a YAML file: mappings, lists and scalars.

    Args:
        path: the file.
        cure: how to mend that the file is missing or no YAML.
        loader: of other tags than YAML's own; by default ``NoKeyTwice``.

    Raises:
        InputError: the file is missing, not text, or not YAML; a key is given twice, or a value is
            invalid (such as a 99th of May).
    """
    text = read_text(path, cure)
    # OpenCV's header, which EuRoC's files have, is not valid YAML.
    if text.startswith("%YAML:"):
        text = text.partition("\n")[2]
    try:
        return yaml.load(text, loader or NoKeyTwice)
    except (yaml.YAMLError, ValueError, OverflowError, RecursionError) as error:
        raise InputError(
            path, f"this is not YAML: {' '.join(str(error).split())}.", cure
        ) from error


class NoKeyTwice(yaml.SafeLoader):
    """A loader that refuses a key given twice; YAML's own would silently take the last."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        """Return the mapping of a node; refuse a key given twice."""
        seen: set[tuple[str, str]] = set()
        for key, _ in node.value:
            name = (key.tag, str(key.value))
            if name in seen and key.tag != MERGE:
                raise yaml.constructor.ConstructorError(
                    None, None, f"the key {key.value} is given twice", key.start_mark
                )
            seen.add(name)
        return super().construct_mapping(node, deep)

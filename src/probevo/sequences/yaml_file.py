"""Readers of YAML files and their pydantic models; every error names the file and the key."""

from __future__ import annotations

import re
from collections.abc import Hashable
from difflib import get_close_matches
from itertools import chain
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError, field_validator
from pydantic_core import ErrorDetails

from probevo.errors import InputError, brief
from probevo.sequences.text import read_text

Model = TypeVar("Model", bound=BaseModel)
MERGE = "tag:yaml.org,2002:merge"
MAX_BYTES = 64_000
"""Ten times the largest file that probevo writes; PyYAML needs more than a second to read it."""
MAX_CONTENT = 100_000
"""Values of a file, where an alias counts as often as it is used: nine lists of nine aliases each,
one in the other, would be 387 million."""
MAX_FAULTS = 8
"""Wrong keys that a message names."""
MIN_LIKENESS = 0.6
"""Likeness from which an unknown key is taken for a misspelt one, 0 to 1."""


class CalibrationModel(BaseModel):
    """A part of a calibration file: numbers, words and lists of them, but no switches."""

    model_config = ConfigDict(frozen=True)

    @field_validator("*", mode="before")
    @classmethod
    def _refuse_switch(cls, value: object) -> object:
        """Refuse ``true``, which pydantic would take for 1."""
        if isinstance(value, bool) or (
            isinstance(value, list) and any(isinstance(item, bool) for item in value)
        ):
            raise ValueError(f"{brief(value)} is a switch; expected a number")
        return value


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
    if content is None:
        raise InputError(path, "this file is empty.", cure)
    try:
        return model.model_validate(content)
    except ValidationError as error:
        faults = error.errors()
        missing = [_key_of(fault) for fault in faults if fault["type"] == "missing"]
        texts = [_fault_text(fault, missing) for fault in faults]
        if len(texts) > MAX_FAULTS:
            texts[MAX_FAULTS:] = [f"and {len(texts) - MAX_FAULTS} more"]
        raise InputError(path, "; ".join(texts) + ".", cure) from error


def _key_of(fault: ErrorDetails) -> str:
    """Return the key at fault, as section.key, shortened where it is long."""
    return brief(".".join(map(str, fault["loc"])) or "content")[1:-1]


def _fault_text(fault: ErrorDetails, missing: list[str]) -> str:
    """Return one fault in words.

    Args:
        fault: pydantic's finding.
        missing: the keys that are missing, of which an unknown one may be a misspelling.
    """
    key = _key_of(fault)
    if fault["type"] == "missing":
        return f"{key} is missing"
    if fault["type"] == "extra_forbidden":
        near = get_close_matches(key, missing, n=1, cutoff=MIN_LIKENESS)
        return f"{key} is not known" + (f" (did you mean {near[0]}?)" if near else "")
    if fault["type"] == "value_error":  # a check of ours, which names the value
        return f"{key}: {fault['msg'].removeprefix('Value error, ')}"
    value = brief(fault["input"])
    if fault["type"] in ("float_parsing", "int_parsing"):
        hint = ", with a decimal point instead of the comma" if "," in value else ""
        return f"{key} is {value}; write a plain number{hint}"
    return f"{key} is {value}; {fault['msg'].replace('Input should', 'it should')}"


def load_yaml(path: Path, cure: str = "", *, loader: type[yaml.SafeLoader] | None = None) -> Any:
    """Read a YAML file: mappings, lists and scalars.

    Args:
        path: the file.
        cure: how to mend that the file is missing or no YAML.
        loader: of other tags than YAML's own; by default ``NoKeyTwice``.

    Raises:
        InputError: the file is missing, too large, not text, or not YAML; a key is given twice, or
            a value is invalid (such as a 99th of May); or its aliases expand without end.
    """
    text = read_text(path, cure, most_bytes=MAX_BYTES)
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
    """A loader that refuses a key given twice, and aliases that expand to a huge content.

    YAML itself would silently take the last of two values. Only ``true`` and ``false`` are
    switches, as in YAML 1.2: ``on`` is a word here, and no number.
    """

    def get_single_node(self) -> yaml.Node | None:
        """Return the document, before any of its values is made."""
        root = super().get_single_node()
        if root is not None:
            _expanded_size(root, {})
        return root

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        """Return the mapping of a node; refuse a key given twice, and a node of another kind."""
        if not isinstance(node, yaml.MappingNode):  # a list or a scalar, by its tag a mapping
            raise yaml.constructor.ConstructorError(
                None, None, f"expected `key: value` lines, but found a {node.id}", node.start_mark
            )
        seen: set[tuple[str, str]] = set()
        for key, _ in node.value:
            name = (key.tag, str(key.value))
            if name in seen and key.tag != MERGE:
                raise yaml.constructor.ConstructorError(
                    None, None, f"the key {brief(key.value)[1:-1]} is given twice", key.start_mark
                )
            seen.add(name)
        return super().construct_mapping(node, deep)


BOOL = "tag:yaml.org,2002:bool"
NoKeyTwice.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in resolvers if tag != BOOL]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
NoKeyTwice.add_implicit_resolver(
    BOOL, re.compile("^(?:true|True|TRUE|false|False|FALSE)$"), list("tTfF")
)


def _expanded_size(node: yaml.Node, sizes: dict[yaml.Node, int]) -> int:
    """Return the number of values of a node if each alias were written out.

    Args:
        node: the node.
        sizes: sizes of nodes that are known already; receives this one.

    Raises:
        yaml.YAMLError: there are more than MAX_CONTENT, or the node contains itself.
    """
    if isinstance(node, yaml.ScalarNode):
        return 1
    if node not in sizes:
        sizes[node] = MAX_CONTENT  # for a node that contains itself
        parts = (
            chain.from_iterable(node.value) if isinstance(node, yaml.MappingNode) else node.value
        )
        sizes[node] = 1 + sum(_expanded_size(part, sizes) for part in parts)
    if sizes[node] > MAX_CONTENT:
        raise yaml.constructor.ConstructorError(
            None, None, f"it expands to more than {MAX_CONTENT:,} values", node.start_mark
        )
    return sizes[node]

"""Settings as users give them, as a dictionary or in words, and what is wrong with them."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from probevo.config.settings import Settings
from probevo.errors import InputError, brief

SettingsType = TypeVar("SettingsType", bound=Settings)

MAX_FAULTS = 8
"""Wrong settings that a message names."""


def checked_settings(
    value: object, model: type[SettingsType], *, example: str, name: str = "config"
) -> SettingsType:
    """Return settings given as themselves, as a dictionary of those that differ, or as None.

    Args:
        value: an argument of a function.
        model: the settings that it may be.
        example: a dictionary as the caller may write it, for messages.
        name: of the argument.

    Raises:
        InputError: it is something else, a key is unknown, or a value is out of bounds.
    """
    if value is None:
        return model()
    if isinstance(value, model):
        return value
    if not isinstance(value, Mapping):
        article = "an" if model.__name__[0] in "AEIOU" else "a"
        cure = f"Give {article} {model.__name__}, or a dict such as {example}."
        raise InputError(name, f"is {brief(value)}.", cure)
    try:
        return model.model_validate(dict(value))
    except ValidationError as error:
        raise setting_error(error, name, model) from error


def setting_error(
    error: ValidationError,
    where: str | Path,
    model: type[BaseModel],
    spelled: Callable[[str], str] = lambda key: key,
) -> InputError:
    """Return pydantic's findings as one error: each wrong key with its value, and a cure.

    The cure concerns the first key; unknown keys come first.

    Args:
        error: raised by validating a ``model``.
        where: the file, or the kind of input.
        model: the settings that were validated.
        spelled: returns a key, ``section.key``, as the user writes it.
    """
    unknown_first = sorted(error.errors(), key=lambda fault: fault["type"] != "extra_forbidden")
    faults = [(".".join(map(str, fault["loc"])), fault) for fault in unknown_first]
    # Of a list with a wrong item, pydantic also says that it has too few right ones.
    keys = [key for key, _ in faults]
    faults = [
        (key, fault)
        for key, fault in faults
        if fault["type"] != "too_short" or not any(other.startswith(f"{key}.") for other in keys)
    ]
    texts = [_fault_text(spelled(key) if key else "", fault) for key, fault in faults[:MAX_FAULTS]]
    if len(faults) > MAX_FAULTS:
        texts.append(f"and {len(faults) - MAX_FAULTS} more")

    known = dict(_known_keys(model))
    first_key, first_fault = faults[0]
    if first_fault["type"] == "extra_forbidden":
        is_dotted = any("." in str(part) for part in first_fault["loc"])
        cure = _nearest_keys(first_key, known, is_dotted=is_dotted)
    else:
        cure = known.get(first_key, "") or known.get(first_key.rpartition(".")[0], "")
    return InputError(where, "; ".join(texts) + ".", cure)


def _fault_text(key: str, fault: ErrorDetails) -> str:
    """Return one fault in words; it has no key if several settings contradict each other."""
    if fault["type"] == "extra_forbidden":
        return f"the key {brief(key)[1:-1]} is not known"
    message = fault["msg"].removeprefix("Value error, ").replace("Input should", "it should")
    return f"{key} is {brief(fault['input'])}; {message}" if key else message


def _nearest_keys(key: str, known: Collection[str], *, is_dotted: bool) -> str:
    """Return the cure of an unknown key: the nearest ones, as they are nested if it was written
    with dots; or all."""
    key = key.replace("-", "_")
    last = key.rpartition(".")[2]
    # The right key in a wrong section, or in none, is nearer than any other spelling.
    near = [name for name in known if name.rpartition(".")[2] == last]
    if not near:
        near = get_close_matches(key, known, n=1)
    if is_dotted and key in known:
        return f"Nest it: {_nested(key)}."
    if is_dotted:
        near = [_nested(name) for name in near]
    return f"Did you mean {' or '.join(near)}?" if near else f"Known are {', '.join(known)}."


def _nested(key: str) -> str:
    """Return ``section.key`` as YAML has it: ``section: {key: …}``."""
    *sections, last = key.split(".")
    text = f"{last}: …"
    for section in reversed(sections):
        text = f"{section}: {{{text}}}"
    return text


def _known_keys(model: type[BaseModel], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Yield the dotted name and the description of each setting."""
    for name, field in model.model_fields.items():
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            yield from _known_keys(field.annotation, f"{prefix}{name}.")
        else:
            yield prefix + name, field.description or ""

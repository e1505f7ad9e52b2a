"""Parsing of the command line into a dataclass of arguments with its settings."""

from __future__ import annotations

import re
from collections.abc import Mapping
from itertools import pairwise
from typing import Any, Literal, TypeVar, get_args, get_origin

import tyro
from pydantic import BaseModel, ValidationError
from tyro.constructors import (
    ConstructorRegistry,
    PrimitiveConstructorSpec,
    PrimitiveTypeInfo,
    StructConstructorSpec,
    StructFieldSpec,
    StructTypeInfo,
)

from probevo.config.validation import setting_error
from probevo.errors import InputError
from probevo.run_config import OWN_KEYS, RunConfig

Arguments = TypeVar("Arguments")
Model = TypeVar("Model", bound=BaseModel)
NOT_FLAGS = ("sequence",)
"""Settings that are positional arguments instead."""
_registry = ConstructorRegistry()


def parse(
    kind: type[Arguments], words: list[str], command: str, default: Arguments | None = None
) -> Arguments:
    """Parse the words of the command line; bad ones exit with code 2 and a hint.

    Args:
        kind: the dataclass of the arguments; its docstrings are the help.
        words: what follows the command.
        command: name of the command, for the help.
        default: what holds where no flag is given.

    Raises:
        InputError: --out is empty, which would mean the current directory.
    """
    if "--out=" in words or ("--out", "") in pairwise(words):
        cure = "Name a folder, or the file to write; . is the current directory."
        raise InputError("--out", "is empty.", cure)
    given: dict[str, Any] = {} if default is None else {"default": default}
    with _registry:
        parsed: Arguments = tyro.cli(
            kind, args=words, prog=f"probevo {command}", config=(tyro.conf.DisallowNone,), **given
        )
    return parsed


def parse_one_of(
    kinds: Mapping[str, type[Arguments]], words: list[str], command: str, all_kinds: type[Any]
) -> Arguments:
    """Parse words of which the first names what the others are arguments of.

    Of subcommands, tyro would name the help without the command before it.

    Args:
        kinds: the dataclasses of the arguments by that first word.
        words: what follows the command.
        command: name of the command, for the help.
        all_kinds: a dataclass with all of them as subcommands, its only field, for the help.

    Raises:
        InputError: as ``parse`` does.
    """
    if words and words[0] in kinds:
        return parse(kinds[words[0]], words[1:], f"{command} {words[0]}")
    parsed: Arguments
    (parsed,) = vars(parse(all_kinds, words, command)).values()
    return parsed


def checked(settings: Model) -> Model:
    """Validate settings that were given as flags; ``parse`` leaves this out.

    Raises:
        InputError: names each flag that is out of bounds.
    """

    def as_flag(key: str) -> str:
        """Return the flag of a setting; items of a list have no flag of their own."""
        name = re.sub(r"\.\d+$", "", key)
        return f"--{name.replace('_', '-')}"

    try:
        return type(settings).model_validate(settings.model_dump())
    except ValidationError as error:
        raise setting_error(error, "flags", type(settings), spelled=as_flag) from error


@_registry.struct_rule
def _unchecked(info: StructTypeInfo) -> StructConstructorSpec | None:
    # Build the settings without validation: tyro would report a value that is out of bounds in
    # pydantic's words, and name the section instead of the flag.
    if not (isinstance(info.type, type) and issubclass(info.type, BaseModel)):
        return None
    model: type[BaseModel] = info.type
    own_keys = OWN_KEYS if issubclass(model, RunConfig) else ()
    own_first = sorted(model.model_fields.items(), key=lambda item: item[0] not in own_keys)
    fields = [
        StructFieldSpec(
            name,
            field.annotation,  # type: ignore[arg-type]
            getattr(info.default, name),
            field.description,
        )
        for name, field in own_first
        if name not in NOT_FLAGS
    ]

    def build(**values: Any) -> BaseModel:
        """Return the settings as they were given; its docstring becomes that of the model."""
        return model.model_construct(**values)

    build.__doc__ = model.__doc__
    return StructConstructorSpec(build, tuple(fields))


@_registry.primitive_rule
def _name_or_nothing(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
    # Offer the names of a Literal only: tyro would list None among them, in random order, although
    # DisallowNone refuses it.
    kinds = get_args(info.type)
    if len(kinds) != 2 or kinds[1] is not type(None) or get_origin(kinds[0]) is not Literal:
        return None
    names: tuple[str, ...] = get_args(kinds[0])
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar="{" + ",".join(names) + "}",
        instance_from_str=lambda words: words[0],
        is_instance=lambda value: value is None or value in names,
        str_from_instance=lambda value: [str(value)],
        choices=names,
    )

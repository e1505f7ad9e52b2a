"""Words of the command line → a dataclass, or the settings of a run."""

from __future__ import annotations

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

from probevo.errors import InputError
from probevo.run_config import OWN_KEYS, RunConfig, setting_error

Arguments = TypeVar("Arguments")
Model = TypeVar("Model", bound=BaseModel)
NOT_FLAGS = ("sequence",)
"""Settings that are given by position."""
_registry = ConstructorRegistry()


def parse(
    kind: type[Arguments], words: list[str], command: str, default: Arguments | None = None
) -> Arguments:
    """The words as a ``kind``; its docstrings are the help. Exits with code 2 and a hint if they do
    not fit.

    Raises:
        InputError: --out is empty, which would be the current directory.
    """
    if "--out=" in words or ("--out", "") in pairwise(words):
        raise InputError(
            "--out", "is empty.", "Name a folder, or the file to write; . is the current directory."
        )
    given: dict[str, Any] = {} if default is None else {"default": default}
    with _registry:
        parsed: Arguments = tyro.cli(
            kind, args=words, prog=f"probevo {command}", config=(tyro.conf.DisallowNone,), **given
        )
    return parsed


def checked(settings: Model) -> Model:
    """Settings that came as flags, once more with the checks that ``parse`` leaves out.

    Raises:
        InputError: names the flag out of bounds.
    """
    try:
        return type(settings).model_validate(settings.model_dump())
    except ValidationError as error:
        raise setting_error(
            error, "flags", type(settings), spelled=lambda key: f"--{key.replace('_', '-')}"
        ) from error


@_registry.struct_rule
def _unchecked(info: StructTypeInfo) -> StructConstructorSpec | None:
    # tyro would report a value out of bounds in pydantic's words, and name the section instead of
    # the flag.
    if not (isinstance(info.type, type) and issubclass(info.type, BaseModel)):
        return None
    model: type[BaseModel] = info.type
    first = OWN_KEYS if issubclass(model, RunConfig) else ()
    ordered = sorted(model.model_fields.items(), key=lambda item: item[0] not in first)
    fields = [
        StructFieldSpec(name, field.annotation, getattr(info.default, name), field.description)  # type: ignore[arg-type]
        for name, field in ordered
        if name not in NOT_FLAGS
    ]

    def build(**values: Any) -> BaseModel:
        return model.model_construct(**values)

    build.__doc__ = model.__doc__
    return StructConstructorSpec(build, tuple(fields))


@_registry.primitive_rule
def _name_or_nothing(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
    # tyro would offer 'None' among the names, in an order of chance, although DisallowNone refuses
    # it.
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

"""Entry points of installed packages, by which these register models, predictors and formats."""

from __future__ import annotations

import importlib.metadata
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint
from typing import Any, TypeVar

from probevo.errors import InputError

LOAD_ERRORS = (ImportError, AttributeError, NameError, SyntaxError, TypeError, ValueError)
"""What loading the module of a broken entry point raises; a package with other faults should show
its own traceback."""

Expected = TypeVar("Expected")


@cache
def entry_points(group: str) -> tuple[EntryPoint, ...]:
    """Return the entry points of a group, as installed when it was first asked for.

    Looking them up reads a file of every installed package, which takes milliseconds; a training
    asks thousands of times.
    """
    return tuple(importlib.metadata.entry_points(group=group))


def load_entry(entry: EntryPoint, expected: type[Expected]) -> Expected:
    """Return what an entry point names.

    Args:
        entry: the entry point.
        expected: the class of which it should be.

    Raises:
        InputError: it cannot be loaded, or is of another class.
    """
    cure = "Update or uninstall the package that provides it."
    try:
        found = entry.load()
    except LOAD_ERRORS as error:
        what = f"it cannot be loaded ({type(error).__name__}: {error})."
        raise InputError(entry_text(entry), what, cure) from error
    if not isinstance(found, expected):
        what = f"it is of type {type(found).__name__}, not {expected.__name__}."
        raise InputError(entry_text(entry), what, cure)
    return found


def entry_text(entry: EntryPoint) -> str:
    """Return how a message names an entry point."""
    return f"entry point {entry.name} = {entry.value} of {entry.group}"


def imported(place: str) -> Any:
    """Import an object that is written as ``module:name``."""
    module, _, name = place.partition(":")
    return getattr(import_module(module), name)

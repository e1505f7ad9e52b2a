"""Entry points of installed packages, by which these register models, predictors and formats."""

from __future__ import annotations

import importlib.metadata
from functools import cache
from importlib.metadata import EntryPoint


@cache
def entry_points(group: str) -> tuple[EntryPoint, ...]:
    """Return the entry points of a group, as installed when it was first asked for.

    Looking them up reads a file of every installed package, which takes milliseconds; a training
    asks thousands of times.
    """
    return tuple(importlib.metadata.entry_points(group=group))

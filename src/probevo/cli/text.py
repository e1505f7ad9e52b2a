"""Layout of text on the terminal."""

from __future__ import annotations

import shutil
from collections.abc import Iterable
from textwrap import wrap


def columns(rows: Iterable[tuple[str, str]]) -> str:
    """Return rows of name and text; the texts are aligned and wrapped to the terminal's width."""
    rows = list(rows)
    indent = max(len(name) for name, _ in rows) + 2
    width = max(40, shutil.get_terminal_size().columns - indent)
    lines = []
    for name, text in rows:
        first, *others = wrap(text, width, break_long_words=False, break_on_hyphens=False) or [""]
        lines.append(f"{name:<{indent}}{first}")
        lines += [" " * indent + part for part in others]
    return "\n".join(line.rstrip() for line in lines)


def table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    """Return a table whose first column is aligned left, and all others right."""
    cells = [head, *rows]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    cells.insert(1, tuple("─" * width for width in widths))
    lines = [[row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:])] for row in cells]
    return "\n".join("  ".join(line).rstrip() for line in lines)

"""Reads number tables out of text files; every error names the file and the line."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.errors import InputError

INT64_LIMIT = 2**63


def read_text(path: Path, cure: str = "") -> str:
    """Content of a UTF-8 text file.

    Raises:
        InputError: it is missing, or not text; ``cure`` says how to mend the former.
    """
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise InputError(path, "this file is missing.", cure) from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(path, f"cannot be read as text ({error}).", cure) from error


def read_lines(path: Path, cure: str = "") -> list[tuple[str, str]]:
    """("path:line", stripped text) of each line that is neither blank nor a # comment.

    Raises:
        InputError: the file is missing, is not text or has no such line.
    """
    lines = [
        (f"{path}:{number}", line.strip())
        for number, line in enumerate(read_text(path, cure).splitlines(), 1)
    ]
    lines = [(where, line) for where, line in lines if line and not line.startswith("#")]
    if not lines:
        raise InputError(path, "this file holds no values.", cure)
    return lines


def parse_floats(texts: list[str], where: str, *, nan_allowed: bool = False) -> list[float]:
    """Numbers of one line. Raises InputError for text and for values that are not finite."""
    numbers = []
    for text in texts:
        try:
            number = float(text)
        except ValueError:
            raise InputError(where, f"{text.strip()!r} is not a number.") from None
        if not (math.isfinite(number) or (nan_allowed and math.isnan(number))):
            raise InputError(where, f"the value {text.strip()!r} is not finite.")
        numbers.append(number)
    return numbers


def parse_stamp_ns(text: str, where: str) -> int:
    """A stamp written as a whole number of nanoseconds."""
    try:
        stamp = int(text)
    except ValueError:
        raise InputError(
            where, f"the stamp {text.strip()!r} is not a whole number of nanoseconds."
        ) from None
    if not -INT64_LIMIT <= stamp < INT64_LIMIT:
        raise InputError(
            where, f"the stamp {stamp} does not fit in 64 bits.", "Stamps are nanoseconds."
        )
    return stamp


def read_fields(path: Path, columns: int) -> list[tuple[str, list[str]]]:
    """("path:line", its ``columns`` texts apart by blanks) of each line."""
    rows = [(where, line.split()) for where, line in read_lines(path)]
    for where, fields in rows:
        if len(fields) != columns:
            raise InputError(where, f"this line has {len(fields)} values; expected {columns}.")
    return rows


def read_table(path: Path, columns: int, *, nan_allowed: bool = False) -> FloatArray:
    """Rows of ``columns`` numbers apart by blanks, [n, columns]."""
    return np.array(
        [
            parse_floats(fields, where, nan_allowed=nan_allowed)
            for where, fields in read_fields(path, columns)
        ]
    )


def read_stamped_csv(
    path: Path, columns: int, *, header: str | None = None, cure: str = ""
) -> tuple[IntArray, FloatArray]:
    """A table whose first column is a stamp in ns: stamps [n] and the next ``columns`` values [n,
    columns].

    Args:
        path: the file; lines that start with # are comments.
        columns: how many values after the stamp to read; further ones are ignored where no header
            is demanded.
        header: text that the first line must be; None where the file has no header or a commented
            one.
        cure: how to mend that the file is missing.
    """
    lines = read_lines(path, cure)
    if header is not None and lines.pop(0)[1].replace(" ", "") != header:
        raise InputError(
            path, "the header is not the expected one.", f"Its first line must read {header}."
        )
    stamps = []
    rows = []
    for where, line in lines:
        fields = line.split(",")
        if len(fields) < columns + 1 or (header is not None and len(fields) > columns + 1):
            raise InputError(where, f"this line has {len(fields)} values; expected {columns + 1}.")
        stamps.append(parse_stamp_ns(fields[0], where))
        rows.append(parse_floats(fields[1 : columns + 1], where))
    return np.array(stamps, dtype=np.int64), np.array(rows).reshape(-1, columns)

"""Readers of number tables in text files; every error names the file and the line."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.errors import InputError, brief
from probevo.storage.files import check_regular

INT64_LIMIT = 2**63
"""Whole numbers from minus this up to below it fit in 64 bits."""
MAX_TEXT_BYTES = 1_000_000_000
"""Ten hours of an IMU at 200 Hz take 0.7 GB."""


def read_text(path: Path, cure: str = "", *, most_bytes: int = MAX_TEXT_BYTES) -> str:
    """Read a UTF-8 text file.

    Args:
        path: the file.
        cure: how to mend that the file is missing.
        most_bytes: the largest plausible size.

    Raises:
        InputError: the file is missing, too large, not a regular file, or not text.
    """
    check_regular(path, most_bytes)
    try:
        return path.read_text(encoding="utf-8-sig")  # some programs begin with a byte order mark
    except FileNotFoundError:
        raise InputError(path, "this file is missing.", cure) from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(path, f"cannot be read as text ({error}).", cure) from error


def read_lines(path: Path, cure: str = "") -> list[tuple[str, str]]:
    """Read the lines of a text file, without blank lines and # comments.

    Returns:
        ("path:line", stripped text) of each line.

    Raises:
        InputError: the file is missing, is not text, or has no such line.
    """
    numbered = enumerate(read_text(path, cure).splitlines(), start=1)
    stripped = [(f"{path}:{number}", line.strip()) for number, line in numbered]
    lines = [(where, line) for where, line in stripped if line and not line.startswith("#")]
    if not lines:
        raise InputError(path, "this file holds no values.", cure)
    return lines


def parse_floats(texts: list[str], where: str, *, nan_allowed: bool = False) -> list[float]:
    """Parse the numbers of one line.

    Args:
        texts: the numbers as text.
        where: "path:line", for messages.
        nan_allowed: accept NaN.

    Raises:
        InputError: a text is no number, or a value is not finite.
    """
    numbers = []
    for text in texts:
        try:
            number = float(text)
        except ValueError:
            raise InputError(where, f"{brief(text.strip())} is not a number.") from None
        if not (math.isfinite(number) or (nan_allowed and math.isnan(number))):
            raise InputError(where, f"the value {brief(text.strip())} is not finite.")
        numbers.append(number)
    return numbers


def parse_stamp_ns(text: str, where: str) -> int:
    """Parse a whole number of nanoseconds.

    Raises:
        InputError: the text is no whole number, or it does not fit in 64 bits.
    """
    try:
        stamp = int(text)
    except ValueError:
        raise InputError(
            where, f"the stamp {brief(text.strip())} is not a whole number of nanoseconds."
        ) from None
    if not -INT64_LIMIT <= stamp < INT64_LIMIT:
        raise InputError(
            where, f"the stamp {brief(stamp)} does not fit in 64 bits.", "Stamps are nanoseconds."
        )
    return stamp


def read_fields(path: Path, columns: int) -> list[tuple[str, list[str]]]:
    """Split the lines of a file at blanks.

    Returns:
        ("path:line", the ``columns`` texts of the line) of each line.

    Raises:
        InputError: a line has commas, or another number of texts, or as ``read_lines`` raises.
    """
    rows = [(where, line.split()) for where, line in read_lines(path)]
    for where, fields in rows:
        if any("," in field for field in fields):
            what = "its values are separated by commas; expected blanks."
            raise InputError(where, what, "Replace the commas by blanks.")
        if len(fields) != columns:
            raise InputError(where, f"this line has {len(fields)} values; expected {columns}.")
    return rows


def read_table(path: Path, columns: int, *, nan_allowed: bool = False) -> FloatArray:
    """Read rows of ``columns`` numbers separated by blanks, [n, columns].

    Raises:
        InputError: as ``read_fields`` and ``parse_floats`` raise.
    """
    rows = [
        parse_floats(fields, where, nan_allowed=nan_allowed)
        for where, fields in read_fields(path, columns)
    ]
    return np.array(rows)


def read_stamped_csv(
    path: Path,
    columns: int,
    *,
    header: str | None = None,
    cure: str = "",
    is_imu: bool = False,
) -> tuple[IntArray, FloatArray]:
    """Read a comma-separated table whose first column is a stamp in ns.

    Args:
        path: the file; lines that start with # are comments.
        columns: number of values to read after the stamp; further values are ignored if no header
            is required.
        header: required first line; None if the file has no header, or a commented one.
        cure: how to mend that the file is missing.
        is_imu: whether the values are angular rate and specific force of an IMU, of which the force
            may be NaN.

    Returns:
        Stamps, [n], ns, and values, [n, columns].

    Raises:
        InputError: the file is missing, its header differs, or a line is faulty.
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
        values = fields[1 : columns + 1]
        rows.append(_parse_sample(values, where) if is_imu else parse_floats(values, where))
    return np.array(stamps, dtype=np.int64), np.array(rows).reshape(-1, columns)


def _parse_sample(texts: list[str], where: str) -> list[float]:
    """Parse angular rate, rad/s, and specific force, m/s², of an IMU: six numbers.

    Raises:
        InputError: a text is no number, or a value is not finite; the force may be NaN as a whole.
    """
    rate_rad_s = parse_floats(texts[:3], where)
    force_m_s2 = parse_floats(texts[3:], where, nan_allowed=True)
    if len({math.isnan(number) for number in force_m_s2}) > 1:
        what = "some of the three accelerations are nan."
        raise InputError(where, what, "Without an accelerometer, all three are.")
    return rate_rad_s + force_m_s2

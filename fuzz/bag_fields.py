"""Bags whose framing is valid, with hostile fields in their messages."""

from __future__ import annotations

import struct
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import Generator

from fuzz.mutations import TOKENS, one_of

HOSTILE_NUMBERS = (0, 1, -1, 2, 3, 255, 65536, 2**31 - 1, -(2**31), 2**32 - 1, 2**63 - 1)
HOSTILE_REALS = (np.nan, np.inf, -np.inf, 0.0, -1.0, 1e-320, 1e9, 1e155, 1e300, -1e300)
HOSTILE_STAMPS = (0, -1, 1, 10**9, 2**31 * 10**9 - 1, 2**32 * 10**9 - 1, -(10**18))
ENCODINGS = ("mono16", "bgr8", "rgba8", "bayer_rggb8", "16UC1", "32FC1", "8UC4", "yuv422", "")
UNWRITABLE = (struct.error, OverflowError, ValueError, TypeError, AssertionError, UnicodeError)
"""What the writer raises for fields that no message can hold."""


def other_messages(messages: Sequence[Any], rng: Generator) -> list[Any]:
    """Return the messages of a bag, one to four of them damaged, lost, doubled or out of order."""
    changed = list(messages)
    for _ in range(rng.integers(1, 5)):
        k = int(rng.integers(len(changed)))
        way = rng.random()
        if way < 0.05:
            del changed[k]
        elif way < 0.1:
            changed.insert(int(rng.integers(len(changed))), changed[k])
        elif way < 0.2:
            changed[k] = replace(changed[k], stamp_ns=one_of(HOSTILE_STAMPS, rng))
        elif way < 0.25:
            changed[k] = replace(changed[k], frame=one_of(TOKENS, rng))
        else:
            changed[k] = replace(changed[k], fields=_other_fields(changed[k].fields, rng))
            if rng.random() < 0.3:
                # All messages of a topic alike, as of a driver that is wrong.
                fields = changed[k].fields
                same = [m.topic == changed[k].topic for m in changed]
                changed = [
                    replace(m, fields=fields) if is_same else m
                    for m, is_same in zip(changed, same, strict=True)
                ]
    return changed


def _other_fields(fields: dict[str, Any], rng: Generator) -> dict[str, Any]:
    name = one_of(tuple(fields), rng)
    return fields | {name: _other_value(name, fields[name], rng)}


def _other_value(name: str, value: Any, rng: Generator) -> Any:
    if isinstance(value, str):
        return one_of(ENCODINGS if name == "encoding" and rng.random() < 0.7 else TOKENS, rng)
    if isinstance(value, bool | int | np.integer):
        return one_of(HOSTILE_NUMBERS, rng)
    if isinstance(value, float):
        return one_of(HOSTILE_REALS, rng)
    if isinstance(value, list):
        changed = list(value)
        changed[int(rng.integers(len(changed)))] = float(one_of(HOSTILE_REALS, rng))
        return changed
    array = np.array(value)
    way = rng.random()
    if array.dtype.kind == "f" and way < 0.7:
        array.flat[int(rng.integers(array.size))] = one_of(HOSTILE_REALS, rng)
        return array
    if array.ndim == 1 and name.lower() in ("data", "d"):
        # Lengths of these may differ from what the other fields say.
        length = int(one_of((0, 1, 7, len(array) // 2, len(array) + 3), rng))
        return np.resize(array, length) if length else array[:0]
    if array.dtype.kind == "u" and array.size:
        array.flat[rng.integers(array.size, size=5)] = rng.integers(256, size=5)
    return array


def _written(path: Path, kind: str, messages: Sequence[Any], rng: Generator | None) -> Path:
    """Write damaged messages as a bag; those that no bag can hold are drawn anew."""
    from sequences.bags import write_messages

    for attempt in range(50 if rng is not None else 0):
        assert rng is not None
        place = path.with_name(f"{path.name}-{attempt}")
        try:
            return write_messages(place, kind, other_messages(messages, rng))
        except UNWRITABLE:
            continue
    return write_messages(path, kind, messages)


def hostile_files(
    kind: str, messages: Sequence[Any], rng: Generator | None
) -> tuple[str, dict[str, bytes]]:
    """Return the path to open, always the same, and the files of a hostile bag.

    Without a generator, nothing is damaged.
    """
    with tempfile.TemporaryDirectory(prefix="fuzz-") as name:
        written = _written(Path(name) / "drive", kind, messages, rng)
        if written.is_file():
            return f"drive{written.suffix}", {f"drive{written.suffix}": written.read_bytes()}
        files = {
            f"drive/{path.relative_to(written).as_posix()}": path.read_bytes()
            for path in sorted(written.rglob("*"))
            if path.is_file()
        }
    return "drive", files

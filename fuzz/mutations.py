"""Seeded mutations of bytes, text, JSON-like values and arrays."""

from __future__ import annotations

import copy
import io
import re
import zipfile
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.random import Generator

Choice = TypeVar("Choice")
Arrays = dict[str, np.ndarray[Any, Any]]

NUMBER = re.compile(r"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")
TOKENS = (
    *("nan", "inf", "-inf", "NaN", "1e999", "-1e999", "1e300", "-1e300", "1e-320", "1e155", "1e18"),
    *("0", "-0", "-1", "1", "2", "0.0", "1e5", "65000", "2147483648", "4294967296"),
    *("9223372036854775807", "9223372036854775808", "-9223372036854775809", "1e999999999"),
    *("18446744073709551616", "0x10", "1_000", "١٢", "½", "9" * 400, "0." + "0" * 400 + "1"),
    *(
        "",
        " ",
        "\t",
        "\n",
        "null",
        "true",
        "on",
        "~",
        "[]",
        "{}",
        "[1]",
        "1,2",
        "1 2",
        ":",
        "-",
        "#",
    ),
    *("2011-99-99", "9999-12-31", "0000-01-01", "\x00", "é", "\U0001f600", "'", '"', "&a", "*a"),
    *("!!python/object:os.system", "%YAML:1.0", "<<", "../..", "/dev/zero", "a" * 5000),
)
"""What takes the place of a number or a word."""
VALUES: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 1, 2, 2**31, 2**63, -(2**64), 10**400),
    *(0.0, -0.0, 1e-320, 1e155, 1e300, float("nan"), float("inf"), -float("inf")),
    *("", "a", "nan", "1e999", "é\U0001f600", "a" * 2000, "/dev/zero", "../x"),
    *([], {}, [1], [[1.0]], [None], {"a": 1}, [[[]]], [0.0] * 500),
)
"""What takes the place of a value."""
FLOATS = (0.0, -0.0, 1e-320, 1e-9, 1e9, 1e20, 1e155, 1e300, np.nan, np.inf, -np.inf, -1.0)
INTEGERS = (0, 1, -1, 127, -128, 255, 2**31 - 1, -(2**31), 2**63 - 1, -(2**63))
DTYPES = (
    "i1",
    "u1",
    "i4",
    "i8",
    "u8",
    "f2",
    "f4",
    "f8",
    "g",
    "c16",
    "?",
    "U5",
    "S3",
    "M8[s]",
    ">f8",
)


def one_of(choices: Sequence[Choice], rng: Generator) -> Choice:
    return choices[int(rng.integers(len(choices)))]


def mutated_bytes(data: bytes, rng: Generator) -> bytes:
    """Damage bytes in one to three places."""
    for _ in range(rng.integers(1, 4)):
        data = one_of(BYTE_EDITS, rng)(data, rng)
    return data


def _place(data: bytes, rng: Generator) -> int:
    return int(rng.integers(len(data) + 1))


def _flip(data: bytes, rng: Generator) -> bytes:
    if not data:
        return b"\0"
    place = int(rng.integers(len(data)))
    return data[:place] + bytes([data[place] ^ (1 << rng.integers(8))]) + data[place + 1 :]


def _cut(data: bytes, rng: Generator) -> bytes:
    return data[: _place(data, rng)]


def _without(data: bytes, rng: Generator) -> bytes:
    start = _place(data, rng)
    return data[:start] + data[start + int(rng.integers(1, 65)) :]


def _inserted(data: bytes, rng: Generator) -> bytes:
    place = _place(data, rng)
    return data[:place] + rng.bytes(int(rng.integers(1, 65))) + data[place:]


def _overwritten(data: bytes, rng: Generator) -> bytes:
    """Put a number of note in place of 1, 2, 4 or 8 bytes."""
    size = int(2 ** rng.integers(4))
    number = int(one_of(INTEGERS, rng)) % 2 ** (8 * size)
    place = _place(data, rng)
    written: bytes = number.to_bytes(size, "little")
    return data[:place] + (written[::-1] if rng.integers(2) else written) + data[place + size :]


def _repeated(data: bytes, rng: Generator) -> bytes:
    start = _place(data, rng)
    part = data[start : start + int(rng.integers(1, 257))]
    return data[:start] + part * int(rng.integers(2, 9)) + data[start:]


def _swapped(data: bytes, rng: Generator) -> bytes:
    a, b, c = sorted(_place(data, rng) for _ in range(3))
    return data[:a] + data[b:c] + data[a:b] + data[c:]


BYTE_EDITS: tuple[Callable[[bytes, Generator], bytes], ...] = (
    *(_flip, _flip, _cut, _without, _inserted, _overwritten, _overwritten, _repeated, _swapped),
)


def mutated_text(data: bytes, rng: Generator) -> bytes:
    """Damage text in one or two places: its numbers, its lines, or its bytes."""
    for _ in range(rng.integers(1, 3)):
        if rng.random() < 0.1:
            data = mutated_bytes(data, rng)
        else:
            text = data.decode("utf-8", "replace")
            data = one_of(TEXT_EDITS, rng)(text, rng).encode("utf-8", "replace")
    return data


def _other_number(text: str, rng: Generator) -> str:
    found = list(NUMBER.finditer(text))
    if not found:
        return text + one_of(TOKENS, rng)
    match = one_of(found, rng)
    return text[: match.start()] + one_of(TOKENS, rng) + text[match.end() :]


def _scaled_number(text: str, rng: Generator) -> str:
    found = list(NUMBER.finditer(text))
    if not found:
        return text
    match = one_of(found, rng)
    number = float(match[0]) * float(one_of((-1.0, 0.0, 1e-6, 0.5, 2.0, 1e3, 1e9), rng))
    return text[: match.start()] + repr(number) + text[match.end() :]


def _other_word(text: str, rng: Generator) -> str:
    found = list(re.finditer(r"\S+", text))
    if not found:
        return text
    match = one_of(found, rng)
    return text[: match.start()] + one_of(TOKENS, rng) + text[match.end() :]


def _other_line(text: str, rng: Generator) -> str:
    lines = text.split("\n")
    k = int(rng.integers(len(lines)))
    j = int(rng.integers(len(lines)))
    kind = rng.integers(6)
    if kind == 0:
        del lines[k]
    elif kind == 1:
        lines.insert(j, lines[k])
    elif kind == 2:
        lines[k], lines[j] = lines[j], lines[k]
    elif kind == 3:
        lines[k:k] = [lines[k]] * int(rng.integers(2, 3000))
    elif kind == 4:
        lines[k] = lines[k] + lines[j]
    else:
        lines[k] = one_of(TOKENS, rng)
    return "\n".join(lines)


def _other_form(text: str, rng: Generator) -> str:
    old, new = one_of(((" ", ","), (",", " "), ("\n", "\r\n"), ("\n", "\r"), (" ", "\t")), rng)
    return one_of((text.replace(old, new), "\ufeff" + text, text * 2, text.upper(), ""), rng)


TEXT_EDITS: tuple[Callable[[str, Generator], str], ...] = (
    *(_other_number, _other_number, _scaled_number, _other_word, _other_line, _other_line),
    _other_form,
)


def mutated_value(value: Any, rng: Generator) -> Any:
    """Change one value somewhere in nested dicts and lists."""
    value = copy.deepcopy(value)
    for _ in range(rng.integers(1, 3)):
        value = _mutated_inside(value, rng)
    return value


def _mutated_inside(value: Any, rng: Generator) -> Any:
    is_container = isinstance(value, dict | list) and len(value) > 0
    if not is_container or rng.random() < 0.15:
        return _other_value(value, rng)
    keys = list(value) if isinstance(value, dict) else list(range(len(value)))
    key = one_of(keys, rng)
    kind = rng.random()
    if kind < 0.1:
        del value[key]
    elif kind < 0.15 and isinstance(value, dict):
        value[str(one_of(TOKENS, rng))] = value[key]
    elif kind < 0.2 and isinstance(value, list):
        value.append(copy.deepcopy(value[key]))
    else:
        value[key] = _mutated_inside(value[key], rng)
    return value


def _other_value(value: Any, rng: Generator) -> Any:
    kind = rng.random()
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if kind < 0.2 and is_number and abs(value) < 1e300:
        return value * one_of((-1, 0, 2, 0.5, 1e3, 1e-6), rng)
    if kind < 0.3:
        return [value]
    if kind < 0.4:
        return str(value)
    return copy.deepcopy(one_of(VALUES, rng))


def mutated_arrays(arrays: Arrays, rng: Generator) -> Arrays:
    """Change values, types, shapes or names of one or two arrays."""
    arrays = dict(arrays)
    for _ in range(rng.integers(1, 3)):
        name = one_of(sorted(arrays), rng)
        kind = rng.integers(12)
        if kind == 0:
            del arrays[name]
            if not arrays:
                return {"a": np.zeros(1)}
        elif kind == 1:
            arrays[one_of(("a", "é", "..", "__metadata__", name + "2"), rng)] = arrays[name]
        elif kind == 2:
            arrays[name] = arrays[one_of(sorted(arrays), rng)]
        else:
            arrays[name] = mutated_array(arrays[name], rng)
    return arrays


def mutated_array(array: np.ndarray[Any, Any], rng: Generator) -> np.ndarray[Any, Any]:
    """Change some values, the type, or the shape."""
    kind = rng.random()
    if kind < 0.6 and array.size:
        array = array.copy()
        flat = array.reshape(-1)
        places = rng.integers(array.size, size=one_of((1, 1, 3, array.size), rng))
        values = FLOATS if array.dtype.kind in "fc" else INTEGERS
        with np.errstate(all="ignore"):
            if array.dtype.kind in "fciu":
                flat[places] = np.array(one_of(values, rng)).astype(array.dtype)
            else:
                flat[places] = flat[places[::-1]]
        return array
    if kind < 0.8:
        with np.errstate(all="ignore"):
            try:
                return array.astype(one_of(DTYPES, rng))
            except (TypeError, ValueError, RuntimeError):  # the last one of dates as short bytes
                return np.zeros(0)
    shapes: tuple[Callable[[], np.ndarray[Any, Any]], ...] = (
        lambda: array.ravel(),
        lambda: array[None],
        lambda: array.T,
        lambda: array[:0] if array.ndim else array,
        lambda: array[: len(array) // 2] if array.ndim else array,
        lambda: array[::-1] if array.ndim else array,
        lambda: np.concatenate([array, array]) if array.ndim else array,
        lambda: np.array(0.0),
    )
    return one_of(shapes, rng)()


def mutated_archive(arrays: Arrays, rng: Generator) -> bytes:
    """Return an ``.npz`` file of right checksums with a member that is no array, or a liar."""
    buffer = io.BytesIO()
    chosen = one_of(sorted(arrays), rng)
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, array in arrays.items():
            member = io.BytesIO()
            np.save(member, array, allow_pickle=False)
            content = member.getvalue()
            if name == chosen:
                content = _lying_member(content, rng)
            if not (name == chosen and rng.random() < 0.1):
                archive.writestr(f"{name}.npy", content)
            if name == chosen and rng.random() < 0.1:
                archive.writestr(one_of((f"{name}.npy", name, "x", "a/b.npy"), rng), content)
    return buffer.getvalue()


def _lying_member(content: bytes, rng: Generator) -> bytes:
    """Return an ``.npy`` file whose header is another one; it keeps its length."""
    head, magic, rest = content[:128], content[:10], content[128:]
    if rng.random() < 0.4:
        return mutated_bytes(head, rng) + rest
    shape = one_of(("(1000000000000,)", "(-1,)", "(2,)", "()", "(0,)", "(99999, 99999)", "x"), rng)
    dtype = one_of(("<f8", "|O", "<U1000000", "|V0", "<M8[ns]", "[('a', '<f8')]", ""), rng)
    text = f"{{'descr': '{dtype}', 'fortran_order': False, 'shape': {shape}, }}"
    return magic + text.encode().ljust(117) + b"\n" + rest

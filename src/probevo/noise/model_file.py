"""The file format of learned noise models: safetensors with JSON metadata and a checksum.

A file holds plain data, never code. safetensors stores the entries of its metadata in random order;
all of ours is therefore a single entry, so that the same model gives the same bytes.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load, save

from probevo.arrays import AnyArray
from probevo.errors import InputError
from probevo.storage.files import write_atomically

FORMAT = "probevo-noise-model"
"""Name of the one entry of the metadata, a JSON object."""
KEYS = ("checksum", "facts", "kind", "version")
"""Keys of that object, sorted."""
VERSION = 1
DTYPES = ("float32", "float64", "int64", "int32", "bool", "uint8")
MAX_HEADER_BYTES = 100_000_000
"""Limit of safetensors itself."""
CURE = "Copy it again from where it came, or train it again."


@dataclass(frozen=True, eq=False)
class ModelFile:
    """The content of a file; only the class of the model knows what the names mean."""

    kind: str
    """Name of the kind of noise model in the registry."""
    arrays: Mapping[str, AnyArray]
    """Arrays of any shape, of a type in DTYPES; each kind decides whether NaN is valid."""
    facts: Mapping[str, Any]
    """Settings, columns, camera, training and so on, as JSON values: lists, not tuples."""


def write_model_file(path: Path, model: ModelFile) -> None:
    """Write a noise model, completely or not at all; the same model gives the same bytes.

    Raises:
        ValueError: an array is of a type not in DTYPES or named ``__metadata__``, or the facts
            would be read back differently (no JSON, NaN, tuples, keys that are no strings).
        InputError: the file cannot be written.
    """
    # Sorted and in native byte order, so that equal models have equal bytes and checksums.
    arrays = {name: np.asarray(model.arrays[name], order="C") for name in sorted(model.arrays)}
    for name, array in arrays.items():
        if name == "__metadata__":
            raise ValueError("safetensors keeps the name __metadata__ for itself; rename the array")
        if array.dtype.name not in DTYPES:
            raise ValueError(
                f"array {name}: type {array.dtype}; expected one of {', '.join(DTYPES)}"
            )
        arrays[name] = array.astype(array.dtype.newbyteorder("="), copy=False)
    # The facts must survive JSON unchanged; otherwise the model that is read would be another one.
    envelope: dict[str, Any] = {"facts": dict(model.facts), "kind": model.kind, "version": VERSION}
    try:
        survives = json.loads(_canonical(envelope)) == envelope
    except (TypeError, ValueError) as error:
        raise ValueError(f"kind or facts are not JSON: {error}") from error
    if not survives:
        raise ValueError(
            "kind or facts change when they pass through JSON: use lists for tuples, strings for"
            " keys"
        )
    envelope["checksum"] = _checksum(envelope, arrays)
    write_atomically(path, save(arrays, {FORMAT: _canonical(envelope)}))


def read_model_file(path: Path) -> ModelFile:
    """Read a noise model; its arrays are writable and not shared.

    Raises:
        InputError: the file cannot be read, is no noise model, has a newer format, or is damaged.
            A change of any byte is detected, unless the same model is read nevertheless.
    """
    try:
        if path.exists() and not path.is_file():
            raise InputError(
                path,
                "this is a folder or device, not a file.",
                "Name the .safetensors file itself.",
            )
        # The metadata decide whether this is a file of ours before all of it is loaded.
        with path.open("rb") as stream:
            envelope = _check_envelope(path, _read_metadata(path, stream))
            stream.seek(0)
            content = stream.read()
    except FileNotFoundError:
        cure = "Name a model file (.safetensors) that `probevo train` has written."
        raise InputError(path, "this file is missing.", cure) from None
    except OSError as error:
        raise InputError(
            path, f"cannot be read: {error.strerror}", "Name a .safetensors noise model."
        ) from error
    # The checksum covers everything but itself.
    claimed = envelope.pop("checksum")
    try:
        arrays = dict(sorted(load(content).items()))
        checksum = _checksum(envelope, arrays)
    except (SafetensorError, KeyError, ValueError, OverflowError, RecursionError) as error:
        # A KeyError means an array type that NumPy does not have.
        raise InputError(path, f"damaged or cut short: {error}.", CURE) from error
    if checksum != claimed:
        raise InputError(path, "damaged: its content does not match its checksum.", CURE)
    for name, array in arrays.items():
        if array.dtype.name not in DTYPES:
            raise InputError(
                f"{path}: {name}", f"type {array.dtype}; expected one of {', '.join(DTYPES)}.", CURE
            )
    return ModelFile(envelope["kind"], arrays, envelope["facts"])


def _canonical(value: Any) -> str:
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)


def _checksum(envelope: Mapping[str, Any], arrays: Mapping[str, AnyArray]) -> str:
    """Compute SHA-256 over the metadata, and the names, types, shapes and bytes of the arrays.

    Args:
        envelope: the metadata without the checksum.
        arrays: the arrays, sorted by name.
    """
    # Measured on 10⁶ samples, 56 MB, which take 0.09 s to read: SHA-256 31 ms (102 ms on a CPU
    # without SHA instructions), BLAKE2b 59 ms, CRC-32 13 ms. SHA-256 is affordable on both, and
    # accidental matches are excluded.
    shapes = [[name, array.dtype.name, array.shape] for name, array in arrays.items()]
    digest = hashlib.sha256(_canonical([envelope, shapes]).encode())
    for array in arrays.values():
        digest.update(array.data)
    return digest.hexdigest()


def _read_metadata(path: Path, stream: BinaryIO) -> str:
    """Read our entry of the metadata.

    Only the header is read, so that a foreign file of many GB is refused without loading it.
    """
    # A safetensors file begins with the length of its JSON header, eight bytes, and that header.
    size = int.from_bytes(stream.read(8), "little")
    raw = stream.read(size) if size <= MAX_HEADER_BYTES else b""
    try:
        header = json.loads(raw.decode())
    except (ValueError, RecursionError) as error:
        raise InputError(
            path, "this is not a safetensors file, or it is damaged or cut short.", CURE
        ) from error
    metadata = header.get("__metadata__") if isinstance(header, dict) else None
    entry = metadata.get(FORMAT) if isinstance(metadata, dict) else None
    if not isinstance(entry, str):
        what = f"this is not a noise model of probevo: its metadata lacks {FORMAT}."
        raise InputError(path, what, "Name a .safetensors file that probevo has trained.")
    return entry


def _check_envelope(path: Path, text: str) -> dict[str, Any]:
    """Parse our entry of the metadata, and check that it has exactly KEYS, each of its type."""
    try:
        envelope = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(
            f"{path}: {FORMAT}", f"damaged: the metadata are not JSON ({error}).", CURE
        ) from error
    # The version comes first: a newer format may have other keys.
    version = envelope.get("version") if isinstance(envelope, dict) else None
    if type(version) is not int:
        raise InputError(f"{path}: {FORMAT}", "damaged: the metadata give no version.", CURE)
    if version > VERSION:
        what = f"written by a newer probevo: format {version}, and this one reads up to {VERSION}."
        raise InputError(
            f"{path}: version", what, "Update probevo, or train the model again with this one."
        )
    if version < VERSION:
        raise InputError(
            f"{path}: version", f"there is no format {version}; expected {VERSION}.", CURE
        )
    if sorted(envelope) != list(KEYS):
        what = (
            f"damaged: the metadata have the keys {', '.join(sorted(envelope))}; expected"
            f" {', '.join(KEYS)}."
        )
        raise InputError(f"{path}: {FORMAT}", what, CURE)
    # With exactly these keys, each must be of its type.
    for key, kind, name in (
        ("checksum", str, "text"),
        ("facts", dict, "a JSON object"),
        ("kind", str, "text"),
    ):
        if not isinstance(envelope[key], kind):
            raise InputError(
                f"{path}: {key}", f"damaged: {str(envelope[key])[:40]!r} is not {name}.", CURE
            )
    return dict(envelope)

"""A learned noise model as a file: safetensors with JSON metadata and a checksum; plain data, never
code.

safetensors keeps its metadata in random order, so all of ours is one entry: the same model gives
the same bytes.
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
from probevo.files import write_atomically

FORMAT = "probevo-noise-model"
"""The one entry of the metadata: a JSON object of these keys."""
KEYS = ("checksum", "facts", "kind", "version")
VERSION = 1
DTYPES = ("float32", "float64", "int64", "int32", "bool", "uint8")
MAX_HEADER_BYTES = 100_000_000
"""safetensors' own limit."""
CURE = "Copy it again from where it came, or train it again."


@dataclass(frozen=True, eq=False)
class ModelFile:
    """What a noise model is stored as; its class alone knows what the names mean."""

    kind: str
    """Which noise model this is: ``knn`` …"""
    arrays: Mapping[str, AnyArray]
    """Arrays of any shape, of the types DTYPES; whether NaN has a meaning is for the kind to say.
    """
    facts: Mapping[str, Any]
    """Settings, predictor columns, camera, hashes of the training data …: JSON, so lists and no
    tuples."""


def write_model_file(path: Path, model: ModelFile) -> None:
    """Write a noise model, whole or not at all; the same model gives the same bytes.

    Raises:
        ValueError: an array is of a type not in DTYPES or named ``__metadata__``, or the facts
            would not read back as they are (not JSON, NaN, tuples, keys that are no strings).
        InputError: the place cannot be written to.
    """
    arrays = {name: np.asarray(model.arrays[name], order="C") for name in sorted(model.arrays)}
    for name, array in arrays.items():
        if name == "__metadata__":
            raise ValueError("safetensors keeps the name __metadata__ for itself; rename the array")
        if array.dtype.name not in DTYPES:
            raise ValueError(
                f"array {name}: type {array.dtype}; expected one of {', '.join(DTYPES)}"
            )
        arrays[name] = array.astype(array.dtype.newbyteorder("="), copy=False)
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
    """Read a noise model; each array is writable and owned by the caller alone.

    Raises:
        InputError: the file cannot be read, is no noise model, is of a newer format, or is damaged:
            a changed byte anywhere is noticed unless the very same model is read.
    """
    try:
        if path.exists() and not path.is_file():
            raise InputError(
                path,
                "this is a folder or device, not a file.",
                "Name the .safetensors file itself.",
            )
        with path.open("rb") as stream:
            envelope = _check_envelope(path, _read_metadata(path, stream))
            stream.seek(0)
            content = stream.read()
    except OSError as error:
        raise InputError(
            path, f"cannot be read: {error.strerror}", "Name a .safetensors noise model."
        ) from error
    claimed = envelope.pop("checksum")
    try:
        arrays = dict(sorted(load(content).items()))
        checksum = _checksum(envelope, arrays)
    except (
        SafetensorError,
        KeyError,
        ValueError,
        OverflowError,
    ) as error:  # KeyError: a type unknown to NumPy
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
    """Over all that the file says but the checksum itself; arrays in the order of their names."""
    # Measured on 10⁶ samples, 56 MB, of which reading takes 0.09 s: SHA-256 31 ms (102 ms where the
    # CPU has no SHA instructions), BLAKE2b 59 ms, CRC-32 13 ms. SHA-256 is affordable on both and
    # never matches by accident.
    shapes = [[name, array.dtype.name, array.shape] for name, array in arrays.items()]
    digest = hashlib.sha256(_canonical([envelope, shapes]).encode())
    for array in arrays.values():
        digest.update(array.data)
    return digest.hexdigest()


def _read_metadata(path: Path, stream: BinaryIO) -> str:
    """Our entry of the metadata: the header alone is read, lest a foreign file of many GB be loaded
    to be refused."""
    size = int.from_bytes(stream.read(8), "little")
    raw = stream.read(size) if size <= MAX_HEADER_BYTES else b""
    try:
        header = json.loads(raw.decode())
    except (ValueError, RecursionError) as error:
        raise InputError(
            path, "this is no safetensors file, or it is damaged or cut short.", CURE
        ) from error
    metadata = header.get("__metadata__") if isinstance(header, dict) else None
    entry = metadata.get(FORMAT) if isinstance(metadata, dict) else None
    if not isinstance(entry, str):
        what = f"this is no noise model of probevo: its metadata lacks {FORMAT}."
        raise InputError(path, what, "Name a .safetensors file that probevo has trained.")
    return entry


def _check_envelope(path: Path, text: str) -> dict[str, Any]:
    """What stands in our entry of the metadata, with exactly KEYS, each of its type."""
    try:
        envelope = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(
            f"{path}: {FORMAT}", f"damaged: the metadata are not JSON ({error}).", CURE
        ) from error
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

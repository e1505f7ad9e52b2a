"""Networks and unfinished trainings on disk: safetensors with JSON facts and a checksum.

A file holds plain arrays, never code. Whoever reads it makes the same structure first, and fills in
the arrays.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import jax
import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from probevo.arrays import AnyArray
from probevo.errors import InputError
from probevo.storage.files import check_regular, write_atomically

FORMAT = "probevo-network"
"""Name of the one entry of the metadata, a JSON object: with several, their order would vary."""
NOISE_MODEL = "probevo-noise-model"
"""The one entry of a noise model's file instead (``noise.model_file``)."""
VERSION = 1
"""Version of the format."""
MAX_BYTES = 10_000_000_000
CURE = "Copy it again from where it came, or train it again."
CURE_OF_VERSION = "It is probably of another version of probevo: train again with this one."
"""Arrays with a right checksum are as they were written."""

CURE_OF_FORMAT = "Update probevo, or train it again with this version."

Tree = TypeVar("Tree")


def write_network_file(path: Path, tree: Any, facts: Mapping[str, Any]) -> None:
    """Write the arrays of a structure, completely or not at all; the same give the same bytes.

    Args:
        path: the file.
        tree: networks, states of optimisers, or a tuple of such.
        facts: JSON values.

    Raises:
        InputError: the file cannot be written.
    """
    arrays = named_arrays(tree)
    text = json.dumps(facts, sort_keys=True, allow_nan=False)
    entry = {"checksum": _checksum(text, arrays), "facts": text, "version": VERSION}
    write_atomically(path, save(arrays, {FORMAT: json.dumps(entry, sort_keys=True)}))


def read_facts(path: Path) -> dict[str, Any]:
    """Read what a file says of itself.

    Raises:
        InputError: the file cannot be read, is damaged, or holds no networks.
    """
    return _read(path)[0]


def read_network_file(path: Path, tree: Tree) -> Tree:
    """Return a structure with the arrays of a file in place of its own.

    Args:
        path: the file.
        tree: a structure of the same arrays; only their names, shapes and types are used.

    Raises:
        InputError: the file cannot be read, is damaged, or has other arrays.
    """
    arrays = _read(path)[1]
    expected = named_arrays(tree)
    for name, array in expected.items():
        stored = arrays.get(name)
        if stored is None or stored.shape != array.shape or stored.dtype != array.dtype:
            has = "is missing" if stored is None else f"is {stored.dtype} {list(stored.shape)}"
            what = f"{has}; expected {array.dtype} {list(array.shape)}."
            raise InputError(f"{path}: {name}", what, CURE_OF_VERSION)
    if len(arrays) > len(expected):
        surplus = sorted(set(arrays) - set(expected))[0]
        what = "is an array that this network lacks."
        raise InputError(f"{path}: {surplus}", what, CURE_OF_VERSION)
    # Fill the arrays into the places of the structure that gave them their names.
    leaves, structure = jax.tree_util.tree_flatten_with_path(tree)
    filled = [jax.numpy.asarray(arrays[_name(place)]) for place, _ in leaves]
    restored: Tree = jax.tree_util.tree_unflatten(structure, filled)
    return restored


def named_arrays(tree: Any) -> dict[str, AnyArray]:
    """Return the arrays of a structure by the names of their places, sorted."""
    leaves = jax.tree_util.tree_flatten_with_path(tree)[0]
    arrays = {_name(place): np.asarray(leaf) for place, leaf in leaves}
    return dict(sorted(arrays.items()))


def _name(place: Any) -> str:
    return str(jax.tree_util.keystr(place))


def _read(path: Path) -> tuple[dict[str, Any], dict[str, AnyArray]]:
    """Read and check all of a file."""
    check_regular(path, MAX_BYTES)
    try:
        with safe_open(path, framework="numpy") as file:
            metadata = file.metadata() or {}
            if NOISE_MODEL in metadata:
                what = "this is a noise model, not a network."
                raise InputError(path, what, "Give it with --noise.")
            entry = json.loads(metadata[FORMAT])
            # The version comes first: another format may have other keys. A file without a version
            # is older than the first.
            version = entry.get("version", 0)
            if version != VERSION:
                what = f"it has format {version}, and this version of probevo reads {VERSION}."
                raise InputError(f"{path}: version", what, CURE_OF_FORMAT)
            arrays = {name: file.get_tensor(name) for name in sorted(file.keys())}
        text = entry["facts"]
        facts = json.loads(text)
        claimed = entry["checksum"]
    except FileNotFoundError:
        cure = "Name a file that `probevo train` has written with --kind of a sensor."
        raise InputError(path, "this file is missing.", cure) from None
    except OSError as error:
        raise InputError(path, f"cannot be read: {error.strerror or error}.", CURE) from error
    except KeyError as error:
        what = f"is not a network of probevo: it lacks {error}."
        cure = "Name a file that `probevo train` has written with --kind of a sensor."
        raise InputError(path, what, cure) from error
    except (AttributeError, SafetensorError, TypeError, ValueError) as error:
        raise InputError(path, f"is damaged, or no network: {error}.", CURE) from error
    if not isinstance(facts, dict) or claimed != _checksum(text, arrays):
        raise InputError(path, "damaged: its content does not match its checksum.", CURE)
    return facts, arrays


def _checksum(text: str, arrays: Mapping[str, AnyArray]) -> str:
    """Compute SHA-256 over the facts, and the names, types, shapes and bytes of sorted arrays."""
    shapes = [[name, array.dtype.name, list(array.shape)] for name, array in arrays.items()]
    digest = hashlib.sha256(json.dumps([text, shapes]).encode())
    for array in arrays.values():
        digest.update(array.tobytes())
    return digest.hexdigest()

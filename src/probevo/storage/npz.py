"""``.npz`` archives: written whole, and read although they may be damaged, or claim more than they
hold."""

from __future__ import annotations

import io
import math
import os
import zipfile
from collections.abc import Collection, Mapping
from pathlib import Path

import numpy as np
from numpy.lib import format as npy

from probevo.arrays import AnyArray
from probevo.storage.files import NO_ARCHIVE, check_regular, write_atomically

MAX_FILE_BYTES = 100_000_000_000
MAX_ARRAY_BYTES = 1 << 31
"""67 million observations, those of four hours at 10 Hz and 450 features a frame."""
END_BYTES = 22
"""Size of the record that ends an archive, without its comment."""
NUM_MEMBERS = slice(10, 12)
"""Bytes of it with the number of members."""
ZIP64 = 0xFFFF
"""Number that stands for a larger one, which is elsewhere."""
NO_NPZ = (*NO_ARCHIVE, RuntimeError)
"""The exceptions of ``read_npz``; a RuntimeError is an encrypted member, or nested too deeply."""


def write_npz(path: Path, arrays: Mapping[str, AnyArray], *, is_compressed: bool = False) -> None:
    """Write arrays by their names, completely or not at all; the same arrays give the same bytes.

    Raises:
        InputError: the file cannot be written.
    """
    buffer = io.BytesIO()
    save = np.savez_compressed if is_compressed else np.savez
    # allow_pickle is not passed: NumPy 2.0 would store it as an array.
    save(buffer, **arrays)  # type: ignore[arg-type]
    write_atomically(path, buffer.getvalue())


def read_npz(path: Path, names: Collection[str] | None = None) -> dict[str, AnyArray]:
    """Read arrays of an archive, without unpickling anything.

    The size that each array claims is compared with that of its member before it is allocated.

    Args:
        path: the file.
        names: arrays to read, as far as they exist; None for all.

    Raises:
        InputError: the file is not a regular one.
        OSError, ValueError and the others of NO_NPZ: it is no archive of plain arrays.
    """
    check_regular(path, MAX_FILE_BYTES)
    with zipfile.ZipFile(path) as archive:
        members = {member.filename.removesuffix(".npy"): member for member in archive.infolist()}
        _check_directory(path, archive)
        chosen = [name for name in members if names is None or name in names]
        return {name: _read_array(archive, members[name]) for name in chosen}


def _check_directory(path: Path, archive: zipfile.ZipFile) -> None:
    """Check that the directory of an archive is whole, which no checksum covers.

    Raises:
        ValueError: it holds no arrays, or another number of them than it says.
    """
    num_members = len(archive.infolist())
    if not num_members:
        raise ValueError("it holds no arrays")
    with path.open("rb") as stream:
        stream.seek(-END_BYTES - len(archive.comment), os.SEEK_END)
        end = stream.read(END_BYTES)
    claimed = int.from_bytes(end[NUM_MEMBERS], "little")
    if claimed not in (num_members, ZIP64):
        raise ValueError(f"its directory says {claimed} arrays, and names {num_members}")


def _read_array(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> AnyArray:
    """Read one array.

    Raises:
        ValueError: it is no array, holds objects, or is larger or smaller than its member.
    """
    with archive.open(member) as stream:
        version = npy.read_magic(stream)
        if version == (1, 0):
            shape, _, dtype = npy.read_array_header_1_0(stream)
        else:
            shape, _, dtype = npy.read_array_header_2_0(stream)
        if dtype.hasobject:
            raise ValueError(f"Object arrays, such as {member.filename}, are not read")
        claimed = math.prod(shape) * dtype.itemsize
        if claimed != member.file_size - stream.tell():
            raise ValueError(f"{member.filename} is not as large as its shape {shape} says")
        if claimed > MAX_ARRAY_BYTES:
            raise ValueError(f"{member.filename} has {claimed:,} bytes")
    with archive.open(member) as stream:
        return np.asarray(npy.read_array(stream, allow_pickle=False))

"""Archives of arrays: what is damaged is refused, although no checksum covers all of it."""

import zipfile
from pathlib import Path

import numpy as np
import pytest

from probevo.storage.npz import NO_NPZ, read_npz, write_npz


def test_what_is_written_is_read(tmp_path: Path) -> None:
    write_npz(tmp_path / "a.npz", {"a": np.arange(3), "b": np.eye(2)})
    arrays = read_npz(tmp_path / "a.npz")
    assert arrays.keys() == {"a", "b"}
    np.testing.assert_array_equal(arrays["b"], np.eye(2))


def test_an_archive_whose_directory_was_zeroed_is_not_an_empty_one(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    np.savez(path, a=np.arange(3))
    content = bytearray(path.read_bytes())
    content[-14:] = bytes(14)  # number of members, size and place of the directory
    path.write_bytes(content)
    with pytest.raises(NO_NPZ, match="no arrays"):
        read_npz(path)


def test_members_that_the_directory_loses_are_missed(tmp_path: Path) -> None:
    """A comment that claims to be long swallows those behind it."""
    path = tmp_path / "a.npz"
    np.savez(path, a=np.arange(3), b=np.eye(2))
    content = bytearray(path.read_bytes())
    entry = content.index(b"PK\x01\x02")
    content[entry + 32 : entry + 34] = b"\xff\xff"  # length of the first member's comment
    path.write_bytes(content)
    with pytest.raises(NO_NPZ, match="says 2 arrays, and names 1"):
        read_npz(path)


def test_an_archive_with_a_comment_is_read(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    np.savez(path, a=np.arange(3))
    with zipfile.ZipFile(path, "a") as archive:
        archive.comment = b"of a drive"
    assert read_npz(path).keys() == {"a"}

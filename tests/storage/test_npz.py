"""Archives of arrays: what is damaged is refused, although no checksum covers all of it."""

from pathlib import Path

import numpy as np
import pytest

from probevo.storage.npz import NO_NPZ, read_npz


def test_what_is_written_is_read(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", a=np.arange(3), b=np.eye(2))
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

"""The work of a training on disk: samples come back as they were, damaged ones not at all."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("jax", reason="jax is missing: pip install 'probevo[nets]'")
pytest.importorskip("equinox")

from nets.small_pairs import small_pairs
from probevo.nets.image_pairs import ImagePairs
from probevo.nets.recorded_training import read_samples, write_samples


def test_a_file_gives_the_samples_back_and_a_damaged_one_none(tmp_path: Path) -> None:
    pairs = small_pairs(3)
    file = tmp_path / "pairs.npz"
    write_samples(file, pairs)
    found = read_samples(file, ImagePairs)
    assert found is not None
    np.testing.assert_array_equal(found.fields, pairs.fields)
    np.testing.assert_array_equal(found.rotations, pairs.rotations)
    file.write_bytes(file.read_bytes()[:200])
    assert read_samples(file, ImagePairs) is None
    assert read_samples(tmp_path / "missing.npz", ImagePairs) is None


def test_samples_of_another_kind_are_none(tmp_path: Path) -> None:
    file = tmp_path / "pairs.npz"
    np.savez(file, views=np.zeros(3))
    assert read_samples(file, ImagePairs) is None

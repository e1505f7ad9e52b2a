"""The work of a training on disk: samples come back as they were, damaged ones not at all."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("jax", reason="jax is missing: pip install 'probevo[nets]'")
pytest.importorskip("equinox")

from nets.small_networks import INPUTS, build
from nets.small_pairs import small_pairs
from probevo.config.networks import NetworkSettings
from probevo.nets import recorded_training
from probevo.nets.image_pairs import ImagePairs
from probevo.nets.learning import Learned, LearningPlan
from probevo.nets.methods import Method
from probevo.nets.recorded_training import TrainingRun, read_samples, write_samples
from probevo.nets.target_space import RotationTargets


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


def test_fewer_data_than_a_batch_are_one_batch(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """They were refused, after the odometry had run over all recordings."""
    batches = []

    def learn(*_: object, plan: LearningPlan, **__: object) -> Learned:
        batches.append(plan.batch)
        return Learned((), epochs=1, kept_epoch=1)

    monkeypatch.setattr(recorded_training, "learn", learn)
    run = TrainingRun(
        "rotation",
        NetworkSettings(batch=32),
        recordings=[],
        origins=[],
        num_frames=20,
        folder=tmp_path,
        extra=None,
        on_progress=lambda done, total: None,
    )
    data = (np.zeros((20, INPUTS)), np.tile([1.0, 0.0, 0.0, 0.0], (20, 1)))
    method = Method("sigma", learns_covariance=True)
    for augment in (None, lambda fields, rotations, key: (fields, rotations)):
        run.learn(method, RotationTargets(), build, learned=data, left_out=data, augment=augment)
    assert batches == [20, 32]

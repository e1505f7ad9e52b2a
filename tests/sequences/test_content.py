"""Recordings are recognised by what they show."""

import shutil
from pathlib import Path

import pytest

import probevo as pv
from probevo.sequences.content import SeenRecording, digests_of_first_frames, is_among
from probevo.sequences.without_imu import WithoutImu
from probevo_sim.point_world import write_points
from training.supervised_drives import point_world


@pytest.fixture(scope="module")
def drives(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive, a copy of it under another name, and another drive of the same name."""
    root = tmp_path_factory.mktemp("drives")
    for seed, name in enumerate(("day", "night")):
        (root / name).mkdir()
        write_points(point_world(seed=seed, frames=8, landmarks=200), root / name / "train.npz")
    shutil.copy(root / "day" / "train.npz", root / "copy.npz")
    return root


def test_a_copy_has_been_seen_and_another_drive_of_the_same_name_has_not(drives: Path) -> None:
    train = pv.open_sequence(drives / "day" / "train.npz")
    seen = [SeenRecording("train.npz", digests_of_first_frames(train).view)]
    names = ("day/train.npz", "copy.npz", "night/train.npz")
    found = [is_among(pv.open_sequence(drives / name), seen) for name in names]
    assert found == [True, True, False]
    assert is_among(WithoutImu.of(train), seen)


def test_without_a_digest_the_name_decides(drives: Path) -> None:
    seen = [SeenRecording("train.npz", None)]
    names = ("day/train.npz", "copy.npz", "night/train.npz")
    found = [is_among(pv.open_sequence(drives / name), seen) for name in names]
    assert found == [True, False, True]

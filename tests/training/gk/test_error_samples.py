"""What the E-step over all drives hands to the fit: above all, which errors are left out together."""

import numpy as np
import pytest
from training.supervised_drives import drive_of, known, point_world

from probevo.noise import StudentT
from probevo.training.gk.evidence import BLOCKS_A_DRIVE, STEPS_A_BLOCK, blocks_of, gather_evidence
from probevo.training.settings import TrainSettings
from probevo.training.supervised_drive import DriveInMemory
from probevo.training.workers import Workers

N = STEPS_A_BLOCK


@pytest.mark.parametrize(
    ("steps", "blocks"),
    [
        ([100 * N], [BLOCKS_A_DRIVE]),
        ([5 * N - 1], [4]),
        ([3, 2 * N, N - 1], [1, 2, 1]),
        ([N, 1], [1, 1]),
        ([N + 1], [2]),
        ([1], [2]),
        ([0, 5], [1, 1]),
    ],
)
def test_no_block_is_short_but_where_a_single_drive_is(steps: list[int], blocks: list[int]) -> None:
    assert blocks_of(steps) == blocks


def groups_of(*frames: int) -> list[int]:
    """How many there are of each of these drives."""
    worlds = [point_world(frames=count, landmarks=200) for count in frames]
    drives = [DriveInMemory(drive_of(world), world.camera, known(world)) for world in worlds]
    settings = TrainSettings(kind="gk", supervision="gt", predictors=("place",))
    groups = gather_evidence(
        drives, StudentT(), settings, workers=Workers(), on_part=lambda _: None
    ).groups
    assert (np.diff(groups) >= 0).all()
    return np.bincount(np.unique(groups) // BLOCKS_A_DRIVE).tolist()


def test_short_drives_are_left_out_as_a_whole() -> None:
    """Else the tracks of a block that is left out go on in the next."""
    assert groups_of(10, N, 2 * N + 1) == [1, 1, 2]


def test_a_single_short_drive_is_cut_in_two() -> None:
    assert groups_of(10) == [2]

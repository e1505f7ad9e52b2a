"""The E-step over all drives: how drives are cut into blocks that are left out together."""

import numpy as np
import pytest

from probevo.noise import StudentT
from probevo.noise.metric import Metric
from probevo.training.gk.error_samples import (
    BLOCKS_A_DRIVE,
    STEPS_A_BLOCK,
    blocks_of,
    gather_error_samples,
)
from probevo.training.settings import TrainSettings
from probevo.training.trainer import TrainingContext
from training.supervised_drives import drive_of, in_memory, point_world

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
    """Return how many blocks there are of each drive with so many frames."""
    worlds = [point_world(frames=count, landmarks=200) for count in frames]
    drives = [in_memory(drive_of(world), world, "gt") for world in worlds]
    settings = TrainSettings(kind="gk", supervision="gt", predictors=("place",))
    metric = Metric.fitted(drives[0].drive.phi)
    context = TrainingContext(drives=drives, metric=metric, settings=settings)
    groups = gather_error_samples(context, StudentT(), lambda share: None).groups
    assert (np.diff(groups) >= 0).all()
    counts: list[int] = np.bincount(np.unique(groups) // BLOCKS_A_DRIVE).tolist()
    return counts


def test_short_drives_are_left_out_as_a_whole() -> None:
    """Otherwise the tracks of a block that is left out would go on in the next."""
    assert groups_of(10, N, 2 * N + 1) == [1, 1, 2]


def test_a_single_short_drive_is_cut_in_two() -> None:
    assert groups_of(10) == [2]
